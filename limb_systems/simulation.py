"""Simulating a limb, or anything with its ports, over a course of duty."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource

from limb_systems.errors import LimbError
from limb_systems.kinematics import bend_angle
from limb_systems.limb import Limb
from limb_systems.progress import Progress
from limb_systems.recording import Recording
from limb_systems.trajectory import Trajectory


class SimulationError(LimbError):
    """A simulation was asked for something impossible, or did not get through."""


# The chain has eigenvalues to -15 000 1/s beside the wires' -0.07 1/s. Of
# Drake's implicit schemes this one needs the fewest evaluations here: a third
# of those of implicit_euler at accuracy 1e-3 (benchmarks/simulation.py).
INTEGRATION_SCHEME = "radau3"
MAX_STEP_SIZE = 0.1


def simulate(
    system: System,
    duty: Trajectory | trajectories.Trajectory | ArrayLike,
    duration: float | None = None,
    *,
    sample_rate: float = 20.0,
    accuracy: float = 1e-3,
    initial_state: ArrayLike | None = None,
) -> Recording:
    """Simulates a limb with Drake's Simulator and records its outputs.

    Args:
        system: a `Limb`, or any system with its ports and ``parameters``. It
            becomes part of a diagram and cannot be used in another one.
        duty: a planned trajectory, a Drake trajectory of W rows, or constant
            duty (W,). A trajectory starts at its own start time.
        duration: s; for a trajectory by default all of it.
        sample_rate: of the recording, Hz.
        accuracy: relative accuracy of the implicit integrator.
        initial_state: all continuous states of the system, by default those
            of its default context: for a `Limb` at rest and at ambient.

    Returns:
        A recording from time 0 to the duration, both included if the sample
        rate divides it; with wire temperature and joint state if the system
        has the ports.

    Raises:
        SimulationError: if an argument makes no sense or the integrator fails.
    """
    source, start, duration = _duty_source(duty, duration, len(system.parameters.wires))
    for name, value in (("sample_rate", sample_rate), ("accuracy", accuracy)):
        if not (np.isfinite(value) and value > 0):
            raise SimulationError(f"{name} is {value!r}; it must be a positive number.")

    builder = DiagramBuilder()
    builder.AddSystem(source)
    builder.AddSystem(system)
    builder.Connect(source.get_output_port(), system.GetInputPort("duty"))
    sinks = {
        name: LogVectorOutput(system.GetOutputPort(name), builder, 1 / sample_rate)
        for name in _logged_ports(system)
    }
    duty_sink = LogVectorOutput(source.get_output_port(), builder, 1 / sample_rate)
    diagram = builder.Build()

    simulator = Simulator(diagram)
    ApplySimulatorConfig(
        SimulatorConfig(
            integration_scheme=INTEGRATION_SCHEME,
            accuracy=accuracy,
            max_step_size=MAX_STEP_SIZE,
            use_error_control=True,
        ),
        simulator,
    )
    context = simulator.get_mutable_context()
    context.SetTime(start)
    if initial_state is not None:
        system_context = system.GetMyMutableContextFromRoot(context)
        system_context.SetContinuousState(np.asarray(initial_state, float))
    _advance(simulator, start, duration)

    logs = {name: sink.FindLog(context) for name, sink in sinks.items()}
    duty_log = duty_sink.FindLog(context)
    signals = {name: log.data() for name, log in logs.items()}
    if isinstance(system, Limb):
        angles = signals["joint_state"][: system.parameters.num_joints]
        signals["bend_angle"] = bend_angle(system.parameters, angles)
    return Recording(
        time=duty_log.sample_times() - start,
        duty=_without_rounding(duty_log.data()),
        parameters=system.parameters,
        source=system.source,
        sample_rate=sample_rate,
        **signals,
    )


def _duty_source(duty, duration: float | None, num_wires: int):
    """The source system, its start time and the time to simulate, s."""
    if isinstance(duty, Trajectory):
        duty = duty.duty_trajectory()
    if isinstance(duty, trajectories.Trajectory):
        source, size = TrajectorySource(duty), duty.rows() * duty.cols()
        start = duty.start_time()
        duration = duty.end_time() - start if duration is None else duration
    else:
        value = np.asarray(duty, float)
        source, size, start = ConstantVectorSource(value), value.size, 0.0
        if not ((value >= 0) & (value <= 1)).all():
            raise SimulationError(f"duty is {value.tolist()}; it must stay within 0 and 1.")
        if duration is None:
            raise SimulationError("duration is missing; constant duty has no end of its own.")
    if size != num_wires:
        raise SimulationError(f"duty has {size} values, but this limb has {num_wires} wires.")
    if not (np.isfinite(duration) and duration > 0):
        raise SimulationError(f"duration is {duration!r} s; it must be a positive number.")
    return source, start, duration


def _without_rounding(duty: np.ndarray) -> np.ndarray:
    """Duty within [0, 1], where interpolation left it by a rounding error only."""
    clipped = np.clip(duty, 0.0, 1.0)
    if np.abs(duty - clipped).max() > 1e-9:
        raise SimulationError(
            f"duty reaches from {duty.min():g} to {duty.max():g}; it must stay within 0 and 1."
        )
    return clipped


def _logged_ports(system: System) -> list[str]:
    ports = [system.get_output_port(index).get_name() for index in range(system.num_output_ports())]
    names = ["measured_temperature", "bend_angle", "wire_temperature", "joint_state"]
    if isinstance(system, Limb):
        # Its bend angle follows from its joint state, and calculated for all
        # samples at once it does not stop the C++ loop at each of them.
        names.remove("bend_angle")
    return [name for name in names if name in ports]


def _advance(simulator: Simulator, start: float, duration: float) -> None:
    """Runs the simulator, second by second to show progress."""
    try:
        simulator.Initialize()
        with Progress("simulating", duration, "s") as progress:
            for end in np.append(np.arange(1.0, duration, 1.0), duration):
                simulator.AdvanceTo(start + end)
                progress.update(end)
    except RuntimeError as error:
        raise SimulationError(
            f"The simulation stopped at {simulator.get_context().get_time() - start:.3g} s of "
            f"{duration:g} s: {' '.join(str(error).split())}"
        ) from error
