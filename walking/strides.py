"""The fit of the ground's friction and the heights of feet to the strides of a robot in space.

More than three feet share a load by heights that nobody measures: they come from hips, rest angles
and limbs that pull differently. Their common effect is the warp of the places where the feet
would be without a ground, h1 - h2 - h3 + h4 of four limbs around a body. A camera sees it, as the
body then rolls and pitches otherwise in a cycle.
"""

import dataclasses

import numpy as np
from scipy.optimize import minimize

from calibration.estimate import Estimate
from calibration.remarks import CalibrationError
from limb_systems import Recording
from limb_systems.simulation import SimulationError
from walking.gait import Gait, rotate_to_heading
from walking.gait_check import EXPECTED_WARP, measure_strides, with_warp_and_friction
from walking.in_mujoco import simulate_in_mujoco
from walking.robot_parameters import RobotParameters

FRICTION_ERROR = 0.5  # relative error that is expected of the description's friction
START_WARPS = (-0.7, 0.7)  # of the search, as multiples of the expected warp
MAX_SIMULATIONS = 25  # from each start
PLACE_ERROR = 5e-4  # m, of x and y of a pose that the model explains
TURN_ERROR = np.deg2rad(0.25)  # rad, of its angles
CURVATURE_STEP = 0.3  # of logarithm and multiple, over which the curvature of the cost is taken
MIN_CURVATURE = 2.0  # of what is expected of the warp alone
NUM_POSES = 20  # in a cycle, that count
NUM_CYCLES = 2  # that are simulated, from the heat of the limit cycle, of which the last one counts


@dataclasses.dataclass(frozen=True)
class StridesFit:
    """A robot with the friction and the warp that were fitted to its strides.

    - ``robot``: its description with the fitted values.
    - ``estimates``: ``friction`` as a multiple of the friction before, and ``warp``, m, by name.
    - ``made``: share of the planned stride that the last stride made.
    """

    robot: RobotParameters
    estimates: dict[str, Estimate]
    made: float


def fit_strides(gait: Gait, recording: Recording, start: float, cycles: int) -> StridesFit:
    """Fit friction and the warp of the feet to the body's pose in the last of some cycles.

    The wires have the gait's heat, to which feedback holds them. Robots of three limbs have no
    warp.

    Args:
        gait: the gait in space that the robot walks by.
        recording: the robot's walk, in which a camera sees the body's pose.
        start: time at which the first cycle begins, s.
        cycles: number of cycles.

    Raises:
        CalibrationError: if the gait is in a plane, the body is not seen, or every robot that is
            tried falls.
    """
    if not gait.in_space:
        raise CalibrationError("Strides tell of friction and feet in space alone, not in a plane.")
    # What is seen of the last cycle.
    last = start + (cycles - 1) * gait.period
    pose = recording.body_pose
    seen = np.full(1, np.nan) if pose is None else _body_motion(recording, last, gait.period)
    if not np.isfinite(seen).all():
        raise CalibrationError(
            "No camera sees the body in the last stride, which would tell of its feet; walk "
            "without --replan."
        )
    warps = len(gait.robot.limbs) > 3

    def cost(values: np.ndarray) -> float:
        """Squared deviations from what is seen, and from what is expected."""
        robot = with_warp_and_friction(gait.robot, EXPECTED_WARP * values[1:].sum(), values[0])
        try:
            walked = simulate_in_mujoco(gait, robot, NUM_CYCLES)
        except SimulationError:
            return np.inf
        residual = _body_motion(walked, (NUM_CYCLES - 1) * gait.period, gait.period) - seen
        scaled = residual / np.array([[PLACE_ERROR] * 2 + [TURN_ERROR] * 3]).T
        # Deviations along a cycle are correlated: all its poses count as one.
        expected = np.append(values[0] / FRICTION_ERROR, values[1:])
        return float((scaled**2).mean(axis=1).sum() + expected @ expected)

    # Search from several starts, as more than one warp explains most of the pose.
    options = {"maxfev": MAX_SIMULATIONS, "xatol": 0.02, "fatol": 0.01}
    searches = []
    for warp in START_WARPS if warps else (0.0,):
        first = np.array([0.0, warp][: 1 + warps])
        simplex = np.vstack([first, first + 0.3 * np.eye(len(first))])
        search = {**options, "initial_simplex": simplex}
        searches.append(minimize(cost, first, method="Nelder-Mead", options=search))
    best = min(searches, key=lambda result: result.fun)
    if not np.isfinite(best.fun):
        raise CalibrationError("The robot falls by this gait whatever its friction and its feet.")
    logarithm, *warp_multiples = best.x
    robot = with_warp_and_friction(gait.robot, EXPECTED_WARP * sum(warp_multiples), logarithm)
    # Standard errors follow from the curvature of the cost along each value.
    curvatures = []
    for step in CURVATURE_STEP * np.eye(len(best.x)):
        change = cost(best.x + step) + cost(best.x - step) - 2 * best.fun
        curvatures.append(change / CURVATURE_STEP**2)
    errors = np.sqrt(2 / np.maximum(curvatures, MIN_CURVATURE))
    friction = float(np.exp(logarithm))
    estimates = {"friction": Estimate(friction, friction * float(errors[0]), "of before")}
    if warp_multiples:
        warp = EXPECTED_WARP * float(warp_multiples[0])
        estimates["warp"] = Estimate(warp, EXPECTED_WARP * float(errors[1]), "m")
    made = measure_strides(recording, gait, np.array([last, last + gait.period]))[0]
    return StridesFit(robot, estimates, float(made[0]))


def _body_motion(recording: Recording, start: float, period: float) -> np.ndarray:
    """Return x, y, m, yaw, roll and pitch, rad (5, NUM_POSES), along a cycle that begins at a time.

    The first three are counted from its beginning.
    """
    assert recording.body_pose is not None
    times = start + period * np.linspace(0.0, 1.0, NUM_POSES)
    pose = np.unwrap(recording.body_pose, axis=1)
    x, y, _, roll, pitch, yaw = (np.interp(times, recording.time, row) for row in pose)
    moved = rotate_to_heading(np.array([x - x[0], y - y[0]]), yaw[0])
    return np.vstack([moved, yaw - yaw[0], roll, pitch])
