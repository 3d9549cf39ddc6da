"""The program of a gait: a periodic motion of heat, body, limbs and feet on the ground.

K knots are on a ring: the last interval ends at the first knot, a stride further, and turned. At
each knot are the configuration y, the heat [x, V] of the wires, the forces λ of the ground and the
travel s of the feet; in each interval, between knots, are the duty and the contacts; each phase has
a duration of its own. What is held:

- the balance of forces, as `Balance`, and in a plane the stability of `Stability`, at every knot;
- (17) of the heat, in every interval, as `heat_defects`;
- a foot on the ground is at z = r - f_n / ρ, or in a plane at z = r if any foot swings, and carries
  a least share of the load; one that sticks does not travel, and has ``|f_t| <= 0.8 μ f_n``; one
  that slides travels along one direction u in each phase, and has f_t = -μ f_n u; one that swings
  carries nothing, is 1 mm clear of the ground at knots inside of its phase, and travels so little
  in an interval that it is clear in between;
- (19), 0 <= D <= 1 and the total duty; and, with a margin of temperature, that T and what
  feedback takes for a possible error of it, a share of T - V, are 3 °C below T_max.

A knot between two phases belongs to both. Where a foot begins to slide or ceases to, friction is
what slides, as friction does not jump: the share of μ counts at knots inside of a phase.

A gait in the vertical plane has one direction along the ground, x, in which u is 1 or -1. In space
there are two, and u is what the program finds, but for its length.
"""

from collections.abc import Sequence
from typing import Literal

import casadi as ca
import numpy as np
from pydrake.solvers import MathematicalProgram

from controllers.temperature_supervisor import lag_error
from limb_systems import LimbModel, Provenance
from limb_systems.segment_chain import rotation
from limb_systems.smooth_function import SmoothFunction
from planners.transcription.collocation import ANGLE_SCALE, heat_defects
from planners.transcription.function_block import FunctionBlock
from planners.transcription.ipopt import ConstraintBlock
from walking.course import LEAST_TURN, MOST_TURN, Course
from walking.gait import Gait, GaitCheck, GaitPhase, along_heading
from walking.robot_parameters import RobotParameters
from walking.standing import (
    LEAST_PIVOT,
    LEAST_STIFFNESS,
    FrictionGain,
    Stability,
    balance_of,
)
from walking.walker import Walker

SLIDES = {"slide_forward": 1.0, "slide_backward": -1.0}

LEAST_LOAD = 0.05  # of the weight, on each foot on the ground
LEAST_SLIP = 1e-6  # m; feet that slip less have no direction
CLEARANCE = 1e-3  # m, of feet that swing; feet on the ground sink in by 0.03 mm
MOST_GAIN = 0.5  # of friction on itself, with which errors of loads grow twofold
ROUNDED = 1e-3  # of a foot's load, by which the cone of friction is blunt
STICKING_SHARE = 0.8  # of μ, that feet that stick may use
# Of weight x limb length, the least stiffness against pitch. Robots whose limbs pull 10% more and
# less than planned tip over with less, open loop; with more they walk more slowly.
STEADINESS = 25.0
# Calibrated limbs are known better, and are driven by feedback: what they need to hold their feet
# apart, heat of both wires of a limb, then is better kept for the stride.
STEADINESS_CALIBRATED = 12.5
FEEDBACK_ROOM = 3.0  # °C, of a margin, for what estimates of T may be off
LENGTH_SCALE, HEAT_SCALE = 0.01, 50.0  # m and °C, a typical travel and warmth
LEAST_STRIDE = 1e-3  # m; below, there is no gait to speak of
STEPS = 0.1, 10.0  # of intervals, as shares of the time constant of cooling over their number
# rad, of roll and pitch and of each joint: bounds that gaits do not reach keep iterates sane.
MOST_PITCH, MOST_ANGLE = 0.5, 0.8
# Limbs that stand in space on soft links find more than one balance farther on.
MOST_ANGLE_IN_SPACE = 0.2


def usual_steadiness(robot: RobotParameters) -> float:
    """25, or 12.5 for a robot of which all limbs are calibrated."""
    calibrated = all(limb.parameters.calibration for limb in robot.limbs)
    return STEADINESS_CALIBRATED if calibrated else STEADINESS


