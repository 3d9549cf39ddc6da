"""Replay of a planned trajectory, and recording of a limb that is moved by hand."""

import dataclasses
import warnings
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    DiagramBuilder,
    EventStatus,
    LeafSystem,
    OutputPort,
    System,
)
from pydrake.systems.primitives import Multiplexer, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from threadpoolctl import threadpool_limits

from hardware.board.journal import closing, open_journal
from hardware.board.link import check_heat_is_measured, present_temperature
from hardware.board.serial_limb import SerialLimb
from hardware.firmware import guard
from hardware.live_feed import LiveView, live_display
from limb_systems import (
    EmulatedLimb,
    LimbError,
    LimbSystem,
    Provenance,
    Recording,
    Trajectory,
)
from limb_systems.drake_python import weak_method
from limb_systems.limb_system import check_limb
from limb_systems.simulation import PERIOD, RecordOptions, record

CUT_OUT_WINDOW = 0.2  # s before the end of a recording, within which a limb has cut out
START_WARNING = 3.0  # °C; a wire that differs more from the start of the plan causes a warning
START_TOLERANCE = 10.0  # °C; a wire that differs more prevents the replay


class ReplayError(LimbError):
    """A trajectory must not be replayed on this limb."""


def replay(
    trajectory: Trajectory,
    limb: LimbSystem,
    *,
    controller: System | None = None,
    unchecked: bool = False,
    journal: str | Path | None = None,
    live: LiveView | None = None,
) -> Recording:
    """Drive a limb along a trajectory and record it at 20 Hz.

    A `SerialLimb` is driven in real time and closed at the end, also after an
    error, so that the wires are off. Other limbs are simulated, in real time if
    they are shown. A `LimbTwin` that cuts out ends the recording, which says so.

    Args:
        trajectory: a plan that passed its check.
        limb: a `SerialLimb`, a `LimbTwin`, a `Limb` or any other `LimbSystem`;
            it becomes part of a diagram and cannot be replayed on twice.
        controller: a system with the output port ``duty`` (W), in [0, 1], and any of the input
            ports ``measured_temperature`` (W), °C, ``bend_angle`` (F), rad, ``measurement``, both
            of them, and the ``body_pose`` of a robot. Its time begins with the plan. If None, the
            trajectory's duty drives the limb in open loop.
        unchecked: whether to replay a plan without a check, for example from another program.
            A plan that failed its check is always refused.
        journal: file of the recording, to which each sample is written when it arrives. Until the
            plan has ended it has a `TableWriter`'s preliminary name; then it replaces a file of
            this name.
        live: page on which to show its curves while it runs.

    Raises:
        ReplayError: if the trajectory failed its check, was planned for another limb, is hotter
            than this limb allows (also within its band), or starts at another temperature than its
            wires have; or if the controller has other ports.
        OutputError: if the disk is full or stalled, or the journal cannot be
            written for another reason.
        HardwareError: if the robot fails on the way, or gets a duty that is
            out of range.
        LimbError: if the duty was out of range; if the limb is no `LimbSystem`.
    """
    with closing(check_limb(limb)):
        check_replayable(trajectory, limb, unchecked=unchecked)
        return _record_with(limb, controller, trajectory.duration, journal, live, trajectory)


def watch(
    limb: LimbSystem,
    duration: float,
    *,
    journal: str | Path | None = None,
    live: LiveView | None = None,
) -> Recording:
    """Record a limb with its wires off, while it hangs, swings or is moved by hand.

    If Ctrl-C ends it, the journal gets its name and says so, and KeyboardInterrupt is raised.

    Args:
        duration: longest duration, s.
        limb, journal, live: as for `replay`.

    Raises:
        HardwareError: if the robot fails on the way.
        OutputError: as for `replay`.
    """
    with closing(check_limb(limb)):
        return _record_with(limb, None, duration, journal, live, ended_by_hand=True)


def present_readings(limb: LimbSystem) -> np.ndarray:
    """Return V (W,), °C: a robot's present readings, or another limb's at the start of simulations.

    `limb_systems.resting_state` makes the initial state of a plan from them.

    Raises:
        HardwareError: if the robot does not answer, or one of its wires has no reading.
    """
    if isinstance(limb, SerialLimb):
        return present_temperature(limb.link)
    assert isinstance(limb, System)
    simulator = Simulator(limb)
    duty = limb.GetInputPort("duty")
    duty.FixValue(simulator.get_mutable_context(), np.zeros(duty.size()))
    simulator.Initialize()  # sensors are read then
    return limb.GetOutputPort("measured_temperature").Eval(simulator.get_context())


