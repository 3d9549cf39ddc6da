"""Gaits of all schedules that are given, planned side by side; the best that walks is taken."""

import dataclasses
import functools
import os
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from limb_systems import Gait, RobotParameters
from limb_systems.progress import Progress
from planners import PlanningError
from planners.gait.gait import plan_gait
from planners.gait.schedules import Schedule
from soft_limb.runs.jobs import local_executor, run_each


@dataclasses.dataclass
class Trial:
    """A schedule, and what came of it.

    - ``schedule``: what each foot does in each phase.
    - ``gait``: the gait; None if there is none.
    - ``reason``: why there is none, or why it was not taken; empty if it was.
    """

    schedule: Schedule
    gait: Gait | None = None
    reason: str = ""


def find_gait(
    robot: RobotParameters,
    schedules: Sequence[Schedule],
    *,
    objective: Literal["speed", "energy"] = "speed",
    temperature_margin: float = 0.0,
    spread: bool = True,
) -> list[Trial]:
    """Plans a gait of each schedule, and checks them, the best first, until one walks as planned.

    Args:
        objective, temperature_margin, spread: as for `plan_gait`.

    Returns:
        What came of each schedule: first the gait that was taken, if any, then others by their
        objective, then those without a gait.
    """
    call = functools.partial(
        _planned, robot, objective=objective, temperature_margin=temperature_margin
    )
    trials = [Trial(schedule) for schedule in schedules]
    if len(schedules) > 1:
        with (
            local_executor(min(os.cpu_count() or 1, len(schedules))) as executor,
            Progress("planning", len(schedules), "schedules") as progress,
        ):
            trials = []
            for trial in run_each(call, schedules, executor):
                trials.append(trial)
                progress.update(len(trials))
    trials.sort(key=lambda trial: -_merit(trial.gait, objective) if trial.gait else np.inf)
    for number, trial in enumerate(trials):
        if trial.reason:
            break
        checked = call(trial.schedule, check=True, spread=spread)
        trial.gait, trial.reason = checked.gait, checked.reason
        if trial.reason:
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


def _planned(
    robot: RobotParameters, schedule: Schedule, check: bool = False, **options: Any
) -> Trial:
    try:
        return Trial(schedule, plan_gait(robot, schedule=schedule, check=check, **options))
    except PlanningError as error:
        return Trial(schedule, reason=str(error))
