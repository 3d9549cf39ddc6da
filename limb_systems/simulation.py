"""Simulation of a limb, or of any system with its ports, under a given duty."""

import contextlib
import copy
import dataclasses
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    Simulator,
    SimulatorConfig,
    SimulatorStatus,
)
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource

from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.schema import short_repr
from limb_systems.files.signal_table import TIMES, clip_rounding
from limb_systems.files.trajectory import Trajectory
from limb_systems.kinematics import bend_angle
from limb_systems.limb_system import ACCURACY, LimbSystem, check_limb
from limb_systems.progress import Progress


class SimulationError(LimbError):
    """An argument of a simulation is invalid, or the integrator failed."""


# The chain has eigenvalues to -15 000 1/s, the wires -0.07 1/s. Of Drake's
# implicit schemes this one needs the fewest evaluations here: a third of
# implicit_euler's evaluations at accuracy 1e-3.
INTEGRATION_SCHEME = "radau3"
MAX_STEP_SIZE = 0.1  # s
# With nonlinear torque, Newton's method leaves errors that do not decrease with the step, and the
# error control would stay at the smallest steps. With steps of this size such limbs are simulated
# more accurately than with smaller steps. With three times as large steps, Newton's method finds
# no solution where a stiff limb is released from a right angle.
MIN_STEP_SIZE = 5e-4  # s
JUMP_MARGIN = 1e-9  # s, before and after a jump of the duty, where steps end and begin
MIN_DUTY_JUMP = 1e-6  # of duty
MIN_PULSE_DURATION = 1e-3  # s, of duty that is worth its simulation
PERIOD = 0.05  # s, of samples and commands of a robot, and so of what observes and controls one
TERMINATED = SimulatorStatus.ReturnReason.kReachedTerminationCondition  # by a system of the diagram


def simulate(
    system: LimbSystem,
    duty: Trajectory | trajectories.Trajectory | ArrayLike,
    duration: float | None = None,
    *,
    sample_rate: float = 20.0,
    accuracy: float | None = None,
    initial_state: ArrayLike | None = None,
) -> Recording:
    """Simulate a limb or a robot with Drake's Simulator and record its outputs.

    Args:
        system: a `Limb`, a `Robot`, or any other `LimbSystem`. It becomes part of a
            diagram and cannot be simulated again.
        duty: a planned trajectory, a Drake trajectory of W rows, or constant
            duty (W,). A trajectory starts at its own start time.
        duration: s; by default the duration of the trajectory.
        sample_rate: rate of the recording, Hz.
        accuracy: accuracy of the implicit integrator, an absolute error of each state in
            a step: °C, rad and rad/s; the system's own if None. Swings that are not much
            larger are damped; a thousandth of their amplitude keeps their energy within 0.3%.
        initial_state: all continuous states of the system, of a `Robot` its state; by default
            the state of its default context: for a `Limb` at rest and at ambient.

    Returns:
        A recording from time 0 to the duration, both included if the sample
        rate divides it; with wire temperature and joint state if the system
        has the ports.

    Raises:
        SimulationError: if an argument is invalid or the integrator fails.
        LimbError: if the system is not a `LimbSystem`.
    """
    # Check the arguments.
    check_limb(system)
    check_positive("sample_rate", sample_rate)
    if accuracy is not None:
        check_positive("accuracy", accuracy)
    applied, duration = _duty_over_time(duty, duration, len(system.parameters.wires))
    num_samples = sample_count(duration, sample_rate)
    check_duty(applied, np.minimum(np.arange(num_samples) / sample_rate, duration))
    warn_of_fast_duty(applied, system)
    # Drive the system with the duty.
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(applied))
    builder.AddSystem(system)
    return record(
        builder,
        system,
        source.get_output_port(),
        duration,
        RecordOptions(
            jumps=jump_times(applied),
            sample_rate=sample_rate,
            accuracy=accuracy,
            initial_state=initial_state,
        ),
    )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RecordOptions:
    """The options of `record`: how it runs a diagram, and further signals that it records.

    - ``reference``: port of the desired bend angles (F), rad, to be recorded.
    - ``until``: function of the diagram's context; the recording ends when it is true.
    - ``real_time``: whether to run in real time although the system does not need it, for example
      because a person watches.
    - ``jumps``: times at which the duty jumps, s, which no step of the integrator may cover.
    - ``sample_rate``, ``accuracy``, ``initial_state``: arguments of `simulate`.
    - ``provenance``: provenance of the recording; this call's if None.
    """

    reference: OutputPort | None = None
    until: Callable[[Context], bool] | None = None
    real_time: bool = False
    jumps: ArrayLike = ()
    sample_rate: float = 20.0
    accuracy: float | None = None
    initial_state: ArrayLike | None = None
    provenance: Provenance | None = None


