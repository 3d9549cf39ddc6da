"""Plans a feasible trajectory for a reference, and checks it by simulation."""

import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories
from pydrake.solvers import SolverInterface

from limb_systems import (
    LimbError,
    LimbModel,
    LimbParameters,
    PlanCheck,
    Provenance,
    Trajectory,
    band,
)
from limb_systems.layout import Layout
from limb_systems.static_equilibria import StaticEquilibria
from planners import references
from planners.plan_check import (
    active_constraints,
    far_from_reference,
    simulated_differences,
    swings,
)
from planners.task import Task
from planners.transcription.program import TrajectoryProgram
from planners.transcription.quasi_static import (
    QuasiStaticProgram,
    check_temperature_limits,
    held_motion,
    solve_quasi_static,
)
from planners.transcription.solving import LONGEST_SOLVE, PlanningError, Solution, solve_program
from planners.transcription.warm_start import multipliers_of, with_motion

ROUNDING = 0.1  # °C, by which a margin of readings is larger than it must be

TOLERANCE_DEG, QUASI_STATIC_TOLERANCE_DEG = 0.1, 1.0  # from the simulation
ROUNDING_OF_ANGLES = 1e-9  # rad
MAX_KNOTS = 20_000  # over a minute on two cores; more is most often a time in ms
MAX_REFINEMENTS = 4
RINGING = 0.3  # s, in which the limb's first mode decays to a third

# Up to which change of the reference (rad) and of the state the previous plan
# is a better start than the quasi-static one, as measured at 301 knots.
SMALL_REFERENCE_CHANGE = np.deg2rad(0.2)
SMALL_STATE_CHANGE = 0.02  # of the scales of the states


def plan(
    parameters: LimbModel | LimbParameters | str | Path | None,
    reference: trajectories.Trajectory,
    *,
    task: Task | None = None,
    knot_rate: float = 10.0,
    initial_state: ArrayLike | None = None,
    tolerance_deg: float | None = None,
    max_knots: int = MAX_KNOTS,
    solver: SolverInterface | None = None,
) -> Trajectory:
    """Plans the feasible trajectory nearest to a reference, eqns (15)-(20).

    Where the plan differs from its simulation by more than the tolerance, knots are added and the
    program is solved again. A limb that is calibrated by prediction has a band of readings
    (`limb_systems.plan_band`). If they reach the limit of the board, the program is solved again
    with a margin.

    Args:
        parameters: the limb, its description, or its YAML file; the nominal limb if None.
        reference: φ_ref in rad, a row for each segment, from time 0 on; it
            need not be feasible or continuous. See `planners.references`.
        task: weights and limits; `Task()` if None.
        knot_rate: knots per second to begin with, Hz. The duration of the
            reference is rounded to whole intervals.
        initial_state: x_init, a state of `Limb`, such as `resting_state` of what is read; by
            default at rest in static equilibrium with wires at ambient temperature.
        tolerance_deg: largest difference between the bend angle of the plan and an accurate
            simulation of its duty, degrees. If None, it is 0.1 for a planar limb, and 1 for a
            limb in space, because plans in space leave out the inertia of the chain.
        max_knots: a plan that needs more is refused.
        solver: one of Drake's solvers, such as `SnoptSolver()`, in place of IPOPT as
            `planners.transcription.solving` uses it.

    Returns:
        The trajectory, with its check. Warns if it is far from its reference, or if the chain's
        inertia, which it leaves out, matters.

    Raises:
        InfeasibleError: if the temperature constraints cannot be met.
        PlanningError: if an argument is invalid, no solver converges or the
            plan fails its check.
    """
    started = time.perf_counter()
    limb = LimbModel.validated(parameters)
    num_knots = number_of_knots(reference, knot_rate, max_knots)
    times = np.linspace(0.0, reference.end_time(), num_knots)
    largest, margin = np.inf, np.zeros(limb.layout.num_wires)
    for refinement in range(MAX_REFINEMENTS + 1):
        planner = Planner(
            limb,
            times,
            task=task,
            tolerance_deg=tolerance_deg,
            solver=solver,
            measured_margin=margin,
        )
        trajectory, offsets, differences = planner.plan_unchecked(reference, initial_state)
        trajectory.check.refinements = refinement
        if (wider := _margin_of(trajectory, margin)) is not None:
            margin = wider
            continue
        tolerance = np.deg2rad(trajectory.check.tolerance_deg)
        before, largest = largest, differences.max()
        if largest <= tolerance or largest > 0.7 * before:  # met, or knots do not help
            break
        finer = _refined(times, offsets, differences, tolerance)
        if len(finer) > max_knots or time.perf_counter() - started > LONGEST_SOLVE:
            break
        times = finer
    trajectory.check.total_time = time.perf_counter() - started
    swinging = swings(trajectory)
    if failure := trajectory.check.failure():
        raise PlanningError(
            " ".join(filter(None, [f"The plan failed its check: {failure}", swinging]))
        )
    if swinging:
        warnings.warn(swinging, stacklevel=2)
    if far := far_from_reference(trajectory):
        warnings.warn(far, stacklevel=2)
    return trajectory


