"""The robot, its emulated twin, and the replay of trajectories on them."""

import lazy_loader

# What `__init__.pyi` imports, each name when it is first used: some take a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
