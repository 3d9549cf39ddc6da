"""What several test files share, and which tests run beside each other.

Two workers of pytest-xdist, as in pyproject.toml, run the tests: a file is on one worker, so
that what its tests share is made once. What is timed is on one worker as well, so that no two
such tests run beside each other; they wait most of the time, and leave the other core alone.
"""

import os

import pytest

# A worker for each core: more threads would only wait for each other. Before numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from limb_systems import LimbParameters, SegmentParameters, Trajectory
from planners import plan, references


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Groups tests as above, the longest groups first."""
    for item in items:
        if "emulator" in item.fixturenames:
            item.add_marker(pytest.mark.xdist_group("real_time"))
        elif not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
    first = ["real_time", "test_reproduce_paper"]
    groups = {item: item.get_closest_marker("xdist_group").args[0] for item in items}
    items.sort(key=lambda item: first.index(groups[item]) if groups[item] in first else len(first))


@pytest.fixture(scope="session")
def fig5_plan() -> Trajectory:
    """The plan of the paper's Fig. 5 reference for the nominal limb, 10 Hz knots over 60 s."""
    return plan(LimbParameters(), references.step_and_decaying_sine())


@pytest.fixture
def two_segments() -> LimbParameters:
    """Two unlike segments in series, of two and three links."""
    tip = SegmentParameters(links=3, length=0.06, mass=0.010, stiffness=0.08)
    tip.wire("left").law.beta, tip.wire("right").law.beta = 2.5e-4, 3.0e-4
    tip.wire("left").law.a1, tip.wire("right").law.a2 = -0.09, 26.0
    return LimbParameters(segments=[SegmentParameters(links=2), tip])
