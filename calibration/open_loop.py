"""Recordings simulated open loop from their duty, for many values of the parameters at once.

Heat and torque are those of the wires' law, which is stated in `limb_systems`
alone. The limb follows its wires without delay: it rings at some hertz, and
they heat within seconds. On a segment without gravity all joints turn alike,
and each bend sensor then reads φ.
"""

import copy
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.course import STEP, Course
from limb_systems import SegmentParameters, WireLaw
from limb_systems.model.rubber import ramp


class OpenLoop:
    """R recordings of one segment of W wires.

    Arrays begin with B, the number of sets of parameters that are simulated at
    once, where they differ between these.

    Args:
        courses: the recordings (R).
        segment: whose links, stiffness and wires' directions count.
    """

    def __init__(self, courses: Sequence[Course], segment: SegmentParameters):
        self._courses, self._segment = courses, segment
        self._directions = np.array([wire.direction for wire in segment.wires])
        self._sides = np.sign(self._directions)
        self.num_steps = max(len(course.duty) for course in courses)
        self._duty = np.zeros((self.num_steps, len(courses), len(segment.wires)))
        for number, course in enumerate(courses):
            self._duty[: len(course.duty), number] = course.duty

    def simulate(
        self,
        law: WireLaw,
        ambient: np.ndarray,
        initial: Sequence[np.ndarray],
        rubber: Mapping[str, np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """V and φ at the ends of the steps.

        Args:
            law: with fields of shape (B, 1, W).
            ambient: T0 of each recording (B, R), °C.
            initial: states of the wires, then V, at the start, each (B, R, W).
            rubber: ``rest_angle`` (B,), rad; optionally ``stiffening`` (B,), and
                ``shift``, rad, and ``rate``, 1/rad, of the rest angle's memory (B,).

        Returns:
            V (K + 1, B, R, W), °C, and φ (K + 1, B, R), rad.
        """
        room, h, links = ambient[..., None], STEP, self._segment.links
        to_bend = (links + 1) / 2  # (11)
        heat = np.array(initial)
        readings = np.empty((self.num_steps + 1, *heat.shape[1:]))
        bends = np.empty((self.num_steps + 1, *ambient.shape))
        rest = rubber["rest_angle"][:, None]
        angle = np.zeros(ambient.shape)  # of each joint, from rest
        alone = np.zeros(heat.shape[1:])  # bend angle that each wire would hold alone
        shift = np.zeros(ambient.shape)  # of the rest angle by its memory
        for step in range(self.num_steps + 1):
            readings[step] = heat[-1]
            theta = (angle + rest / to_bend)[..., None]
            torques = law.torque(heat[:-1], room, theta) * self._directions
            before, alone = alone, to_bend / self._segment.stiffness * np.abs(torques)
            if "shift" in rubber and step:
                progress = h * ramp((alone - before) / h)
                towards = rubber["shift"][:, None] * (progress * self._sides).sum(axis=-1)
                pace = rubber["rate"][:, None]
                shift = (shift + pace * towards) / (1 + pace * progress.sum(axis=-1))
            pull = torques.sum(axis=-1) / self._segment.stiffness + shift / to_bend
            angle = self._at_rest(pull, angle, rubber)
            bends[step] = rest + to_bend * angle
            if step < self.num_steps:
                heat = _runge_kutta(law, heat, self._duty[step], room, h)
        return readings, bends

    def _at_rest(
        self, pull: np.ndarray, angle: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Joint angle that a torque over k holds, from the angle before, by Newton's method."""
        if "stiffening" not in rubber:
            return pull
        at_45 = np.pi / 2 / (self._segment.links + 1)
        cubic = rubber["stiffening"][:, None] / at_45**2
        for _ in range(2):
            excess = angle + cubic * angle**3 - pull
            angle = angle - excess / (1 + 3 * cubic * angle**2)
        return angle

    def at_samples(
        self, number: int, readings: np.ndarray, bends: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """V (M, B, W) and φ (M, B) at the samples of one recording, from those of all steps."""
        steps = self._courses[number].times / STEP
        before = np.minimum(steps.astype(int), self.num_steps - 1)
        after = (steps - before)[:, None]
        bend = bends[before, :, number] * (1 - after) + bends[before + 1, :, number] * after
        after = after[..., None]
        reading = (
            readings[before, :, number] * (1 - after) + readings[before + 1, :, number] * after
        )
        return reading, bend


def with_fields(law: type[WireLaw], fields: Mapping[str, np.ndarray]) -> WireLaw:
    """A law of a class with arrays for fields, for calculations alone."""
    together = copy.copy(law())
    for name, values in fields.items():
        setattr(together, name, values)
    return together


def _runge_kutta(law: WireLaw, heat: np.ndarray, duty: np.ndarray, room, h: float) -> np.ndarray:
    """[x, V] a step later, by the classical method."""

    def rates(heat: np.ndarray) -> np.ndarray:
        result = np.empty_like(heat)
        for row, rate in zip(result, law.rates(heat[:-1], duty, room), strict=False):
            row[...] = rate
        result[-1] = law.reading_rate(heat[-1], heat[:-1])
        return result

    first = rates(heat)
    second = rates(heat + h / 2 * first)
    third = rates(heat + h / 2 * second)
    fourth = rates(heat + h * third)
    return heat + h / 6 * (first + 2 * (second + third) + fourth)
