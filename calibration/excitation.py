"""What tells most about a limb's wires: pulses, slow ramps, random levels of all, and motions.

A study of what recordings tell (two wires, 400 s, the sensors' noise) says: of
29 parameters one pulse each tells 16 to better than 10%, equilibria 20, pulses
of many heights and lengths 21, and random levels of both wires 22. Ramps with
reversals are the only direct view of hysteresis, and a motion like those that
are planned, repeated, shows how well they can be predicted at all.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import LeafSystem
from pydrake.trajectories import PiecewisePolynomial

from calibration.controller import TAPER
from limb_systems import LimbParameters
from limb_systems.model.ensemble import draw_ensemble, stacked
from limb_systems.model.ownership import weak_method
from limb_systems.simulation import PERIOD

MEMBERS = 16  # limbs that the recordings so far cannot tell apart, all of which stay below T_max
REACTION_TIME = 0.5  # s, within which a wire may reach the highest temperature
RISE_TAPER = 0.2  # share of a rise, over which the duty is reduced
NAMES = ("conditioning", "pulses", "ramps", "random")  # of those that are fitted
MOTIONS = 3  # times that the motion is repeated
LEVEL_STEP = 0.5  # s, of ramps


@dataclasses.dataclass(frozen=True)
class Excitation:
    """A recording that is made with a given course of duty.

    - ``name``: of its file.
    - ``kind``: "heated" or "motion", of `calibrate`.
    - ``purpose``: in words, for the operator.
    - ``pause``: s without heat before it.
    - ``course``: duty over time, a row for each wire.
    - ``seed``: of what is random in it; None if nothing is.
    """

    name: str
    kind: str
    purpose: str
    pause: float
    course: PiecewisePolynomial
    seed: int | None = None


def excitations(num_wires: int, seed: int = 0) -> list[Excitation]:
    """All of them in their order; with two wires 13 minutes, and 6 of rest between them.

    Args:
        num_wires: W.
        seed: of durations and levels that are random.
    """
    random, each = np.random.default_rng(seed), np.eye(num_wires)
    wires, off = range(num_wires - 1, -1, -1), np.zeros(num_wires)  # the right one first

    conditioning = [(3.0, off)]
    for wire in wires:
        conditioning += 2 * [(8.0, 0.5 * each[wire]), (22.0, off)]

    pulses = [(3.0, off)]
    for number in range(5):
        for wire in wires:
            duration = random.uniform(2.0, 12.0) if number else 3.0
            pulses.append((duration, random.uniform(0.2, 0.6) * each[wire]))
            pulses.append((random.uniform(5.0, 12.0), off))

    ramps = [(2.0, off)]
    times = np.arange(0.0, 50.0, LEVEL_STEP)
    levels = 0.05 + 0.3 * (1 - _triangle(times / 50.0)) + 0.15 * (1 - 2 * _triangle(times / 16.0))
    for wire in wires:
        ramps += [(LEVEL_STEP, level * each[wire]) for level in np.clip(levels, 0.0, 0.6)]

    motion = [(1.0, off)]
    for duration, left, right in MOTION:
        # Wires beyond the second one follow the two in turn.
        motion.append((duration, np.resize([left, right], num_wires)))

    return [
        Excitation("conditioning", "heated", "two pulses of each wire", 0.0, _course(conditioning)),
        Excitation(
            "pulses", "heated", "pulses of many heights and lengths", 5.0, _course(pulses), seed
        ),
        Excitation("ramps", "heated", "slow ramps with reversals", 5.0, _course(ramps)),
        Excitation(
            "random",
            "heated",
            "random levels of all wires, then two minutes of cooling",
            5.0,
            _course([*_random_levels(random, num_wires), (120.0, off)]),
            seed,
        ),
        *(
            Excitation(
                f"motion_{number}",
                "motion",
                "a motion that is left out of the fit, and judges it",
                120.0,
                _course(motion),
            )
            for number in range(1, MOTIONS + 1)
        ),
    ]


# s, and duty of left and right: to both sides, with both wires warm, as plans do it.
MOTION = (
    (8.0, 0.25, 0.25),
    (8.0, 0.05, 0.35),
    (6.0, 0.1, 0.2),
    (7.0, 0.4, 0.03),
    (6.0, 0.2, 0.1),
    (5.0, 0.0, 0.3),
    (4.0, 0.15, 0.15),
)


def _random_levels(random: np.random.Generator, num_wires: int) -> list:
    """Levels of all wires, each of which changes at times of its own, for 140 s."""
    levels, changes = np.zeros(num_wires), 2.0 * np.arange(1, num_wires + 1)
    parts, now = [], 0.0
    while now < 140.0:
        wire = int(np.argmin(changes))
        parts.append((changes[wire] - now, levels.copy()))
        now = changes[wire]
        levels[wire] = max(0.0, random.uniform(-0.12, 0.5))
        changes[wire] = now + random.uniform(3.0, 10.0)
    return parts


def _triangle(turns: np.ndarray) -> np.ndarray:
    """From 1 at whole turns to 0 half a turn later."""
    return 2 * np.abs(turns % 1 - 0.5)


def _course(parts: Sequence[tuple[float, np.ndarray]]) -> PiecewisePolynomial:
    times = np.cumsum([0.0, *(duration for duration, _ in parts)])
    levels = np.array([level for _, level in parts] + [parts[-1][1]])
    return PiecewisePolynomial.ZeroOrderHold(times, levels.T)


class LimitedDuty(LeafSystem):
    """A course of duty, limited so that no wire gets hotter than T_max.

    The wires' temperatures are simulated for several limbs that a calibration
    cannot tell apart, and the hottest counts: the limit is tight as long as
    little is known. Over the last 15 °C of what a thermocouple may read the duty
    falls to zero as well.

    - input 0 ``measured_temperature``: V (W), °C
    - output 0 ``duty``: D (W), in [0, 1]
    - state, discrete, at 20 Hz: [x of the wires' laws (number of states, limbs, W), D (W)]
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters, course: PiecewisePolynomial):
        """
        Args:
            parameters: of the limb, as well as it is calibrated so far, of one segment.
            course: of duty, a row for each wire.
        """
        super().__init__()
        self._law, rooms, _ = stacked(draw_ensemble(parameters, MEMBERS))
        self._rooms, self._course = rooms[:, np.newaxis, np.newaxis], course
        self._highest = parameters.temperature_limits.maximum
        self._num_wires = len(parameters.wires)
        self._shape = (len(self._law.states), MEMBERS, 1, self._num_wires)
        self.DeclareVectorInputPort("measured_temperature", self._num_wires)
        state = self.DeclareDiscreteState(int(np.prod(self._shape)) + self._num_wires)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._start))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, weak_method(self._update))
        self.DeclareVectorOutputPort(
            "duty",
            self._num_wires,
            weak_method(self._calc),
            {self.discrete_state_ticket(state)},
        )
        self.set_name("limited_duty")

    def _start(self, context, discrete_state):
        measured = self.get_input_port().Eval(context)
        states = np.zeros(self._shape)
        for row, cold, name in zip(
            states, self._law.cold_states(0.0), self._law.states, strict=True
        ):
            # Silicone is at most as warm as what the thermocouple reads.
            row[...] = measured if self._law.is_temperature(name) else cold
        discrete_state.set_value(np.append(states.ravel(), np.zeros(self._num_wires)))

    def _update(self, context, discrete_state):
        values = context.get_discrete_state_vector().value()
        states, duty = values[: -self._num_wires].reshape(self._shape), values[-self._num_wires :]
        rates = np.empty_like(states)
        for row, rate in zip(rates, self._law.rates(list(states), duty, self._rooms), strict=True):
            row[...] = rate
        states = states + PERIOD * rates
        duty = np.minimum(self._wanted(context.get_time()), self._allowed(states, context))
        discrete_state.set_value(np.append(states.ravel(), duty))

    def _wanted(self, time: float) -> np.ndarray:
        return self._course.value(min(time, self._course.end_time()))[:, 0]

    def _allowed(self, states: np.ndarray, context) -> np.ndarray:
        """The duty (W,) at which no limb's wire is above T_max soon."""
        cooling, heating = (
            np.asarray(
                self._law.rates(list(states), np.full(self._num_wires, level), self._rooms)[0]
            )
            for level in (0.0, 1.0)
        )
        room = (self._highest - states[0]) / REACTION_TIME
        duty = ((room - cooling) / (heating - cooling)).min(axis=(0, 1))
        measured = self.get_input_port().Eval(context)
        taper = (self._highest - 5.0 - measured) / TAPER
        return np.clip(np.minimum(duty, taper), 0.0, 1.0)

    def _calc(self, context, output):
        output.SetFromVector(context.get_discrete_state_vector().value()[-self._num_wires :])


