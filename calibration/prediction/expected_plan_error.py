"""The expected error of plans by a calibration, and the recording to make next.

A plan begins with what is read at its start, and has temperatures and reversals of its own. Its
distance from the limb has two parts:

- what the law leaves of motions that it was not fitted to, predicted from their start as plans
  are, and more of motions that are wider than those;
- what the limbs differ by that the recordings cannot tell apart, in a motion to T_max and back by
  both sides, on another day: in a room somewhat warmer, with a somewhat other supply, and with a
  bend sensor that has drifted.
"""

import dataclasses
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from calibration.prediction.heated_run import STEP
from calibration.prediction.law_fit import (
    AMBIENT_SPREAD,
    KNOWN_SHARE,
    LawFit,
    Predicted,
    mean_bend_error,
)
from calibration.prediction.unknowns import READING_FIELDS, Unknown
from calibration.remarks import Remark
from limb_systems import LimbParameters, WireLaw
from limb_systems.monte_carlo import OpenLoop, draw_limbs, stack_limbs
from limb_systems.wire_laws.wire_law import COLD_HEATING, SLOW_HEATING

NUM_LIMBS = 64
SUPPLY_SPREAD = 0.03  # of the heat for the same duty, from day to day
# Motions of one limb are missed by half to twice the expected; `benchmarks/plan_miss.py` shows how
# often that holds.
MISS_RATIO = 2.0
# s, and shares of the duty of wires towards -E2 and +E2: both warm, then reversals to both sides.
TYPICAL_LEVELS = (
    (10.0, 0.6, 0.6),
    (8.0, 0.1, 0.9),
    (6.0, 0.2, 0.5),
    (7.0, 1.0, 0.1),
    (6.0, 0.5, 0.2),
    (5.0, 0.0, 0.8),
    (4.0, 0.4, 0.4),
    (4.0, 0.8, 0.0),
    (6.0, 0.0, 0.6),
)
# expected miss over the range of the bend: good up to, bad from there on
GOOD_SHARE = 0.15
WORST_SHARE = 0.4
MIN_RISE_SHARE = 0.8  # share of the rise to T_max that recordings must reach
SWING_SHARE = 0.3  # share of a wire's rise that is a swing
MIN_SWINGS = 2  # that show hysteresis

HEAT_ALONE = "heat the {} wire alone from cold for 60 s and let it cool for 120 s"
LAW_RECORDINGS = {  # recordings that tell fields of laws, see `Prior`
    COLD_HEATING: HEAT_ALONE,
    SLOW_HEATING: "raise the duty of the {} wire alone slowly until it is as hot as it may be, and "
    "lower it as slowly",
}
SEGMENT_RECORDINGS = {  # recordings, and the parameters of the segment that they tell best
    "mount the limb horizontally, turned about its axis by 0°, 90°, 180° and 270°, and in each "
    "mounting hold each wire at four levels, then neighbouring pairs": (
        *("stiffness", "stiffness_ratio", "roll", "angle", "rest_angle_e3"),
    ),
    "record the cold limb for 10 s, then heat it": ("rest_angle",),
    "bend the limb as far as it may be to one side, then to the other": ("stiffening",),
    "heat the wires in turn, each until it bends the limb to its side, three times": (
        *("shift", "rate"),
    ),
}
FURTHER_RECORDINGS = {
    "motion": "record a motion like those that you plan, named motion_1.csv, which judges the laws",
    "ring_down": "record a ring-down, named ring_down_1.csv, which tells σ",
}


@dataclasses.dataclass(frozen=True)
class PlanMiss:
    """The mean |φ* - φ| of a plan, open loop, rad: its expected value and its range.

    - ``law_error``: what the law leaves of the motions that judged.
    - ``expected``: this for motions as wide as plans, and what is unknown of the limb and its day.
    - ``span``: range of the bend in the motions that judged, rad.
    - ``part_errors``: least and most by which parts were missed that were left out of a fit, rad.
    - ``by_mean``: what the mean bend is expected to miss motions as wide as plans by, rad.
    """

    law_error: float
    expected: float
    span: float
    part_errors: tuple[float, float]
    by_mean: float

    @property
    def low(self) -> float:
        """The least that a plan is expected to miss by, rad: on the same day, near what judged."""
        return min(self.law_error / MISS_RATIO, self.part_errors[0])

    @property
    def high(self) -> float:
        """The most that a plan is expected to miss by, rad."""
        return max(self.expected, self.part_errors[1]) * MISS_RATIO

    @property
    def in_words(self) -> str:
        """The range, as part of a sentence."""
        low, high = np.rad2deg([self.low, self.high])
        return f"in open loop, a plan will miss by {low:.1f}° to {high:.1f}° on average"

    @property
    def remarks(self) -> list[Remark]:
        """A remark if the expected error is large for the limb's range."""
        share = self.expected / self.span
        if share <= GOOD_SHARE:
            return []
        sentence = (
            f"{self.in_words[0].upper()}{self.in_words[1:]}, and the bend ranged over "
            f"{np.rad2deg(self.span):.0f}° in what judged: record more motions like those that "
            "you plan, from cold and with reversals."
        )
        return [Remark("off" if share <= WORST_SHARE else "far", sentence)]


