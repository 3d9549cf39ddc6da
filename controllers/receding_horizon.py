"""Receding horizon: plans towards the reference while a limb moves, and feedback about them.

In real time, another process plans the horizons: a solver holds Python's lock
while it works, and with a thread commands were late by 10 to 20 ms. Requests and plans go
through a socket, so that the modules of a script need not be imported again.
"""

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

REPLAN_TICKS = 5  # from one plan to the next
PROPORTIONAL_GAIN = 0.3  # 1/s; small, as the next plan follows soon
NICENESS = 5  # of the planning process, which gives way to the commanding process
PROCESS_CODE = "from controllers.receding_horizon import serve_plans; serve_plans()"


class RecedingHorizon(PlanController):
    """Feedback that plans the coming seconds again and again, towards a plan's reference.

    At 4 Hz `HorizonPlanner` plans from the estimate of the next tick, at which the
    new plan comes into force. Between plans, the estimated bend φ follows the bend φ* of the
    newest plan by a bend rate of k_p (φ* - φ), to which the wires contribute as in `PlanFeedback`.

    In simulated time, a plan is made within its tick. In real time another process makes it, and
    the command never waits for it: the previous plan stays in force until the new plan is
    ready. A plan that is not ready when the next plan is due is late, and the next plan is left
    out. The previous plan also stays in force if planning fails.

    Ports and state are as in `PlanController`, and

    - output 1 ``replans``: numbers of plans that were begun, were late and failed (3)
    - state, discrete, at 20 Hz: 2: the replans; 3: the plan in force

    ``counts`` has the newest replans (3), for a summary when the simulation is gone.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, trajectory: Trajectory, *, real_time: bool = False):
        """
        Args:
            trajectory: a plan; its reference is followed, and its duty is in force until the
                first horizon is planned.
            real_time: whether another process makes the plans.
        """
        plan = trajectory.since_start()
        self._planner = HorizonPlanner.of(plan)
        self._process = PlannerProcess(plan) if real_time else None
        first = self._planner.first_horizon(plan)
        super().__init__(trajectory.parameters, first.duty[0])
        self._template = first
        margin = horizon_task().temperature_margin
        self._highest = np.array(trajectory.parameters.temperature_limits.maximum - margin)
        self.counts = np.zeros(3)
        replans = self.DeclareDiscreteState(3)
        self.DeclareDiscreteState(pack(first))
        self.DeclareStateOutputPort("replans", replans)

    def _desired_duty(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        counts = state.value(2).copy()
        plan = unpack(state.value(3), self._template)
        if self._process and (made := self._process.poll_plan()):
            plan = _newer_plan(made, plan, counts)
            state.set_value(2, counts)
            state.set_value(3, pack(plan))
            self.counts = counts
        missed = plan.bend_angle_at(time) - self._estimator.bend_angle(estimate)
        return plan.duty_at(time), PROPORTIONAL_GAIN * missed

    def _temperature_limit(self, time: float, estimate: StateEstimate) -> np.ndarray:
        return self._highest

    def _after_update(self, context, ahead: StateEstimate, state) -> None:
        time = self._plan_time(context)
        if round(time / PERIOD) % REPLAN_TICKS:
            return
        counts = state.value(2).copy()
        plan = unpack(state.value(3), self._template)
        request = time + PERIOD, ahead.heat, ahead.lasting, plan, ahead.residual
        is_late = self._process is not None and self._process.is_planning
        counts[1 if is_late else 0] += 1
        if self._process is None:
            state.set_value(3, pack(_newer_plan(self._planner.plan(*request), plan, counts)))
        elif not is_late:
            self._process.begin(*request)
        state.set_value(2, counts)
        self.counts = counts


def _newer_plan(made: HorizonPlan, plan: HorizonPlan, counts: np.ndarray) -> HorizonPlan:
    """Return the new plan, or the previous plan if the new plan failed; count failures."""
    counts[2] += not made.success
    return made if made.success else plan


class PlannerProcess:
    """A `HorizonPlanner` in another process, which ends with this object or program.

    - ``is_planning``: whether a plan was requested that is not ready yet.

    Args:
        trajectory: a plan that starts at time 0.

    Raises:
        LimbError: if the process cannot be started.
    """

    def __init__(self, trajectory: Trajectory):
        # Start the process with one end of a socket.
        ours, theirs = socket.socketpair()
        process = self._process = subprocess.Popen(
            [sys.executable, "-c", PROCESS_CODE, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=sys.__stderr__,  # a solver may print
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # its matrices are small
        )
        theirs.close()
        self._connection = Connection(ours.detach())
        weakref.finalize(self, _end, process, self._connection)
        # Send the plan, and wait until the planner is built.
        self.begin(trajectory)
        self._connection.poll(None)
        self.poll_plan()

    def begin(self, *request: Any) -> None:
        """Request a plan by the arguments of `HorizonPlanner.plan`, once the last plan is made.

        Raises:
            LimbError: if the process has ended.
        """
        self.is_planning = True
        try:
            self._connection.send(request)
        except OSError as error:
            raise LimbError(PROCESS_ENDED) from error

    def poll_plan(self) -> HorizonPlan | None:
        """Return the requested plan, without waiting; None if it is not ready yet.

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


def serve_plans() -> None:
    """Make the requested plans, in the planning process, until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the commanding one decides
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
