"""Calibration by prediction error: laws of the wires, fitted to all heated recordings."""
