"""Systems are freed when nobody needs them: plans in a loop must not fill the memory."""

import gc
import weakref
from pathlib import Path

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from hardware import LimbTwin, Station
from limb_systems import JouleHeating, Limb, LimbActuation, LimbParameters, simulate
from planners import TrajectoryProgram
from walking import Robot


def limb_in_a_diagram():
    builder = DiagramBuilder()
    limb = builder.AddSystem(Limb())
    builder.ExportInput(limb.GetInputPort("duty"))
    builder.Build()
    return limb


def simulated_limb():
    limb = Limb()
    simulate(limb, [0.0, 0.1], 0.2)
    return limb


def two_in_a_diagram():
    """Drake would refuse systems of one name."""
    builder = DiagramBuilder()
    for make in [Limb, LimbTwin, Robot, LimbActuation, lambda: JouleHeating(LimbParameters())]:
        for _ in range(2):
            builder.AddSystem(make())
    return builder.Build()


GRIPPER = Path(__file__).parents[2] / "examples" / "gripper" / "scenario.yaml"


def test_system_is_freed():
    for make in [
        Limb,
        LimbTwin,
        lambda: JouleHeating(LimbParameters()),
        limb_in_a_diagram,
        simulated_limb,
        lambda: TrajectoryProgram(LimbParameters(), np.linspace(0.0, 1.0, 3)).limb,
        lambda: LimbActuation().ToAutoDiffXd(),
        Robot,
        two_in_a_diagram,
        lambda: Station(GRIPPER),
    ]:
        system = make()
        reference = weakref.ref(system)
        del system
        gc.collect()
        assert reference() is None
