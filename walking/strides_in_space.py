"""What the strides of a robot in space tell: friction of the ground, and heights of its feet.

More than three feet share a load by heights that nobody measures: those of the hips, of rest angles
and of limbs that pull differently. Their common effect is the warp of the places where the feet
would be without a ground, h1 - h2 - h3 + h4 of four limbs around a body. A camera sees it, as the
body then rolls and pitches otherwise in a cycle.
"""

import copy

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize

from calibration.estimate import Estimate
from calibration.remarks import CalibrationError
from limb_systems import Recording
from limb_systems.simulation import SimulationError
from walking.gait import Gait, along_heading
from walking.gait_check import with_friction
from walking.in_mujoco import simulate_in_mujoco
from walking.robot_parameters import RobotParameters
from walking.strides import FRICTION, StridesFit, fit_heat, smoothed

WARP = 1e-3  # m, that is expected
STARTS = (-0.7, 0.7)  # of the warp, as multiples of the expected one
SIMULATIONS = 25  # from each start
PLACE_ERROR, TURN_ERROR = 5e-4, np.deg2rad(0.25)  # m and rad, of a pose that the model explains
STEP = 0.3  # of logarithm and multiple, over which the curvature of the cost is taken
LEAST_CURVATURE = 2.0  # of what is expected of the warp alone
POSES = 20  # in a cycle, that count
CYCLES = 2  # that are simulated, from the heat of the limit cycle, of which the last one counts


def fit_strides_in_space(gait: Gait, recording: Recording, start: float, cycles: int) -> StridesFit:
    """Fit friction and the warp of the feet to the body's pose in the last of some cycles.

    The wires have the gait's heat, to which feedback holds them. Robots of three limbs have no
    warp.

    Args:
        gait: the gait that the robot walks by.
        recording: begins with cold wires; the body's pose is seen.
        start: time at which the first cycle begins, s.
        cycles: number of cycles.

    Raises:
        CalibrationError: if the body is not seen, or falls on every robot that is tried.
    """
    # What is seen of the last cycle.
    last = start + (cycles - 1) * gait.period
    pose = recording.body_pose
    seen = np.full(1, np.nan) if pose is None else _course(recording, last, gait.period)
    if not np.isfinite(seen).all():
        raise CalibrationError(
            "No camera sees the body in the last stride, which would tell of its feet; walk "
            "without --replan."
        )
    warps = len(gait.robot.limbs) > 3

    def cost(values: np.ndarray) -> float:
        """Squared deviations from what is seen, and from what is expected."""
        robot = with_warp_and_friction(gait.robot, WARP * values[1:].sum(), values[0])
        try:
            walked = simulate_in_mujoco(gait, robot, CYCLES)
        except SimulationError:
            return np.inf
        missed = _course(walked, (CYCLES - 1) * gait.period, gait.period) - seen
        scaled = missed / np.array([[PLACE_ERROR] * 2 + [TURN_ERROR] * 3]).T
        # Deviations are alike along a cycle: all poses of it count as one.
        expected = np.append(values[0] / FRICTION, values[1:])
        return float((scaled**2).mean(axis=1).sum() + expected @ expected)

    # Search from several starts, as more than one warp explains most of the pose.
    options = {"maxfev": SIMULATIONS, "xatol": 0.02, "fatol": 0.01}
    found = []
    for warp in STARTS if warps else (0.0,):
        first = np.array([0.0, warp][: 1 + warps])
        simplex = np.vstack([first, first + 0.3 * np.eye(len(first))])
        search = {**options, "initial_simplex": simplex}
        found.append(minimize(cost, first, method="Nelder-Mead", options=search))
    best = min(found, key=lambda result: result.fun)
    if not np.isfinite(best.fun):
        raise CalibrationError("The robot falls by this gait whatever its friction and its feet.")
    logarithm, *others = best.x
    robot = with_warp_and_friction(gait.robot, WARP * sum(others), logarithm)
    # Standard errors follow from the curvature of the cost along each value.
    curvatures = [
        (cost(best.x + step) + cost(best.x - step) - 2 * best.fun) / STEP**2
        for step in STEP * np.eye(len(best.x))
    ]
    errors = np.sqrt(2 / np.maximum(curvatures, LEAST_CURVATURE))
    friction = float(np.exp(logarithm))
    estimates = {"friction": Estimate(friction, friction * float(errors[0]), "of before")}
    if others:
        estimates["warp"] = Estimate(WARP * float(others[0]), WARP * float(errors[1]), "m")
    # The heat at the end of the recording is the wires' own.
    heat = fit_heat(copy.deepcopy(gait.robot), recording)[0]
    return StridesFit(robot, estimates, heat[-1], smoothed(recording)[:, -1])


def with_warp_and_friction(
    robot: RobotParameters, warp: float, logarithm: float
) -> RobotParameters:
    """Return a copy of a robot with other hips and friction.

    Args:
        warp: h1 - h2 - h3 + h4 of four hips that are raised and lowered by turns, m.
        logarithm: of the friction as a multiple.
    """
    robot = with_friction(robot, float(np.exp(logarithm)))
    for limb, raised in zip(robot.limbs, 0.25 * warp * warp_pattern(robot), strict=True):
        limb.position = [*limb.position[:2], limb.position[2] + float(raised)]
    return robot


def warp_pattern(robot: RobotParameters) -> np.ndarray:
    """Return heights of hips (L,), of rms 1, that no plane has; zero of three hips."""
    places = np.array([limb.position[:2] for limb in robot.limbs])
    patterns = null_space(np.column_stack([np.ones(len(places)), places]).T)
    if not patterns.size:
        return np.zeros(len(places))
    return patterns[:, 0] * np.sqrt(len(places)) * np.sign(patterns[0, 0])


def _course(recording: Recording, start: float, period: float) -> np.ndarray:
    """Return x, y, m, yaw, roll and pitch, rad (5, POSES), along a cycle that begins at a time.

    The first three are counted from its beginning.
    """
    assert recording.body_pose is not None
    times = start + period * np.linspace(0.0, 1.0, POSES)
    pose = np.unwrap(recording.body_pose, axis=1)
    x, y, _, roll, pitch, yaw = (np.interp(times, recording.time, row) for row in pose)
    moved = along_heading(np.array([x - x[0], y - y[0]]), yaw[0])
    return np.vstack([moved, yaw - yaw[0], roll, pitch])
