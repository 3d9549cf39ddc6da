"""Gaits of robots that stand on limbs: the program, its mechanics and what checks them."""
