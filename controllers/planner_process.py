"""Horizons that are planned in a process of their own, beside one that has to keep time.

A solver holds Python's lock while it works, and a thread beside it would wait for it:
commands were late by 10 to 20 ms. What is sent and answered goes through a socket, as the
modules of a script need not be imported again for that.
"""

import dataclasses
import os
import signal
import socket
import subprocess
import sys
import weakref
from multiprocessing.connection import Connection

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
        ours, theirs = socket.socketpair()
        process = self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=sys.__stderr__,  # what a solver may print is no result of ours
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # its matrices are small
        )
        theirs.close()
        self._connection = Connection(ours.detach())
        weakref.finalize(self, _end, process, self._connection)
        if task:
            task = dataclasses.replace(task, customize=None)  # of no use to a horizon
        self._ask(trajectory, task)
        self._answer()

    def begin(
        self,
        time: float,
        heat: np.ndarray,
        bend_offset: np.ndarray,
        previous: HorizonPlan | None = None,
    ) -> None:
        """Asks for a plan, as of `HorizonPlanner.plan`, once the one before is made.

        Raises:
            LimbError: if the process has ended.
        """
        self._ask(time, heat, bend_offset, previous)

    def plan_if_made(self) -> HorizonPlan | None:
        """The plan that was asked for; None if it is not made yet. Does not wait.

        Raises:
            LimbError: if the process has ended.
        """
        return self._answer() if self._connection.poll() else None

    def _ask(self, *question) -> None:
        try:
            self._connection.send(question)
        except OSError as error:
            raise LimbError(ENDED) from error

    def _answer(self):
        try:
            return self._connection.recv()
        except (EOFError, OSError) as error:
            raise LimbError(ENDED) from error


ENDED = (
    "The process that plans the coming seconds has ended, perhaps because memory ran out; end "
    "other programs and start again."
)


def _end(process: subprocess.Popen, connection: Connection) -> None:
    """Ends the process, whatever it is at; it may be stopped."""
    connection.close()
    process.kill()
    process.wait()


def answer_questions() -> None:
    """What the process does: answers until there are no more questions."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both, and the other decides
    os.nice(PRIORITY)
    connection = Connection(int(sys.argv[1]))
    planner = planner_of(*connection.recv())
    answer = None
    try:
        while True:
            connection.send(answer)
            answer = planner.plan(*connection.recv())
    except (EOFError, OSError):
        os._exit(0)
