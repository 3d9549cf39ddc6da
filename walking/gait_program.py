"""The program of a gait: a periodic motion of heat, body, limbs and feet on the ground.

K knots are on a ring: the last interval ends at the first knot, a stride further, and turned. At
each knot are the configuration y, the heat [x, V] of the wires, the forces λ of the ground and the
travel s of the feet. Each interval between knots has a duty and contacts, and each phase has a
duration. The constraints are:

- the balance of forces, as `Balance`, and in a plane the stability of `Stability`, at every knot;
- (17) of the heat, in every interval, as `heat_defects`;
- a foot on the ground is at z = r - f_n / ρ, or in a plane at z = r if any foot swings, and carries
  a least share of the load;
- a foot that sticks does not travel, and has |f_t| <= c μ f_n, with c of ``sticking_share``;
- a foot that slides travels along one direction u in each phase, and has f_t = -μ f_n u;
- a foot that swings carries nothing, is 1 mm clear of the ground at knots inside of its phase, and
  travels so little in an interval that it is clear in between;
- (19), 0 <= D <= 1 and the total duty; and, with a margin of temperature, that T and a share of
  T - V, which feedback takes for a possible error of T, are 3 °C below T_max.

A knot between two phases belongs to both. Where a foot begins or ends to slide, it has the friction
of a foot that slides, as friction does not jump: the share of μ counts at knots inside of a phase.

A gait in the vertical plane has one direction along the ground, x, in which u is 1 or -1. In space
there are two, and the program finds the direction u, whose length is 1.
"""

from collections.abc import Sequence
from typing import Literal

import casadi as ca
import numpy as np
from pydrake.solvers import MathematicalProgram

from controllers.temperature_supervisor import lag_error
from limb_systems import LimbModel, Provenance
from limb_systems.limb_mechanics import ANGLE_SCALE
from limb_systems.segment_chain import rotation
from limb_systems.smooth_function import SmoothFunction
from planners.transcription.collocation import heat_defects
from planners.transcription.function_block import FunctionBlock
from planners.transcription.ipopt import ConstraintBlock
from walking.course import MAX_TURN, MIN_TURN, Course
from walking.gait import Gait, GaitCheck, GaitPhase, rotate_to_heading
from walking.robot_parameters import RobotParameters
from walking.standing import (
    MIN_BODY_STIFFNESS,
    MIN_PIVOT,
    FrictionGain,
    Stability,
    make_balance,
)
from walking.walker import Walker

SLIDE_SIGNS = {"slide_forward": 1.0, "slide_backward": -1.0}

MIN_LOAD_SHARE = 0.05  # of the weight, on each foot on the ground
# The same in space for calibrated robots, which are real. Their limbs bend a degree or two more or
# less than modelled, and their hips are a millimetre off, so that the body leans to one side. With
# less on the feet of the other side, it tips over.
MIN_LOAD_SHARE_CALIBRATED = 0.16
# Stiffness of the feet against roll and pitch in space, as a multiple of weight times limb length,
# of calibrated robots. The weight that tips over takes some 0.8 of it.
MIN_STANCE_STIFFNESS = 2.5
MIN_SLIP = 1e-6  # m; feet that slip less have no direction
SWING_CLEARANCE = 1e-3  # m, of feet that swing; feet on the ground sink in by 0.03 mm
MAX_FRICTION_GAIN = 0.5  # of friction on itself, with which errors of loads grow twofold
CONE_ROUNDING = 1e-3  # of a foot's load: radius of the blunt tip of the friction cone
STICKING_SHARE = 0.8  # of μ, that feet that stick may use
# The same of calibrated robots of four and more feet, whose warp shifts loads from foot to foot.
# With more, three of ten robots whose hips are within 1 mm made less than 0.85 of a stride ahead,
# with this one of ten.
STICKING_SHARE_CALIBRATED = 0.6
# The same on the spot. With 0.8 a turn takes a third less time, but on feet warped by 0.5 mm the
# lighter pair slides in both drags, so that the robot turns to and fro. With this, turns of five
# robots make 0.25 to 1.0 of the plan on feet warped by 1 mm, 12 of 20 at least 0.7.
STICKING_SHARE_ON_THE_SPOT = 0.5
# Of weight x limb length, the least stiffness against pitch. Robots whose limbs pull 10% more and
# less than planned tip over with less, open loop; with more they walk more slowly.
STEADINESS = 25.0
# Calibrated limbs are known better, and are driven by feedback: what they need to hold their feet
# apart, heat of both wires of a limb, then is better kept for the stride.
STEADINESS_CALIBRATED = 12.5
MAX_FEEDBACK_MARGIN = 3.0  # °C, of a margin, for what estimates of T may be off
LENGTH_SCALE = 0.01  # m, a typical travel
HEAT_SCALE = 50.0  # °C, a typical warmth
MIN_STRIDE = 1e-3  # m; below, there is no gait to speak of
STEP_RANGE = 0.1, 10.0  # of intervals, as shares of the time constant of cooling over their number
# rad: gaits do not reach these bounds, which keep the iterates sane.
MAX_ROLL_AND_PITCH = 0.5
MAX_JOINT_ANGLE = 0.8
# Limbs that stand in space on soft links find more than one balance farther on.
MAX_JOINT_ANGLE_IN_SPACE = 0.2