def record(
    builder: DiagramBuilder,
    system: LimbSystem,
    duty: OutputPort,
    duration: float,
    options: RecordOptions | None = None,
) -> Recording:
    """Run a diagram with a limb in it and record the limb.

    This is `simulate` for duty from any output port, for example the port of a
    controller. A system with ``real_time``, such as a robot, runs in real time.

    Args:
        builder: builder of a diagram that contains the system and the source of its duty.
        system: a `Limb`, or any other `LimbSystem`.
        duty: the port that drives the limb; it is connected here.
        duration: at most, s.
        options: the options of the run; the defaults if None.

    Raises:
        SimulationError: if the integrator fails.
        LimbError: if the duty left [0, 1], or the system is not a `LimbSystem`.
    """
    check_limb(system)
    check_positive("duration", duration, " s")
    options = options or RecordOptions()
    sample_rate = options.sample_rate
    # Stamp the recording before the run has to keep time.
    provenance = options.provenance or Provenance.now(system.parameters)

    # Log the ports at the sample rate. A model's bend angle is calculated from its joint state for
    # all samples at once, so that the C++ loop does not call Python at each of them.
    builder.Connect(duty, system.GetInputPort("duty"))
    ports: dict[str, OutputPort] = {}
    for name in (*Recording.MEASURED, *Recording.optional()):
        is_calculated = name == "bend_angle" and is_model(system)
        if system.HasOutputPort(name) and not is_calculated:
            ports[name] = system.GetOutputPort(name)
    ports["duty"] = duty
    if options.reference:
        ports["reference"] = options.reference
    sinks = {name: LogVectorOutput(port, builder, 1 / sample_rate) for name, port in ports.items()}

    # Run the diagram.
    diagram = build(builder)
    accuracy = system.accuracy if options.accuracy is None else options.accuracy
    simulator = make_simulator(diagram, accuracy)
    context = simulator.get_mutable_context()
    if options.initial_state is not None:
        _set_state(system, system.GetMyMutableContextFromRoot(context), options.initial_state)
    end = last_sample_time(duration, sample_rate)
    real_time = options.real_time or system.real_time
    advance(simulator, end, options.until, real_time, options.jumps)

    # Copy the logs, which are Drake's, into a recording.
    signals = {name: sink.FindLog(context).data().copy() for name, sink in sinks.items()}
    for name in TIMES:
        if name in signals:
            signals[name] = signals[name][0]
    signals["duty"] = clip_rounding(signals["duty"])
    if is_model(system):
        angles = signals["joint_state"][: system.parameters.num_joints]
        signals["bend_angle"] = bend_angle(system.parameters, angles)
    times = np.minimum(np.arange(signals["duty"].shape[1]) / sample_rate, duration)
    return Recording(
        time=times,
        parameters=system.parameters,
        robot=getattr(system, "robot", None),
        source=system.source,
        sample_rate=sample_rate,
        provenance=provenance,
        **signals,
    )


def is_model(system: LimbSystem) -> bool:
    """Return whether a system is a model, whose bend angle follows from its joint state."""
    return getattr(system, "is_model", False)


def build(builder: DiagramBuilder) -> Diagram:
    """Build the diagram of a builder.

    Raises:
        SimulationError: if a system in it is part of another diagram.
    """
    try:
        return builder.Build()
    except RuntimeError as error:
        if "already been built" not in str(error):
            raise
        raise SimulationError(
            "This system is part of a diagram already; make a new one to simulate it."
        ) from error


def discrete_simulator_config() -> SimulatorConfig:
    """Return the configuration for mechanics in discrete steps of the plant's length.

    Heat is integrated by Euler's method at the same steps, which suffices for the wires.
    """
    return SimulatorConfig(integration_scheme="explicit_euler", max_step_size=MAX_STEP_SIZE)


