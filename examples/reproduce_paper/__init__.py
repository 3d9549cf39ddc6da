"""The paper's evaluation on emulated limbs: `soft-limb demo`, `examples/reproduce_paper.py`."""
