"""Recordings for calibration: their kinds, checks, repair, and what a cold limb shows in them."""
