"""The plan that tests of commands share."""

import pytest

from limb_systems import LimbParameters, SegmentParameters, Trajectory
from planners import plan, references


@pytest.fixture(scope="session")
def short_plan() -> Trajectory:
    """A plan of two joints that bend by 3° in 2 s."""
    limb = LimbParameters(segments=[SegmentParameters(links=2)])
    return plan(limb, references.from_samples([0.0, 2.0], [0.0, 0.05]))
