"""The course of a gait in a cycle, and the check that a robot can take it."""

import dataclasses

import numpy as np
from scipy.spatial.distance import pdist

from limb_systems import LimbModel, tip_position
from planners.transcription.solving import PlanningError
from walking.robot_parameters import RobotParameters

MIN_TURN = 0.05  # rad, of robots that turn as far as they can
MAX_TURN = np.pi / 2  # rad, in a cycle


@dataclasses.dataclass(frozen=True)
class Course:
    """The travel and turn of a gait in a cycle.

    - ``turn``: turn of the body to the left, rad; as far as it can, at least 0.05 rad, if infinite.
      The stride is along the body's heading in the middle of the cycle.
    - ``stride``: m; the longest if None, or none if the turn is infinite.
    - ``speed``: m/s; the fastest if None.
    """

    turn: float = 0.0
    stride: float | None = None
    speed: float | None = None

    @property
    def on_the_spot(self) -> bool:
        """True if the gait turns without a stride."""
        return self.stride == 0.0 or (self.stride is None and np.isinf(self.turn))


def check_course(robot: RobotParameters, course: Course) -> None:
    """Raise PlanningError for a course that the robot cannot take with any schedule."""
    turn = course.turn
    stride = course.stride
    speed = course.speed
    assert robot.ground is not None, "a gait needs a ground"
    if np.isnan(turn):
        raise PlanningError("turn is nan; it must be an angle in rad, or infinite.")
    if turn and robot.body.mount == "planar":
        raise PlanningError(
            "The body moves in the vertical plane, in which it cannot turn; set body.mount to free."
        )
    if turn and robot.ground.slope:
        raise PlanningError(
            f"The ground slopes by {np.rad2deg(robot.ground.slope):.3g}°, so that no motion of a "
            "robot that turns repeats; gaits turn on level ground."
        )
    if stride is not None and not 0 <= stride < np.inf:
        raise PlanningError(f"stride is {stride:g} m; it must be 0 or more.")
    if speed is not None and not 0 < speed < np.inf:
        raise PlanningError(f"speed is {speed:g} m/s; it must be more than 0.")
    if course.on_the_spot and not turn:
        raise PlanningError("A gait without a stride must turn; ask for a turn, or for a stride.")
    if course.on_the_spot and speed is not None:
        raise PlanningError("A gait on the spot has no speed; ask for a turn alone.")
    longest_step = _longest_step_of_all_limbs(robot)
    if stride and stride > longest_step:
        raise PlanningError(
            f"A stride of {1e3 * stride:.3g} mm cannot be had: between wires at T_max on either "
            f"side, the feet are at most {1e3 * longest_step:.3g} mm apart."
        )
    arm = np.linalg.norm(robot.hips[:, :2], axis=1).min()
    most = min(MAX_TURN, 2 * np.arcsin(min(1.0, longest_step / 2 / max(arm, 1e-6))))
    if np.isfinite(turn) and abs(turn) > most:
        raise PlanningError(
            f"A turn of {np.rad2deg(turn):.3g}° in a cycle cannot be had: between wires at T_max "
            f"on either side, the feet go at most {1e3 * longest_step:.3g} mm, which turns the "
            f"body by {np.rad2deg(most):.3g}°."
        )


def _longest_step_of_all_limbs(robot: RobotParameters) -> float:
    """Return the longest step that every limb reaches, m: the smallest of the limbs' longest.

    A limb's longest step is between two of its tips, each with one wire at T_max.
    """
    longest_steps = []
    for limb in robot.limbs:
        parameters = limb.parameters
        wires = LimbModel.of(parameters).wires
        hottest = parameters.temperature_limits.maximum
        # Heat one wire at a time, and find the tips; [1:] drops E1, along the straight limb.
        heated = np.full((wires.num_wires, wires.num_wires), parameters.ambient_temperature)
        np.fill_diagonal(heated, hottest)
        states = np.array([*map(wires.settled_states, heated)])
        tips = tip_position(parameters, LimbModel.of(parameters).statics.angles(states).T)[1:]
        longest_steps.append(pdist(tips.T).max(initial=0.0))
    return float(min(longest_steps))