def check_replayable(trajectory: Trajectory, limb: LimbSystem, *, unchecked: bool = False) -> None:
    """Raise ReplayError if a trajectory must not be replayed on a limb."""
    # The plan must have passed its check.
    if trajectory.check.is_missing:
        if not unchecked:
            raise ReplayError(
                "This trajectory was never checked and is not replayed; plan it again with "
                "soft-limb plan, which checks it by simulation (in Python also unchecked=True)."
            )
    elif failure := trajectory.check.failure():
        raise ReplayError(f"This trajectory failed its check and is not replayed: {failure}")
    # It must be for this number of wires, and not too hot for them.
    planned = trajectory.parameters
    present = limb.parameters
    if len(planned.wires) != len(present.wires):
        raise ReplayError(
            f"This trajectory drives {len(planned.wires)} wires, but the limb has "
            f"{len(present.wires)}."
        )
    hottest = trajectory.wire_temperature.max()
    limit = present.temperature_limits.maximum
    if hottest > limit + 1e-6:
        raise ReplayError(
            f"This trajectory heats a wire to {hottest:.1f} °C, but this limb's "
            f"temperature_limits.maximum is {limit:g} °C; plan it again for this limb."
        )
    # The highest reading of its band must be below the limit of the board.
    limit = present.temperature_limits.measured_maximum
    if isinstance(limb, SerialLimb):
        _check_robot(trajectory, limb)
        limit = min(limit, limb.info.temperature_limit)
    if (highest := max(trajectory.check.highest_readings, default=-np.inf)) >= limit:
        raise ReplayError(
            f"On a limb like this one the trajectory may be read at up to {highest:.0f} °C, and "
            f"the board switches off at {limit:g} °C: the calibration is too uncertain for it; "
            "calibrate with more recordings, or plan with a lower temperature_limits.maximum."
        )


def _check_robot(trajectory: Trajectory, limb: SerialLimb) -> None:
    """Raise ReplayError unless the plan is for this board, and starts at the wires' temperature."""
    # The temperatures of the plan must come from thermocouples, and its board be this board.
    board = limb.info.serial_number
    planned = trajectory.parameters
    check_heat_is_measured(planned)
    number = planned.board.identity
    if isinstance(planned.board, EmulatedLimb):
        number = planned.board.serial_number
    if number and number != board:
        raise ReplayError(
            f"This trajectory was planned with the calibration of the limb {number}, but the limb "
            f"on {limb.link.port} is {board}; calibrate that one."
        )
    # Temperature and total duty must be within the robot's limits.
    limit = planned.temperature_limits.maximum
    if limit > limb.info.temperature_limit:
        raise ReplayError(
            f"This trajectory may heat wires to {limit:g} °C, but the board switches off at "
            f"{limb.info.temperature_limit:g} °C; plan it again with a lower "
            "temperature_limits.maximum."
        )
    total = trajectory.duty.sum(axis=0)
    largest_total = limb.parameters.total_duty
    if total.max() > largest_total + 1e-3:
        raise ReplayError(
            f"This trajectory's duties add up to {total.max():.2f} at "
            f"{trajectory.time[np.argmax(total)]:.1f} s, but this limb's total_duty is "
            f"{largest_total:g}; raise it if the supply and the limb are made for that, or plan "
            "another motion."
        )
    # The wires must be about as warm as at the start of the plan.
    measured = present_readings(limb)
    planned_start = trajectory.measured_temperature[:, 0]
    differences = np.abs(measured - planned_start)
    wire = int(np.argmax(differences))
    if differences[wire] > START_WARNING:
        now = ",".join(f"{reading:.1f}" for reading in measured)
        sentence = (
            f"The {planned.wire_names[wire]} wire is at {measured[wire]:.1f} °C, but the "
            f"trajectory starts at {planned_start[wire]:.1f} °C; wait until it has cooled, or plan "
            f"from where it is: soft-limb plan --start {now}."
        )
        if differences[wire] > START_TOLERANCE:
            raise ReplayError(sentence)
        warnings.warn(sentence, stacklevel=2)


def _connect_controller(
    builder: DiagramBuilder, limb: LimbSystem, controller: System
) -> OutputPort:
    """Connect a limb's outputs to a controller, and return the controller's duty.

    Raise ReplayError unless the limb has an output for each input of the controller.
    """
    # The controller must have a duty for each wire.
    name = type(controller).__name__
    num_wires = len(limb.parameters.wires)
    if not controller.HasOutputPort("duty"):
        raise ReplayError(f"{name} has no output port duty, and cannot drive a limb.")
    duty = controller.GetOutputPort("duty")
    if duty.size() != num_wires:
        raise ReplayError(
            f"{name} has a duty for {duty.size()} wires, but the limb has {num_wires}."
        )
    # Its inputs must be outputs of the limb.
    names = [*Recording.MEASURED, "measurement"]
    if limb.HasOutputPort("body_pose"):
        names.append("body_pose")
    for index in range(controller.num_input_ports()):
        port = controller.get_input_port(index)
        if port.get_name() not in names:
            raise ReplayError(
                f"{name} has an input port {port.get_name()}, but a limb has only the outputs "
                f"{', '.join(names)}."
            )
        if limb.HasOutputPort(port.get_name()):
            output = limb.GetOutputPort(port.get_name())
        else:
            # Join both readings for a limb without the output ``measurement``.
            readings = list(map(limb.GetOutputPort, Recording.MEASURED))
            joined = builder.AddSystem(Multiplexer([reading.size() for reading in readings]))
            for entry, reading in enumerate(readings):
                builder.Connect(reading, joined.get_input_port(entry))
            output = joined.get_output_port()
        if port.size() != output.size():
            raise ReplayError(
                f"{name} takes {port.size()} values at {port.get_name()}, but the limb has "
                f"{output.size()}."
            )
        builder.Connect(output, port)
    return duty


