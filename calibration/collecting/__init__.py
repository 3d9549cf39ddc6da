"""Collecting recordings from a robot or an emulated limb."""
