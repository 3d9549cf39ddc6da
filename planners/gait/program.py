"""The program of a gait: a periodic motion of heat, body, limbs and feet on the ground.

K knots are on a ring: the last interval ends at the first knot, a stride further. At each knot
are the configuration y, the heat [x, V] of the wires, the forces λ of the ground and the travel s
of the feet; in each interval, between knots, are the duty and the contacts; each phase has a
duration of its own. What is held:

- the balance of forces and the stability of `Standing`, at every knot;
- (17) of the heat, in every interval, as `heat_defects`;
- a foot on the ground is at z = r - f_n / ρ, or at z = r if any foot swings, and carries a least
  share of the load; one that sticks does not travel, and has ``|f_t| <= 0.8 μ f_n``; one that
  slides travels one way only, and has f_t = -μ f_n against it; one that swings carries nothing, is
  1 mm clear of the ground at knots inside of its phase, and travels so little in an interval that
  it is clear in between;
- (19), 0 <= D <= 1 and the total duty.

A knot between two phases belongs to both. Where a foot begins to slide or ceases to, friction is
what slides, as friction does not jump: the share of μ counts at knots inside of a phase.
"""

from collections.abc import Sequence
from typing import Literal

import casadi as ca
import numpy as np
from pydrake.solvers import MathematicalProgram

from limb_systems import Gait, GaitCheck, GaitPhase, Provenance, RobotParameters, Wires
from limb_systems.model.smooth_function import SmoothFunction
from planners.gait.planar_robot import POSE, PlanarRobot
from planners.gait.standing import LEAST_PIVOT, LEAST_STIFFNESS, FrictionGain, Standing
from planners.transcription.collocation import ANGLE_SCALE, heat_defects
from planners.transcription.function_block import FunctionBlock
from planners.transcription.ipopt import ConstraintBlock

SLIDES = {"slide_forward": 1.0, "slide_backward": -1.0}

LEAST_LOAD = 0.05  # of the weight, on each foot on the ground
CLEARANCE = 1e-3  # m, of feet that swing; feet on the ground sink in by 0.03 mm
MOST_GAIN = 0.5  # of friction on itself, with which errors of loads grow twofold
STICKING_SHARE = 0.8  # of μ, that feet that stick may use
# Of weight x limb length, the least stiffness against pitch. Robots whose limbs pull 10% more and
# less than planned tip over with less, open loop; with more they walk more slowly.
STEADINESS = 25.0
# Calibrated limbs are known better, and are driven by feedback: what they need to hold their feet
# apart, heat of both wires of a limb, then is better kept for the stride.
STEADINESS_CALIBRATED = 12.5
LENGTH_SCALE = 0.01  # m, a typical travel
LEAST_STRIDE = 1e-3  # m; below, there is no gait to speak of
STEPS = 0.1, 10.0  # of intervals, as shares of the time constant of cooling over their number
# rad, of the body and of each joint: bounds that gaits do not reach keep iterates sane.
MOST_PITCH, MOST_TURN = 0.5, 0.8


def usual_steadiness(robot: RobotParameters) -> float:
    """25, or 12.5 for a robot of which all limbs are calibrated."""
    calibrated = all(limb.parameters.calibration for limb in robot.limbs)
    return STEADINESS_CALIBRATED if calibrated else STEADINESS