def plan_miss(
    limb: LimbParameters,
    rollouts: Sequence[Predicted],
    fitted: Sequence[Predicted],
    errors: Sequence[float],
    mean_error: float,
) -> PlanMiss:
    """Return how far plans of a calibrated limb will miss it.

    Args:
        limb: one with its calibration's covariance; of one segment.
        rollouts: what judged, predicted from its start; see `LawFit.roll_out`.
        fitted: the recordings of the fit, which may be missed by more.
        errors: errors of parts that were left out, rad, by fits without them.
        mean_error: error of the mean bend in these parts, rad.
    """
    # In space: the mean distance of two readings of a sensor that has drifted on both axes.
    unknown_error = float(np.sqrt(np.pi)) * limb.segments[0].bend_sensor.drift
    typical_range = 0.0
    if limb.segments[0].axes == 1:
        unknown_error, typical_range = _typical_motion(limb)
    # Error that the law leaves of the motions.
    law_error = max(mean_bend_error(rollouts), float(np.mean(errors)))
    # Motions that bend the limb by more are missed by more.
    span = _bend_range(rollouts)
    wider = max(1.0, typical_range / span)
    wider_than_fitted = max(1.0, typical_range / _bend_range(fitted))
    wide_error = max(law_error * wider, mean_bend_error(fitted) * wider_than_fitted)
    if typical_range:  # a limb that stays in the middle of its range misses no more
        law_error = min(law_error, typical_range / 2)
        wide_error = min(wide_error, typical_range / 2)
    expected = float(np.hypot(wide_error, unknown_error))
    return PlanMiss(law_error, expected, span, (min(errors), max(errors)), mean_error * wider)


def _bend_range(group: Sequence[Predicted]) -> float:
    """Return the widest range of a bend in a recording, rad; 1° at least, as sensors have noise."""
    spans = []
    for predicted in group:
        bend = predicted.run.bend
        spans.append(np.nanmax(bend, axis=0) - np.nanmin(bend, axis=0))
    return max(float(np.max(spans)), float(np.deg2rad(1.0)))


def remarks_on_coverage(limb: LimbParameters, fitted: Sequence[Predicted]) -> Iterator[Remark]:
    """Yield remarks on wires whose recordings are cooler than plans, or lack reversals."""
    max_temperature = limb.temperature_limits.maximum
    room = limb.ambient_temperature
    for index, wire in enumerate(limb.wires):
        # Collect the wire's readings in each recording that heats it.
        heated_readings = []
        for predicted in fitted:
            readings = predicted.run.temperature[:, index]
            readings = readings[~np.isnan(readings)]
            if predicted.run.duty[:, index].any() and len(readings):
                heated_readings.append(readings)
        if not heated_readings:
            continue
        # Compare the hottest reading with T_max; then count the swings.
        hottest = float(np.concatenate(heated_readings).max())
        min_swing = SWING_SHARE * (hottest - room)
        if hottest < room + MIN_RISE_SHARE * (max_temperature - room):
            yield Remark(
                "range",
                f"The {wire.name} wire was read at {hottest:.0f} °C at most, and plans may heat it "
                f"to {max_temperature:.0f} °C, where nothing is known of it: record it hotter, or "
                "lower temperature_limits.maximum.",
            )
        elif sum(_count_swings(readings, min_swing) for readings in heated_readings) < MIN_SWINGS:
            yield Remark(
                "range",
                f"The {wire.name} wire is heated and cools once: plans turn back and forth, and "
                "hysteresis shows where they do; record it with reversals.",
            )


def _count_swings(readings: np.ndarray, min_swing: float) -> int:
    """Return how often readings fall by so much after they have risen by as much."""
    count = 0
    rising = False
    extreme = np.inf
    for value in readings.tolist():
        extreme = max(extreme, value) if rising else min(extreme, value)
        if rising and value < extreme - min_swing:
            count = count + 1
            rising = False
            extreme = value
        elif not rising and value > extreme + min_swing:
            rising = True
            extreme = value
    return count


