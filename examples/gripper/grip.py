"""Compute the bend and the heat with which a finger presses on an object with a force.

A finger is a planar limb that bends until one of its links touches a ball. At rest, the springs
and the force F of the contact carry the wires' torque:

    K θ + ∇V(θ) - f(x) = F ∇g(θ),   g(θ) = 0   (2 at rest, with a contact)

where g is the gap between the limb's axis and the ball, less half the limb's thickness. f depends
on heat alone. So a grip is planned as a motion in free air: with the same heat and without F, the
finger would bend further. This larger bend is the reference for `plan`, and the plan respects the
limits of the wires as for any motion.
"""

import dataclasses
import itertools

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from pydrake.trajectories import PiecewisePolynomial
from scipy.optimize import brentq

from limb_systems import LimbModel, LimbParameters, Trajectory, bend_angle
from limb_systems.dynamics import equation_of_motion
from limb_systems.symbolic_chain import Chain
from planners import PlanningError

TEMPERATURE_MARGIN = 5.0  # °C, by which wires stay below T_max


@dataclasses.dataclass(frozen=True)
class Grip:
    """A finger at rest that presses on a ball.

    - ``bend_angle``: φ of the free finger with the same heat, rad, by (11) from the mean of its
      joint angles, as in (15): the reference for a plan.
    - ``gripping_bend_angle``: φ with the ball, rad.
    - ``joint_angles``: θ with the ball (n,), rad.
    - ``force``: F, N, and ``normal``: unit vector from the finger to the ball in (E1, E2).
    - ``wire_temperature``: T of each wire (W,), °C.
    - ``largest_force``: largest steady force there, N, with the pulling wires near T_max.
    """

    bend_angle: float
    gripping_bend_angle: float
    joint_angles: np.ndarray
    force: float
    normal: np.ndarray
    wire_temperature: np.ndarray
    largest_force: float


def grip(
    parameters: LimbParameters,
    center: ArrayLike,
    radius: float,
    force: float,
) -> Grip:
    """Return the grip of a finger on a ball; the wires on the other side are at T_warm.

    Args:
        parameters: description of the finger, a planar limb of one segment, with gravity.
        center: center of the ball in the base's frame, (E1, E2), m.
        radius: radius of the ball, m.
        force: F with which the finger presses, N.

    Raises:
        PlanningError: if the limb is not a planar limb of one segment, does not reach the ball,
            touches it at T_warm, or cannot press with this force.
    """
    return _Finger(parameters, np.asarray(center, float), radius).grip(force)


def fingers_duty(planned: Trajectory) -> dict[str, Trajectory | PiecewisePolynomial]:
    """Return the duty of both fingers of the gripper; the right finger mirrors the left.

    Args:
        planned: the plan of the left finger, which bends towards its right wire.
    """
    mirrored = PiecewisePolynomial.FirstOrderHold(planned.time, planned.duty[::-1])
    return {"left_finger.duty": planned, "right_finger.duty": mirrored}


