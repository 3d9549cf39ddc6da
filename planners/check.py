"""Simulates the duty of a plan, to see how far the plan is from what the limb would do."""

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import Limb, Trajectory, Wires, simulate, split_state
from limb_systems.model.kinematics import bend_angle
from limb_systems.model.manipulator import make_manipulator
from limb_systems.model.wire_blocks import make_blocks
from limb_systems.simulation import MAX_STEP_SIZE, failure_told, make_simulator

# Accuracy of the simulation that a plan is checked with: its bend angle is
# within 0.002° of that at accuracy 1e-6, for the Fig. 5 reference and for
# steps to 170°. Ten times finer takes three times as long.
CHECK_ACCURACY = 3e-4
CHECK_RATE = 20.0  # Hz, of the comparison, or that of the knots if it is higher
HEAT_ACCURACY = 3e-5  # of the wires alone
FORCE_STEP = 0.01  # s, between which forces are linear


def simulated_differences(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the plan's bend angle from that of its simulated duty.

    The duty is simulated with an accurate integrator from the plan's first
    state.

    Returns:
        Times (M,), s, and the largest difference of a segment (M,), rad.
    """
    rate = max(CHECK_RATE, 1 / np.diff(trajectory.time).min())
    wires = Wires(trajectory.parameters)
    runs_in_python = not (wires.rates_are_affine and wires.torque_is_affine)
    if runs_in_python and not wires.torque_needs_angle:
        times, simulated = _heat_then_motion(trajectory, rate)
    else:
        recording = simulate(
            Limb(trajectory.parameters),
            trajectory,
            sample_rate=rate,
            accuracy=CHECK_ACCURACY,
            initial_state=trajectory.state[:, 0],
        )
        times, simulated = recording.time, recording.bend_angle
    planned = trajectory.since_start().bend_angle_at(np.minimum(times, trajectory.duration))
    return times, np.abs(simulated - planned).max(axis=0)


def _heat_then_motion(trajectory: Trajectory, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (M,), s, and bend angles (S, M), rad, of a limb that does not act back on its wires.

    Wires whose laws run in Python are simulated alone, so that the implicit
    integrator of the chain, which evaluates its systems very often, does not call them.
    """
    parameters, plan = trajectory.parameters, trajectory.since_start()
    angles, rates, states, _ = split_state(parameters, plan.state[:, 0])
    duration, n = plan.duration, parameters.num_joints

    builder = DiagramBuilder()
    heating = builder.AddSystem(make_blocks(parameters)[0])
    duty = builder.AddSystem(TrajectorySource(plan.duty_trajectory()))
    builder.Connect(duty.get_output_port(), heating.get_input_port())
    simulator = Simulator(builder.Build())
    config = SimulatorConfig(
        integration_scheme="runge_kutta3",
        accuracy=HEAT_ACCURACY,
        max_step_size=MAX_STEP_SIZE,
        use_error_control=True,
    )
    ApplySimulatorConfig(config, simulator)
    simulator.get_mutable_context().SetContinuousState(states)
    integrator = simulator.get_mutable_integrator()
    with failure_told(simulator, duration):
        simulator.Initialize()
        integrator.StartDenseIntegration()
        simulator.AdvanceTo(duration)
    times = np.linspace(0.0, duration, int(np.ceil(duration / FORCE_STEP)) + 1)
    courses = integrator.StopDenseIntegration().vector_values(times).T
    forces = Wires(parameters).forces(courses, np.zeros((1, n)))

    builder = DiagramBuilder()
    manipulator = builder.AddSystem(make_manipulator(parameters))
    course = PiecewisePolynomial.FirstOrderHold(times, forces.T)
    source = builder.AddSystem(TrajectorySource(course))
    builder.Connect(
        source.get_output_port(), manipulator.get_applied_generalized_force_input_port()
    )
    sink = LogVectorOutput(manipulator.get_state_output_port(), builder, 1 / rate)
    simulator = make_simulator(builder.Build(), CHECK_ACCURACY)
    context = simulator.get_mutable_context()
    context.SetContinuousState(np.concatenate([angles, rates]))
    num_samples = int(np.floor(duration * rate + 1e-6)) + 1
    with failure_told(simulator, duration):
        simulator.AdvanceTo(max(duration, (num_samples - 1) / rate))
    log = sink.FindLog(context)
    return log.sample_times(), bend_angle(parameters, log.data()[:n])
