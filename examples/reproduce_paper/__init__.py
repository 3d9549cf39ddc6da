"""The paper's evaluation on emulated limbs, which `python examples/reproduce_paper` runs."""
