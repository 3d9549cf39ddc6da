"""Drives a limb by what comes on ROS 2 topics, and publishes what it does."""

import contextlib
import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import PassThrough

from hardware.board.journal import open_journal
from hardware.firmware import guard
from hardware.replaying import START_TOLERANCE
from limb_systems import LimbError, LimbParameters, LimbSystem, Provenance, Trajectory
from limb_systems.limb_system import check_limb
from limb_systems.simulation import PERIOD, failure_told, make_simulator
from ros_bridge.messages import LATEST, SILENCE, Heard, Message, Topics

READY_TIME = 60.0  # s, in which the other process starts, on a computer that is busy
DEAF = 20  # ticks without an answer of the other process
FAREWELL = 3.0  # s, in which it ends
# Of a duty when a command leaves: the next one leaves a period later.
OLDEST = LATEST - PERIOD
ARMED, RUNNING, FAULT, IDLE = "armed", "running", "fault", "idle"


class NodeProcess:
    """The process that speaks to ROS 2, as the loop sees it, which never waits for it."""

    def __init__(self, topics: Topics, parameters: LimbParameters):
        """
        Args:
            topics: names of the topics.
            parameters: description of the limb.

        Raises:
            LimbError: if there is nothing to speak to ROS 2 with, or no network.
        """
        self._pipe, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ros_bridge.node", str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # the terminal's Ctrl-C is not for it
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(sys.path),  # where this package is
                "OPENBLAS_NUM_THREADS": "1",
            },
        )
        theirs.close()
        self._heard, self._unanswered = Heard(), 0
        try:
            with _living():
                self._pipe.send((topics, len(parameters.wires), parameters.total_duty))
                trouble = self._pipe.recv() if self._pipe.poll(READY_TIME) else "it does not start"
            if trouble:
                raise LimbError(
                    f"There is no way to ROS 2: {trouble}. Without ROS 2 on this computer, the "
                    "bridge needs CycloneDDS: pip install cyclonedds."
                )
        except BaseException:
            self.close()
            raise

    def tell(self, messages: dict[str, Message]) -> None:
        """Publishes messages on topics; LimbError if the process has died."""
        self._unanswered += 1
        with _living():
            self._pipe.send(list(messages.items()))

    def hear(self) -> Heard:
        """What was heard so far; LimbError if the process has died or is silent for a second."""
        with _living():
            while self._pipe.poll():
                self._heard, self._unanswered = self._pipe.recv(), 0
        if self._unanswered > DEAF:
            raise LimbError("The process that speaks to ROS 2 does not answer.")
        return self._heard

    def close(self) -> None:
        """Ends the process, once it has published what it was told."""
        self._pipe.close()
        try:
            self._process.wait(FAREWELL)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextlib.contextmanager
def _living() -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError) as error:
        raise LimbError("The process that speaks to ROS 2 has died.") from error


class Driver:
    """Chooses the duty at each tick: that of a plan that runs, or a fresh one from the topic.

    - ``state``: `ARMED` or `RUNNING`.
    - ``why``: why the duty is zero, or what else is to be said; empty if there is nothing.
    - ``applied``: the duty (W,).
    - ``age``: age of the newest duty, s; infinite if there was none.
    - ``plan_time``: time since the start of the plan, s; None if none runs.
    """

    def __init__(self, parameters: LimbParameters, plan: Trajectory | None = None):
        """
        Args:
            parameters: description of the limb.
            plan: trajectory that may be started.
        """
        self.state, self.why, self.age = ARMED, "", np.inf
        self.applied = np.zeros(len(parameters.wires))
        self.plan_time: float | None = None
        self._parameters, self._plan = parameters, plan.since_start() if plan else None
        self._start, self._requests = 0.0, 0
        self._refused_start = ""

    def duty(self, heard: Heard, measured: np.ndarray, now: float) -> np.ndarray:
        """The duty (W,) to apply from now on for a period.

        Args:
            heard: what was heard so far.
            measured: V (W,), °C.
            now: time, s of the monotonic clock.
        """
        self.age = now - heard.born
        if heard.requests != self._requests:
            self._requests = heard.requests
            self._heed(heard, measured, now)
        duty, why = self._choose(heard, measured, now)
        self.state = ARMED if duty is None else RUNNING
        self.why = "; ".join(filter(None, [self._refused_start, why]))
        self.applied = np.zeros(len(measured)) if duty is None else duty
        return self.applied

    def plan_message(self) -> dict[str, float] | None:
        """What the plan that runs says of now; None if none runs."""
        if self.plan_time is None:
            return None
        assert self._plan
        plan, time = self._plan, self.plan_time
        return {
            "time_s": time,
            **_named("reference_{}_rad", plan.interpolated(plan.reference, time)),
            **_named("planned_{}_rad", plan.bend_angle_at(time)),
            **_named("duty_{}", plan.interpolated(plan.duty, time), self._parameters.wire_names),
        }

    def _heed(self, heard: Heard, measured: np.ndarray, now: float) -> None:
        """Starts or stops the plan."""
        self._refused_start = ""
        if not heard.run:
            self.plan_time = None
        elif self.plan_time is None:
            self._refused_start = self._why_not_start(heard, measured)
            if not self._refused_start:
                self.plan_time, self._start = 0.0, now

    def _why_not_start(self, heard: Heard, measured: np.ndarray) -> str:
        if self._plan is None:
            return "the plan was not started: this bridge was given none"
        if heard.duty is not None and self.age <= LATEST:
            return "the plan was not started: somebody commands the duty"
        away = np.abs(measured - self._plan.measured_temperature[:, 0]).max()
        if not away <= START_TOLERANCE:
            return (
                f"the plan was not started: a wire's reading is {away:.0f} °C from where it starts"
            )
        return ""

    def _choose(
        self, heard: Heard, measured: np.ndarray, now: float
    ) -> tuple[np.ndarray | None, str]:
        if self.plan_time is not None:
            assert self._plan
            self.plan_time = now - self._start
            if self.plan_time < self._plan.duration:
                return self._plan.interpolated(self._plan.duty, self.plan_time), ""
            self.plan_time = None
        if self.age > OLDEST:
            return None, "" if np.isinf(self.age) else "the newest duty is too old"
        if heard.duty is None:
            return None, f"the duty was refused: {heard.refused}"
        limit = self._parameters.temperature_limits.maximum
        if not (highest := measured.max()) < limit:
            return None, f"a wire is at {highest:.1f} °C; temperature_limits.maximum is {limit:g}"
        is_alone = now - heard.other > SILENCE
        return np.array(heard.duty), "" if is_alone else "another writer of the duty is ignored"


