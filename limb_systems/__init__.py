"""A soft limb bent by shape-memory-alloy wires, as Drake systems."""

import lazy_loader

from limb_systems.startup import check_shadows, let_ctrl_c_end_imports

let_ctrl_c_end_imports()
check_shadows()

# What `__init__.pyi` imports, each name when it is first used: some take a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
