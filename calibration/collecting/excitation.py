"""Informative recordings of wires: pulses, slow ramps, random levels of all, and motions.

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

from calibration.collecting.bend_control import DUTY_TAPER
from calibration.recordings.kinds import MOUNTING_ANGLES, MOUNTINGS
from limb_systems import LimbParameters
from limb_systems.drake_python import declare_state_output, weak_method
from limb_systems.law_functions import check_affine
from limb_systems.monte_carlo import draw_limbs, stack_limbs
from limb_systems.simulation import PERIOD
from limb_systems.wire_laws.wire_law import duty_for_rate

NUM_LIMBS = 16  # limbs that the recordings so far cannot tell apart, all of which stay below T_max
MOUNTED_LEVELS = (0.12, 0.2, 0.28, 0.36)  # of duty
MOUNTED_COOLING_TIME = 40.0  # s, after a wire or a pair
REACTION_TIME = 0.5  # s, within which a wire may reach the highest temperature
OFF_AND_ON = np.array([0.0, 1.0]).reshape(2, 1, 1, 1)  # duty of all wires of all limbs
RISE_TAPER_SHARE = 0.2  # share of a rise, over which the duty is reduced
NUM_MOTIONS = 3  # times that the motion is repeated
LEVEL_STEP = 0.5  # s, of ramps


@dataclasses.dataclass(frozen=True)
class Excitation:
    """A recording that is made with a given duty over time.

    - ``name``: name of the file.
    - ``kind``: "heated" or "motion", as `calibrate` has it.
    - ``pause``: time without heat before it, s.
    - ``duty``: duty over time, a row for each wire.
    - ``seed``: seed of what is random in it; None if nothing is.
    - ``turned``: angle about E1, degrees, by which the limb lies turned under gravity; None
      if gravity does not bend it.
    """

    name: str
    kind: str
    pause: float
    duty: PiecewisePolynomial
    seed: int | None = None
    turned: float | None = None

    @property
    def heated_time(self) -> float:
        """Time for which any wire has duty, s."""
        times = np.array(self.duty.get_segment_times())
        return float(np.diff(times) @ self.duty.vector_values(times[:-1]).any(axis=0))


def mountings(num_wires: int) -> list[Excitation]:
    """Return excitations of a limb turned about its axis under gravity by 0°, 90°, 180° and 270°.

    Each wire is held at four levels of duty, then each pair of neighbours at one. The direction of
    gravity turns with the mounting, and the wires' directions do not. So the recordings of all
    mountings identify three things that one mounting cannot separate: the wires' directions, the
    stiffness, and which direction across the limb the bend sensor takes for its first axis, E2.
    """
    unit_levels = np.eye(num_wires)
    off = np.zeros(num_wires)
    # The parts of the duty: durations, s, and duties (W,).
    parts = [(10.0, off)]
    for wire in unit_levels:
        parts += [(15.0, level * wire) for level in MOUNTED_LEVELS]
        parts.append((MOUNTED_COOLING_TIME, off))
    pairs = unit_levels + np.roll(unit_levels, 1, axis=1)
    # Two wires are neighbours twice, on both sides, but are one pair: np.unique drops the second.
    for pair in np.unique(pairs, axis=0) if num_wires > 1 else ():
        parts.append((30.0, MOUNTED_LEVELS[1] * pair))
        parts.append((MOUNTED_COOLING_TIME, off))
    return [
        Excitation(name, "heated", pause=60.0, duty=held_levels(parts), turned=turned)
        for name, turned in zip(MOUNTINGS, MOUNTING_ANGLES, strict=True)
    ]


def excitations(num_wires: int, seed: int = 0) -> list[Excitation]:
    """Return the excitations in their order; with two wires 13 minutes, and 6 of rest in between.

    Args:
        num_wires: W.
        seed: seed of durations and levels that are random.
    """
    random = np.random.default_rng(seed)
    unit_levels = np.eye(num_wires)
    # The last wire comes first, the right one of two.
    wires = range(num_wires - 1, -1, -1)
    off = np.zeros(num_wires)

    # Heat each wire twice from cold.
    conditioning = [(3.0, off)]
    for wire in wires:
        conditioning += 2 * [(8.0, 0.5 * unit_levels[wire]), (22.0, off)]

    # Pulses of random heights and lengths.
    pulses = [(3.0, off)]
    for number in range(5):
        for wire in wires:
            duration = random.uniform(2.0, 12.0) if number else 3.0
            pulses.append((duration, random.uniform(0.2, 0.6) * unit_levels[wire]))
            pulses.append((random.uniform(5.0, 12.0), off))

    # A slow triangle with a faster one on it, which reverses.
    ramps = [(2.0, off)]
    times = np.arange(0.0, 50.0, LEVEL_STEP)
    levels = 0.05 + 0.3 * (1 - _triangle(times / 50.0)) + 0.15 * (1 - 2 * _triangle(times / 16.0))
    for wire in wires:
        ramps += [(LEVEL_STEP, level * unit_levels[wire]) for level in np.clip(levels, 0.0, 0.6)]

    # The motion that judges.
    motion = [(1.0, off)]
    for number, (duration, left, right) in enumerate(MOTION_LEVELS):
        # More than two wires take turns in following the two.
        turn = number if num_wires > 2 else 0
        motion.append((duration, np.roll(np.resize([left, right], num_wires), turn)))

    random_parts = [*_random_levels(random, num_wires), (120.0, off)]
    result = [
        Excitation("conditioning", "heated", 0.0, held_levels(conditioning)),
        Excitation("pulses", "heated", 5.0, held_levels(pulses), seed),
        Excitation("ramps", "heated", 5.0, held_levels(ramps)),
        Excitation("random", "heated", 5.0, held_levels(random_parts), seed),
    ]
    for number in range(1, NUM_MOTIONS + 1):
        result.append(Excitation(f"motion_{number}", "motion", 120.0, held_levels(motion)))
    return result


# s, and duty of left and right: to both sides, with both wires warm, as plans do it.
MOTION_LEVELS = (
    (8.0, 0.25, 0.25),
    (8.0, 0.05, 0.35),
    (6.0, 0.1, 0.2),
    (7.0, 0.4, 0.03),
    (6.0, 0.2, 0.1),
    (5.0, 0.0, 0.3),
    (4.0, 0.15, 0.15),
)


def _random_levels(random: np.random.Generator, num_wires: int) -> list:
    """Return the levels of all wires, each of which changes at times of its own, for 140 s."""
    levels = np.zeros(num_wires)
    changes = 2.0 * np.arange(1, num_wires + 1)
    parts = []
    time = 0.0
    while time < 140.0:
        wire = int(np.argmin(changes))
        parts.append((changes[wire] - time, levels.copy()))
        time = changes[wire]
        levels[wire] = max(0.0, random.uniform(-0.12, 0.5))
        changes[wire] = time + random.uniform(3.0, 10.0)
    return parts


def _triangle(turns: np.ndarray) -> np.ndarray:
    """Return a wave from 1 at whole turns to 0 half a turn later."""
    return 2 * np.abs(turns % 1 - 0.5)


def held_levels(parts: Sequence[tuple[float, np.ndarray]]) -> PiecewisePolynomial:
    """Return duty (W) over time: one level (W,) after the other, each for its duration, s."""
    times = np.cumsum([0.0, *(duration for duration, _ in parts)])
    levels = np.array([level for _, level in parts] + [parts[-1][1]])
    return PiecewisePolynomial.ZeroOrderHold(times, levels.T)


class _DutyByReadings(LeafSystem):
    """Duty over time, which subclasses limit by what thermocouples read, at 20 Hz.

    The last elements of the state are the duty, those before are the subclass's.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, duty: PiecewisePolynomial, start: np.ndarray):
        super().__init__()
        self._wanted_duty = duty
        self._num_wires = duty.rows()
        self.DeclareVectorInputPort("measured_temperature", self._num_wires)
        state = self.DeclareDiscreteState(np.append(start, np.zeros(self._num_wires)))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, weak_method(self._update))
        declare_state_output(self, "duty", state, slice(len(start), len(start) + self._num_wires))

    def _update(self, context, discrete_state):
        state = context.get_discrete_state_vector().value()
        wanted_duty = self._wanted_duty.value(min(context.get_time(), self._wanted_duty.end_time()))
        measured = self.get_input_port().Eval(context)
        own_state = state[: -self._num_wires]
        own_state, limited_duty = self._limited(own_state, wanted_duty[:, 0], measured)
        discrete_state.set_value(np.append(own_state, limited_duty))

    def _limited(self, own_state, wanted_duty, measured) -> tuple[np.ndarray, np.ndarray]:
        """Return the subclass's state after a step, and the limited duty (W,) until then."""
        raise NotImplementedError