def make_simulator(system: System, accuracy: float | None = ACCURACY) -> Simulator:
    """Return Drake's Simulator with the integrator that a limb needs.

    Args:
        accuracy: accuracy of the integrator; None for mechanics in discrete steps.
    """
    simulator = Simulator(system)
    # Mechanics in discrete steps needs no error control.
    if accuracy is None:
        ApplySimulatorConfig(discrete_simulator_config(), simulator)
        return simulator
    ApplySimulatorConfig(
        SimulatorConfig(
            integration_scheme=INTEGRATION_SCHEME,
            accuracy=accuracy,
            max_step_size=MAX_STEP_SIZE,
            use_error_control=True,
        ),
        simulator,
    )
    # Take the smallest step instead of failing where error control asks for smaller steps.
    integrator = simulator.get_mutable_integrator()
    integrator.set_requested_minimum_step_size(MIN_STEP_SIZE)
    integrator.set_throw_on_minimum_step_size_violation(False)
    return simulator


def _duty_over_time(
    duty: Any, duration: float | None, num_wires: int
) -> tuple[trajectories.Trajectory, float]:
    """Return the duty over time from 0, a row for each wire, and the duration to simulate, s."""
    if isinstance(duty, Trajectory):
        duty = duty.since_start().duty_trajectory()
    if isinstance(duty, trajectories.Trajectory):
        with contextlib.suppress(RuntimeError):  # if it is empty
            if (duty.rows(), duty.cols()) == (num_wires, 1):
                return _from_zero(duty, duration)
        description = "another trajectory"
    else:
        # Hold constant duty over the duration.
        try:
            values = np.asarray(duty, float)
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.shape == (num_wires,):
            if duration is None:
                raise SimulationError("duration is missing; constant duty needs one.")
            check_positive("duration", duration, " s")
            samples = np.column_stack([values, values])
            hold = trajectories.PiecewisePolynomial.ZeroOrderHold([0.0, duration], samples)
            return hold, duration
        description = short_repr(duty)
    raise SimulationError(
        f"duty is {description}; it must be a number or a trajectory's row for each of "
        f"{num_wires} wires."
    )


def _from_zero(
    duty: trajectories.Trajectory, duration: float | None
) -> tuple[trajectories.Trajectory, float]:
    """Return a trajectory of duty shifted to start at 0 s, and the duration, s."""
    if duration is None:
        duration = duty.end_time() - duty.start_time()
    check_positive("duration", duration, " s")
    if duty.start_time() == 0:
        return duty, duration
    if not isinstance(duty, trajectories.PiecewisePolynomial):
        raise SimulationError(
            f"duty starts at {duty.start_time():g} s; unless it is a piecewise polynomial, "
            "it must start at 0 s."
        )
    # Shift a copy.
    duty = copy.deepcopy(duty)
    duty.shiftRight(-duty.start_time())
    return duty, duration


def check_duty(duty: trajectories.Trajectory, times: np.ndarray) -> None:
    """Raise SimulationError if duty leaves [0, 1] at the samples or any break."""
    if isinstance(duty, trajectories.PiecewiseTrajectory):
        breaks = np.array(duty.get_segment_times())
        times = np.concatenate([times, breaks, (breaks[1:] + breaks[:-1]) / 2])
    values = duty.vector_values(times)
    if not np.abs(values - np.clip(values, 0.0, 1.0)).max() < 1e-9:  # NaN is not; rounding is
        raise SimulationError(
            f"duty reaches from {values.min():g} to {values.max():g}; it must stay within 0 and 1."
        )


def sample_count(duration: float, rate: float) -> int:
    """Return the number of samples from time 0 to a duration, s, at a rate, Hz."""
    return int(np.floor(duration * rate + 1e-6)) + 1


def last_sample_time(duration: float, rate: float) -> float:
    """Return the time of the last of `sample_count` samples, at least the duration, s.

    Drake's clock ticks at rounded multiples of the period.
    """
    return max(duration, (sample_count(duration, rate) - 1) * (1 / rate))


