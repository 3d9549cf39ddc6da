"""Contacts of the feet of a robot that walks, from its motion and its contact forces."""

import itertools

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from walking.gait import GaitPhase
from walking.robot import make_robot, set_positions
from walking.robot_parameters import RobotParameters

# m/s, and m/s for each N along the ground, twice that by which feet that stick creep in Drake.
MIN_SLIDING_SPEED = 2e-4
CREEP_PER_FORCE = 8.4e-4
LIFTED_LOAD_SHARE = 0.02  # share of what all feet carry
# s, over which speeds are averaged where a camera's noise would make feet slide; and the speed, as
# a multiple of the standard deviation of what noise leaves of it, from which they then do.
AVERAGING_TIME = 0.5
NOISE_FACTOR = 3.0


def foot_fall(recording: Recording) -> list[GaitPhase]:
    """Return phases in which none of L feet changes its contact, by K samples of a recording.

    A foot swings where it carries less than 2% of what all feet carry. Else it slides where its
    point at the ground is faster than 0.2 mm/s plus 0.84 mm/s for each N along the ground; else it
    sticks. In the plane it slides forward if it goes towards +x, and else backward. The described
    friction plays no part, as the ground's friction may differ from it.

    Where the body's pose is measured with noise, speeds are means over 0.5 s, and three standard
    deviations of the noise of these means are added to the speed above which a foot slides.

    Raises:
        LimbError: if the recording has no joint angles, no pose of the body or no contact forces,
            or fewer than two samples.
    """
    robot = recording.robot
    forces = recording.contact_force
    missing = recording.joint_state is None or forces is None or len(forces[0]) < 2
    if missing or not isinstance(robot, RobotParameters):
        raise LimbError(
            "Contacts of feet follow from two or more samples of a robot's joint angles and "
            "contact forces, which this recording does not have."
        )
    assert forces is not None
    velocity, noise = _foot_velocity(recording)
    speed = np.linalg.norm(velocity, axis=1)  # (L, K-1)

    # Take the mean force along the ground and load between samples (L, K-1).
    foot_forces = forces.reshape(len(robot.limbs), -1, len(recording.time))
    foot_forces = (foot_forces[..., 1:] + foot_forces[..., :-1]) / 2
    tangential = np.linalg.norm(foot_forces[:, :-1], axis=1)
    load = foot_forces[:, -1]

    # Decide each foot's contact.
    swings = load <= LIFTED_LOAD_SHARE * load.sum(axis=0)
    slides = np.where(velocity[:, 0] > 0, "slide_forward", "slide_backward")
    if robot.body.mount != "planar":
        slides = np.full(slides.shape, "slide")
    min_speed = MIN_SLIDING_SPEED + CREEP_PER_FORCE * tangential + NOISE_FACTOR * noise
    contacts = np.where(swings, "swing", np.where(speed > min_speed, slides, "stick"))

    # Join samples with the same contacts to phases.
    samples = zip(recording.time[:-1].tolist(), contacts.T.tolist(), strict=True)
    phases = []
    for phase_contacts, group in itertools.groupby(samples, lambda sample: sample[1]):
        start, _ = next(group)
        phases.append(GaitPhase(start, phase_contacts))
    return phases


def _foot_velocity(recording: Recording) -> tuple[np.ndarray, float]:
    """Return the velocity of each foot's point at the ground along x and y, and its noise.

    Returns:
        From each sample to the next (L, 2, K-1), m/s, and the standard deviation of noise in each
        of its numbers, m/s; 0 if there is less noise than would make feet slide.
    """
    slip = _foot_slip(recording)
    steps = np.diff(recording.time)
    step = float(np.median(steps))
    averaged = max(1, round(AVERAGING_TIME / step))
    noise = 0.0  # of places, m
    if len(steps) > averaged:  # from second differences, where a camera holds each of its poses
        noise = float(np.median(np.abs(np.diff(slip)), axis=-1).max()) / (0.674 * np.sqrt(2.0))
    if noise < MIN_SLIDING_SPEED * step:
        return slip / steps, 0.0
    from scipy.ndimage import uniform_filter1d  # takes long to import

    velocity = uniform_filter1d(slip / steps, averaged, mode="nearest")
    return velocity, np.sqrt(2.0) * noise / (averaged * step)


def _foot_slip(recording: Recording) -> np.ndarray:
    """Return the slip of each foot's point at the ground between samples (L, 2, K-1), m.

    A foot that rolls does not slip: its centre goes as far as it turns.
    """
    robot = recording.robot
    joint_state = recording.joint_state
    assert isinstance(robot, RobotParameters)
    assert joint_state is not None
    builder = DiagramBuilder()  # it keeps the plant
    plant = make_robot(builder, robot)
    context = plant.CreateDefaultContext()
    feet = [plant.GetBodyByName(f"{limb.name}_foot") for limb in robot.limbs]
    poses = np.empty((len(feet), len(recording.time), 3, 4))
    for sample, angles in enumerate(joint_state[: len(joint_state) // 2].T):
        pose = None if recording.body_pose is None else recording.body_pose[:, sample]
        set_positions(plant, context, robot, pose, angles)
        for foot, body in enumerate(feet):
            poses[foot, sample] = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix34()
    moved = np.diff(poses[..., 3], axis=1)
    turned = poses[:, 1:, :, :3] @ np.swapaxes(poses[:, :-1, :, :3], -1, -2)
    from scipy.spatial.transform import Rotation  # takes long to import

    turns = Rotation.from_matrix(turned.reshape(-1, 3, 3)).as_rotvec().reshape(moved.shape)
    slip = moved + np.cross(turns, [0.0, 0.0, -robot.feet.radius])
    return np.swapaxes(slip[..., :2], 1, 2)
