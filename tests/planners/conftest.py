"""What tests of planners share: laws of wires, which they import, and a limb for short plans."""

import sys
from pathlib import Path

from limb_systems import LimbParameters

sys.path.insert(0, str(Path(__file__).parent))


def cold_parameters(**changes) -> LimbParameters:
    """Return a limb without the warm-up (20), for short plans."""
    parameters = LimbParameters(**changes)
    parameters.temperature_limits.warm_up_time = 1000.0
    return parameters