class GaitProgram:
    """Program of one schedule of contacts.

    - ``prog``: the `MathematicalProgram`, with all that is linear.
    - ``blocks``: all other constraints.
    - ``sliding``: `FrictionGain` of feet that slide, which is not among them at first.
    - ``y``, ``heat``, ``forces``, ``travel``, ``duty``: indices of the configuration (K, d), of
      [x, V] (K, M), of λ (K, 2F), s (K, F) and the duty of the interval after the knot (K, W)
      among the decision variables.
    - ``steps``: indices of the lengths of the intervals of each phase (P,), s.
    - ``stride``, ``merit``: indices of the travel per period, m, and the objective: speed, m/s, or
      heating per distance, s of full duty of one wire per m.
    - ``phase_of``: phase of each interval (K,).
    - ``temperature_margin``, ``sticking_share``, ``steadiness``: as given.

    Args:
        robot: description of the robot, on a planar body.
        schedule: contact of each foot, for each phase (P, F).
        intervals: number of intervals of each phase (P,).
        objective: "speed" or "energy".
        temperature_margin: how far T stays below T_max, °C.
        sticking_share: share of μ that feet that stick may use.
        clearance: height of feet that swing, m.
        steadiness: the least stiffness against pitch, the last pivot of `Standing`, as a multiple
            of weight times limb length; no pivot is bounded if it is -inf.
    """

    def __init__(
        self,
        robot: RobotParameters,
        schedule: Sequence[Sequence[str]],
        intervals: Sequence[int],
        objective: Literal["speed", "energy"] = "speed",
        temperature_margin: float = 0.0,
        sticking_share: float = STICKING_SHARE,
        clearance: float = CLEARANCE,
        steadiness: float = STEADINESS,
    ):
        self.robot, self.schedule, self.objective = robot, schedule, objective
        self.temperature_margin = temperature_margin
        self.sticking_share, self.steadiness = sticking_share, steadiness
        self.planar, self.wires = PlanarRobot(robot), Wires(robot.together)
        self.phase_of = np.repeat(np.arange(len(schedule)), intervals)
        self.contacts = np.array(schedule)[self.phase_of]  # in each interval (K, F)
        self.before = np.roll(self.contacts, 1, axis=0)
        self.load = float(np.hypot(*self.planar.weight))
        self._add_variables()
        self._add_bounds(temperature_margin)
        self._add_contacts(sticking_share, clearance)
        both = (self.contacts, self.before)
        down = np.all([of != "swing" for of in both], axis=0)
        stuck = np.all([of == "stick" for of in both], axis=0)
        held = np.stack([stuck, down], axis=-1).astype(float)
        # Feet that swing come down on loads that are not known to micrometres.
        self.lifts = bool((self.contacts == "swing").any())
        standing = Standing(self.planar, self.wires, held, ground_gives=not self.lifts)
        self.standing = standing
        off_ground = np.all([of == "swing" for of in both], axis=0)
        self.blocks: list[ConstraintBlock] = [
            self._standing_block(off_ground, clearance),
            self._heat_block(),
            self._merit_block(),
        ]
        self.sliding = self._sliding_block()

    def _add_variables(self) -> None:
        prog = self.prog = MathematicalProgram()
        K, planar, wires = len(self.phase_of), self.planar, self.wires
        F, W = planar.num_feet, wires.num_wires
        cooling = -np.diag(wires.affine_rates()[0])[:W].mean()
        joints = np.full(len(planar.stiffness) - POSE, ANGLE_SCALE)
        pose = np.array([LENGTH_SCALE, LENGTH_SCALE, ANGLE_SCALE])
        merit = 1e-3 if self.objective == "speed" else 1e3
        sizes = {
            "y": (K, np.concatenate([pose, joints])),
            "heat": (K, wires.heat_scales),
            "forces": (K, np.full(2 * F, self.load / F)),
            "travel": (K, np.full(F, LENGTH_SCALE)),
            "duty": (K, np.ones(W)),
            "steps": (1, np.full(len(self.schedule), 1.0 / (K * cooling))),
            "stride": (1, np.array([LENGTH_SCALE])),
            "merit": (1, np.array([merit])),
        }
        places = {}
        for name, (rows, scales) in sizes.items():
            variables = prog.NewContinuousVariables(rows, len(scales), name)
            first = prog.num_vars() - variables.size
            places[name] = first + np.arange(variables.size).reshape(variables.shape)
            for of_row in variables:
                for variable, scale in zip(of_row, scales, strict=True):
                    prog.SetVariableScaling(variable, float(scale))
        self.y, self.heat, self.forces = places["y"], places["heat"], places["forces"]
        self.travel, self.duty = places["travel"], places["duty"]
        self.steps = places["steps"][0]
        self.stride, self.merit = int(places["stride"][0, 0]), int(places["merit"][0, 0])
        self.time_steps = self.steps[self.phase_of]  # of each interval (K,)
        sign = -1.0 if self.objective == "speed" else 1.0
        prog.AddLinearCost([sign / merit], 0.0, [self._variable(self.merit)])

    def _add_bounds(self, temperature_margin: float) -> None:
        W, limits = self.wires.num_wires, self.robot.together.temperature_limits
        self._bound(self.y[:, 2], -MOST_PITCH, MOST_PITCH)
        self._bound(self.y[:, POSE:], -MOST_TURN, MOST_TURN)
        self._bound(self.y[:1, 0], 0.0, 0.0)
        ambient = self.robot.together.ambient_temperature
        self._bound(self.heat[:, :W], ambient, limits.maximum - temperature_margin)
        readings = self.heat[:, self.wires.num_states :]
        self._bound(readings, -np.inf, limits.measured_maximum)
        self._bound(self.duty, 0.0, 1.0)
        typical = self.prog.GetVariableScaling()[int(self.steps[0])]
        self._bound(self.steps, *(share * typical for share in STEPS))
        self._bound(np.array([self.stride]), LEAST_STRIDE, np.inf)
        for of_interval in self.duty:
            self._add_linear(np.ones((1, W)), 0.0, self.robot.total_duty, of_interval)

    def _add_contacts(self, sticking_share: float, clearance: float) -> None:
        assert self.robot.ground is not None, "a gait needs a ground"
        mu = self.robot.ground.friction
        K, F = self.contacts.shape
        # The foot of a limb of length L that bends evenly is on the arc z = 2 x² / 3 L. From knot
        # to knot it would dip below the ground if it went further than this.
        furthest = np.sqrt(1.5 * self.planar.size * clearance) / LENGTH_SCALE
        for k in range(K):
            for foot in range(F):
                force = self.forces[k, 2 * foot : 2 * foot + 2]
                contacts = {self.before[k, foot], self.contacts[k, foot]}
                if "swing" in contacts:
                    self._bound(force, 0.0, 0.0)
                else:
                    self._bound(force[1:], LEAST_LOAD * self.load, np.inf)
                    for contact in contacts & SLIDES.keys():
                        row = np.array([[1.0, mu * SLIDES[contact]]])
                        self._add_linear(row, 0.0, 0.0, force, F / self.load)
                    if contacts == {"stick"} and np.isfinite(sticking_share):
                        most = sticking_share * mu
                        rows = np.array([[1.0, -most], [1.0, most]])
                        upper = np.array([0.0, np.inf])
                        self._add_linear(rows, -upper[::-1], upper, force, F / self.load)
                contact, after = self.contacts[k, foot], (k + 1) % K
                pair = [self.travel[after, foot], self.travel[k, foot], self.stride]
                row = np.array([[1.0, -1.0, float(after == 0)]]) * SLIDES.get(contact, 1.0)
                least = -furthest if contact == "swing" else 0.0
                most = {"stick": 0.0, "swing": furthest}.get(contact, np.inf)
                self._add_linear(row, least, most, pair, 1.0 / LENGTH_SCALE)

    def _standing_block(self, off_ground: np.ndarray, clearance: float) -> ConstraintBlock:
        """`Standing` at all knots: in balance, with the feet's travel, on the ground and stable.

        Args:
            off_ground: true where a foot swings before and after a knot (K, F).
        """
        planar, load = self.planar, self.load
        d, F = len(planar.stiffness), planar.num_feet
        forces, moments = np.full(2, load), np.full(d - 2, load * planar.size)
        scales = np.concatenate(
            [forces, moments, np.full(2 * F, LENGTH_SCALE), np.ones(2 * F + POSE)]
        )
        lower, upper = np.zeros((2, len(self.y), len(scales)))
        heights, pivots = slice(d + F, d + 2 * F), slice(d + 2 * F, -F)
        lower[:, -F:], upper[:, -F:] = -np.inf, np.inf if self.lifts else LEAST_PIVOT
        lower[:, heights] = planar.radius + clearance * off_ground
        upper[:, heights] = np.where(off_ground, np.inf, planar.radius)
        lower[:, pivots] = LEAST_PIVOT if np.isfinite(self.steadiness) else -np.inf
        pitch = self.steadiness * load * planar.size / LEAST_STIFFNESS[-1]
        lower[:, -F - 1] = np.arcsinh(pitch)
        upper[:, pivots] = np.inf
        return FunctionBlock(self.standing, self.points, scales=scales, bounds=(lower, upper))

    def _sliding_block(self) -> ConstraintBlock:
        """`FrictionGain` of each foot that slides, in each knot and phase that it is part of."""
        assert self.robot.ground is not None, "a gait needs a ground"
        K, F = self.contacts.shape
        contacts = np.concatenate([self.contacts, self.before])
        directions = np.vectorize(SLIDES.get)(contacts, 0.0)
        rows, feet = directions.nonzero()
        held = np.stack([contacts == "stick", contacts != "swing"], axis=-1).astype(float)
        sliding = self.robot.ground.friction * directions[rows, feet, None] * np.eye(F)[feet]
        gain = FrictionGain(self.planar, self.wires, held[rows], sliding)
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

    def _merit_block(self) -> ConstraintBlock:
        """The objective m: S = m Σ h, or m S = Σ h D."""
        stride, merit = ca.SX.sym("S"), ca.SX.sym("m")
        steps, duty = ca.SX.sym("h", len(self.steps)), ca.SX.sym("D", *self.duty.shape)
        of_intervals = steps[self.phase_of.tolist()]
        if self.objective == "speed":
            missed, scale = stride - merit * ca.sum(of_intervals), LENGTH_SCALE
        else:
            missed, scale = merit * stride - ca.sum(ca.sum(duty, 1) * of_intervals), 10.0
        function = SmoothFunction(missed, ca.vertcat(stride, merit, steps, ca.vec(duty)))
        point = np.concatenate([[self.stride, self.merit], self.steps, self.duty.T.ravel()])
        return FunctionBlock(function, point[None], scales=scale)

    @property
    def points(self) -> np.ndarray:
        """Indices of the points of `Standing` (K, P)."""
        states = self.heat[:, : self.wires.num_states]
        return np.hstack([self.y, states, self.forces, self.travel])

    def complete(self, x: np.ndarray, stride: float, steps: np.ndarray) -> np.ndarray:
        """Fill in travel, time and merit, which follow from the other decision variables.

        Args:
            stride: travel per period, m.
            steps: lengths of the intervals (K,), s, equal within a phase.
        """
        x[self.travel], x[self.stride] = self.planar.feet(x[self.y])[..., 0], stride
        x[self.time_steps] = steps
        used = (x[self.duty] * steps[:, None]).sum()
        x[self.merit] = stride / steps.sum() if self.objective == "speed" else used / stride
        return x

    def gait(self, x: np.ndarray, check: GaitCheck) -> Gait:
        """The gait that all decision variables describe."""
        around = np.arange(len(self.y) + 1) % len(self.y)
        steps, N, W = x[self.time_steps], self.wires.num_states, self.wires.num_wires
        time = np.append(0.0, np.cumsum(steps))
        y, heat = x[self.y[around]].T, x[self.heat[around]].T
        y[0, -1] += x[self.stride]
        slopes = np.diff(y[POSE:]) / steps
        rates = 0.5 * (slopes + np.roll(slopes, 1, axis=1))[:, around]
        starts = np.flatnonzero(np.diff(self.phase_of, prepend=-1))
        return Gait(
            time=time,
            duty=np.clip(x[self.duty[around]].T, 0.0, 1.0),
            joint_state=np.vstack([y[POSE:], rates]),
            wire_temperature=heat[:W],
            measured_temperature=heat[N:],
            other_wire_state=heat[W:N] if N > W else None,
            body_pose=y[:POSE],
            contact_force=x[self.forces[around]].T,
            robot=self.robot,
            phases=[
                GaitPhase(float(time[start]), list(contacts))
                for start, contacts in zip(starts, self.schedule, strict=True)
            ],
            check=check,
            provenance=Provenance.now(self.robot.together),
        )

    def slides_evenly(self, x: np.ndarray) -> bool:
        """Whether the friction of no foot that slides acts on itself too much."""
        return bool((self.sliding.evaluate(x) <= self.sliding.upper).all())

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