def jump_times(duty: trajectories.Trajectory) -> np.ndarray:
    """Return the times (J,), s, at which a piecewise trajectory jumps."""
    if not isinstance(duty, trajectories.PiecewiseTrajectory):
        return np.empty(0)
    breaks = np.array(duty.get_segment_times())[1:-1]
    if not len(breaks):
        return breaks
    # Compare the duty on both sides of each break.
    before = duty.vector_values(breaks - JUMP_MARGIN)
    after = duty.vector_values(breaks + JUMP_MARGIN)
    return breaks[np.abs(after - before).max(axis=0) > MIN_DUTY_JUMP]


def warn_of_fast_duty(duty: trajectories.Trajectory, system: LimbSystem) -> None:
    """Warn if duty jumps faster than a system can follow."""
    jumps = jump_times(duty)
    if len(jumps) < 2:
        return
    shortest = np.diff(jumps).min()
    # Choose the shortest pulse that the system can follow.
    if is_model(system):
        fastest = MIN_PULSE_DURATION
        reason = "its wires respond to the mean only, and simulating each pulse takes long"
    else:
        fastest = PERIOD
        reason = f"{type(system).__name__} takes duty at about 20 Hz"
    if shortest < 0.99 * fastest:
        warnings.warn(
            f"The duty jumps after {1e3 * shortest:.3g} ms already: {reason}. Give its mean over "
            "the periods of the pulses.",
            stacklevel=3,
        )


def check_positive(name: str, value: Any, unit: str = "") -> None:
    """Raise SimulationError if a value is not a positive number."""
    if not isinstance(value, (int, float)) or not (np.isfinite(value) and value > 0):
        raise SimulationError(f"{name} is {value!r}{unit}; it must be a positive number.")


def _set_state(system, context, state) -> None:
    """Set the state of a system, discrete states before continuous ones, after a check."""
    state = np.asarray(state, float)
    is_discrete = is_model(system) and context.num_discrete_state_groups()
    num_discrete = context.get_discrete_state_vector().size() if is_discrete else 0
    size = num_discrete + context.num_continuous_states()
    if state.shape != (size,) or not np.isfinite(state).all():
        raise SimulationError(
            f"initial_state must be {size} finite numbers, but it has "
            f"the shape {state.shape} or contains values that are not finite."
        )
    if is_discrete:
        context.SetDiscreteState(state[:num_discrete])
    context.SetContinuousState(state[num_discrete:])


def advance(
    simulator: Simulator,
    end: float,
    until: Callable[[Context], bool] | None = None,
    real_time: bool = False,
    jumps: ArrayLike = (),
) -> None:
    """Simulate from time 0 to the end, s, in parts; other arguments as in `RecordOptions`.

    Unless in real time, steps of the integrator end just before each jump of the duty, and begin
    again just after it: error control would step over pulses that are shorter than its steps.

    Raises:
        SimulationError: if the integrator fails.
    """
    context = simulator.get_context()
    with raising_simulation_error(simulator, end):
        simulator.Initialize()
        # In real time each part begins when its events are due, and ends halfway to the next.
        # Waiting here and not in the Simulator lets other threads and signals come through.
        # Else parts of 1 s are short enough for the progress bar, and for ``until``.
        part = PERIOD if real_time else 1.0
        ahead = PERIOD / 2 if real_time else 0.0
        stops = np.arange(0.0, end - 1e-9, part)
        if not real_time:
            near_jumps = np.add.outer(jumps, [-JUMP_MARGIN, JUMP_MARGIN]).ravel()
            stops = np.union1d(stops, near_jumps[(near_jumps > 0.0) & (near_jumps < end)])
        start = time.monotonic()
        with Progress("recording" if real_time else "simulating", end, "s") as progress:
            for due in np.append(stops, end):
                if real_time:
                    time.sleep(max(0.0, start + due - time.monotonic()))
                status = simulator.AdvanceTo(min(due + ahead, end))
                progress.update(due)
                if status.reason() == TERMINATED or (until and until(context)):
                    break


@contextlib.contextmanager
def raising_simulation_error(simulator: Simulator, end: float) -> Iterator[None]:
    """A context that raises SimulationError, with the time, if a simulation to an end, s, fails."""
    try:
        yield
    except RuntimeError as error:
        raise SimulationError(
            f"The simulation stopped at {simulator.get_context().get_time():.3g} s of "
            f"{end:g} s: {' '.join(str(error).split())}"
        ) from error
