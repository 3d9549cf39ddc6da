"""Horizons that are planned in a process of their own, beside one that has to keep time.

A solver holds Python's lock while it works, and a thread beside it would wait for it:
commands were late by 10 to 20 ms. What is sent and answered goes through pipes, as the
modules of a script need not be imported again for that.
"""

import dataclasses
import os
import pickle
import signal
import subprocess
import sys
import weakref

import numpy as np

from controllers.horizon import HorizonPlan, HorizonPlanner
from limb_systems import LimbError, Trajectory
from planners import Task, references

PRIORITY = 5  # by which the process gives way to who commands
PROGRAM = "from controllers.planner_process import answer_questions; answer_questions()"


def planner_of(trajectory: Trajectory, task: Task | None = None) -> HorizonPlanner:
    """Of horizons towards the reference of a plan that starts at time 0."""
    reference = references.from_samples(trajectory.time, trajectory.reference)
    return HorizonPlanner(trajectory.parameters, reference, task)


class PlannerProcess:
    """A `planner_of` a trajectory in another process, which ends with this object or process.

    Args:
        trajectory: a plan that starts at time 0.
        task: as of `HorizonPlanner`.

    Raises:
        LimbError: if the process cannot be started.
    """

    def __init__(self, trajectory: Trajectory, task: Task | None = None):
        process = self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # its matrices are small
        )
        assert process.stdin
        assert process.stdout
        self._questions, self._answers = process.stdin, process.stdout
        weakref.finalize(self, _end, process)
        if task:
            task = dataclasses.replace(task, customize=None)  # of no use to a horizon
        self._ask(trajectory, task)

    def plan(
        self,
        time: float,
        heat: np.ndarray,
        bend_offset: np.ndarray,
        previous: HorizonPlan | None = None,
    ) -> HorizonPlan:
        """As of `HorizonPlanner`; waits without holding other threads up.

        Raises:
            LimbError: if the process has ended.
        """
        return self._ask(time, heat, bend_offset, previous)

    def _ask(self, *question):
        """What the process answers."""
        try:
            pickle.dump(question, self._questions)
            self._questions.flush()
            return pickle.load(self._answers)
        except (EOFError, BrokenPipeError) as error:
            raise LimbError(
                "The process that plans the coming seconds has ended, perhaps because memory ran "
                "out; end other programs and start again."
            ) from error


def _end(process: subprocess.Popen) -> None:
    """Ends the process, which reads until there is nothing more."""
    process.communicate()


def answer_questions() -> None:
    """What the process does: answers on standard output until there are no more questions."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both, and the other decides
    os.nice(PRIORITY)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a solver may print is no answer
    planner = planner_of(*pickle.load(sys.stdin.buffer))
    answer = None
    while True:
        pickle.dump(answer, answers)
        try:
            answers.flush()
            question = pickle.load(sys.stdin.buffer)
        except (EOFError, BrokenPipeError):
            os._exit(0)  # what may be left to be written has no reader
        answer = planner.plan(*question)
