"""A planned state-input trajectory with the results of its check."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.signal_table import Planned, not_saved, sample_rate, signal
from limb_systems.kinematics import bend_angle
from limb_systems.limb_parameters import LimbParameters
from limb_systems.summary import Entry, Summary

DEFECT_TOLERANCE = 1e-6
DISTANCE_RATE = 20.0  # Hz, of the samples for the distance from the reference
# Fields of a `PlanCheck` that JSON has under the same names.
_CHECK_FIELDS = ["solver", "status", "iterations", "refinements", "cost", "guess_cost"]
_CHECK_FIELDS += ["largest_defect", "largest_difference_deg", "tolerance_deg"]


@dataclasses.dataclass
class ActiveConstraint:
    """A bound that is active in a plan from ``start`` to ``end``, s.

    - ``bound``: name of a bound of (18)-(20), or of constraints that ``customize`` added.
    """

    bound: str = ""
    start: float = 0.0
    end: float = 0.0


@dataclasses.dataclass
class AddedTerms:
    """Costs, or constraints, of one name that the task's ``customize`` added to a plan's program.

    - ``name``: their description, or else their formula.
    - ``number``: number of them.
    - ``cost``: sum of their values at the plan; None for constraints.
    """

    name: str = ""
    number: int = 0
    cost: float | None = None


@dataclasses.dataclass
class PlanCheck:
    """The solver's result for a plan, and the difference of the plan from its simulation.

    - ``solver``, ``status``: name of the solver that found it, and its status.
    - ``iterations``, ``solve_time``: iterations and time of the solver, s.
    - ``total_time``: time from the request to the checked plan, s.
    - ``refinements``: number of times that knots were added to meet the tolerance.
    - ``cost``, ``guess_cost``: value of eqn (15) at the plan and at the quasi-static guess.
    - ``largest_defect``: largest defect of the collocation constraints as the planner evaluates
      them, acceleration scaled by M(0)/k to rad, others by their time step.
    - ``broken_constraint``: a constraint of the task's ``customize`` that does not hold,
      and its violation; empty if all hold.
    - ``largest_difference_deg``: largest difference of the bend angle from an
      accurate simulation of the plan's duty, degrees.
    - ``tolerance_deg``: largest difference that was allowed, degrees.
    - ``active_constraints``: the times at which bounds are active.
    - ``added``: the terms that the task's ``customize`` added.
    - ``bend_band_deg``: mean half-width of the band about the bend angle, degrees, that has 95%
      of the readings of all limbs that the calibration cannot distinguish; 0 if unknown. See
      `limb_systems.plan_band`.
    - ``highest_readings``: the highest reading of each wire, °C, that 995 of 1000
      of these limbs stay below; empty if it is not known.
    """

    solver: str = ""
    status: str = ""
    iterations: int = 0
    refinements: int = 0
    solve_time: float = 0.0
    total_time: float = 0.0
    cost: float = 0.0
    guess_cost: float = 0.0
    largest_defect: float = math.nan
    broken_constraint: str = ""
    largest_difference_deg: float = math.nan
    tolerance_deg: float = math.nan
    active_constraints: list[ActiveConstraint] = dataclasses.field(default_factory=list)
    added: list[AddedTerms] = dataclasses.field(default_factory=list)
    bend_band_deg: float = 0.0
    highest_readings: list[float] = dataclasses.field(default_factory=list)

    @property
    def added_constraints(self) -> list[str]:
        """The names of the constraints that the task's ``customize`` added."""
        return [terms.name for terms in self.added if terms.cost is None]

    @property
    def is_missing(self) -> bool:
        """True if the plan was never checked."""
        return math.isnan(self.largest_defect + self.largest_difference_deg + self.tolerance_deg)

    def failure(self) -> str | None:
        """Return one sentence on why the plan must not be used, or None if it may be used."""
        if self.is_missing:
            return "it was never checked by simulating it."
        if not self.largest_defect <= DEFECT_TOLERANCE:
            return (
                f"the dynamics are violated by {self.largest_defect:.1e} (scaled), "
                f"more than {DEFECT_TOLERANCE:.0e}."
            )
        if self.broken_constraint:
            return f"the task's constraint {self.broken_constraint}."
        if not self.largest_difference_deg <= self.tolerance_deg:
            return (
                f"simulating the planned duty ends up to {self.largest_difference_deg:.3f}° away "
                f"from the plan, more than {self.tolerance_deg:g}°; use more knots per "
                "second, or more cycles of a gait."
            )
        return None


