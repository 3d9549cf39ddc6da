"""Sensors that lie while a limb is held to its plan: no wire gets hot, and nothing winds up.

The limb is an emulated one that its plan does not know well, and the fault is between it and the
controller, so that neither board nor cut-out sees it.
"""

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from controllers import PlanFeedback
from hardware import LimbTwin, replay
from limb_systems import LimbParameters
from limb_systems.drake_python import weak_method
from limb_systems.limb_system import wrap_controller
from limb_systems.simulation import PERIOD
from planners import Task, plan, references

from .conftest import beginning

START, END = 6.0, 12.0  # s, of the faults
LEFT = 0
BEND = 2
HOTTEST = 111.0  # °C, true: the most that a board lets a wire become by docs/hardware.md


@pytest.fixture(scope="module")
def wave():
    """From side to side by 12°."""
    times = np.arange(0.0, 18.01, 0.1)
    reference = references.from_samples(times, np.deg2rad(12.0) * np.sin(0.7 * times))
    return plan(LimbParameters(), reference, task=Task.closed_loop(), tolerance_deg=0.2)


class FaultySensor(LeafSystem):
    """Passes on what two thermocouples and a bend sensor read, one of which lies for a while.

    It shows a function of the time since the fault came, s, of its reading, of its reading before
    the fault, and of a random number that is new each period. The state has the last two.
    """

    __slots__ = ()

    def __init__(self, sensor, shown, start):
        super().__init__()
        self._sensor, self._shown, self._start = sensor, shown, start
        self._random = np.random.default_rng(0)
        self.DeclareDiscreteState(2)
        for name, size in (("measured_temperature", 2), ("bend_angle", 1)):
            self.DeclareVectorInputPort(name, size)
            calc = weak_method(self._bend if name == "bend_angle" else self._temperature)
            self.DeclareVectorOutputPort(name, size, calc)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

    def _readings(self, context):
        return np.concatenate([self.get_input_port(index).Eval(context) for index in range(2)])

    def _update(self, context, state):
        before = context.get_discrete_state_vector()[0]
        if context.get_time() < self._start:
            before = self._readings(context)[self._sensor]
        state.set_value([before, self._random.normal()])

    def _shown_now(self, context):
        readings, time = self._readings(context), context.get_time()
        if self._start <= time < END:
            state = context.get_discrete_state_vector().value()
            shown = self._shown(time - self._start, readings[self._sensor], *state)
            readings[self._sensor] = shown
        return readings

    def _temperature(self, context, output):
        output.SetFromVector(self._shown_now(context)[:2])

    def _bend(self, context, output):
        output.SetFromVector(self._shown_now(context)[2:])


def driven(trajectory, sensor=None, shown=None, start=START):
    controller = PlanFeedback(trajectory)
    if shown:
        controller = wrap_controller(FaultySensor(sensor, shown, start), controller)
    return replay(trajectory, LimbTwin(truth=True), controller=controller)


@pytest.fixture(scope="module")
def good(wave):
    return driven(wave)


def apart(recording, good, begin, end):
    """The largest difference of bend from that without a fault, °."""
    during = (good.time >= begin) & (good.time <= end)
    return np.rad2deg(np.abs(recording.bend_angle - good.bend_angle)[0, during]).max()


def test_lies_heat_no_wire_and_do_not_wind_up(wave, good):
    """A bend sensor that is stuck to the last bit is not believed: see test_estimator.py."""
    for shown, misled, in_the_end in (
        (lambda t, y, before, noise: y + np.deg2rad(3.0 * t), 18.0, 4.0),
        # Taken for something that holds the limb: both wires are driven to their limit.
        (lambda t, y, before, noise: before + np.deg2rad(0.5) * noise, 12.0, 10.0),
    ):
        recording = driven(wave, BEND, shown)
        assert not recording.interrupted
        assert recording.wire_temperature.max() < HOTTEST
        before = recording.time <= START
        np.testing.assert_array_equal(recording.duty[:, before], good.duty[:, before])
        assert apart(recording, good, START, END) < misled
        assert apart(recording, good, END + 3.0, 18.0) < in_the_end


def test_a_thermocouple_that_stands_still_does_not_hide_that_its_wire_gets_hot(wave):
    until_end = beginning(wave, 1 + round(10 * END))
    recording = driven(until_end, LEFT, lambda t, y, before, noise: before, start=3.0)
    assert not recording.interrupted
    assert recording.wire_temperature.max() < HOTTEST


def test_a_thermocouple_that_reads_more_than_expected_is_believed(wave, good):
    until_end = beginning(wave, 1 + round(10 * END))
    warned = driven(until_end, LEFT, lambda t, y, before, noise: y + 40.0)
    late = (warned.time > START + 2.0) & (warned.time <= END)
    expected = good.duty[0, : len(late)][late].mean()
    assert warned.duty[0, late].mean() < 0.6 * expected