def _record_with(
    limb: LimbSystem,
    controller: System | None,
    duration: float,
    journal: str | Path | None,
    live: LiveView | None,
    plan: Trajectory | None = None,
    *,
    ended_by_hand: bool = False,
) -> Recording:
    """Record a limb under a controller, or the duty of a plan, or none; see `replay`, `watch`."""
    # Connect what drives the limb, and end the simulation at a cut-out.
    builder = DiagramBuilder()
    if controller:
        builder.AddSystem(controller)
        builder.AddSystem(limb)
        duty = _connect_controller(builder, limb, controller)
    else:
        signal = PiecewisePolynomial(np.zeros((len(limb.parameters.wires), 1)))
        if plan:
            signal = plan.since_start().duty_trajectory()
        duty = builder.AddSystem(TrajectorySource(signal)).get_output_port()
        builder.AddSystem(limb)
    if plan is not None and limb.HasOutputPort("cut_out"):
        cut_out_end = builder.AddSystem(_EndAtCutOut())
        builder.Connect(limb.GetOutputPort("cut_out"), cut_out_end.get_input_port())
    return record_with_journal(
        builder,
        limb,
        duty,
        duration,
        journal,
        live,
        options=RecordOptions(),
        plan=plan,
        ended_by_hand=ended_by_hand,
    )


def record_with_journal(
    builder: DiagramBuilder,
    limb: LimbSystem,
    duty: OutputPort,
    duration: float,
    journal: str | Path | None = None,
    live: LiveView | None = None,
    *,
    options: RecordOptions,
    plan: Trajectory | None = None,
    kind: str = "",
    seed: int | None = None,
    ended_by_hand: bool = False,
) -> Recording:
    """Record a limb as `limb_systems.simulation.record`, with a journal and on a page if given.

    The caller closes a robot, see `closing`.

    Args:
        builder, limb, duty, duration, options: as for `record`.
        journal, live: as for `replay`.
        plan: trajectory that the limb follows; a cut-out then interrupts the recording.
        kind, seed: kind of the recording, and seed of its provenance.
        ended_by_hand: whether Ctrl-C is a regular end.
    """
    provenance = Provenance.now(limb.parameters, seed)
    options = dataclasses.replace(options, provenance=provenance, real_time=live is not None)
    with (
        threadpool_limits(1, "blas"),  # matrices are small: more threads would wait for each other
        live_display(builder, live, limb, duty, duration, plan=plan, reference=options.reference),
        open_journal(
            builder,
            journal,
            limb,
            duty,
            options,
            ended_by_hand=ended_by_hand,
            kind=kind,
            may_wait=not (limb.real_time or live),
        ) as writer,
    ):
        recording = record(builder, limb, duty, duration, options)
        recording.kind = kind
        # Note a cut-out in the recording and its journal.
        if plan is not None and limb.HasOutputPort("cut_out"):
            recording.interrupted = _cut_out(recording, duration)
            if writer and recording.interrupted:
                writer.finish(recording.interrupted)
    return recording


def _cut_out(recording: Recording, duration: float) -> str:
    """Return a sentence on the wire that ended a recording early, if one was too hot; or none."""
    end_time = recording.time[-1]
    in_window = recording.time >= end_time - CUT_OUT_WINDOW
    highest = recording.measured_temperature[:, in_window].max(axis=1)
    ended_early = end_time < duration - 0.5 / recording.sample_rate  # also by a controller
    if not ended_early or highest.max() < guard.TEMPERATURE_LIMIT:
        return ""
    return (
        f"the {recording.parameters.wire_names[int(np.argmax(highest))]} wire was measured at "
        f"{guard.TEMPERATURE_LIMIT:g} °C or more, the limit at which a board switches off"
    )


class _EndAtCutOut(LeafSystem):
    """A system that ends the simulation when an emulated limb has cut out.

    - input 0 ``cut_out``: 1 if it has cut out, else 0
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("cut_out", 1)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._end_if_cut_out))

    def _end_if_cut_out(self, context) -> EventStatus:
        if self.get_input_port().Eval(context)[0]:
            return EventStatus.ReachedTermination(self, "the emulated limb has cut out")
        return EventStatus.DidNothing()