class Planner:
    """Plans repeatedly for one limb, task and set of knots.

    The program is built once; each call of `plan` replaces the reference and
    the initial state in it. A control loop can thus plan again from the state
    that was reached, with a new reference.

    Args:
        parameters: the limb, its description, or its YAML file; the nominal limb if None.
        times: times of the knots (N,), s, increasing from 0.
        task: weights and limits; `Task()` if None.
        tolerance_deg, solver: as in `planners.plan`.
        measured_margin: how far readings V stay below
            ``temperature_limits.measured_maximum``, °C, one number or one for
            each wire (W,).
    """

    def __init__(
        self,
        parameters: LimbModel | LimbParameters | str | Path | None,
        times: ArrayLike,
        *,
        task: Task | None = None,
        tolerance_deg: float | None = None,
        solver: SolverInterface | None = None,
        measured_margin: ArrayLike = 0.0,
    ):
        self._model = model = LimbModel.validated(parameters)
        self.parameters = model.parameters
        self.task = task or Task()
        self.times = np.asarray(times, float)
        if self.times.ndim != 1 or len(self.times) < 2 or not (np.diff(self.times) > 0).all():
            raise PlanningError("times must be at least two knots, increasing.")
        if self.times[0] != 0:
            raise PlanningError(f"times start at {self.times[0]:g} s; they must start at 0 s.")
        self._margin = _measured_margin(measured_margin, model.layout.num_wires)
        self._held = model.statics
        self._layout = model.layout
        planar = self._layout.is_planar
        if tolerance_deg is None:
            tolerance_deg = TOLERANCE_DEG if planar else QUASI_STATIC_TOLERANCE_DEG
        check_positive("tolerance_deg", tolerance_deg, "degrees")
        if solver is not None and not planar:
            raise PlanningError(
                f"{solver.SolverName()} cannot plan for a limb that bends in space; leave the "
                "solver out."
            )
        self._tolerance_deg, self._solver = tolerance_deg, solver
        # Once for all plans, of which a control loop makes many.
        self._provenance = Provenance.now(self.parameters)
        self._program: TrajectoryProgram | QuasiStaticProgram | None = None
        self._previous: tuple[np.ndarray, np.ndarray, Solution] | None = None

    def plan(
        self,
        reference: trajectories.Trajectory,
        initial_state: ArrayLike | None = None,
        *,
        elapsed: float = 0.0,
    ) -> Trajectory:
        """Plans from a state as `planners.plan` does, but never adds knots.

        The solver starts from the previous plan if reference and state are
        nearly the same, and else from the quasi-static plan.

        Args:
            reference: φ_ref in rad, from now on; its last angle is held.
            initial_state: x_init, a state of `Limb`.
            elapsed: part of the warm-up (20) that is over, s.
        """
        started = time.perf_counter()
        trajectory, _, _ = self.plan_unchecked(reference, initial_state, elapsed=elapsed)
        trajectory.check.total_time = time.perf_counter() - started
        if failure := trajectory.check.failure():
            raise PlanningError(f"The plan failed its check: {failure}")
        return trajectory

    def plan_unchecked(
        self,
        reference: trajectories.Trajectory,
        initial_state: ArrayLike | None = None,
        *,
        elapsed: float = 0.0,
    ) -> tuple[Trajectory, np.ndarray, np.ndarray]:
        """A plan that may fail its check, and where it differs from its simulation.

        Returns:
            The plan; times (M,), s; the largest difference of a bend angle at
            these times (M,), rad.
        """
        times = self.times
        angles_ref = _sample_reference(reference, times, self._layout)
        state = _initial_state(self._held, initial_state)
        heat = state[2 * self._layout.num_joints :]
        warm_up = max(0.0, self.parameters.temperature_limits.warm_up_time - elapsed)
        check_temperature_limits(self._model, times, heat, warm_up, self.task, self._margin)
        if self._program is None:
            self._program = self._make_program()
        program = self._program
        program.update(angles_ref, state, warm_up)
        guess, multipliers = self._guess(program, angles_ref, state, warm_up)
        solution = self._solve(program, guess, multipliers, angles_ref, state)
        trajectory = self._trajectory(program, solution, angles_ref)
        trajectory.check.guess_cost = program.cost(guess)
        trajectory.check.active_constraints = active_constraints(
            trajectory, self.task, warm_up, self._margin, program.active_knots(solution.x)
        )
        offsets, differences = simulated_differences(trajectory)
        trajectory.check.largest_difference_deg = float(np.rad2deg(differences.max()))
        return trajectory, offsets, differences

    def _make_program(self) -> TrajectoryProgram | QuasiStaticProgram:
        if not self._layout.is_planar:
            return QuasiStaticProgram(self._model, self.times, self._held, self.task, self._margin)
        return TrajectoryProgram(
            self._model,
            self.times,
            self.task,
            measured_margin=self._margin,
            with_constraints=self._solver is not None or self.task.customize is not None,
        )

    def _guess(
        self, program, angles_ref, state, warm_up_time: float
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray] | None]:
        """Return decision variables from which a program is solved, and multipliers if known."""
        if isinstance(program, QuasiStaticProgram):
            return program.guess(), None
        # Solve the quasi-static program.
        quasi_static, solution = solve_quasi_static(
            self._model,
            self.times,
            angles_ref,
            state[2 * self._layout.num_joints :],
            self.task,
            warm_up_time,
            self._margin,
        )
        heat = solution.x[quasi_static.heat].T
        duty = solution.x[quasi_static.duty].T
        motion = held_motion(self._held, heat[: self._held.wires.num_states].T, duty.T)
        states = np.vstack([motion.T, heat])
        states[:, 0] = state
        guess = program.variables(states, duty)
        if not program.starts_near:
            return guess, None
        # Let the motion follow from its heat.
        try:
            guess = with_motion(program, guess)
            return guess, multipliers_of(program, guess, quasi_static, solution)
        except (LimbError, np.linalg.LinAlgError):
            return guess, None

    def _solve(self, program, guess, multipliers, angles_ref, state) -> Solution:
        """Solution from the previous one if little changed, else from the guess."""
        start = guess
        if self._previous is not None:
            previous_ref, previous_state, previous = self._previous
            reference_change = np.abs(angles_ref - previous_ref).max()
            state_change = np.abs((state - previous_state) / program.state_scales).max()
            if reference_change < SMALL_REFERENCE_CHANGE and state_change < SMALL_STATE_CHANGE:
                start, multipliers = previous.x, previous.multipliers
        solution = solve_program(program, start, multipliers, self._solver, program.starts_near)
        self._previous = (angles_ref, state, solution)
        return solution

    def _trajectory(self, program, solution: Solution, angles_ref) -> Trajectory:
        return Trajectory(
            time=program.knots(solution.x),
            reference=angles_ref,
            **program.signals(solution.x),
            parameters=self.parameters,
            check=PlanCheck(
                solver=solution.solver,
                status=solution.status,
                iterations=solution.iterations,
                solve_time=solution.solve_time,
                cost=solution.cost,
                largest_defect=program.largest_defect(solution.x),
                broken_constraint=program.broken_constraint(solution.x),
                added=program.added_terms(solution.x),
                tolerance_deg=self._tolerance_deg,
            ),
            provenance=self._provenance,
        )


