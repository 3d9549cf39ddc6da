"""The model: what a limb is, and its parts as Drake systems, in the paper's order."""
