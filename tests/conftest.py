"""What several test files share."""

import pytest

from limb_systems import LimbParameters, SegmentParameters, Trajectory
from planners import Task, plan, references


@pytest.fixture(scope="session")
def fig5_plan() -> Trajectory:
    """The paper's plan of its Fig. 5 reference for the nominal limb, 10 Hz knots over 60 s."""
    return plan(LimbParameters(), references.step_and_decaying_sine(), task=Task.paper())


@pytest.fixture
def two_segments() -> LimbParameters:
    """Two unlike segments in series, of two and three links."""
    tip = SegmentParameters(links=3, length=0.06, mass=0.010, stiffness=0.08)
    tip.wire("left").law.beta, tip.wire("right").law.beta = 2.5e-4, 3.0e-4
    tip.wire("left").law.a1, tip.wire("right").law.a2 = -0.09, 26.0
    return LimbParameters(segments=[SegmentParameters(links=2), tip])
