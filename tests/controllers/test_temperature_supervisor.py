"""The supervisor against wires that follow (6) and (7) exactly, and others that do not."""

import copy
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.linalg import expm

from controllers import PlanFeedback, TemperatureSupervisor, supervised
from hardware import LimbTwin
from limb_systems import HystereticLaw, Limb, LimbError, LimbParameters
from limb_systems.limb_parameters import CalibrationRecord
from limb_systems.simulation import record

from .conftest import limb_of

LIMIT = 100.0  # °C, T_max, of limbs that are not calibrated
PERIOD = 0.05


small_limb = functools.partial(limb_of, links=1)


class ExactWires:
    """Two wires in steps of constant duty, by the matrix exponential of (6) and (7).

    Readings show a share of their excess over the room.
    """

    def __init__(self, parameters, shown=1.0):
        self._shown, self._ambient = shown, parameters.ambient_temperature
        self._steps = []
        for wire in parameters.wires:
            law = wire.law
            rates = np.array([[law.a1, 0.0, law.a2], [-law.a3, law.a3, 0.0], [0.0, 0.0, 0.0]])
            self._steps.append(expm(PERIOD * rates))
        self.excess = np.zeros((2, 2))  # [T, V] - T0 of each wire

    @property
    def temperature(self):
        return self._ambient + self.excess[:, 0]

    @property
    def reading(self):
        return self._ambient + self._shown * self.excess[:, 1]

    def step(self, duty):
        self.excess = np.array(
            [(A @ [*x, D])[:2] for A, x, D in zip(self._steps, self.excess, duty, strict=True)]
        )


def driven(parameters, wires, asked, shown=True):
    """T (K, 2) of wires behind a supervisor that is asked for duty (K, 2), and what they got.

    The wires' readings are NaN if they are not shown.
    """
    supervisor = TemperatureSupervisor(parameters)
    simulator = Simulator(supervisor)
    context, temperatures, applied = simulator.get_mutable_context(), [], []
    ports = [supervisor.GetInputPort(name) for name in ("duty", "measured_temperature")]
    for k, duty in enumerate(asked):
        ports[0].FixValue(context, np.asarray(duty, float))
        ports[1].FixValue(context, wires.reading if shown else np.full(2, np.nan))
        simulator.AdvanceTo(PERIOD * (k + 1))
        applied.append(supervisor.GetOutputPort("duty").Eval(context).copy())
        wires.step(applied[-1])
        temperatures.append(wires.temperature)
    return np.array(temperatures), np.array(applied)


