"""Gaits of all schedules that are given, planned side by side; the best that walks is taken."""

import concurrent.futures
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from limb_systems import Gait, RobotParameters
from planners import PlanningError
from planners.gait.gait import plan_gait
from planners.gait.schedules import Schedule, schedule_text
from soft_limb.runs.jobs import run_each


@dataclasses.dataclass
class Trial:
    """A schedule, and what came of it.

    - ``schedule``: its text.
    - ``gait``: the gait; None if there is none.
    - ``reason``: why there is none, or why it was not taken; empty if it was.
    """

    schedule: str
    gait: Gait | None = None
    reason: str = ""


def find_gait(
    robot: RobotParameters,
    schedules: Sequence[Schedule],
    executor: concurrent.futures.Executor,
    said: Callable[[int], None],
    *,
    objective: Literal["speed", "energy"] = "speed",
    temperature_margin: float = 0.0,
    spread: bool = True,
) -> list[Trial]:
    """Plans a gait of each schedule, and checks them, the best first, until one walks as planned.

    Args:
        executor: runs the planning.
        said: function that is called with the number of schedules that are done.
        objective, temperature_margin: as for `plan_gait`.
        spread: as for `check_gait`.

    Returns:
        What came of each schedule: first the gait that was taken, if any, then others by their
        objective, then those without a gait.
    """
    call = functools.partial(
        _planned, robot, objective=objective, temperature_margin=temperature_margin
    )
    trials: list[Trial] = []
    for trial in run_each(call, schedules, executor):
        trials.append(trial)
        said(len(trials))
    trials.sort(key=lambda trial: -_merit(trial.gait, objective) if trial.gait else np.inf)
    for number, trial in enumerate(trials):
        if trial.gait is None:
            break
        try:
            trial.gait = plan_gait(
                robot,
                schedule=trial.gait.schedule,
                objective=objective,
                temperature_margin=temperature_margin,
                spread=spread,
            )
        except PlanningError as error:
            trial.reason = str(error)
            continue
        for slower in trials[number + 1 :]:
            if slower.gait:
                slower.reason = f"{1e3 * slower.gait.speed:.2f} mm/s, and another is better"
        return [trial, *trials[:number], *trials[number + 1 :]]
    return trials


def _merit(gait: Gait, objective: str) -> float:
    """What the objective is to make large: speed, m/s, or distance for the heat of a cycle, m/s."""
    if objective == "speed":
        return gait.speed
    return gait.stride / float(np.diff(gait.time) @ gait.duty[:, :-1].sum(axis=0))


def _planned(robot: RobotParameters, schedule: Schedule, **options) -> Trial:
    try:
        gait = plan_gait(robot, schedule=schedule, check=False, **options)
    except PlanningError as error:
        return Trial(schedule_text(schedule), reason=str(error))
    return Trial(schedule_text(schedule), gait)