class DutyUntilWarm(LeafSystem):
    """A course of duty, less of it the closer what a thermocouple reads comes to a given rise.

    - input 0 ``measured_temperature``: V (W), °C
    - output 0 ``duty``: D (W), in [0, 1]
    - state, discrete, at 20 Hz: [V at the beginning (W), °C, D (W)]
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, course: PiecewisePolynomial, rise: float):
        """
        Args:
            course: of duty, a row for each wire.
            rise: of the readings, at which there is no duty, °C.
        """
        super().__init__()
        self._course, self._rise, self._num_wires = course, rise, course.rows()
        self.DeclareVectorInputPort("measured_temperature", self._num_wires)
        # A robot has read nothing yet when it is initialized.
        unread, off = np.full(self._num_wires, np.nan), np.zeros(self._num_wires)
        state = self.DeclareDiscreteState(np.append(unread, off))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, weak_method(self._update))
        self.DeclareVectorOutputPort(
            "duty",
            self._num_wires,
            weak_method(self._calc),
            {self.discrete_state_ticket(state)},
        )
        self.set_name("duty_until_warm")

    def _update(self, context, discrete_state):
        cold = context.get_discrete_state_vector().value()[: self._num_wires]
        measured = self.get_input_port().Eval(context)
        cold = np.where(np.isnan(cold), measured, cold)
        rise = measured - cold
        share = np.clip((1 - rise / self._rise) / RISE_TAPER, 0.0, 1.0)
        wanted = self._course.value(min(context.get_time(), self._course.end_time()))[:, 0]
        discrete_state.set_value(np.append(cold, share * wanted))

    def _calc(self, context, output):
        output.SetFromVector(context.get_discrete_state_vector().value()[self._num_wires :])
