"""Drive a limb with the duty or the plan that ROS 2 topics command, and publish its state."""

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
from limb_systems.simulation import (
    PERIOD,
    RecordOptions,
    make_simulator,
    raising_simulation_error,
)
from ros_bridge.messages import MAX_DUTY_AGE, START_SILENCE, Message, ReceivedCommands, Topics

STARTUP_TIME = 60.0  # s, for the other process on a busy computer
MAX_UNANSWERED = 20  # ticks without an answer of the other process
EXIT_TIME = 3.0  # s, for the other process to end
# s, when the command is sent: the duty is applied for one more period.
MAX_COMMAND_AGE = MAX_DUTY_AGE - PERIOD
ARMED, RUNNING, FAULT, IDLE = "armed", "running", "fault", "idle"


class NodeProcess:
    """The connection to the process that speaks to ROS 2; the loop never waits for it."""

    def __init__(self, topics: Topics, parameters: LimbParameters):
        """
        Args:
            topics: names of the topics.
            parameters: description of the limb.

        Raises:
            LimbError: if there is nothing to speak to ROS 2 with, or no network.
        """
        # Start the process.
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
        self._received = ReceivedCommands()
        self._unanswered = 0
        # Wait until it is ready.
        try:
            with raising_if_dead():
                self._pipe.send((topics, len(parameters.wires), parameters.total_duty))
                error = self._pipe.recv() if self._pipe.poll(STARTUP_TIME) else "it does not start"
            if error:
                raise LimbError(
                    f"The bridge cannot reach ROS 2: {error}. Without ROS 2 on this computer, the "
                    "bridge needs CycloneDDS: pip install cyclonedds."
                )
        except BaseException:
            self.close()
            raise

    def publish(self, messages: dict[str, Message]) -> None:
        """Publish messages on topics; raise LimbError if the process has died."""
        self._unanswered += 1
        with raising_if_dead():
            self._pipe.send(list(messages.items()))

    def receive(self) -> ReceivedCommands:
        """Return the received commands; raise LimbError if the process is dead or silent."""
        with raising_if_dead():
            while self._pipe.poll():
                self._received = self._pipe.recv()
                self._unanswered = 0
        if self._unanswered > MAX_UNANSWERED:
            raise LimbError("The process that speaks to ROS 2 does not answer.")
        return self._received

    def close(self) -> None:
        """End the process after it has published all messages."""
        self._pipe.close()
        try:
            self._process.wait(EXIT_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextlib.contextmanager
def raising_if_dead() -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError) as error:
        raise LimbError("The process that speaks to ROS 2 has died.") from error