class LimitedDuty(_DutyByReadings):
    """Duty over time, limited so that no wire gets hotter than T_max.

    The wires' temperatures are simulated for several limbs that a calibration
    cannot tell apart, and the hottest counts: the limit is tight as long as
    little is known. Over the last 15 °C of what a thermocouple may read the duty
    falls to zero as well.

    - input 0 ``measured_temperature``: V (W), °C
    - output 0 ``duty``: D (W), in [0, 1]
    - state, discrete, at 20 Hz: [x of the wires' laws a period later (number of states,
      limbs, W), D (W)]
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters, duty: PiecewisePolynomial):
        """
        Args:
            parameters: the limb, as well as it is calibrated so far, of one segment.
            duty: a row for each wire.

        Raises:
            LimbError: if the rates of a wire's law are not affine in the duty.
        """
        check_affine(parameters)
        self._law, rooms, _ = stack_limbs(draw_limbs(parameters, NUM_LIMBS))
        self._rooms = rooms[:, np.newaxis, np.newaxis]
        self._highest = parameters.temperature_limits.maximum
        self._shape = (len(self._law.states), NUM_LIMBS, 1, len(parameters.wires))
        super().__init__(duty, np.zeros(int(np.prod(self._shape))))
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._start))

    def _start(self, context, discrete_state):
        measured = self.get_input_port().Eval(context)
        states = np.zeros(self._shape)
        cold_states = zip(states, self._law.states, self._law.cold_states(0.0), strict=True)
        for row, name, cold in cold_states:
            # Silicone is at most as warm as what the thermocouple reads.
            row[...] = np.nan_to_num(measured, nan=self._highest)
            if not self._law.is_temperature(name):
                row[...] = cold
        no_duty = np.zeros(self._num_wires)
        states, _ = self._limited(states, no_duty, no_duty)
        discrete_state.set_value(np.append(states, no_duty))

    def _limited(self, own_state, wanted_duty, measured):
        states = own_state.reshape(self._shape)
        # Solve for the duty with which the hottest T reaches T_max within the reaction time.
        rates = np.empty((len(states), 2, *self._shape[1:]))
        law_rates = self._law.rates(list(states), OFF_AND_ON, self._rooms)
        for row, rate in zip(rates, law_rates, strict=True):
            row[...] = rate
        rates_off, rates_on = np.moveaxis(rates, 1, 0)
        allowed_rate = (self._highest - states[0]) / REACTION_TIME
        allowed_duty = duty_for_rate(allowed_rate, rates_off[0], rates_on[0]).min(axis=(0, 1))
        taper = (self._highest - 5.0 - measured) / DUTY_TAPER
        taper[np.isnan(taper)] = 0.0  # no duty without a reading
        allowed_duty = np.minimum(np.maximum(np.minimum(allowed_duty, taper), 0.0), 1.0)
        duty = np.minimum(wanted_duty, allowed_duty)
        states = states + PERIOD * (rates_off + duty * (rates_on - rates_off))
        return states.ravel(), duty


class DutyUntilWarm(_DutyByReadings):
    """Duty over time, less of it the closer what a thermocouple reads comes to a given rise.

    - input 0 ``measured_temperature``: V (W), °C
    - output 0 ``duty``: D (W), in [0, 1]
    - state, discrete, at 20 Hz: [V at the beginning (W), °C, D (W)]
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, duty: PiecewisePolynomial, rise: float):
        """
        Args:
            duty: a row for each wire.
            rise: rise of the readings at which there is no duty, °C.
        """
        # A robot has read nothing yet when it is initialized.
        super().__init__(duty, np.full(duty.rows(), np.nan))
        self._rise = rise

    def _limited(self, own_state, wanted_duty, measured):
        cold_readings = np.where(np.isnan(own_state), measured, own_state)
        share = np.clip((1 - (measured - cold_readings) / self._rise) / RISE_TAPER_SHARE, 0.0, 1.0)
        return cold_readings, np.nan_to_num(share) * wanted_duty  # no duty without a reading
