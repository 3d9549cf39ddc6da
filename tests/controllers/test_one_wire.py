"""A limb of one wire through plan, replay with feedback, learning and horizon.

Drake returns a vector for a matrix of one column, which numpy then broadcasts.
"""

import numpy as np
import pytest

from controllers import Learner, RecedingHorizon
from hardware import replay
from limb_systems import Limb, LimbParameters, simulate
from planners import plan, references


@pytest.fixture(scope="module")
def one_wire() -> LimbParameters:
    parameters = LimbParameters()
    segment = parameters.segments[0]
    segment.links, segment.wires = 2, segment.wires[1:]
    parameters.temperature_limits.warm_up_time = 1000.0
    return parameters


def test_it_plans_follows_and_learns(one_wire):
    reference = references.from_samples([0.0, 1.0, 2.0, 5.0], np.deg2rad([0.0, 0.0, 12.0, 10.0]))
    planned = plan(one_wire, reference, knot_rate=5.0, tolerance_deg=0.5)
    assert planned.duty.shape[0] == 1

    weak = LimbParameters.from_yaml(one_wire.to_yaml())
    weak.segments[0].wires[0].law.beta *= 0.8

    def distance(recording) -> float:
        asked = planned.bend_angle_at(recording.time)
        return float(np.rad2deg(np.abs(recording.bend_angle - asked).mean()))

    open_loop = simulate(Limb(weak), planned)
    followed = replay(planned, Limb(weak), controller=RecedingHorizon(planned))
    assert distance(followed) < 0.7 * distance(open_loop)

    learner = Learner(planned)
    learner.update(open_loop)
    duty = learner.duty_trajectory().vector_values(planned.time)
    assert np.abs(duty - planned.duty).max() > 0.05
    learned = simulate(Limb(weak), learner.duty_trajectory(), planned.duration)
    assert distance(learned) < 0.7 * distance(open_loop)
