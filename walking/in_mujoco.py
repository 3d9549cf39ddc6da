"""Gaits in MuJoCo, whose contact takes a twentieth of the time of Drake's.

Feet that stick creep as in Drake (`urdf.robot_mjcf`), on which strides depend most.
"""

import copy
import itertools
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from limb_systems import LimbError, LimbModel, Recording, bend_angle
from limb_systems.simulation import PERIOD, SimulationError
from planners.transcription.quasi_static import integrate_readings
from urdf import robot_mjcf
from walking import Gait, RobotParameters
from walking.robot import body_positions

STEP = 2e-3  # s
STEPS = round(PERIOD / STEP)  # in a period


def simulate_in_mujoco(gait: Gait, robot: RobotParameters, cycles: int) -> Recording:
    """Simulate cycles of a gait's duty on a robot, which begins with the gait's first knot at rest.

    The torques of wires of any law are applied to the joints. Heat does not depend on the motion.

    Returns:
        A recording at 20 Hz, with a sample after the last cycle; as of a `Robot`, which has the
        force on the feet at its samples, too.

    Raises:
        SimulationError: if the motion blows up.
        LimbError: if MuJoCo is not installed.
    """
    try:
        import mujoco
        from mujoco import rollout
    except ImportError as error:
        raise LimbError(
            "Gaits are checked in MuJoCo, which is not installed: pip install 'soft-limb[walking]'."
        ) from error
    full_state = mujoco.mjtState.mjSTATE_FULLPHYSICS
    torques = mujoco.mjtState.mjSTATE_QFRC_APPLIED.value
    parameters = robot.as_single_limb
    num_samples = int(cycles * gait.period / PERIOD + 1e-9) + 2
    times = PERIOD * np.arange(num_samples)
    heat, readings, forces = _wires_along(gait, robot, cycles, times)

    # Put the robot into the pose of the gait's first knot.
    spec = mujoco.MjSpec.from_string(robot_mjcf(robot, wires=False, timestep=STEP))
    spec.compiler.discardvisual = True
    model = spec.compile()
    # A motion that blows up is not begun anew. The robot is one island, which need not be found.
    for flag in (mujoco.mjtDisableBit.mjDSBL_AUTORESET, mujoco.mjtDisableBit.mjDSBL_ISLAND):
        model.opt.disableflags |= flag
    data = mujoco.MjData(model)
    joints = slice(model.nq - parameters.num_joints, model.nq)
    positions = body_positions(gait.body_pose[:, 0])
    in_plane = len(positions) == 3
    data.qpos[: joints.start] = positions if in_plane else np.roll(positions, 3)
    data.qpos[joints] = gait.joint_angles[:, 0]
    state = np.zeros(mujoco.mj_stateSize(model, full_state))
    mujoco.mj_getState(model, data, state, full_state)

    # Simulate from sample to sample, with torques at the angles of the last one.
    applied = np.zeros((STEPS, model.nv))
    shares = np.arange(STEPS)[:, None] / STEPS
    places = slice(1, 1 + model.nq)
    states, sensed = [state], []
    for before, after in itertools.pairwise(heat):
        angles = np.tile(state[places][joints], (STEPS, 1))
        applied[:, -parameters.num_joints :] = forces(before + shares * (after - before), angles)
        reached, on_feet = rollout.rollout(model, data, state, applied, control_spec=torques)
        state = reached[0, -1]
        if not np.isfinite(state).all():
            raise SimulationError(f"The motion blows up after {times[len(states)]:.1f} s.")
        states.append(state)
        sensed.append(on_feet[0, 0])
    sensed.append(on_feet[0, -1])

    configurations = np.array(states)[:, places].T
    velocities = np.array(states)[:, 1 + model.nq : 1 + model.nq + model.nv].T
    pose = configurations[: joints.start]
    if not in_plane:
        angles = Rotation.from_quat(pose[3:].T, scalar_first=True).as_euler("xyz")
        pose = np.vstack([pose[:3], angles.T])
    loads = np.array(sensed).reshape(num_samples, -1, 3)
    axes = [0, 2] if robot.force_size == 2 else [0, 1, 2]
    return Recording(
        time=times,
        duty=gait.duty_trajectory(cycles).vector_values(times),
        measured_temperature=readings.T,
        wire_temperature=heat[:, : readings.shape[1]].T,
        bend_angle=bend_angle(parameters, configurations[joints]),
        joint_state=np.vstack([configurations[joints], velocities[-parameters.num_joints :]]),
        body_pose=pose,
        contact_force=loads[:, :, axes].reshape(num_samples, -1).T,
        robot=robot,
        parameters=parameters,
        source="model in MuJoCo",
        sample_rate=1 / PERIOD,
    )


def _wires_along(
    gait: Gait, robot: RobotParameters, cycles: int, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray, np.ndarray], np.ndarray]]:
    """Return x (K, N) and V (K, W) of a robot's wires at times (K,), and `Wires.forces`."""
    limbs = copy.deepcopy(robot.as_single_limb)
    for segment in limbs.segments:
        segment.stiffening = 0.0  # which MuJoCo has
    wires = LimbModel.of(limbs).wires
    duty = gait.duty_trajectory(cycles)
    breaks = np.array(duty.get_segment_times())
    ends = np.union1d(times, breaks)
    heat = gait.initial_heat
    course = [heat[: wires.num_states]]
    held_until = np.append(breaks[breaks < times[-1]], times[-1])
    for start, end in itertools.pairwise(held_until):
        within = ends[(ends >= start) & (ends <= end)]
        levels = np.tile(duty.value(start).ravel(), (len(within), 1))
        course += [*wires.integrate_states(course[-1], levels, within)[1:]]
    readings = integrate_readings(wires, np.array(course), heat[wires.num_states :], ends)
    places = np.searchsorted(ends, times)
    return np.array(course)[places], readings[places], wires.forces