@dataclasses.dataclass(eq=False, repr=False, kw_only=True)
class Trajectory(Planned):
    """A feasible motion of a limb with F bends, n joints and W wires.

    Between the K knots duty is linear and joint angles are cubic, as in
    direct collocation.

    - ``time``: time of the knots (K,), s.
    - ``reference``: φ_ref (F, K), rad.
    - ``duty``: D (W, K), in [0, 1].
    - ``joint_state``: [θ, θ̇] (2n, K), rad and rad/s.
    - ``wire_temperature``, ``measured_temperature``: T, V (W, K), °C.
    - ``parameters``: parameters of the limb that it was planned for.
    - ``check``: result of its solver and of its check.
    - ``other_wire_state``: the states of the wires' laws other than T
      (N - W, K), in the order of `Wires`; None if there are no others.
    - ``provenance``: its provenance; None if it is not known.
    - ``sample_rate``: mean rate of the knots, Hz, which follows from ``time``.

    Raises:
        LimbError: at construction, if shapes disagree, values are not finite,
            time does not increase or duty leaves [0, 1].
    """

    KIND: ClassVar[str] = "trajectory"

    sample_rate: float = sample_rate(math.nan)
    check: PlanCheck
    parameters: LimbParameters
    provenance: Provenance | None = None
    time: np.ndarray = signal()
    reference: np.ndarray = signal()
    duty: np.ndarray = signal()
    joint_state: np.ndarray = signal()
    wire_temperature: np.ndarray = signal()
    measured_temperature: np.ndarray = signal()
    other_wire_state: np.ndarray | None = not_saved(None)

    def __post_init__(self):
        self._check()
        if len(self.time) < 2:
            raise LimbError("a trajectory needs at least two knots.")
        self.sample_rate = (len(self.time) - 1) / self.duration

    @property
    def origin(self) -> str:
        """A caption: the source of the joint angles that a picture of the limb shows."""
        return "planned motion, nothing measured"

    def statements(self, nearest: str = "") -> Summary:
        """Return the statements about the plan: check, distance from the reference, active limits.

        Args:
            nearest: the distance of the best plan within the limits, in words, if known.
        """
        check = self.check
        parameters = self.parameters
        num_segments = len(parameters.segments)
        num_knots = len(self.time)
        # Measure the distance from the reference.
        plan = self.since_start()
        times = np.linspace(0.0, plan.duration, int(np.ceil(plan.duration * DISTANCE_RATE)) + 1)
        differences = plan.interpolated(plan.reference, times) - plan.bend_angle_at(times)
        distances = self.model.layout.distances(differences)
        mean_distance_deg = np.rad2deg(distances.mean())
        difference_at_knots = np.abs(self.bend_angle - self.reference)
        largest_distance_deg = np.rad2deg(difference_at_knots.max())
        # Write the texts for people.
        texts = {
            "reference": f"missed by {mean_distance_deg:.2f}° on average, "
            f"{largest_distance_deg:.2f}° at most{nearest}",
            "limb": f"{num_segments} segment{'s' * (num_segments > 1)}, {parameters.num_joints} "
            f"joints, {len(parameters.wires)} wires",
            "plan": f"{self.duration:g} s, {num_knots} knots, from request to checked plan in "
            f"{check.total_time:.2f} s",
            "solver": f"{check.solver}: {check.status} in {check.iterations} iterations, "
            f"{check.solve_time:.2f} s; cost {check.cost:.6g} (at the start "
            f"{check.guess_cost:.6g})",
            "check": f"{'failed' if check.failure() else 'passed'}, simulated again: within "
            f"{check.largest_difference_deg:.4f}° of the plan (allowed {check.tolerance_deg:g}°); "
            f"largest defect {check.largest_defect:.1e}",
        }
        if check.is_missing:
            texts["solver"] = f"{check.solver or 'unknown'}: {check.status}"
            texts["check"] = "none"
        if check.highest_readings:
            texts["band"] = (
                f"on limbs like this one φ is read within ±{check.bend_band_deg:.2f}° of the plan "
                f"(95%), V up to {max(check.highest_readings):.0f} °C (99.5%)"
            )
        # List the times of each active bound; added constraints have lines of their own.
        ranges: dict[str, list[str]] = {}
        for active in check.active_constraints:
            ranges.setdefault(active.bound, []).append(_time_range(active.start, active.end))
        active_times = {bound: f"at {', '.join(times)} s" for bound, times in ranges.items()}
        added_lines = [_added_terms_line(terms, active_times) for terms in check.added]
        width = max(map(len, active_times), default=0)
        lines = [f"{bound:<{width}}  {times}" for bound, times in active_times.items()]
        texts["limits"] = "\n".join(["the plan runs along", *lines]) if lines else "none is active"
        texts["added"] = "\n".join(added_lines)
        # Collect the values for JSON.
        values = {
            "duration_s": self.duration,
            "knots": num_knots,
            **{name: getattr(check, name) for name in _CHECK_FIELDS},
            "solve_time_s": check.solve_time,
            "total_time_s": check.total_time,
            "reference_missed_mean_deg": float(mean_distance_deg),
            "reference_missed_largest_deg": float(largest_distance_deg),
            "bend_band_deg": check.bend_band_deg if check.highest_readings else None,
            "highest_readings_c": check.highest_readings,
            "active_constraints": [
                {"bound": active.bound, "start_s": active.start, "end_s": active.end}
                for active in check.active_constraints
            ],
            "added": [dataclasses.asdict(terms) for terms in check.added],
        }
        return Summary.of(texts, values)

    def summary(self) -> Summary:
        """Return the summary of a plan: its size and check, and in details its statements.

        Only ``soft-limb show`` has the distance of the best plan, which takes a second to find.
        """
        statements = self.statements()
        entries = [
            Entry("duration", self.duration, "s"),
            Entry("samples", len(self.time), "", f"{len(self.time)} knots"),
            self._bend_entry(),
            self._check_entry,
        ]
        details = [entry for entry in statements.entries if entry.name not in ("check", "plan")]
        return Summary(entries, details + statements.details)

    @property
    def state(self) -> np.ndarray:
        """The states of `Limb` at the knots, [θ, θ̇, x, V], a column for each knot."""
        return np.vstack([self.joint_state, self.wire_states, self.measured_temperature])

    def since_start(self) -> "Trajectory":
        """Return this plan with time zero at its start, as in recordings of its replay."""
        start = float(self.time[0])
        if start == 0:
            return self
        # Shift the times of the active constraints, too.
        bounds = [
            dataclasses.replace(bound, start=bound.start - start, end=bound.end - start)
            for bound in self.check.active_constraints
        ]
        check = dataclasses.replace(self.check, active_constraints=bounds)
        return dataclasses.replace(self, time=self.time - start, check=check)

    def duty_trajectory(self) -> PiecewisePolynomial:
        """Return the duty between the knots, for a `TrajectorySource`."""
        return PiecewisePolynomial.FirstOrderHold(self.time, self.duty)

    def state_trajectory(self) -> PiecewisePolynomial:
        """Return states of `Limb` between the knots, cubic as in direct collocation.

        Their slopes at the knots are the rates of the dynamics.
        """
        model = self.model
        heat = np.vstack([self.wire_states, self.measured_temperature])
        accelerations = model.dynamics.accelerations(
            np.vstack([self.joint_state, self.wire_states]).T
        )
        heat_rates = model.wires.heat_rates(heat.T, self.duty.T)
        rates = np.vstack([self.joint_rates, accelerations.T, heat_rates.T])
        return PiecewisePolynomial.CubicHermite(self.time, self.state, rates)

    def bend_angle_at(self, times: ArrayLike) -> np.ndarray:
        """Return φ* at any times (M,), (F, M), rad; at one time, (F,), as ports take it.

        For the times of a recording, use it on `since_start`.
        """
        joints = PiecewisePolynomial.CubicHermite(self.time, self.joint_angles, self.joint_rates)
        return self._at(times, lambda at: bend_angle(self.model, joints.vector_values(at)))

    def duty_at(self, times: ArrayLike) -> np.ndarray:
        """Return the duty at any times (M,), (W, M); at one time, (W,), as ports take it."""
        return self._at(times, self.duty_trajectory().vector_values)

    @staticmethod
    def _at(times: ArrayLike, values: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Return values at times, without their axis if that is one time."""
        at = np.asarray(times, float)
        if not np.isfinite(at).all():
            raise LimbError("times must be finite.")
        columns = values(np.atleast_1d(at))
        return columns if at.ndim else columns[:, 0]

    def is_same_plan(self, other: "Trajectory") -> bool:
        """Return whether another trajectory has the same file, except for provenance."""

        def text_without_provenance(plan: Trajectory) -> str:
            parameters = plan.parameters.without_provenance()
            return dataclasses.replace(plan, parameters=parameters, provenance=None).to_text()

        return text_without_provenance(self) == text_without_provenance(other)

    def _text(self) -> Iterator[str]:
        if not self.check.is_missing and (failure := self.check.failure()):
            raise LimbError(f"This plan failed its check and is not saved: {failure}")
        yield from super()._text()


def _time_range(start: float, end: float) -> str:
    """Return a range of time, s, or the time of a single knot."""
    first = f"{start:.1f}"
    last = f"{end:.1f}"
    return first if first == last else f"{first}-{last}"


def _added_terms_line(terms: AddedTerms, active_times: dict[str, str]) -> str:
    """Return a line on terms that the task added, and remove them from the active constraints."""
    if terms.cost is None:
        kind = "constraint"
        times = active_times.pop(terms.name, None)
        state = f"active {times}" if times else "not active"
    else:
        kind = "cost"
        state = f"{terms.cost:.3g}"
    number = kind if terms.number == 1 else f"{terms.number} {kind}s"
    return f"{terms.name} ({number}): {state}"