def _margin_of(trajectory: Trajectory, margin: np.ndarray) -> np.ndarray | None:
    """Notes a plan's band in its check; a wider margin of readings (W,), °C, if it needs one."""
    around = band(trajectory)
    if around is None:
        return None
    check, limit = trajectory.check, trajectory.parameters.temperature_limits.measured_maximum
    check.bend_band_deg = float(np.rad2deg(around.bend_reading.mean()))
    check.highest_readings = around.highest_readings.tolist()
    if (around.highest_readings < limit).all():
        return None
    excess = around.highest_readings - trajectory.measured_temperature.max(axis=1)
    return np.maximum(margin, excess + ROUNDING)


def _measured_margin(margin: ArrayLike, num_wires: int) -> np.ndarray:
    values = np.asarray(margin, float)
    if values.shape not in ((), (num_wires,)) or not (values >= 0).all():
        raise PlanningError(
            f"measured_margin is {margin!r}; it must be °C, zero or more, one number or one for "
            f"each of {num_wires} wires."
        )
    return np.broadcast_to(values, num_wires)


def check_positive(name: str, value: Any, unit: str) -> None:
    """Raises PlanningError unless a value is a positive, finite number."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and np.isfinite(value) and value > 0):
        raise PlanningError(f"{name} is {value!r} {unit}; it must be a positive number.")


def number_of_knots(reference: trajectories.Trajectory, knot_rate: float, max_knots: int) -> int:
    """Number of knots that a plan starts with.

    Args:
        reference, knot_rate, max_knots: as in `plan`.

    Raises:
        PlanningError: if it is less than two or more than ``max_knots``.
    """
    duration = reference.end_time()
    check_positive("knot_rate", knot_rate, "Hz")
    check_positive("max_knots", max_knots, "knots")
    if reference.start_time() > 0 or not (np.isfinite(duration) and duration > 0):
        raise PlanningError(
            f"The reference lasts from {reference.start_time():g} s to {duration:g} s; "
            "it must start at 0 s and end later."
        )
    num_intervals = round(min(duration * knot_rate, 1e18))
    if num_intervals < 1:
        raise PlanningError(
            f"A reference of {duration:g} s at {knot_rate:g} knots per second makes one knot; "
            "a plan needs two, so ask for more knots per second."
        )
    if num_intervals + 1 > max_knots:
        raise PlanningError(
            f"A reference of {duration:g} s at {knot_rate:g} knots per second makes "
            f"{num_intervals + 1:,} knots, more than {max_knots:,}; is its time in s? If it "
            "is, ask for fewer knots per second, or allow more by --max-knots (max_knots in "
            "Python)."
        )
    return num_intervals + 1


def _sample_reference(reference, times: np.ndarray, layout: Layout) -> np.ndarray:
    if reference.cols() != 1 or reference.rows() != layout.num_bends:
        of_each = "an angle each" if layout.is_planar else f"{layout.num_bends} bend angles in all"
        segments, angles = len(layout.bends_of), reference.rows() * reference.cols()
        raise PlanningError(
            f"The reference has {angles} angle{'s' * (angles != 1)} at each time; "
            f"this limb has {segments} segment{'s' * (segments > 1)}, with {of_each}."
            + f" {references.IN_SPACE}"
            * (layout.is_planar and angles == 2 * segments)
        )
    angles = reference.vector_values(times)
    bad = ~(np.abs(angles) <= np.pi + ROUNDING_OF_ANGLES).all(axis=0)  # also true for NaN
    if bad.any():
        index = int(np.argmax(bad))
        worst = angles[np.argmax(np.abs(angles[:, index])), index]  # NaN if there is one
        raise PlanningError(
            f"The reference is {np.rad2deg(worst):.6g}° at {times[index]:g} s; "
            "bend angles must be numbers from -180° to 180°."
        )
    return angles


def _initial_state(held: StaticEquilibria, initial_state) -> np.ndarray:
    rest = held.resting_state(held.wires.cold_states[: held.wires.num_wires])
    if initial_state is None:
        return rest
    state = np.asarray(initial_state, float)
    if state.shape != rest.shape or not np.isfinite(state).all():
        raise PlanningError(
            f"initial_state must be {rest.size} finite numbers, a state of this limb's `Limb`."
        )
    return state


def _refined(
    times: np.ndarray, offsets: np.ndarray, differences: np.ndarray, tolerance: float
) -> np.ndarray:
    """Knots with a new one in the middle of each interval that caused a difference.

    An interval may cause a difference within it and, because the limb rings,
    shortly after it.
    """
    starts, ends = times[:-1], times[1:]
    bad = offsets[differences > tolerance / 2]
    blamed = np.searchsorted(bad, ends + RINGING, side="right") > np.searchsorted(bad, starts)
    middles = 0.5 * (starts + ends)[blamed]
    return np.sort(np.concatenate([times, middles]))
