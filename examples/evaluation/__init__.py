"""The paper's evaluation on emulated limbs: what `examples/reproduce_paper.py` is made of."""
