"""The error of this package."""

from limb_systems import LimbError


class CalibrationError(LimbError):
    """Recordings are missing or tell nothing about what is to be calibrated."""
