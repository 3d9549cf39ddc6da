"""Runs of limbs: a plan replayed, a motion taught and followed, repetitions."""