def drive(
    limb: LimbSystem,
    *,
    plan: Trajectory | None = None,
    topics: Topics | None = None,
    output: Path | None = None,
) -> None:
    """Drives a limb at 20 Hz, in real time, by what comes on ROS 2 topics, until a signal comes.

    Args:
        limb: a `SerialLimb`, which is closed at the end, or any other `LimbSystem`.
        plan: trajectory that may be started, which was checked for this limb.
        topics: names of the topics.
        output: file of the recording; there is none if None.

    Raises:
        HardwareError: if the robot fails on the way.
        LimbError: if an emulated limb cuts out, or there is no way to ROS 2, or no longer.
        OutputError: if the file cannot be written.
    """
    robot: Any = check_limb(limb)
    close = robot.close if limb.real_time else lambda: None
    topics, end = topics or Topics(), (IDLE, "the bridge has ended")
    with contextlib.ExitStack() as stack:
        stack.callback(close)
        node = stack.enter_context(contextlib.closing(NodeProcess(topics, limb.parameters)))
        try:
            _loop(limb, node, Driver(limb.parameters, plan), topics, output)
        except Exception as error:
            end = FAULT, str(error)
            raise
        finally:
            close()
            with contextlib.suppress(LimbError):
                node.tell({topics.state: json.dumps({"state": end[0], "why": end[1]})})


def _loop(
    limb: LimbSystem, node: NodeProcess, driver: Driver, topics: Topics, output: Path | None
) -> None:
    builder = DiagramBuilder()
    builder.AddSystem(limb)
    entry = builder.AddSystem(PassThrough(len(limb.parameters.wires)))
    builder.ExportInput(entry.get_input_port(), "duty")
    builder.Connect(entry.get_output_port(), limb.GetInputPort("duty"))
    made, port = Provenance.now(limb.parameters), entry.get_output_port()
    with open_journal(builder, output, limb, port, 1 / PERIOD, provenance=made, ended_by_hand=True):
        simulator = make_simulator(builder.Build(), limb.accuracy)
        context = simulator.get_mutable_context()
        duty = simulator.get_system().GetInputPort("duty")
        duty.FixValue(context, np.zeros(duty.size()))
        simulator.Initialize()  # arms a robot
        start = time.monotonic()
        for due in (PERIOD * tick for tick in itertools.count()):
            time.sleep(max(0.0, start + due - time.monotonic()))
            heard, measured = node.hear(), _read(limb, context, "measured_temperature")
            duty.FixValue(context, driver.duty(heard, measured, time.monotonic()))
            with failure_told(simulator, np.inf):
                simulator.AdvanceTo(due + PERIOD / 2)  # so that what is due now is done
            node.tell(_messages(limb, context, topics, driver, heard))
            if limb.HasOutputPort("cut_out") and _read(limb, context, "cut_out")[0]:
                raise LimbError(
                    f"A wire of the {limb.source} was measured at {guard.TEMPERATURE_LIMIT:g} °C "
                    "or more, the limit at which a board switches off."
                )


def _read(limb: LimbSystem, context: Context, name: str) -> np.ndarray:
    return limb.GetOutputPort(name).Eval(limb.GetMyContextFromRoot(context))


def _messages(
    limb: LimbSystem, context: Context, topics: Topics, driver: Driver, heard: Heard
) -> dict[str, Message]:
    """What is published at a tick."""
    measured, bend = (_read(limb, context, name) for name in ("measured_temperature", "bend_angle"))
    is_known = limb.HasOutputPort("applied_duty")
    applied = _read(limb, context, "applied_duty") if is_known else driver.applied
    state = {
        "state": driver.state,
        "why": driver.why,
        "duty": applied.tolist(),
        "age": driver.age if np.isfinite(driver.age) else None,
        "delay": heard.delay,
        "commands": heard.commands,
        "plan_time": driver.plan_time,
    }
    wires = _named("{}_c", measured, limb.parameters.wire_names)
    planned = driver.plan_message()
    return {
        topics.sensors: wires | _named("bend_{}_rad", bend),
        topics.state: json.dumps(state, ensure_ascii=False),
        **({topics.plan: planned} if planned else {}),
    }


def _named(form: str, values: np.ndarray, names: Iterable[str | int] | None = None) -> dict:
    """Numbers by names; those of segments are numbers from zero."""
    found = itertools.count() if names is None else names
    return {form.format(name): float(value) for name, value in zip(found, values, strict=False)}
