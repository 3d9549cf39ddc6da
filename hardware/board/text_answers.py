"""What the answers of a text board show: readings that no sensor has, and lines that do no more.

Such a board confirms nothing. But a wire whose duty is zero cools, and one that is heated gets
warmer. Where that is not read, the sketch may answer without taking lines any more.
"""

import dataclasses
import math
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from hardware.board.text_board import BEND, DUTY, SENSORS, TextBoard
from hardware.firmware import guard, heat
from limb_systems.files.signal_table import RANGES
from limb_systems.heat_bounds import HeatBounds

NO_DUTY = 0.01  # largest duty at which a wire cools
COOL = 10.0  # °C above the room, at which a wire need not cool
CROSSTALK = 0.5  # share of the warmest other wire's rise that may reach it through the limb
NOISE = 0.5  # °C, of a reading that rises
LAG = 3.0  # s, for which a reading must not have risen, to say that its wire cools
FALL = 0.25  # share of its rise above the room by which a wire cools
STILL, LONGEST_COOLING = 15.0, 30.0  # s, within which it begins to, and does so
ECHO = 1.0  # s, within which a duty that was sent is answered with


class AnswerCheck:
    """Compares the answers of a text board with what was sent to it."""

    def __init__(self, board: TextBoard, wire_names: Sequence[str]):
        self._board, self._names = board, list(wire_names)
        count = len(self._names)
        self._room, self._before = math.inf, math.nan  # °C and s, of the answer before
        self._heated = np.zeros(count, bool)  # and not read to have cooled since
        self._since = np.zeros(count)  # s, when its duty became zero
        self._peak, self._risen = np.full(count, -np.inf), np.zeros(count)  # °C and s, from then on
        self._sent: deque[tuple[float, np.ndarray]] = deque([(-math.inf, np.zeros(count))])
        self._echoes = np.zeros(count)
        self._observers: list[heat.WireObserver] = []
        self._cold = np.zeros(count)

    def arm(self, temperature: np.ndarray, bounds: Sequence[HeatBounds]) -> None:
        """Takes readings of wires without heat, and bounds by which heat must show, if any."""
        self._cold, self._before = temperature, math.nan
        self._observers = [heat.WireObserver(0.0) for _ in bounds]
        for observer, bound in zip(self._observers, bounds, strict=True):
            observer.bounds = dataclasses.astuple(bound.around_any())

    def implausible(self, values: Mapping[str, float]) -> str:
        """Say which sensor reads what no sensor does, empty if none does."""
        low, high, _ = RANGES["measured_temperature"]
        for name in self._names:
            if name in self._board.answered and not low <= (read := values[name]) <= high:
                return (
                    f"The thermocouple of the {name} wire reads {read:.3g} °C, outside of {low:g} "
                    f"to {high:g} °C"
                )
        if BEND not in self._board.answered:
            return ""
        assert self._board.answer
        low, high, _ = RANGES["bend_angle"]
        bend = SENSORS[self._board.answer.bend_of]().bend_angle(values[BEND])
        if low <= bend <= high:
            return ""
        return (
            f"The bend sensor reads a {self._board.answer.bend_of.replace('_', ' ')} of "
            f"{np.rad2deg(values[BEND]):.3g}°, a bend outside of {np.rad2deg(low):g}° to "
            f"{np.rad2deg(high):g}°"
        )

    @property
    def waiting(self) -> bool:
        """Whether a wire, or a duty in the answers, has still to follow zero."""
        return bool(self._heated.any() or (self._echoes > 0).any())

    def deaf(self, now: float, sent: np.ndarray, values: Mapping[str, float]) -> str:
        """Say by what the board shows that it takes no lines any more, empty if it does not.

        Args:
            now: time of the answer, s.
            sent: duty (W) since the last call, as it was sent.
            values: plausible readings, as `AnswerLine.read` returns them.
        """
        temperature = np.array([values.get(name, np.nan) for name in self._names])
        return (
            self._unlike_echo(now, sent, values)
            or self._not_cooling(now, sent, temperature)
            or self._not_warming(now, sent, temperature)
        )

    def _unlike_echo(self, now: float, sent: np.ndarray, values: Mapping[str, float]) -> str:
        """Whether the answers name a duty that was not sent within the last second."""
        self._sent.append((now, sent))
        while len(self._sent) > 1 and self._sent[1][0] < now - ECHO:
            self._sent.popleft()
        recent = np.array([duty for _, duty in self._sent])
        line = self._board.line
        tolerance = 0.01 + 10.0**-line.decimals / line.full
        for wire, name in enumerate(self._names):
            if DUTY + name not in values:
                continue
            duty = values[DUTY + name] / line.full
            self._echoes[wire] = duty if duty > tolerance else 0.0
            low, high = recent[:, wire].min(), recent[:, wire].max()
            if not low - tolerance <= duty <= high + tolerance:
                return (
                    f"The board says that the {name} wire has a duty of {duty:.2f}, and "
                    f"{sent[wire]:.2f} was sent for {ECHO:g} s"
                )
        return ""

    def _not_cooling(self, now: float, sent: np.ndarray, temperature: np.ndarray) -> str:
        """Whether a wire does not cool although its duty is zero."""
        off, rising = sent <= NO_DUTY, temperature > self._peak + NOISE
        self._heated |= ~off & np.isfinite(temperature)
        self._since[~off], self._peak[~off] = now, -np.inf
        self._risen[~off | rising] = now
        self._peak[rising & off] = temperature[rising & off]
        if np.isfinite(temperature).any():
            self._room = min(self._room, float(np.nanmin(temperature)))
        rise = np.nan_to_num(temperature - self._room)
        for wire in np.flatnonzero(self._heated & off):
            others = np.delete(rise, wire).max(initial=0.0)
            warm = rise[wire] > COOL + CROSSTALK * others
            fallen, top = self._peak[wire] - temperature[wire], self._peak[wire] - self._room
            zero, steady = now - self._since[wire], now - self._risen[wire]
            if steady > LAG and (not warm or fallen > FALL * top):
                self._heated[wire] = False
            elif warm and (
                zero > LONGEST_COOLING
                or (zero > STILL and fallen < NOISE)
                or (zero > LAG and temperature[wire] > self._board.temperature_limit)
            ):
                return (
                    f"The {self._names[wire]} wire is read at {temperature[wire]:.0f} °C, and "
                    f"does not cool although zero was sent for {zero:.0f} s"
                )
        return ""

    def _not_warming(self, now: float, sent: np.ndarray, temperature: np.ndarray) -> str:
        """Whether a wire is read to be colder than the duty makes any wire."""
        elapsed, self._before = now - self._before, now
        if not elapsed > 0:
            return ""
        for wire, observer in enumerate(self._observers):
            observer.advance(float(sent[wire]), elapsed, temperature[wire] - self._cold[wire])
            if observer.shortfall > guard.SHORTFALL:
                least = self._cold[wire] + observer.least_reading
                return (
                    f"The {self._names[wire]} wire is read at {temperature[wire]:.0f} °C, and by "
                    f"what was sent it must have {least:.0f} °C or more"
                )
        return ""