class GaitProgram:
    """Program of one schedule of contacts.

    - ``prog``: the `MathematicalProgram`, with all that is linear.
    - ``blocks``: all other constraints.
    - ``sliding``: `FrictionGain` of feet that slide, which is not among them at first; None in
      space.
    - ``y``, ``heat``, ``forces``, ``duty``: indices of the configuration (K, d), of [x, V] (K, M),
      of λ (K, F, τ + 1) and the duty of the interval after the knot (K, W) among the decision
      variables.
    - ``travel``: indices of s (K + 1, F, τ).
    - ``direction``, ``advance``: indices of u of each foot and phase in which a foot slides in
      space (S, 2), and of how far it does in each interval of these (A,).
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
        begins_as: a gait of the same robot, with whose heat it begins; with its own if None.
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
        self.robot, self.schedule, self.objective = robot, schedule, objective
        self.temperature_margin, self.course = temperature_margin, course or Course()
        self.sticking_share, self.steadiness = sticking_share, steadiness
        self.walker, self.wires = Walker(robot), LimbModel.of(robot.as_single_limb).wires
        self.phase_of = np.repeat(np.arange(len(schedule)), intervals)
        self.contacts = np.array(schedule)[self.phase_of]  # in each interval (K, F)
        self.before = np.roll(self.contacts, 1, axis=0)
        self.slides = self.contacts == "slide"
        self.in_space = self.walker.num_tangents == 2
        self.load = float(np.linalg.norm(self.walker.weight))
        self._add_variables()
        self._add_bounds()
        self._add_course()
        self.begins_as = begins_as
        if begins_as:
            states = begins_as.wire_states[:, 0]
            self._bound(self.heat[0, : len(states)], states, states)
        self._add_contacts()
        # Feet that swing come down on loads that pivots do not know to micrometres.
        self.lifts = bool((self.contacts == "swing").any())
        self.balance = balance_of(
            self.walker, self.wires, ground_gives=self.in_space or not self.lifts
        )
        self.blocks: list[ConstraintBlock] = [
            self._balance_block(),
            *([] if self.in_space else [self._stability_block()]),
            self._heat_block(),
            self._merit_block(),
            *self._contact_blocks(),
        ]
        self.sliding = None if self.in_space else self._sliding_block()

    def _add_variables(self) -> None:
        prog = self.prog = MathematicalProgram()
        K, walker, wires = len(self.phase_of), self.walker, self.wires
        F, W, τ = walker.num_feet, wires.num_wires, walker.num_tangents
        cooling = -np.diag(wires.affine_rates()[0])[:W].mean()
        joints = np.full(len(walker.stiffness) - walker.pose_size, ANGLE_SCALE)
        places, angles = np.full(τ + 1, LENGTH_SCALE), np.full(2 * τ - 1, ANGLE_SCALE)
        merit = 1e-3 if self.objective == "speed" else 1e3
        num_slides = len(np.unique(self._slide_numbers))
        sizes = {
            "y": (K, np.concatenate([places, angles, joints])),
            "heat": (K, wires.heat_scales),
            "forces": (K, np.full((τ + 1) * F, self.load / F)),
            "travel": (K + 1, np.full(τ * F, LENGTH_SCALE)),
            "duty": (K, np.ones(W)),
            "steps": (1, np.full(len(self.schedule), 1.0 / (K * cooling))),
            "end": (1, np.append(places[:-1], angles[: τ - 1])),
            "merit": (1, np.array([merit])),
            "direction": (num_slides, np.ones(τ)),
            "advance": (1, np.full(int(self.slides.sum()), LENGTH_SCALE)),
        }
        indices = {}
        for name, (rows, scales) in sizes.items():
            variables = prog.NewContinuousVariables(rows, len(scales), name)
            first = prog.num_vars() - variables.size
            indices[name] = first + np.arange(variables.size).reshape(variables.shape)
            for of_row in variables:
                for variable, scale in zip(of_row, scales, strict=True):
                    prog.SetVariableScaling(variable, float(scale))
        self.y, self.heat, self.duty = indices["y"], indices["heat"], indices["duty"]
        self.forces = indices["forces"].reshape(K, F, τ + 1)
        self.travel = indices["travel"].reshape(K + 1, F, τ)
        self.steps, self.end = indices["steps"][0], indices["end"][0]
        self.merit = int(indices["merit"][0, 0])
        self.direction, self.advance = indices["direction"], indices["advance"][0]
        self.time_steps = self.steps[self.phase_of]  # of each interval (K,)
        sign = -1.0 if self.objective == "speed" else 1.0
        prog.AddLinearCost([sign / merit], 0.0, [self._variable(self.merit)])

    @property
    def _slide_numbers(self) -> np.ndarray:
        """The number of the direction in which each foot that slides does (A,), by interval."""
        phases, feet = self.phase_of[self.slides.nonzero()[0]], self.slides.nonzero()[1]
        return np.unique(np.column_stack([phases, feet]), axis=0, return_inverse=True)[1].ravel()

    def _add_bounds(self) -> None:
        W, limits = self.wires.num_wires, self.robot.as_single_limb.temperature_limits
        B, τ = self.walker.pose_size, self.walker.num_tangents
        self._bound(self.y[:, τ + 1 : 2 * τ + 1], -MOST_PITCH, MOST_PITCH)
        angle = MOST_ANGLE_IN_SPACE if self.in_space else MOST_ANGLE
        self._bound(self.y[:, B:], -angle, angle)
        self._bound(self.y[:1, self._travels], 0.0, 0.0)
        ambient = self.robot.as_single_limb.ambient_temperature
        self._bound(self.heat[:, :W], ambient, limits.maximum - self.temperature_margin)
        readings = self.heat[:, self.wires.num_states :]
        self._bound(readings, -np.inf, limits.measured_maximum)
        self._leave_room_for_feedback(limits.maximum)
        self._bound(self.duty, 0.0, 1.0)
        typical = self.prog.GetVariableScaling()[int(self.steps[0])]
        self._bound(self.steps, *(share * typical for share in STEPS))
        for of_interval in self.duty:
            self._add_linear(np.ones((1, W)), 0.0, self.robot.total_duty, of_interval)

    def _leave_room_for_feedback(self, highest: float) -> None:
        """Keep T where `TemperatureLimiter`, which distrusts T - V, lets feedback hold it, °C."""
        lag, W = lag_error(self.robot.as_single_limb), self.wires.num_wires
        room = min(FEEDBACK_ROOM, self.temperature_margin)
        if not room:
            return
        row = np.array([[1 + lag, -lag]]) / HEAT_SCALE
        most = (highest - room) / HEAT_SCALE
        for of_knot in self.heat:
            for pair in zip(of_knot[:W], of_knot[-W:], strict=True):
                self._add_linear(row, -np.inf, most, pair)

    @property
    def _travels(self) -> list[int]:
        """The coordinates of the body that do not repeat: x, or x, y and yaw."""
        return [0, 1, 5] if self.in_space else [0]

    def _add_course(self) -> None:
        course, (stride, *others) = self.course, self.end
        if course.on_the_spot:
            self._bound([stride], 0.0, 0.0)
        elif course.stride is None:
            self._bound([stride], LEAST_STRIDE, np.inf)
        else:
            self._bound([stride], course.stride, course.stride)
        if course.speed is not None:
            row = np.append(1.0, -course.speed * np.bincount(self.phase_of))
            self._add_linear(row[None], 0.0, 0.0, [stride, *self.steps], 1.0 / LENGTH_SCALE)
        if not others:
            return
        aside, yaw = others
        if np.isinf(course.turn):
            bounds = sorted(np.sign(course.turn) * np.array([LEAST_TURN, MOST_TURN]))
            self._bound([yaw], *bounds)
        else:
            self._bound([yaw], course.turn, course.turn)
        if course.on_the_spot or np.isinf(course.turn):
            self._bound([aside], 0.0, 0.0)
        else:
            half = 0.5 * course.turn
            row = np.array([[-np.sin(half), np.cos(half)]])
            self._add_linear(row, 0.0, 0.0, [stride, aside], 1.0 / LENGTH_SCALE)

    def _add_contacts(self) -> None:
        """All that is linear of what feet do; in a plane it is all but the end of the travel."""
        K, F = self.contacts.shape
        mu, to_load, to_travel = self.walker.friction, F / self.load, 1.0 / LENGTH_SCALE
        # The foot of a limb of length L that bends evenly is on the arc z = 2 x² / 3 L. From knot
        # to knot it would dip below the ground if it went further than this.
        furthest = np.sqrt(1.5 * self.walker.size * CLEARANCE) * to_travel
        for k in range(K):
            for foot in range(F):
                force, contact = self.forces[k, foot], self.contacts[k, foot]
                contacts = {self.before[k, foot], contact}
                if "swing" in contacts:
                    self._bound(force, 0.0, 0.0)
                else:
                    self._bound(force[-1:], LEAST_LOAD * self.load, np.inf)
                    for slides in contacts & SLIDES.keys():
                        row = np.array([[1.0, mu * SLIDES[slides]]])
                        self._add_linear(row, 0.0, 0.0, force, to_load)
                    if (
                        contacts == {"stick"}
                        and np.isfinite(self.sticking_share)
                        and not self.in_space
                    ):
                        most = self.sticking_share * mu
                        rows, upper = np.array([[1.0, -most], [1.0, most]]), np.array([0.0, np.inf])
                        self._add_linear(rows, -upper[::-1], upper, force, to_load)
                if contact == "slide":
                    continue
                least = -furthest if contact == "swing" else 0.0
                most = {"stick": 0.0, "swing": furthest}.get(contact, np.inf)
                row = np.array([[1.0, -1.0]]) * SLIDES.get(contact, 1.0)
                for pair in zip(self.travel[k + 1, foot], self.travel[k, foot], strict=True):
                    self._add_linear(row, least, most, pair, to_travel)
        self._bound(self.advance, 0.0, np.inf)
        self._bound(self.direction, -1.0, 1.0)

    def _contact_blocks(self) -> list[ConstraintBlock]:
        """What is not linear of what feet do: where they end; in space how they stick and slide."""
        τ, F, K = self.walker.num_tangents, self.walker.num_feet, len(self.contacts)
        first, last, end = ca.SX.sym("s0", τ), ca.SX.sym("s1", τ), ca.SX.sym("end", 2 * τ - 1)
        carried = last - end[:τ] - _turned(first, end[τ:])
        goes_on = SmoothFunction(carried, ca.vertcat(first, last, end))
        points = np.hstack([self.travel[0], self.travel[-1], np.tile(self.end, (F, 1))])
        blocks: list[ConstraintBlock] = [FunctionBlock(goes_on, points, scales=LENGTH_SCALE)]
        if not self.in_space:
            return blocks
        mu, unit = self.walker.friction, self.load / F
        u, f, yaw, a = ca.SX.sym("u", 2), ca.SX.sym("f", 3), ca.SX.sym("yaw"), ca.SX.sym("a")
        sticks = self.forces[(self.contacts == "stick") & (self.before == "stick")]
        if np.isfinite(self.sticking_share) and len(sticks):
            pull = ca.sqrt(ca.dot(f[:2], f[:2]) / unit**2 + ROUNDED**2)
            cone = SmoothFunction(self.sticking_share * mu * f[2] / unit - pull, f)
            bounds = np.zeros((len(sticks), 1)), np.full((len(sticks), 1), np.inf)
            blocks.append(FunctionBlock(cone, sticks, bounds=bounds))
        numbers, (intervals, feet) = self._slide_numbers, self.slides.nonzero()
        if not len(numbers):
            return blocks
        length = SmoothFunction(ca.dot(u, u) - 1, u)
        slips = SmoothFunction(last - first - a * u, ca.vertcat(first, last, a, u))
        ways = [self.travel[intervals, feet], self.travel[intervals + 1, feet]]
        points = np.column_stack([*ways, self.advance, self.direction[numbers]])
        # At the knots at both ends of the interval; the last one ends at the first knot, turned.
        ends = np.column_stack([np.append(intervals, intervals + 1), np.tile(feet, 2)])
        knot, foot, number = np.unique(np.column_stack([ends, np.tile(numbers, 2)]), axis=0).T
        loaded = ~self._swings[knot % K, foot]
        knot, foot, number = knot[loaded], foot[loaded], number[loaded]
        turn = np.where(knot == K, self.end[2], self.y[0, 5])
        pulls = SmoothFunction(f[:2] + mu * f[2] * _turned(u, -yaw), ca.vertcat(f, u, yaw))
        forces = np.column_stack([self.forces[knot % K, foot], self.direction[number], turn])
        return [
            *blocks,
            FunctionBlock(length, self.direction),
            FunctionBlock(slips, points, scales=LENGTH_SCALE),
            FunctionBlock(pulls, forces, scales=unit),
        ]

    @property
    def _swings(self) -> np.ndarray:
        """Where a foot swings before or after a knot (K, F)."""
        return (self.contacts == "swing") | (self.before == "swing")

    def _balance_block(self) -> ConstraintBlock:
        """`Balance` at all knots: at rest, with the feet's travel, on the ground."""
        walker, load = self.walker, self.load
        d, F, τ = len(walker.stiffness), walker.num_feet, walker.num_tangents
        forces, moments = np.full(τ + 1, load), np.full(d - τ - 1, load * walker.size)
        scales = np.concatenate([forces, moments, np.full((τ + 1) * F, LENGTH_SCALE)])
        lower, upper = np.zeros((2, len(self.y), len(scales)))
        off_ground = (self.contacts == "swing") & (self.before == "swing")
        lower[:, -F:] = walker.radius + CLEARANCE * off_ground
        upper[:, -F:] = np.where(off_ground, np.inf, walker.radius)
        return FunctionBlock(self.balance, self.points, scales=scales, bounds=(lower, upper))

    def _stability_block(self) -> ConstraintBlock:
        """`Stability` at all knots."""
        walker, load, both = self.walker, self.load, (self.contacts, self.before)
        down = np.all([of != "swing" for of in both], axis=0)
        stuck = np.all([of == "stick" for of in both], axis=0)
        held = np.stack([stuck, down], axis=-1).astype(float)
        stability, F = Stability(walker, self.wires, held), walker.num_feet
        lower, upper = np.full((2, len(self.y), stability.num_values), np.inf)
        lower[:, -F:], upper[:, -F:] = -np.inf, np.inf if self.lifts else LEAST_PIVOT
        lower[:, :-F] = LEAST_PIVOT if np.isfinite(self.steadiness) else -np.inf
        pitch = self.steadiness * load * walker.size / LEAST_STIFFNESS[-1]
        lower[:, -F - 1] = np.arcsinh(pitch)
        return FunctionBlock(stability, self.points, bounds=(lower, upper))

    def _sliding_block(self) -> ConstraintBlock:
        """`FrictionGain` of each foot that slides, in each knot and phase that it is part of."""
        K, F = self.contacts.shape
        contacts = np.concatenate([self.contacts, self.before])
        directions = np.vectorize(SLIDES.get)(contacts, 0.0)
        rows, feet = directions.nonzero()
        held = np.stack([contacts == "stick", contacts != "swing"], axis=-1).astype(float)
        sliding = self.walker.friction * directions[rows, feet, None] * np.eye(F)[feet]
        gain = FrictionGain(self.walker, self.wires, held[rows], sliding)
        lower, upper = np.full((len(rows), 1), -np.inf), np.full((len(rows), 1), MOST_GAIN)
        return FunctionBlock(gain, self.points[rows % K], bounds=(lower, upper))

    def _heat_block(self) -> ConstraintBlock:
        """(17) of the heat around the period, with duty held over intervals of free length."""
        before, after = (ca.SX.sym(name, self.heat.shape[1]) for name in ("y0", "y1"))
        duty, step = ca.SX.sym("D", self.wires.num_wires), ca.SX.sym("h")
        defects = heat_defects(self.wires, before, duty, after, duty, step)
        function = SmoothFunction(defects, ca.vertcat(before, after, duty, step))
        around = np.roll(self.heat, -1, axis=0)
        points = np.column_stack([self.heat, around, self.duty, self.time_steps])
        return FunctionBlock(function, points, scales=self.wires.heat_scales)

    @property
    def _distance(self) -> tuple[int, float]:
        """What counts as distance: its index, and how many m it is."""
        if self.course.on_the_spot or np.isinf(self.course.turn):
            return int(self.end[2]), float(np.copysign(self.walker.size, self.course.turn))
        return int(self.end[0]), 1.0

    def _merit_block(self) -> ConstraintBlock:
        """The objective m, by the distance S: S = m Σ h, or m S = Σ h D."""
        (index, metres), goes, merit = self._distance, ca.SX.sym("S"), ca.SX.sym("m")
        steps, duty = ca.SX.sym("h", len(self.steps)), ca.SX.sym("D", *self.duty.shape)
        of_intervals, distance = steps[self.phase_of.tolist()], metres * goes
        if self.objective == "speed":
            missed, scale = distance - merit * ca.sum(of_intervals), LENGTH_SCALE
        else:
            missed, scale = merit * distance - ca.sum(ca.sum(duty, 1) * of_intervals), 10.0
        function = SmoothFunction(missed, ca.vertcat(goes, merit, steps, ca.vec(duty)))
        point = np.concatenate([[index, self.merit], self.steps, self.duty.T.ravel()])
        return FunctionBlock(function, point[None], scales=scale)

    @property
    def points(self) -> np.ndarray:
        """Indices of the points of `Balance` (K, P)."""
        parts = self.y, self.heat[:, : self.wires.num_states], self.forces, self.travel[:-1]
        return np.hstack([part.reshape(len(self.y), -1) for part in parts])

    def complete(
        self, x: np.ndarray, steps: np.ndarray, end: np.ndarray | None = None
    ) -> np.ndarray:
        """Fill in travel, time and merit, which follow from the other decision variables.

        Args:
            steps: lengths of the intervals (K,), s, equal within a phase.
            end: the body's travel per period, as the variables ``end``; little of it if None.
        """
        τ, course = self.walker.num_tangents, self.course
        if end is None:
            turn = np.copysign(LEAST_TURN, course.turn) if np.isinf(course.turn) else course.turn
            stride = course.stride or (0.0 if course.on_the_spot else LEAST_STRIDE)
            end = np.array([stride, stride * np.tan(turn / 2), turn])[: len(self.end)]
        x[self.end], x[self.time_steps] = end, steps
        travel = self.walker.feet(x[self.y])[..., :-1]
        carried = along_heading(travel[0].T, -end[2]).T if self.in_space else travel[0]
        last = end[:τ] + carried
        x[self.travel] = np.concatenate([travel, last[None]])
        intervals, feet = self.slides.nonzero()
        slid = x[self.travel[intervals + 1, feet]] - x[self.travel[intervals, feet]]
        for number in range(len(self.direction)):
            of_slide = self._slide_numbers == number
            foot = feet[of_slide][0]
            way = slid[of_slide].sum(axis=0)
            if np.linalg.norm(way) < LEAST_SLIP:
                way = last[foot] - travel[0, foot]
            x[self.direction[number]] = way / np.linalg.norm(way)
        along = x[self.direction[self._slide_numbers]]
        x[self.advance] = (along * slid).sum(axis=1).clip(min=0.0)
        index, metres = self._distance
        distance, used = metres * x[index], (x[self.duty] * steps[:, None]).sum()
        x[self.merit] = distance / steps.sum() if self.objective == "speed" else used / distance
        return x

    def gait(self, x: np.ndarray, check: GaitCheck) -> Gait:
        """The gait that all decision variables describe."""
        around = np.arange(len(self.y) + 1) % len(self.y)
        steps, N = x[self.time_steps], self.wires.num_states
        time = np.append(0.0, np.cumsum(steps))
        y, heat = x[self.y[around]].T, x[self.heat[around]].T
        y[self._travels, -1] = x[self.end]
        B = self.walker.pose_size
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

    def slides_evenly(self, x: np.ndarray) -> bool:
        """Whether the friction of no foot that slides acts on itself too much."""
        return self.sliding is None or bool((self.sliding.evaluate(x) <= self.sliding.upper).all())

    def violation(self, x: np.ndarray) -> float:
        """The largest violation of constraints and bounds, scaled."""
        violations = [0.0]
        for block in self.blocks:
            values = block.evaluate(x)
            violations += [(block.lower - values).max(), (values - block.upper).max()]
        for binding in self.prog.GetAllConstraints():
            evaluator, values = binding.evaluator(), self.prog.EvalBinding(binding, x)
            violations += [(evaluator.lower_bound() - values).max()]
            violations += [(values - evaluator.upper_bound()).max()]
        return float(max(violations))

    def _variable(self, index):
        return self.prog.decision_variable(int(index))

    def _bound(self, indices, lower, upper) -> None:
        variables = np.array([self._variable(index) for index in np.ravel(indices)])
        self.prog.AddBoundingBoxConstraint(lower, upper, variables)

    def _add_linear(self, rows, lower, upper, indices, scale: float = 1.0) -> None:
        ones = np.ones(len(rows))
        variables = [self._variable(index) for index in indices]
        self.prog.AddLinearConstraint(scale * rows, lower * ones, upper * ones, variables)


def _turned(vector: ca.SX, yaw: ca.SX) -> ca.SX:
    """A vector along the ground (τ,), turned; in a plane there is no yaw (0,)."""
    return rotation(2, yaw)[:2, :2] @ vector if yaw.numel() else vector