square = [[1.0, float(k // 20 % 2)] for k in range(220)]


@settings(max_examples=4, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    ticks=st.integers(1, 60),
    highest=st.floats(0.5, 5.0),
)
def test_wires_with_exact_laws_stay_below_the_limit(seed, ticks, highest):
    """Whatever is asked, and however long each of it lasts."""
    parameters, rng = small_limb(), np.random.default_rng(seed)
    asked = np.repeat(rng.uniform(-0.5, highest, (160 // ticks + 1, 2)), ticks, axis=0)[:160]
    temperature, applied = driven(parameters, ExactWires(parameters), asked)
    assert temperature.max() <= LIMIT
    assert applied.min() >= 0.0
    assert applied.max() <= 1.0


def test_the_nearest_duty_is_applied():
    """Each wire has a bound of its own, so what is nearest to the duty asked is nearest in each."""
    parameters = small_limb()
    asked = [[1.0, 0.2]] * 200 + [[0.1, np.nan]] * 3 + [[-3.0, 0.4]] * 2
    _, applied = driven(parameters, ExactWires(parameters), asked)
    assert applied[199, 0] < 0.5
    np.testing.assert_array_equal(applied[1:200, 1], np.full(199, 0.2))
    np.testing.assert_array_equal(applied[200:203], [[0.1, 0.0]] * 3)
    np.testing.assert_array_equal(applied[203:], [[0.0, 0.4]] * 2)


def test_full_duty_is_used_up_to_the_limit_and_slightly_beyond_with_wrong_laws():
    """A supply of 10% more voltage heats by 20% more; a bad bond halves the rate of readings.

    As nothing says how well it is known, the limiter takes readings to lag up to twice as long.
    """
    parameters = small_limb()
    for a2_share, a3_share, least, beyond in (
        (1.0, 1.0, 98.0, 0.0),
        (1.2, 1.0, 95.0, 0.0),
        (1.0, 0.5, 95.0, 1.0),
        (1.2, 0.5, 95.0, 2.0),
    ):
        others = copy.deepcopy(parameters)
        for wire in others.wires:
            wire.law.a2 *= a2_share
            wire.law.a3 *= a3_share
        temperature, _ = driven(parameters, ExactWires(others), square)
        assert least < temperature.max() <= LIMIT + beyond


def test_wires_that_are_hotter_than_they_read_stay_below_the_limit():
    """By 12% of what they show over the room, of which no calibration by readings can know."""
    parameters = small_limb()
    parameters.calibration = CalibrationRecord([], [], [], [], temperature_error=0.5)
    for heating_factor, least in ((1.0, 85.0), (1.12, 93.0)):
        others = copy.deepcopy(parameters)
        for wire in others.wires:
            wire.law.a2 *= heating_factor
        temperature, _ = driven(parameters, ExactWires(others, shown=1 / heating_factor), square)
        assert least < temperature.max() <= LIMIT


def test_without_readings_temperature_follows_the_law():
    parameters = small_limb()
    temperature, _ = driven(parameters, ExactWires(parameters), np.ones((300, 2)), shown=False)
    assert 60.0 < temperature.max() <= LIMIT
    assert temperature[-1].max() < temperature[150].max()  # less known, and more careful


def supervised_recording(limb, parameters, asked, seconds):
    builder = DiagramBuilder()
    builder.AddSystem(limb)
    supervisor = builder.AddSystem(TemperatureSupervisor(parameters))
    source = builder.AddSystem(TrajectorySource(asked))
    builder.Connect(source.get_output_port(), supervisor.GetInputPort("duty"))
    name = "measured_temperature"
    builder.Connect(limb.GetOutputPort(name), supervisor.GetInputPort(name))
    return record(builder, limb, supervisor.GetOutputPort("duty"), seconds)


def waves(num_wires, seconds):
    """Full duty of half of the wires, and square waves of the others."""
    times = np.arange(0.0, seconds + 1.5, 1.5)
    rows = [
        np.ones(len(times)) if wire % 2 else np.arange(len(times)) % 2.0
        for wire in range(num_wires)
    ]
    return PiecewisePolynomial.ZeroOrderHold(times, rows)


def test_limbs_of_any_law_of_two_segments_and_emulated_ones_stay_below_the_limit(two_segments):
    """The emulated one is not calibrated, and its thermocouples lag."""
    hysteretic = small_limb(HystereticLaw)
    for limb, parameters, beyond in (
        (Limb(hysteretic), hysteretic, 0.0),
        (Limb(two_segments), two_segments, 0.0),
        (LimbTwin(small_limb(), seed=14, truth=True), small_limb(), 2.0),
    ):
        asked = waves(len(parameters.wires), 8.0)
        recording = supervised_recording(limb, parameters, asked, 8.0)
        assert 95.0 < recording.wire_temperature.max() <= LIMIT + beyond


def test_the_limit_stays_below_that_of_the_board():
    parameters = small_limb()
    parameters.temperature_limits.measured_maximum = 103.0
    temperature, _ = driven(parameters, ExactWires(parameters), np.ones((200, 2)))
    assert 94.0 < temperature.max() <= 98.0


def test_a_supervised_controller_outputs_the_limited_duty(fed, short_plan):
    """It is asked to bend the other way by wires that are warmer than the limit."""
    readings = {
        "measured_temperature": np.full((20, 2), 40.0),
        "bend_angle": np.deg2rad(np.full((20, 1), -15.0)),
    }
    asked = fed(PlanFeedback(short_plan), readings).duty
    parameters = copy.deepcopy(short_plan.parameters)
    parameters.temperature_limits.measured_maximum = 43.0  # 5 °C above the limit
    got = fed(supervised(PlanFeedback(short_plan), parameters), readings).duty
    assert asked[1:].max() > 0.5
    assert (got == 0.0).all()
    with pytest.raises(LimbError, match="PlanFeedback has a duty for 2 wires, but the limb has 3"):
        supervised(PlanFeedback(short_plan), LimbParameters.in_space(wires=3))
