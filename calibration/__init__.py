"""Calibration of a limb's parameters from recordings (Sec. V)."""
