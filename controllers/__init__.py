"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

import lazy_loader

# What `__init__.pyi` imports, each name when it is first used: some take a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