class Driver:
    """Choose the duty at each tick: from the running plan, or a new duty from the topic.

    - ``state``: `ARMED` or `RUNNING`.
    - ``why``: reason why the duty is zero, or a remark; may be empty.
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
        self.state = ARMED
        self.why = ""
        self.age = np.inf
        self.applied = np.zeros(len(parameters.wires))
        self.plan_time: float | None = None
        self._parameters = parameters
        self._plan = plan.since_start() if plan else None
        self._start = 0.0
        self._requests = 0
        self._refused_start = ""

    def duty(self, received: ReceivedCommands, measured: np.ndarray, now: float) -> np.ndarray:
        """Return the duty (W,) to apply for the next period.

        Args:
            received: the commands that were received so far.
            measured: V (W,), °C.
            now: time, s of the monotonic clock.
        """
        # Start or stop the plan if that was requested.
        self.age = now - received.born
        if received.requests != self._requests:
            self._requests = received.requests
            self._start_or_stop(received, measured, now)
        # Choose the duty; it is zero if there is none.
        duty, why = self._choose(received, measured, now)
        self.state = ARMED if duty is None else RUNNING
        self.why = "; ".join(filter(None, [self._refused_start, why]))
        self.applied = np.zeros(len(measured)) if duty is None else duty
        return self.applied

    def plan_message(self) -> dict[str, float] | None:
        """Return reference, plan and duty at the present time; None if no plan runs."""
        if self.plan_time is None:
            return None
        assert self._plan
        plan = self._plan
        time = self.plan_time
        return {
            "time_s": time,
            **_named("reference_{}_rad", plan.interpolated(plan.reference, time)),
            **_named("planned_{}_rad", plan.bend_angle_at(time)),
            **_named("duty_{}", plan.interpolated(plan.duty, time), self._parameters.wire_names),
        }

    def _start_or_stop(self, received: ReceivedCommands, measured: np.ndarray, now: float) -> None:
        """Start or stop the plan, or note why it is not started."""
        self._refused_start = ""
        if not received.run:
            self.plan_time = None
        elif self.plan_time is None:
            self._refused_start = self._start_refusal(received, measured)
            if not self._refused_start:
                self.plan_time, self._start = 0.0, now

    def _start_refusal(self, received: ReceivedCommands, measured: np.ndarray) -> str:
        if self._plan is None:
            return "the plan was not started: the bridge was started without --plan"
        if received.duty is not None and self.age <= MAX_DUTY_AGE:
            return "the plan was not started: another program commands the duty"
        away = np.abs(measured - self._plan.measured_temperature[:, 0]).max()
        if not away <= START_TOLERANCE:
            return (
                f"the plan was not started: a wire's reading is {away:.0f} °C from where it starts"
            )
        return ""

    def _choose(
        self, received: ReceivedCommands, measured: np.ndarray, now: float
    ) -> tuple[np.ndarray | None, str]:
        # Take the duty of the running plan until its end.
        if self.plan_time is not None:
            assert self._plan
            self.plan_time = now - self._start
            if self.plan_time < self._plan.duration:
                return self._plan.interpolated(self._plan.duty, self.plan_time), ""
            self.plan_time = None
        # Take the newest duty of the topic if it is new and no wire is too hot.
        if self.age > MAX_COMMAND_AGE:
            return None, "" if np.isinf(self.age) else "the newest duty is too old"
        if received.duty is None:
            return None, f"the duty was refused: {received.refused}"
        limit = self._parameters.temperature_limits.maximum
        if not (highest := measured.max()) < limit:
            return None, f"a wire is at {highest:.1f} °C; temperature_limits.maximum is {limit:g}"
        is_alone = now - received.other > START_SILENCE
        return np.array(received.duty), "" if is_alone else "another writer of the duty is ignored"


def drive(
    limb: LimbSystem,
    *,
    plan: Trajectory | None = None,
    topics: Topics | None = None,
    output: Path | None = None,
) -> None:
    """Drive a limb at 20 Hz in real time as ROS 2 topics command, until a signal comes.

    Args:
        limb: a `SerialLimb`, which is closed at the end, or any other `LimbSystem`.
        plan: trajectory that may be started; it must have been checked for this limb.
        topics: names of the topics.
        output: file of the recording; there is none if None.

    Raises:
        HardwareError: if the robot fails on the way.
        LimbError: if an emulated limb cuts out, or the connection to ROS 2 fails.
        OutputError: if the file cannot be written.
    """
    robot: Any = check_limb(limb)
    close = robot.close if limb.real_time else lambda: None
    topics = topics or Topics()
    end = IDLE, "the bridge has ended"
    # Close the limb and end the process on any way out.
    with contextlib.ExitStack() as stack:
        stack.callback(close)
        node = stack.enter_context(contextlib.closing(NodeProcess(topics, limb.parameters)))
        try:
            _loop(limb, node, Driver(limb.parameters, plan), topics, output)
        except Exception as error:
            end = FAULT, str(error)
            raise
        finally:
            # Switch the wires off first, then publish the end.
            close()
            with contextlib.suppress(LimbError):
                node.publish({topics.state: json.dumps({"state": end[0], "why": end[1]})})


def _loop(
    limb: LimbSystem, node: NodeProcess, driver: Driver, topics: Topics, output: Path | None
) -> None:
    # Build a diagram of the limb, with its duty as input.
    builder = DiagramBuilder()
    builder.AddSystem(limb)
    entry = builder.AddSystem(PassThrough(len(limb.parameters.wires)))
    builder.ExportInput(entry.get_input_port(), "duty")
    builder.Connect(entry.get_output_port(), limb.GetInputPort("duty"))
    options = RecordOptions(provenance=Provenance.now(limb.parameters))
    port = entry.get_output_port()
    # Simulate in real time, and set the duty at each tick.
    with open_journal(builder, output, limb, port, options, ended_by_hand=True):
        simulator = make_simulator(builder.Build(), limb.accuracy)
        context = simulator.get_mutable_context()
        duty = simulator.get_system().GetInputPort("duty")
        duty.FixValue(context, np.zeros(duty.size()))
        simulator.Initialize()  # arms a robot
        start = time.monotonic()
        for due in (PERIOD * tick for tick in itertools.count()):
            time.sleep(max(0.0, start + due - time.monotonic()))
            received = node.receive()
            measured = _read(limb, context, "measured_temperature")
            duty.FixValue(context, driver.duty(received, measured, time.monotonic()))
            with raising_simulation_error(simulator, np.inf):
                simulator.AdvanceTo(due + PERIOD / 2)  # beyond the tick, whose events then run
            node.publish(_messages(limb, context, topics, driver, received))
            if limb.HasOutputPort("cut_out") and _read(limb, context, "cut_out")[0]:
                raise LimbError(
                    f"A wire of the {limb.source} was measured at {guard.TEMPERATURE_LIMIT:g} °C "
                    "or more, the limit at which a board switches off."
                )


def _read(limb: LimbSystem, context: Context, name: str) -> np.ndarray:
    return limb.GetOutputPort(name).Eval(limb.GetMyContextFromRoot(context))


def _messages(
    limb: LimbSystem, context: Context, topics: Topics, driver: Driver, received: ReceivedCommands
) -> dict[str, Message]:
    """Return the messages to publish at a tick, by topic."""
    measured = _read(limb, context, "measured_temperature")
    bend = _read(limb, context, "bend_angle")
    # Publish the duty that the board applies, if it tells.
    is_known = limb.HasOutputPort("applied_duty")
    applied = _read(limb, context, "applied_duty") if is_known else driver.applied
    state = {
        "state": driver.state,
        "why": driver.why,
        "duty": applied.tolist(),
        "age": driver.age if np.isfinite(driver.age) else None,
        "delay": received.delay,
        "commands": received.commands,
        "plan_time": driver.plan_time,
    }
    # Add the readings, and the plan if it runs.
    wires = _named("{}_c", measured, limb.parameters.wire_names)
    planned = driver.plan_message()
    return {
        topics.sensors: wires | _named("bend_{}_rad", bend),
        topics.state: json.dumps(state, ensure_ascii=False),
        **({topics.plan: planned} if planned else {}),
    }


def _named(form: str, values: np.ndarray, names: Iterable[str | int] | None = None) -> dict:
    """Return numbers by name; without names they are numbered from zero."""
    labels = itertools.count() if names is None else names
    return {form.format(name): float(value) for name, value in zip(labels, values, strict=False)}
