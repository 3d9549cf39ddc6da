"""Replans towards the reference, while a limb moves, and follows the newest plan.

In real time, horizons are planned in a process of their own: a solver holds Python's lock
while it works, and with a thread commands were late by 10 to 20 ms. Questions and answers go
through a socket, as the modules of a script need not be imported again for that.
"""

import dataclasses
import os
import signal
import socket
import subprocess
import sys
import weakref
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from controllers.estimator import StateEstimate, pack, unpack
from controllers.horizon import HorizonPlan, HorizonPlanner, horizon_task
from controllers.plan_controller import PlanController
from limb_systems import LimbError, Trajectory
from limb_systems.simulation import PERIOD
from planners import Task

REPLAN_TICKS = 5  # from one plan to the next
PROPORTIONAL_GAIN = 0.3  # 1/s; little, as the next plan is soon there, and knows the wires
NICENESS = 5  # by which the process gives way to who commands
PROCESS_CODE = "from controllers.receding_horizon import answer_questions; answer_questions()"


class RecedingHorizon(PlanController):
    """Feedback that plans the coming seconds again and again, towards a plan's reference.

    At 4 Hz `HorizonPlanner` plans from the estimate of the next tick, from which on the
    new plan is in force. Between plans, the estimated bend φ is held to that of the
    newest by a bend rate of k_p (φ* - φ), to which the wires contribute as in `PlanFeedback`.

    In simulated time, a plan is made within its tick. In real time it is made in a
    process of its own and the command never waits for it: the plan before stays in
    force until it is there. It is late if that is not so when the next one is due,
    which is then left out. If planning fails, the plan before stays in force, too.

    Ports and state are those of `PlanController`, and

    - output 1 ``replans``: how many plans were begun, were late and failed (3)
    - state, discrete, at 20 Hz: 2: the replans; 3: the plan in force
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self, trajectory: Trajectory, *, task: Task | None = None, real_time: bool = False
    ):
        """
        Args:
            trajectory: a plan, whose reference it follows, and whose duty is in force
                until the first plan of its own.
            task: weights and margins, as for `HorizonPlanner`.
            real_time: whether plans are made in a process of their own.
        """
        plan = trajectory.since_start()
        self._planner = HorizonPlanner.of(plan, task)
        self._process = PlannerProcess(plan, task) if real_time else None
        first = self._planner.first_horizon(plan)
        super().__init__(trajectory.parameters, first.duty[0])
        self._template = first
        margin = (task or horizon_task()).temperature_margin
        self._highest = np.array(trajectory.parameters.temperature_limits.maximum - margin)
        replans = self.DeclareDiscreteState(3)
        self.DeclareDiscreteState(pack(first))
        self.DeclareStateOutputPort("replans", replans)

    def _desired_duty(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        counts, plan = state.value(2).copy(), unpack(state.value(3), self._template)
        if self._process and (made := self._process.poll_plan()):
            plan = _replace_if_solved(made, plan, counts)
            state.set_value(2, counts)
            state.set_value(3, pack(plan))
        missed = plan.bend_angle_at(time) - self._estimator.bend_angle(estimate)
        return plan.duty_at(time), PROPORTIONAL_GAIN * missed

    def _temperature_limit(self, time: float, estimate: StateEstimate) -> np.ndarray:
        return self._highest

    def _after_update(self, context, ahead: StateEstimate, state) -> None:
        time = self._plan_time(context)
        if round(time / PERIOD) % REPLAN_TICKS:
            return
        counts, plan = state.value(2).copy(), unpack(state.value(3), self._template)
        question = time + PERIOD, ahead.heat, ahead.lasting, plan, ahead.residual
        is_late = self._process is not None and self._process.is_planning
        counts[1 if is_late else 0] += 1
        if self._process is None:
            state.set_value(
                3, pack(_replace_if_solved(self._planner.plan(*question), plan, counts))
            )
        elif not is_late:
            self._process.begin(*question)
        state.set_value(2, counts)


def _replace_if_solved(made: HorizonPlan, plan: HorizonPlan, counts: np.ndarray) -> HorizonPlan:
    """Return a new plan, or the plan before if the new one failed; count failures."""
    counts[2] += not made.success
    return made if made.success else plan


class PlannerProcess:
    """A `HorizonPlanner` in another process, which ends with this object or program.

    - ``is_planning``: whether a plan was asked for that is not there yet.

    Args:
        trajectory: a plan that starts at time 0.
        task: weights and margins, as for `HorizonPlanner`.

    Raises:
        LimbError: if the process cannot be started.
    """

    def __init__(self, trajectory: Trajectory, task: Task | None = None):
        ours, theirs = socket.socketpair()
        process = self._process = subprocess.Popen(
            [sys.executable, "-c", PROCESS_CODE, str(theirs.fileno())],
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
        self.begin(trajectory, task)
        self._connection.poll(None)
        self.poll_plan()

    def begin(self, *question: Any) -> None:
        """Ask for a plan by the arguments of `HorizonPlanner.plan`, once the last is made.

        Raises:
            LimbError: if the process has ended.
        """
        self.is_planning = True
        try:
            self._connection.send(question)
        except OSError as error:
            raise LimbError(PROCESS_ENDED) from error

    def poll_plan(self) -> HorizonPlan | None:
        """Return the plan that was asked for; None if it is not made yet. Does not wait.

        Raises:
            LimbError: if the process has ended.
        """
        try:
            if not self._connection.poll():
                return None
            self.is_planning = False
            return self._connection.recv()
        except (EOFError, OSError) as error:
            raise LimbError(PROCESS_ENDED) from error


PROCESS_ENDED = (
    "The process that plans the coming seconds has ended, perhaps because memory ran out; end "
    "other programs and start again."
)


def _end(process: subprocess.Popen, connection: Connection) -> None:
    """End the process, which may be busy or stopped."""
    connection.close()
    process.kill()
    process.wait()


def answer_questions() -> None:
    """Answer questions in the process until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both, and the other decides
    os.nice(NICENESS)
    connection = Connection(int(sys.argv[1]))
    planner = HorizonPlanner.of(*connection.recv())
    answer = None
    try:
        while True:
            connection.send(answer)
            answer = planner.plan(*connection.recv())
    except (EOFError, OSError):
        os._exit(0)
