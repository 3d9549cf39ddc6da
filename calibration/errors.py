"""The error of this package."""

from limb_systems import LimbError


class CalibrationError(LimbError):
    """Recordings are missing, or a parameter cannot be estimated from them."""