def _typical_motion(limb: LimbParameters) -> tuple[float, float]:
    """Return the distance between limbs of one calibration in a typical motion, and its range, rad.

    The distance is the mean over the motion, of which the root mean square over limbs is taken.
    """
    # Shares of the full duty of both sides (K, 2), and the side of each wire.
    durations, *levels = np.transpose(TYPICAL_LEVELS)
    shares = np.repeat(np.transpose(levels), np.round(durations / STEP).astype(int), axis=0)
    sides = [int(wire.lever[0] > 0) for wire in limb.wires]
    # Find the duty that heats a wire to T_max by bisection.
    low = 0.0
    high = 1.0
    for _ in range(6):
        middle = (low + high) / 2
        hottest = _simulate_limbs([limb], middle * shares[:, sides])[0].max()
        low, high = (middle, high) if hottest < limb.temperature_limits.maximum else (low, middle)
    # Draw limbs that the recordings cannot tell apart, on other days.
    limbs = draw_limbs(limb, NUM_LIMBS)
    random = np.random.default_rng(0)
    for drawn in limbs:
        drift, room_deviation = random.standard_normal(2)
        drawn.segments[0].rest_angle += drawn.segments[0].bend_sensor.drift * drift
        drawn.ambient_temperature += AMBIENT_SPREAD * room_deviation
    # Compare each of them, with less or more supply in turn, with the calibrated limb.
    supplies = np.exp([0.0, -SUPPLY_SPREAD, SUPPLY_SPREAD]).tolist()
    bends = _simulate_limbs([limb, *limbs], low * shares[:, sides], supplies)[1]
    members = np.arange(1, len(limbs) + 1)
    distances = np.abs(bends[:, 1 + members % 2, members] - bends[:, 0, :1]).mean(axis=0)
    return float(np.sqrt((distances**2).mean())), float(np.ptp(bends[:, 0, 0]))


def _simulate_limbs(
    limbs: Sequence[LimbParameters], duty: np.ndarray, supplies: Sequence[float] = (1.0,)
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate T (S, W, B), °C, and φ (K + 1, R, B), rad, of cold limbs under duty (K, W).

    Each run has the duty times one of the supplies (R,).
    """
    # All wires start cold, each limb in its room.
    law, ambient, rubber = stack_limbs(limbs)
    rooms = np.repeat(ambient[:, np.newaxis], len(supplies), axis=1)
    room = np.repeat(rooms[..., np.newaxis], duty.shape[1], axis=-1)
    start = []
    for state, cold in zip(law.states, law.cold_states(0.0), strict=True):
        start.append(cold + law.is_temperature(state) * room)
    courses = np.multiply.outer(supplies, duty).swapaxes(0, 1)
    open_loop = OpenLoop(courses, STEP, limbs[0].segments[0])
    temperature, _, bend = open_loop.simulate(law, rooms, [*start, room], rubber)
    return temperature, bend.reshape(-1, *rooms.T.shape)


def next_recording(fit: LawFit | None, kinds: Collection[str], sag: str = "") -> str:
    """Return the recording to make next and what it tells, in words; empty if none is needed.

    Args:
        fit: fit of the wires; None if not by prediction.
        kinds: kinds of the recordings that there are.
        sag: the recording of the sag that tells k, in words; empty if k is known.
    """
    # A wire without heat or thermocouple comes first, then the least known parameter.
    if fit is None:
        kinds = {*kinds, "motion"}
    else:
        unidentified = fit.unidentified
        if not fit.measures_heat:
            unidentified = [u for u in unidentified if u.field not in READING_FIELDS]
        if unidentified:
            wire = unidentified[0].wire
            num_unknowns = sum(unknown.wire == wire for unknown in unidentified)
            bond = "with a thermocouple on it, " if num_unknowns == 1 else ""  # else never heated
            return _recording_in_words(fit, HEAT_ALONE, wire, unidentified, bond)
        shares = dict(zip(fit.names, fit.unknown_shares, strict=True))
        poorly_known = [u for u in fit.unknowns if shares[u.name] > KNOWN_SHARE]
        for unknown in sorted(poorly_known, key=lambda u: -shares[u.name]):
            if recording := identified_by(fit.law, unknown.field):
                return _recording_in_words(fit, recording, unknown.wire, poorly_known)
    # Then come the kinds of recordings that are missing.
    if "motion" not in kinds:
        return FURTHER_RECORDINGS["motion"]
    return sag or ("" if "ring_down" in kinds else FURTHER_RECORDINGS["ring_down"])


def identified_by(law: type[WireLaw], field: str) -> str:
    """Return the recording that tells an unknown of a law or of the segment best; empty if none."""
    for recording, fields in SEGMENT_RECORDINGS.items():
        if field in fields:
            return recording
    law_field = law.__dataclass_fields__.get(field)  # type: ignore[attr-defined]
    prior = law_field and law_field.metadata["prior"]
    return LAW_RECORDINGS.get(prior.identified_by, "") if prior else ""


def _recording_in_words(
    fit: LawFit, recording: str, wire: int | None, unknowns: Sequence[Unknown], bond: str = ""
) -> str:
    """Return a recording, with the name of its wire, if any, and the unknowns that it tells."""
    names = []
    for unknown in unknowns:
        if unknown.wire == wire and identified_by(fit.law, unknown.field) == recording:
            names.append(unknown.name)
    text = recording if wire is None else recording.format(fit.segment.wires[wire].name)
    return f"{bond}{text}, which tells {', '.join(names)}"