class _Finger:
    """The equations of `grip`."""

    def __init__(self, parameters: LimbParameters, center: np.ndarray, radius: float):
        model = LimbModel.of(parameters)
        if not model.layout.is_planar or len(parameters.segments) > 1:
            raise PlanningError("Only planar limbs of one segment can grip; give such a limb.")
        if center.shape != (2,) or not center[1] or not radius > 0:
            raise PlanningError(
                f"The ball is at {center.tolist()} m with a radius of {radius:g} m; give its "
                "center in (E1, E2), to one side of the straight finger, and a radius above 0."
            )
        self._parameters = parameters
        self._center = center
        self._wires = model.wires
        self._statics = model.mean_angle_statics
        # Find the wires that pull towards the ball, and their range of temperature.
        side = np.sign(center[1])
        self._pulls = np.array([np.sign(wire.e2) == side for wire in parameters.wires])
        limits = parameters.temperature_limits
        self._warm = limits.warm
        self._hottest = limits.maximum - TEMPERATURE_MARGIN
        # Write the gap between the finger and the ball as a function of the joint angles.
        n = model.layout.num_joints
        segment = parameters.segments[0]
        q = ca.SX.sym("q", n)
        x = ca.SX.sym("x", self._wires.num_states)
        F = ca.SX.sym("F")
        chain = Chain(model.mechanics, q)
        last = chain.position(n - 1, model.mechanics.end_offset[-1])
        ends = [*chain.origins, last]
        gap = ca.norm_2(ca.DM(center) - _nearest(ends, ca.DM(center))[:2])
        away = radius + segment.thickness / 2
        # Solve the balance of torques with the contact force, and the gap of zero.
        rest = ca.SX(n, 1)  # no velocity, no acceleration
        residual = equation_of_motion(model.mechanics, self._wires, q, rest, rest, x)
        balance = ca.vertcat(residual - F * ca.gradient(gap, q), gap - away)
        unknown = ca.vertcat(q, F)
        self._touching = ca.rootfinder(
            "grip",
            "newton",
            {"x": unknown, "p": x, "g": balance},
            {"show_eval_warnings": False},
        )
        self._point = ca.Function("point", [q], [_nearest(ends, ca.DM(center))])
        # Start near the root, as another root may be beyond the ball.
        self._start = np.append(self._statics.angles(self._states(self._warm)), 0.0)

    def grip(self, force: float) -> Grip:
        # Check that the force is between zero and the force of the hottest wires.
        most = self._force(self._hottest)
        if most <= 0:
            raise PlanningError(
                f"The finger does not reach the ball with wires at {self._hottest:g} °C; move the "
                "ball nearer."
            )
        if self._force(self._warm) >= 0:
            raise PlanningError(
                f"The finger touches the ball with all wires at {self._warm:g} °C; move the ball "
                "away from it."
            )
        if not 0 < force <= most:
            raise PlanningError(
                f"The finger can press on this ball with up to {most:.3g} N, its wires at "
                f"{self._hottest:g} °C, and not with {force:g} N."
            )
        # Find the temperature for the force.
        T = brentq(lambda T: self._force(T) - force, self._warm, self._hottest)
        angles, _ = self._pressing(T)
        away = self._center - np.array(self._point(angles)).ravel()[:2]
        return Grip(
            bend_angle=float(self._statics.values(self._states(T))[0]),
            gripping_bend_angle=float(bend_angle(self._parameters, angles)[0]),
            joint_angles=angles,
            force=force,
            normal=away / np.linalg.norm(away),
            wire_temperature=np.where(self._pulls, T, self._warm),
            largest_force=most,
        )

    def _force(self, T: float) -> float:
        """Return F, N, with the pulling wires at T; negative if the ball would have to pull."""
        return self._pressing(T)[1]

    def _pressing(self, T: float) -> tuple[np.ndarray, float]:
        """Return θ (n,) and F at rest, with the pulling wires at T and the ball touched."""
        states = self._states(T)
        try:
            solution = self._touching(self._start, states)
        except RuntimeError as error:
            raise PlanningError(
                "The solver found no pose in which the finger touches the ball; move the ball into "
                "the reach of one side of the finger."
            ) from error
        values = np.array(solution).ravel()
        return values[:-1], float(values[-1])

    def _states(self, T: float) -> np.ndarray:
        return self._wires.settled_states(np.where(self._pulls, T, self._warm))


def _nearest(ends: list[ca.SX], point: ca.DM) -> ca.SX:
    """Return the point (3,) on the links that is nearest to a point (2,).

    Args:
        ends: the links' ends in order, each (3,).
    """
    points = []
    for start, end in itertools.pairwise(ends):
        along = end[:2] - start[:2]
        share = ca.dot(point - start[:2], along) / ca.dot(along, along)
        points.append(start + ca.fmax(0.0, ca.fmin(1.0, share)) * (end - start))
    # Choose the nearest of the nearest points of all links.
    nearest = points[0]
    for at in points[1:]:
        nearer = ca.norm_2(point - at[:2]) < ca.norm_2(point - nearest[:2])
        nearest = ca.if_else(nearer, at, nearest)
    return nearest