def default_steadiness(robot: RobotParameters) -> float:
    """Return 25, or 12.5 for a robot that is calibrated."""
    return STEADINESS_CALIBRATED if is_calibrated(robot) else STEADINESS


def default_sticking_share(robot: RobotParameters, course: Course) -> float:
    """Return 0.8; for a calibrated robot whose feet may be warped 0.6 ahead, and 0.5 on the spot.

    Along arcs it is 0.8 for all robots, as few have such a gait with less.
    """
    can_be_warped = robot.body.mount == "free" and len(robot.limbs) > 3
    if not (can_be_warped and is_calibrated(robot)):
        return STICKING_SHARE
    if course.on_the_spot:
        return STICKING_SHARE_ON_THE_SPOT
    return STICKING_SHARE if course.turn else STICKING_SHARE_CALIBRATED


def is_calibrated(robot: RobotParameters) -> bool:
    """Return whether all limbs of a robot are calibrated."""
    return all(limb.parameters.calibration for limb in robot.limbs)


class GaitProgram:
    """Program of one schedule of contacts.

    - ``prog``: the `MathematicalProgram`, with all that is linear.
    - ``blocks``: all other constraints.
    - ``sliding``: `FrictionGain` of feet that slide, which is not in ``blocks`` at first; None in
      space.
    - ``y``, ``heat``, ``forces``, ``duty``: indices of the configuration (K, d), of [x, V] (K, M),
      of λ (K, F, τ + 1) and the duty of the interval after the knot (K, W) among the decision
      variables.
    - ``travel``: indices of s (K + 1, F, τ).
    - ``direction``: indices of u of each foot and phase in which a foot slides in space (S, 2).
    - ``advance``: indices of the travel along u in each interval of such a phase (A,).
    - ``steps``: indices of the lengths of the intervals of each phase (P,), s.
    - ``end``: indices of the body's travel per period: x, m; in space x, y and yaw.
    - ``merit``: index of the objective: speed, m/s, or heating per distance, s of full duty of one
      wire per m. A turn on the spot counts by the way of a point that is a limb's length away.
    - ``phase_of``: phase of each interval (K,).
    - ``temperature_margin``, ``sticking_share``, ``steadiness``, ``course``,
      ``begins_as``: as given.

    Args:
        robot: description of the robot, on a body that is not welded.
        schedule: contact of each foot, for each phase (P, F).
        intervals: number of intervals of each phase (P,).
        objective: "speed" or "energy".
        temperature_margin: how far T stays below T_max, °C.
        sticking_share: share of μ that feet that stick may use.
        steadiness: the least stiffness against pitch in a plane, the last pivot of `Stability`, as
            a multiple of weight times limb length; no pivot is bounded if it is -inf.
        course: where it goes; ahead, as fast as it can, if None.
        begins_as: a gait of the same robot, with whose wire temperatures it begins, as far as the
            margin allows; with its own if None.
    """

    def __init__(
        self,
        robot: RobotParameters,
        schedule: Sequence[Sequence[str]],
        intervals: Sequence[int],
        objective: Literal["speed", "energy"] = "speed",
        temperature_margin: float = 0.0,
        sticking_share: float = STICKING_SHARE,
        steadiness: float = STEADINESS,
        course: Course | None = None,
        begins_as: Gait | None = None,
    ):
        self.robot = robot
        self.schedule = schedule
        self.objective = objective
        self.temperature_margin = temperature_margin
        self.course = course or Course()
        self.sticking_share = sticking_share
        self.steadiness = steadiness
        self.begins_as = begins_as
        self.walker = Walker(robot)
        self.wires = LimbModel.of(robot.as_single_limb).wires
        self.in_space = self.walker.num_tangents == 2
        self.load = float(np.linalg.norm(self.walker.weight))  # N, of all feet

        # Repeat the contacts of each phase for each of its intervals (K, F). Contacts are cyclic.
        self.phase_of = np.repeat(np.arange(len(schedule)), intervals)
        self.contacts = np.array(schedule)[self.phase_of]
        self.contacts_before = np.roll(self.contacts, 1, axis=0)
        # Feet that slide in space; in a plane they "slide_forward" or "slide_backward".
        self.slides_in_space = self.contacts == "slide"

        # Add variables, and all constraints that are linear.
        self._add_variables()
        self._add_bounds()
        self._add_course()
        if begins_as:
            # The wires begin as warm as at the start of that gait.
            limits = self.robot.as_single_limb.temperature_limits
            warmest = limits.maximum - self.temperature_margin
            warmth = np.minimum(begins_as.wire_temperature[:, 0], warmest)
            self._bound(self.heat[0, : len(warmth)], warmth, warmth)
        self._add_contacts()

        # State the nonlinear constraints. In a plane, the ground is rigid if feet swing: the pivots
        # of `Stability` do not resolve the micrometres by which feet sink into ground that gives.
        self.has_swing = bool((self.contacts == "swing").any())
        self.balance = make_balance(
            self.walker, self.wires, ground_gives=self.in_space or not self.has_swing
        )
        self.blocks: list[ConstraintBlock] = [
            self._balance_block(),
            *([] if self.in_space else [self._stability_block()]),
            self._heat_block(),
            self._merit_block(),
            *self._contact_blocks(),
        ]
        # `plan_gait` adds this block if friction of a gait without it is not stable.
        self.sliding = None if self.in_space else self._sliding_block()

    def _add_variables(self) -> None:
        """Add the decision variables with their scales, and the objective."""
        prog = self.prog = MathematicalProgram()
        walker = self.walker
        K = len(self.phase_of)
        F = walker.num_feet
        τ = walker.num_tangents
        W = self.wires.num_wires

        # Scale each variable by a typical value.
        joint_scales = np.full(len(walker.stiffness) - walker.pose_size, ANGLE_SCALE)
        place_scales = np.full(τ + 1, LENGTH_SCALE)
        angle_scales = np.full(2 * τ - 1, ANGLE_SCALE)
        cooling_rate = -np.diag(self.wires.affine_rates()[0])[:W].mean()
        merit_scale = 1e-3 if self.objective == "speed" else 1e3
        num_slides = len(np.unique(self._slide_numbers))
        sizes = {
            "y": (K, np.concatenate([place_scales, angle_scales, joint_scales])),
            "heat": (K, self.wires.heat_scales),
            "forces": (K, np.full((τ + 1) * F, self.load / F)),
            "travel": (K + 1, np.full(τ * F, LENGTH_SCALE)),
            "duty": (K, np.ones(W)),
            "steps": (1, np.full(len(self.schedule), 1.0 / (K * cooling_rate))),
            "end": (1, np.append(place_scales[:-1], angle_scales[: τ - 1])),
            "merit": (1, np.array([merit_scale])),
            "direction": (num_slides, np.ones(τ)),
            "advance": (1, np.full(int(self.slides_in_space.sum()), LENGTH_SCALE)),
        }
        indices = {}
        for name, (rows, scales) in sizes.items():
            variables = prog.NewContinuousVariables(rows, len(scales), name)
            first = prog.num_vars() - variables.size
            indices[name] = first + np.arange(variables.size).reshape(variables.shape)
            for row in variables:
                for variable, scale in zip(row, scales, strict=True):
                    prog.SetVariableScaling(variable, float(scale))

        # Keep the indices by which constraints refer to the variables.
        self.y = indices["y"]
        self.heat = indices["heat"]
        self.duty = indices["duty"]
        self.forces = indices["forces"].reshape(K, F, τ + 1)
        self.travel = indices["travel"].reshape(K + 1, F, τ)
        self.steps = indices["steps"][0]
        self.time_steps = self.steps[self.phase_of]  # of each interval (K,)
        self.end = indices["end"][0]
        self.merit = int(indices["merit"][0, 0])
        self.direction = indices["direction"]
        self.advance = indices["advance"][0]

        # Maximize the speed, or minimize the heating per distance.
        sign = -1.0 if self.objective == "speed" else 1.0
        prog.AddLinearCost([sign / merit_scale], 0.0, [self._variable(self.merit)])

    @property
    def _slide_numbers(self) -> np.ndarray:
        """The row of ``direction`` for each interval and foot that slides in space (A,)."""
        intervals, feet = self.slides_in_space.nonzero()
        slides = np.column_stack([self.phase_of[intervals], feet])
        return np.unique(slides, axis=0, return_inverse=True)[1].ravel()

    def _add_bounds(self) -> None:
        """Bound the pose, the heat, the duty, and the lengths of intervals."""
        W = self.wires.num_wires
        B = self.walker.pose_size
        τ = self.walker.num_tangents

        # Bound roll, pitch and joints; the body begins at the origin. A configuration has τ
        # coordinates of the body along the ground, its height, roll and pitch, yaw, and the joints.
        self._bound(self.y[:, τ + 1 : 2 * τ + 1], -MAX_ROLL_AND_PITCH, MAX_ROLL_AND_PITCH)
        angle = MAX_JOINT_ANGLE_IN_SPACE if self.in_space else MAX_JOINT_ANGLE
        self._bound(self.y[:, B:], -angle, angle)
        self._bound(self.y[:1, self._travel_coordinates], 0.0, 0.0)

        # Bound temperatures and readings, with room for feedback.
        limits = self.robot.as_single_limb.temperature_limits
        ambient = self.robot.as_single_limb.ambient_temperature
        self._bound(self.heat[:, :W], ambient, limits.maximum - self.temperature_margin)
        readings = self.heat[:, self.wires.num_states :]
        self._bound(readings, -np.inf, limits.measured_maximum)
        self._leave_room_for_feedback(limits.maximum)

        # Bound duty and total duty.
        self._bound(self.duty, 0.0, 1.0)
        for interval_duty in self.duty:
            self._add_linear(np.ones((1, W)), 0.0, self.robot.total_duty, interval_duty)

        # Bound the lengths of intervals, whose scale is the typical length.
        typical_step = self.prog.GetVariableScaling()[int(self.steps[0])]
        shortest, longest = STEP_RANGE
        self._bound(self.steps, shortest * typical_step, longest * typical_step)

    def _leave_room_for_feedback(self, maximum: float) -> None:
        """Keep T below what `TemperatureLimiter` allows feedback, which distrusts T - V.

        Args:
            maximum: T_max, °C.
        """
        margin = min(MAX_FEEDBACK_MARGIN, self.temperature_margin)
        if not margin:
            return
        lag = lag_error(self.robot.as_single_limb)
        row = np.array([[1 + lag, -lag]]) / HEAT_SCALE
        upper = (maximum - margin) / HEAT_SCALE
        W = self.wires.num_wires
        for knot_heat in self.heat:
            for temperature, reading in zip(knot_heat[:W], knot_heat[-W:], strict=True):
                self._add_linear(row, -np.inf, upper, (temperature, reading))

    @property
    def _travel_coordinates(self) -> list[int]:
        """The coordinates of the body that do not repeat: x, or x, y and yaw."""
        return [0, 1, 5] if self.in_space else [0]

    def _add_course(self) -> None:
        """Constrain the body's travel per period to the course."""
        course = self.course
        stride, *aside_and_yaw = self.end

        # Constrain stride and speed.
        if course.on_the_spot:
            self._bound([stride], 0.0, 0.0)
        elif course.stride is None:
            self._bound([stride], MIN_STRIDE, np.inf)
        else:
            self._bound([stride], course.stride, course.stride)
        if course.speed is not None:
            row = np.append(1.0, -course.speed * np.bincount(self.phase_of))
            self._add_linear(row[None], 0.0, 0.0, [stride, *self.steps], 1.0 / LENGTH_SCALE)
        if not aside_and_yaw:
            return

        # Constrain the turn; the way is along the heading in the middle of the cycle.
        aside, yaw = aside_and_yaw
        if np.isinf(course.turn):
            bounds = sorted(np.sign(course.turn) * np.array([MIN_TURN, MAX_TURN]))
            self._bound([yaw], *bounds)
        else:
            self._bound([yaw], course.turn, course.turn)
        if course.on_the_spot or np.isinf(course.turn):
            self._bound([aside], 0.0, 0.0)
        else:
            heading = 0.5 * course.turn
            row = np.array([[-np.sin(heading), np.cos(heading)]])
            self._add_linear(row, 0.0, 0.0, [stride, aside], 1.0 / LENGTH_SCALE)

    def _add_contacts(self) -> None:
        """Add the linear constraints of contact.

        In a plane, these are all constraints of contact but the end of the travel.
        """
        num_knots, num_feet = self.contacts.shape
        for knot in range(num_knots):
            for foot in range(num_feet):
                self._add_contact_force(knot, foot)
                self._add_foot_travel(knot, foot)
        self._bound(self.advance, 0.0, np.inf)
        self._bound(self.direction, -1.0, 1.0)

    def _add_contact_force(self, knot: int, foot: int) -> None:
        """Constrain the ground's force on a foot at a knot, by the contacts before and after it."""
        force = self.forces[knot, foot]
        contacts = {self.contacts_before[knot, foot], self.contacts[knot, foot]}
        if "swing" in contacts:
            self._bound(force, 0.0, 0.0)
            return
        leans = self.in_space and is_calibrated(self.robot)
        share = MIN_LOAD_SHARE_CALIBRATED if leans else MIN_LOAD_SHARE
        self._bound(force[-1:], share * self.load, np.inf)

        # Friction of a foot that slides in a plane: f_t = -μ f_n u.
        mu = self.walker.friction
        scale = self.walker.num_feet / self.load
        for contact in contacts & SLIDE_SIGNS.keys():
            row = np.array([[1.0, mu * SLIDE_SIGNS[contact]]])
            self._add_linear(row, 0.0, 0.0, force, scale)

        # Friction of a foot that sticks: |f_t| <= c μ f_n. In space it is a cone, not linear.
        if contacts == {"stick"} and np.isfinite(self.sticking_share) and not self.in_space:
            ratio = self.sticking_share * mu
            rows = np.array([[1.0, -ratio], [1.0, ratio]])
            lower = np.array([-np.inf, 0.0])
            upper = np.array([0.0, np.inf])
            self._add_linear(rows, lower, upper, force, scale)

    def _add_foot_travel(self, knot: int, foot: int) -> None:
        """Constrain the travel of a foot in the interval after a knot."""
        contact = self.contacts[knot, foot]
        if contact == "slide":
            return  # along a direction that the program finds
        # The foot of a limb of length L that bends evenly is on the arc z = 2 x² / 3 L. From knot
        # to knot it would dip below the ground if it went further than this.
        scale = 1.0 / LENGTH_SCALE
        max_swing = np.sqrt(1.5 * self.walker.size * SWING_CLEARANCE) * scale
        lower = -max_swing if contact == "swing" else 0.0
        upper = {"stick": 0.0, "swing": max_swing}.get(contact, np.inf)
        row = np.array([[1.0, -1.0]]) * SLIDE_SIGNS.get(contact, 1.0)
        for pair in zip(self.travel[knot + 1, foot], self.travel[knot, foot], strict=True):
            self._add_linear(row, lower, upper, pair, scale)

    def _contact_blocks(self) -> list[ConstraintBlock]:
        """Return the constraints of contact that are not linear."""
        blocks: list[ConstraintBlock] = [self._travel_end_block()]
        if not self.in_space:
            return blocks
        sticks = (self.contacts == "stick") & (self.contacts_before == "stick")
        if np.isfinite(self.sticking_share) and sticks.any():
            blocks.append(self._friction_cone_block(self.forces[sticks]))
        if self.slides_in_space.any():
            blocks += self._slide_blocks()
        if is_calibrated(self.robot):
            blocks.append(self._stance_block())
        return blocks

    def _stance_block(self) -> ConstraintBlock:
        """Return the lower bound on the feet's stiffness against roll and pitch, at all knots.

        K = k Σ p pᵀ is this stiffness (2, 2), N·m, of feet of the stiffness k at places p about
        their mean. Bounded is det K / tr K, which is at most the smaller eigenvalue of K, and at
        least half of it.
        """
        feet = self.walker.symbolic_feet
        places = feet[:2, :] - ca.sum2(feet[:2, :]) / self.walker.num_feet
        K = self.robot.contact_stiffness * places @ places.T
        stiffness = ca.det(K) / ca.trace(K) / (self.load * self.walker.size)
        function = SmoothFunction(stiffness, self.walker.configuration)
        lower = np.full((len(self.y), 1), MIN_STANCE_STIFFNESS)
        return FunctionBlock(function, self.y, bounds=(lower, np.full_like(lower, np.inf)))

    def _travel_end_block(self) -> ConstraintBlock:
        """Return the constraint that each foot ends a stride further, and turned."""
        τ = self.walker.num_tangents
        first = ca.SX.sym("s0", τ)
        last = ca.SX.sym("s1", τ)
        end = ca.SX.sym("end", 2 * τ - 1)
        deviation = last - end[:τ] - _turn_vector(first, end[τ:])
        function = SmoothFunction(deviation, ca.vertcat(first, last, end))
        ends = np.tile(self.end, (self.walker.num_feet, 1))
        points = np.hstack([self.travel[0], self.travel[-1], ends])
        return FunctionBlock(function, points, scales=LENGTH_SCALE)

    def _friction_cone_block(self, forces: np.ndarray) -> ConstraintBlock:
        """Return the friction cone of feet that stick in space.

        Args:
            forces: indices of the ground's forces on these feet (n, 3).
        """
        foot_load = self.load / self.walker.num_feet
        f = ca.SX.sym("f", 3)
        pull = ca.sqrt(ca.dot(f[:2], f[:2]) / foot_load**2 + CONE_ROUNDING**2)
        margin = self.sticking_share * self.walker.friction * f[2] / foot_load - pull
        lower = np.zeros((len(forces), 1))
        upper = np.full((len(forces), 1), np.inf)
        return FunctionBlock(SmoothFunction(margin, f), forces, bounds=(lower, upper))

    def _slide_blocks(self) -> list[ConstraintBlock]:
        """Return the constraints of feet that slide in space: direction, travel and friction."""
        K = len(self.contacts)
        mu = self.walker.friction
        numbers = self._slide_numbers
        intervals, feet = self.slides_in_space.nonzero()
        u = ca.SX.sym("u", 2)

        # The direction u has length 1.
        length = SmoothFunction(ca.dot(u, u) - 1, u)

        # In each interval the foot travels along u.
        first = ca.SX.sym("s0", 2)
        last = ca.SX.sym("s1", 2)
        a = ca.SX.sym("a")
        slip = SmoothFunction(last - first - a * u, ca.vertcat(first, last, a, u))
        travels = [self.travel[intervals, feet], self.travel[intervals + 1, feet]]
        slip_points = np.column_stack([*travels, self.advance, self.direction[numbers]])

        # Friction is along -u at the knots at both ends of the interval, unless the foot swings
        # there. The last interval ends at the first knot, turned.
        ends = np.column_stack([np.append(intervals, intervals + 1), np.tile(feet, 2)])
        knot, foot, number = np.unique(np.column_stack([ends, np.tile(numbers, 2)]), axis=0).T
        swings = (self.contacts == "swing") | (self.contacts_before == "swing")
        loaded = ~swings[knot % K, foot]
        knot = knot[loaded]
        foot = foot[loaded]
        number = number[loaded]
        f = ca.SX.sym("f", 3)
        yaw = ca.SX.sym("yaw")
        friction = SmoothFunction(f[:2] + mu * f[2] * _turn_vector(u, -yaw), ca.vertcat(f, u, yaw))
        turn = np.where(knot == K, self.end[2], self.y[0, 5])
        friction_points = np.column_stack(
            [self.forces[knot % K, foot], self.direction[number], turn]
        )
        return [
            FunctionBlock(length, self.direction),
            FunctionBlock(slip, slip_points, scales=LENGTH_SCALE),
            FunctionBlock(friction, friction_points, scales=self.load / self.walker.num_feet),
        ]

    def _balance_block(self) -> ConstraintBlock:
        """Return `Balance` at all knots: at rest, with the feet's travel, on the ground."""
        walker = self.walker
        F = walker.num_feet
        τ = walker.num_tangents

        # Scale forces, moments, and the travel and height of feet.
        force_scales = np.full(τ + 1, self.load)
        moment_scales = np.full(len(walker.stiffness) - τ - 1, self.load * walker.size)
        foot_scales = np.full((τ + 1) * F, LENGTH_SCALE)
        scales = np.concatenate([force_scales, moment_scales, foot_scales])

        # Put feet on the ground, or clear of it.
        lower, upper = np.zeros((2, len(self.y), len(scales)))
        off_ground = (self.contacts == "swing") & (self.contacts_before == "swing")
        lower[:, -F:] = walker.radius + SWING_CLEARANCE * off_ground
        upper[:, -F:] = np.where(off_ground, np.inf, walker.radius)
        return FunctionBlock(self.balance, self.points, scales=scales, bounds=(lower, upper))

    def _stability_block(self) -> ConstraintBlock:
        """Return `Stability` at all knots."""
        walker = self.walker
        F = walker.num_feet

        # The ground supports a foot in x and z if it does so before and after the knot.
        both = np.stack([self.contacts, self.contacts_before])
        sticks = (both == "stick").all(axis=0)
        is_down = (both != "swing").all(axis=0)
        supported = np.stack([sticks, is_down], axis=-1).astype(float)
        stability = Stability(walker, self.wires, supported)

        # Bound pivots of limbs and body from below, and sensitivities of loads from above.
        lower = np.full((len(self.y), stability.num_values), np.inf)
        upper = np.full_like(lower, np.inf)
        lower[:, -F:] = -np.inf
        upper[:, -F:] = np.inf if self.has_swing else MIN_PIVOT
        lower[:, :-F] = MIN_PIVOT if np.isfinite(self.steadiness) else -np.inf
        pitch = self.steadiness * self.load * walker.size / MIN_BODY_STIFFNESS[-1]
        lower[:, -F - 1] = np.arcsinh(pitch)
        return FunctionBlock(stability, self.points, bounds=(lower, upper))

    def _sliding_block(self) -> ConstraintBlock:
        """Return `FrictionGain` of each foot that slides, in each knot and phase of its slide."""
        K, F = self.contacts.shape
        contacts = np.concatenate([self.contacts, self.contacts_before])
        directions = np.vectorize(SLIDE_SIGNS.get)(contacts, 0.0)
        rows, feet = directions.nonzero()
        supported = np.stack([contacts == "stick", contacts != "swing"], axis=-1).astype(float)
        sliding = self.walker.friction * directions[rows, feet, None] * np.eye(F)[feet]
        gain = FrictionGain(self.walker, self.wires, supported[rows], sliding)
        lower = np.full((len(rows), 1), -np.inf)
        upper = np.full((len(rows), 1), MAX_FRICTION_GAIN)
        return FunctionBlock(gain, self.points[rows % K], bounds=(lower, upper))

    def _heat_block(self) -> ConstraintBlock:
        """Return (17) of the heat around the period; duty is constant in an interval."""
        before = ca.SX.sym("y0", self.heat.shape[1])
        after = ca.SX.sym("y1", self.heat.shape[1])
        duty = ca.SX.sym("D", self.wires.num_wires)
        step = ca.SX.sym("h")
        defects = heat_defects(self.wires, before, duty, after, duty, step)
        function = SmoothFunction(defects, ca.vertcat(before, after, duty, step))
        next_heat = np.roll(self.heat, -1, axis=0)
        points = np.column_stack([self.heat, next_heat, self.duty, self.time_steps])
        return FunctionBlock(function, points, scales=self.wires.heat_scales)

    @property
    def _distance(self) -> tuple[int, float]:
        """The index of the variable that is the distance, and how many m its unit is."""
        if self.course.on_the_spot or np.isinf(self.course.turn):
            return int(self.end[2]), float(np.copysign(self.walker.size, self.course.turn))
        return int(self.end[0]), 1.0

    def _merit_block(self) -> ConstraintBlock:
        """Return the definition of the merit m, by the distance S: S = m Σ h, or m S = Σ h D."""
        index, metres = self._distance
        travel = ca.SX.sym("S")
        merit = ca.SX.sym("m")
        steps = ca.SX.sym("h", len(self.steps))
        duty = ca.SX.sym("D", *self.duty.shape)
        interval_steps = steps[self.phase_of.tolist()]
        distance = metres * travel
        if self.objective == "speed":
            defect = distance - merit * ca.sum(interval_steps)
            scale = LENGTH_SCALE
        else:
            defect = merit * distance - ca.sum(ca.sum(duty, 1) * interval_steps)
            scale = 10.0
        function = SmoothFunction(defect, ca.vertcat(travel, merit, steps, ca.vec(duty)))
        point = np.concatenate([[index, self.merit], self.steps, self.duty.T.ravel()])
        return FunctionBlock(function, point[None], scales=scale)

    @property
    def points(self) -> np.ndarray:
        """Indices of the points of `Balance` (K, P)."""
        states = self.heat[:, : self.wires.num_states]
        parts = [self.y, states, self.forces, self.travel[:-1]]
        return np.hstack([part.reshape(len(self.y), -1) for part in parts])

    def complete(
        self, x: np.ndarray, steps: np.ndarray, end: np.ndarray | None = None
    ) -> np.ndarray:
        """Fill in travel, time and merit of x, which follow from the other decision variables.

        Args:
            x: all decision variables, which are changed.
            steps: lengths of the intervals (K,), s, equal within a phase.
            end: the body's travel per period, as the variables ``end``: forward, sideways, m, and
                turn, rad. If None, the travel of the course, or a little where it has none.
        """
        τ = self.walker.num_tangents

        # Choose the travel of the body if none is given; an infinite turn is as far as it comes.
        if end is None:
            course = self.course
            turn = np.copysign(MIN_TURN, course.turn) if np.isinf(course.turn) else course.turn
            stride = course.stride or (0.0 if course.on_the_spot else MIN_STRIDE)
            sideways = stride * np.tan(turn / 2)  # at the end of an arc
            end = np.array([stride, sideways, turn])[: len(self.end)]
        x[self.end] = end
        x[self.time_steps] = steps

        # Take the places of the feet (K, F, τ) from the configuration; a period later they stand
        # turned and moved with the body.
        places = self.walker.feet(x[self.y])[..., :-1]
        turned = rotate_to_heading(places[0].T, -end[2]).T if self.in_space else places[0]
        last = end[:τ] + turned
        x[self.travel] = np.concatenate([places, last[None]])

        # Each foot that slides in space does so along its mean direction.
        intervals, feet = self.slides_in_space.nonzero()
        slid = x[self.travel[intervals + 1, feet]] - x[self.travel[intervals, feet]]
        for number in range(len(self.direction)):
            is_in_slide = self._slide_numbers == number
            foot = feet[is_in_slide][0]
            path = slid[is_in_slide].sum(axis=0)
            if np.linalg.norm(path) < MIN_SLIP:  # too short to have a direction
                path = last[foot] - places[0, foot]
            x[self.direction[number]] = path / np.linalg.norm(path)
        directions = x[self.direction[self._slide_numbers]]
        x[self.advance] = (directions * slid).sum(axis=1).clip(min=0.0)

        # Compute the merit: speed, or heating per distance, a variable times metres per unit of it.
        index, metres = self._distance
        distance = metres * x[index]
        heating = (x[self.duty] * steps[:, None]).sum()
        x[self.merit] = distance / steps.sum() if self.objective == "speed" else heating / distance
        return x

    def gait(self, x: np.ndarray, check: GaitCheck) -> Gait:
        """Return the gait that all decision variables describe."""
        B = self.walker.pose_size
        N = self.wires.num_states

        # The last knot is the first one again, a stride further.
        around = np.arange(len(self.y) + 1) % len(self.y)
        steps = x[self.time_steps]
        time = np.append(0.0, np.cumsum(steps))
        heat = x[self.heat[around]].T
        y = x[self.y[around]].T
        y[self._travel_coordinates, -1] = x[self.end]

        # Rates at a knot are the mean of the slopes before and after it.
        slopes = np.diff(y[B:]) / steps
        rates = 0.5 * (slopes + np.roll(slopes, 1, axis=1))[:, around]
        starts = np.flatnonzero(np.diff(self.phase_of, prepend=-1))
        return Gait(
            time=time,
            duty=np.clip(x[self.duty[around]].T, 0.0, 1.0),
            joint_state=np.vstack([y[B:], rates]),
            **self.wires.signals(heat[:N]),
            measured_temperature=heat[N:],
            body_pose=y[:B],
            contact_force=x[self.forces[around]].reshape(len(around), -1).T,
            robot=self.robot,
            phases=[
                GaitPhase(float(time[start]), list(contacts))
                for start, contacts in zip(starts, self.schedule, strict=True)
            ],
            check=check,
            provenance=Provenance.now(self.robot.as_single_limb),
        )

    def has_stable_friction(self, x: np.ndarray) -> bool:
        """Return whether the `FrictionGain` of each foot that slides is small enough."""
        return self.sliding is None or bool((self.sliding.evaluate(x) <= self.sliding.upper).all())

    def violation(self, x: np.ndarray) -> float:
        """Return the largest violation of constraints and bounds, scaled."""
        violations = [0.0]
        for block in self.blocks:
            values = block.evaluate(x)
            violations += [(block.lower - values).max(), (values - block.upper).max()]
        for binding in self.prog.GetAllConstraints():
            evaluator = binding.evaluator()
            values = self.prog.EvalBinding(binding, x)
            violations += [(evaluator.lower_bound() - values).max()]
            violations += [(values - evaluator.upper_bound()).max()]
        return float(max(violations))

    def _variable(self, index):
        return self.prog.decision_variable(int(index))

    def _bound(self, indices, lower, upper) -> None:
        """Bound the variables of some indices."""
        variables = np.array(list(map(self._variable, np.ravel(indices))))
        self.prog.AddBoundingBoxConstraint(lower, upper, variables)

    def _add_linear(self, rows, lower, upper, indices, scale: float = 1.0) -> None:
        """Bound scale · rows · x, with x the variables of some indices."""
        ones = np.ones(len(rows))
        variables = list(map(self._variable, indices))
        self.prog.AddLinearConstraint(scale * rows, lower * ones, upper * ones, variables)


def _turn_vector(vector: ca.SX, yaw: ca.SX) -> ca.SX:
    """Return a vector along the ground (τ,) turned by a yaw, rad; in a plane there is none (0,)."""
    return rotation(2, yaw)[:2, :2] @ vector if yaw.numel() else vector
