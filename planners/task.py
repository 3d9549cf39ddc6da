"""The task of a plan: the weights of (15), and further costs and limits."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from limb_systems import LimbError, LimbParameters
from limb_systems.errors import reraise_as
from limb_systems.files.input import read_text
from limb_systems.files.schema import load_typed
from limb_systems.plan_band import MAX_MARGIN, temperature_margin


class TaskError(LimbError):
    """A field of a task is invalid."""


@dataclasses.dataclass(frozen=True)
class Phase:
    """Weights from a time on, until the next phase.

    - ``start``: s.
    - ``angle_weight``, ``duty_weight``: as in `Task`.
    """

    start: float
    angle_weight: float
    duty_weight: float

    def __post_init__(self):
        _check_weights(self, " of a phase")


@dataclasses.dataclass(frozen=True)
class Task:
    """Weights and limits of a plan.

    The defaults are the weights of the paper's (15), except at the end of the plan. In (15), duty
    at the last knot has no weight and the last angle has 1000 times the weight of the others, so
    that duty chatters and jumps in the last second. Here duty is constant in the last second, and
    the last angle has less weight. `Task.paper` is (15) as printed.

    Cost:

    - ``angle_weight``: Q, on each joint's deviation, 1/rad².
    - ``duty_weight``: R, on each wire's duty squared.
    - ``terminal_factor``: Q_N / Q.
    - ``phases``: other Q and R from given times on.
    - ``energy_weight``: weight of the sum of duty over wires and knots, which is
      proportional to the heating energy; for minimum energy.
    - ``temperature_weight``: weight of the mean temperature above ambient of each
      segment's wires at each knot, 1/°C; against wires that heat up against each other.
    - ``time_weight``: weight of the duration, 1/s; for minimum time.

    Limits in addition to (18)-(20), all linear; the bend rate is the mean of (11):

    - ``max_bend_rate``: largest bend rate of each segment at the knots, rad/s.
    - ``max_temperature_rate``: largest temperature rate of each wire, °C/s.
    - ``reach``: whether each segment must end within 0.1° of the reference's
      last angle, with a bend rate of at most 0.5°/s.
    - ``final_hold``: time before the end in which the bend rate is at most 0.5°/s, s.
    - ``duty_hold``: time before the end in which duty is constant, s; at least
      the last interval, unless it is zero.
    - ``temperature_margin``: distance of the wires from T_max, °C, where feedback may heat them.
    - ``duty_margin``: distance of duty from 1. It may be 0 all the same: then
      feedback heats the other wire.
    - ``stretch``: shortest and longest duration of the plan, as factors of the reference's
      duration; None if both are 1. Reference and warm-up (20) are stretched alike.

    - ``customize``: function that is called with the program before it is solved, to add your own
      costs and constraints to its ``prog``. A planar limb has a `TrajectoryProgram`. Its ``states``
      are the indices of θ (n), rad; θ̇ (n), rad/s; the wires' states (N), which begin with T (W),
      °C; and V (W), °C, at each knot. A limb in space has a `QuasiStaticProgram`, with ``bends`` in
      place of ``states``. Both have ``heat``, the wires' states and V, and ``duty``. The plan's
      check lists the added terms, by the descriptions of their evaluators.
    """

    angle_weight: float = 100.0
    duty_weight: float = 2.0
    terminal_factor: float = 100.0
    phases: Sequence[Phase] = ()
    energy_weight: float = 0.0
    temperature_weight: float = 0.0
    time_weight: float = 0.0
    max_bend_rate: float | None = None
    max_temperature_rate: float | None = None
    reach: bool = False
    final_hold: float = 0.0
    duty_hold: float = 1.0
    temperature_margin: float = 0.0
    duty_margin: float = 0.0
    stretch: tuple[float, float] | None = None
    customize: Callable | None = dataclasses.field(default=None, metadata={"in_files": False})

    def __post_init__(self):
        # Check the numbers.
        _check_weights(self, "")
        if not self.duty_margin < 1:
            raise TaskError(f"duty_margin is {self.duty_margin!r}; it must be less than 1.")
        for name in ("max_bend_rate", "max_temperature_rate"):
            value = getattr(self, name)
            if value is not None and not (_is_number(value) and value > 0):
                raise TaskError(f"{name} is {value!r}; it must be a positive number or None.")
        if not isinstance(self.reach, bool | np.bool_):
            raise TaskError(f"reach is {self.reach!r}; it must be True or False.")
        if self.stretch is not None and not _is_stretch(self.stretch):
            raise TaskError(
                f"stretch is {self.stretch!r}; it must be a shortest and a longest factor, "
                "both positive."
            )
        if self.time_weight and self.stretch is None:
            raise TaskError("time_weight needs a stretch, the factors that the time may take.")
        # Check the phases and the function.
        if not all(isinstance(phase, Phase) for phase in self.phases):
            raise TaskError(f"phases is {self.phases!r}; it must be a sequence of Phase.")
        if not (self.customize is None or callable(self.customize)):
            raise TaskError(f"customize is {self.customize!r}; it must be a function or None.")
        starts = [phase.start for phase in self.phases]
        if starts != sorted(starts):
            raise TaskError("phases must come in the order of their start.")

    @classmethod
    def paper(cls) -> "Task":
        """Return the paper's (15): Q_N = 1000 Q, and duty is free to the last knot."""
        return cls(terminal_factor=1000.0, duty_hold=0.0)

    @classmethod
    def closed_loop(cls, parameters: LimbParameters | None = None) -> "Task":
        """Return weights and margins of plans for feedback.

        The plan of a calibrated limb goes to the reference: its duty has little weight, and its
        wires may be as hot as `TemperatureLimiter` lets feedback heat them. The plan of another
        limb leaves heat and duty to the feedback, for unknown errors.

        Args:
            parameters: description of the limb; one that is not calibrated if None.
        """
        record = parameters and parameters.calibration
        if not (parameters and record and record.bend_error > 0):
            return cls(duty_weight=10.0, temperature_margin=MAX_MARGIN, duty_margin=0.4)
        return cls(duty_weight=0.5, temperature_margin=temperature_margin(parameters))

    @classmethod
    def load(cls, path: str | Path) -> "Task":
        """Read a YAML file of fields; fields that are left out have their defaults.

        Raises:
            TaskError: with one sentence naming the file and the field.
        """
        text = read_text(path, "task", TaskError)
        with reraise_as(TaskError, f"{path}: "):
            return load_typed(cls, text)

    @property
    def named_limits(self) -> str:
        """The task's limits in words, for sentences."""
        names = ["max_bend_rate", "max_temperature_rate", "reach", "final_hold", "customize"]
        given = [name for name in names if getattr(self, name)]
        return f" and the task's {', '.join(given)}" if given else ""

    def weights(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return Q and R at the knots, each (N,); the last Q is Q_N, the last R has no effect.

        (15) is a sum over knots. Knots that are closer than the widest spacing have proportionally
        less weight, so that adding knots does not change the sum.
        """
        angle = np.full(len(times), self.angle_weight)
        duty = np.full(len(times), self.duty_weight)
        for phase in self.phases:
            angle[times >= phase.start] = phase.angle_weight
            duty[times >= phase.start] = phase.duty_weight
        angle[-1] *= self.terminal_factor
        share = self.shares(times)
        return angle * share, duty * share

    @staticmethod
    def shares(times: np.ndarray) -> np.ndarray:
        """Return the weight of each knot (N,): 1 where knots are evenly spaced."""
        steps = np.diff(times)
        widest = steps.max()
        # Spacings that are equal except for rounding get exactly the weight one.
        return np.append(np.where(np.isclose(steps, widest, rtol=1e-9), 1.0, steps / widest), 1.0)


def _check_weights(task: Task | Phase, whose: str) -> None:
    """Raise TaskError unless all fields that are always numbers are zero or more."""
    for field in dataclasses.fields(task):
        value = getattr(task, field.name)
        if field.type is float and not (_is_number(value) and value >= 0):
            raise TaskError(f"{field.name}{whose} is {value!r}; it must be a number, zero or more.")


def _is_number(value: Any) -> bool:
    kinds = (int, float, np.integer, np.floating)
    return isinstance(value, kinds) and not isinstance(value, bool) and bool(np.isfinite(value))


def _is_stretch(value: Any) -> bool:
    if not isinstance(value, Sequence) or len(value) != 2 or not all(map(_is_number, value)):
        return False
    return 0 < value[0] <= value[1]
