"""The planner: from a reference to a feasible trajectory that is checked by simulation."""

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
    swing_warning,
)
from planners.task import Task
from planners.transcription.program import TrajectoryProgram
from planners.transcription.quasi_static import (
    QuasiStaticProgram,
    check_temperature_limits,
    solve_quasi_static,
    static_motion,
)
from planners.transcription.solving import LONGEST_SOLVE, PlanningError, Solution, solve_program
from planners.transcription.warm_start import estimate_multipliers, solve_motion

MARGIN_ROUNDING = 0.1  # °C, by which a margin of readings is larger than it must be

# from the simulation
TOLERANCE_DEG = 0.1
QUASI_STATIC_TOLERANCE_DEG = 1.0
ANGLE_ROUNDING = 1e-9  # rad
MAX_KNOTS = 20_000  # over a minute on two cores; more is most often a time in ms
MAX_REFINEMENTS = 4
RINGING_TIME = 0.3  # s, in which the limb's first mode decays to a third

# After smaller changes of the reference (rad) and of the state, the previous plan is a better
# start than the quasi-static plan, as measured at 301 knots.
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
    """Return the feasible trajectory nearest to a reference, eqns (15)-(20).

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
        initial_state: x_init, a state of `Limb`, such as `resting_state` of readings; by
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
        PlanningError: if an argument is invalid, no solver converges or the plan fails its check.
    """
    started = time.perf_counter()
    limb = LimbModel.validated(parameters)
    num_knots = initial_num_knots(reference, knot_rate, max_knots)
    times = np.linspace(0.0, reference.end_time(), num_knots)
    planner = Planner(limb, times, task=task, tolerance_deg=tolerance_deg, solver=solver)
    largest_difference = np.inf
    for refinement in range(MAX_REFINEMENTS + 1):
        # Solve the program at these knots, and simulate the duty of the plan.
        trajectory, sample_times, differences = planner.plan_unchecked(reference, initial_state)
        trajectory.check.refinements = refinement
        # Keep away from the board's limit if the band of readings reaches it, and solve again.
        if planner.widen_margin(trajectory):
            continue
        # Stop where plan and simulation agree, or more knots do not help.
        tolerance = np.deg2rad(trajectory.check.tolerance_deg)
        previous_difference = largest_difference
        largest_difference = differences.max()
        if largest_difference <= tolerance or largest_difference > 0.7 * previous_difference:
            break
        # Add knots where plan and simulation differ.
        finer = _refine_knots(planner.times, sample_times, differences, tolerance)
        if len(finer) > max_knots or time.perf_counter() - started > LONGEST_SOLVE:
            break
        planner.set_knots(finer)
    trajectory.check.total_time = time.perf_counter() - started

    # Refuse a plan that failed its check, and warn of a plan that may disappoint.
    swinging = swing_warning(trajectory)
    if failure := trajectory.check.failure():
        sentences = [f"The plan failed its check: {failure}", swinging]
        raise PlanningError(" ".join(filter(None, sentences)))
    if swinging:
        warnings.warn(swinging, stacklevel=2)
    if far := far_from_reference(trajectory):
        warnings.warn(far, stacklevel=2)
    return trajectory


class Planner:
    """A planner for one limb and task, which plans repeatedly at the same knots.

    The program is built once; each call of `plan` replaces the reference and the initial state in
    it. A control loop can thus plan again from the current state, with a new reference.

    Args:
        parameters: the limb, its description, or its YAML file; the nominal limb if None.
        times: times of the knots (N,), s, increasing from 0.
        task: weights and limits; `Task()` if None.
        tolerance_deg, solver: as in `planners.plan`.
        measured_margin: how far readings V stay below ``temperature_limits.measured_maximum``, °C,
            one number or one for each wire (W,).
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
        # The request, which is checked.
        self._model = model = LimbModel.validated(parameters)
        self.parameters = model.parameters
        self.task = task or Task()
        self.set_knots(times)
        self._margin = _measured_margin(measured_margin, model.layout.num_wires)
        self._statics = model.statics
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
        self._tolerance_deg = tolerance_deg
        self._solver = solver
        # A control loop makes many plans; they share their provenance.
        self._provenance = Provenance.now(self.parameters)

    def set_knots(self, times: ArrayLike) -> None:
        """Plan at other knots from now on, without the previous plan as a start.

        Args:
            times: times of the knots (N,), s, increasing from 0.

        Raises:
            PlanningError: if the times are invalid.
        """
        self.times = np.asarray(times, float)
        if self.times.ndim != 1 or len(self.times) < 2 or not (np.diff(self.times) > 0).all():
            raise PlanningError("times must be at least two knots, increasing.")
        if self.times[0] != 0:
            raise PlanningError(f"times start at {self.times[0]:g} s; they must start at 0 s.")
        self._discard_program()

    def widen_margin(self, trajectory: Trajectory) -> bool:
        """Widen the margin of readings if a plan's band of readings reaches the board's limit.

        The band is noted in the plan's check.

        Returns:
            Whether the margin is wider now, so that the plan must be made again.
        """
        around = band(trajectory)
        if around is None:
            return False
        check = trajectory.check
        check.bend_band_deg = float(np.rad2deg(around.bend_reading.mean()))
        check.highest_readings = around.highest_readings.tolist()
        limits = trajectory.parameters.temperature_limits
        if (around.highest_readings < limits.measured_maximum).all():
            return False
        excess = around.highest_readings - trajectory.measured_temperature.max(axis=1)
        self._margin = np.maximum(self._margin, excess + MARGIN_ROUNDING)
        self._discard_program()
        return True

    def _discard_program(self) -> None:
        self._program: TrajectoryProgram | QuasiStaticProgram | None = None
        self._previous: tuple[np.ndarray, np.ndarray, Solution] | None = None

    def plan(
        self,
        reference: trajectories.Trajectory,
        initial_state: ArrayLike | None = None,
        *,
        elapsed: float = 0.0,
    ) -> Trajectory:
        """Return a plan from a state as `planners.plan` does, but without refining the knots.

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
        """Return a plan that may fail its check, and its differences from its simulation.

        Returns:
            The plan; times (M,), s; the largest difference of a bend angle at
            these times (M,), rad.
        """
        # Check the request.
        angles_ref = _sample_reference(reference, self.times, self._layout)
        state = _initial_state(self._statics, initial_state)
        heat = state[2 * self._layout.num_joints :]
        warm_up = max(0.0, self.parameters.temperature_limits.warm_up_time - elapsed)
        check_temperature_limits(self._model, self.times, heat, warm_up, self.task, self._margin)
        # Solve the program (15)-(20).
        if self._program is None:
            self._program = self._make_program()
        program = self._program
        program.update(angles_ref, state, warm_up)
        guess, multipliers = self._guess(program, angles_ref, state, warm_up)
        solution = self._solve(program, guess, multipliers, angles_ref, state)
        trajectory = self._trajectory(program, solution, angles_ref)
        # Complete the check of the plan, and simulate its duty.
        trajectory.check.guess_cost = program.cost(guess)
        trajectory.check.active_constraints = active_constraints(
            trajectory, self.task, warm_up, self._margin, program.active_knots(solution.x)
        )
        times, differences = simulated_differences(trajectory)
        trajectory.check.largest_difference_deg = float(np.rad2deg(differences.max()))
        return trajectory, times, differences

    def _make_program(self) -> TrajectoryProgram | QuasiStaticProgram:
        if not self._layout.is_planar:
            return QuasiStaticProgram(
                self._model, self.times, self._statics, self.task, self._margin
            )
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
        """Return the start of a program: its decision variables, and multipliers if any."""
        if isinstance(program, QuasiStaticProgram):
            solution = program.linear_start()
            return (solution.x, solution.multipliers) if solution else (program.guess(), None)
        # Solve the quasi-static program.
        quasi_static, solution = solve_quasi_static(
            self._model,
            self.times,
            angles_ref,
            state[2 * self._layout.num_joints :],
            self.task,
            warm_up_time,
            self._margin,
            is_start=True,
        )
        heat = solution.x[quasi_static.heat].T
        duty = solution.x[quasi_static.duty].T
        motion = static_motion(self._statics, heat[: self._statics.wires.num_states].T, duty.T)
        states = np.vstack([motion.T, heat])
        states[:, 0] = state
        guess = program.variables(states, duty)
        if not program.starts_near:
            return guess, None
        # Let the motion follow from its heat.
        try:
            guess, slopes = solve_motion(program, guess)
            return guess, estimate_multipliers(program, guess, slopes, quasi_static, solution)
        except (LimbError, np.linalg.LinAlgError):
            return guess, None

    def _solve(self, program, guess, multipliers, angles_ref, state) -> Solution:
        """Solve a program from the previous solution if little changed, else from the guess."""
        start = guess
        if self._previous is not None:
            previous_ref, previous_state, previous = self._previous
            reference_change = np.abs(angles_ref - previous_ref).max()
            state_change = np.abs((state - previous_state) / program.state_scales).max()
            if reference_change < SMALL_REFERENCE_CHANGE and state_change < SMALL_STATE_CHANGE:
                start = previous.x
                multipliers = previous.multipliers
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


def _measured_margin(margin: ArrayLike, num_wires: int) -> np.ndarray:
    values = np.asarray(margin, float)
    if values.shape not in ((), (num_wires,)) or not (values >= 0).all():
        raise PlanningError(
            f"measured_margin is {margin!r}; it must be °C, zero or more, one number or one for "
            f"each of {num_wires} wires."
        )
    return np.broadcast_to(values, num_wires)


def check_positive(name: str, value: Any, unit: str) -> None:
    """Raise PlanningError unless a value is a positive, finite number."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and np.isfinite(value) and value > 0):
        raise PlanningError(f"{name} is {value!r} {unit}; it must be a positive number.")


def initial_num_knots(reference: trajectories.Trajectory, knot_rate: float, max_knots: int) -> int:
    """Return the number of knots that a plan starts with.

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
    # Count the knots.
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
    """Return φ_ref (F, K), rad, at times (K,), s."""
    if reference.cols() != 1 or reference.rows() != layout.num_bends:
        of_each = "an angle each" if layout.is_planar else f"{layout.num_bends} bend angles in all"
        segments = len(layout.bends_of)
        angles = reference.rows() * reference.cols()
        sentence = (
            f"The reference has {angles} angle{'s' * (angles != 1)} at each time; "
            f"this limb has {segments} segment{'s' * (segments > 1)}, with {of_each}."
        )
        if layout.is_planar and angles == 2 * segments:
            sentence += f" {references.IN_SPACE}"
        raise PlanningError(sentence)
    # Refuse angles beyond a half turn.
    angles = reference.vector_values(times)
    bad = ~(np.abs(angles) <= np.pi + ANGLE_ROUNDING).all(axis=0)  # also true for NaN
    if bad.any():
        index = int(np.argmax(bad))
        worst = angles[np.argmax(np.abs(angles[:, index])), index]  # NaN if there is one
        raise PlanningError(
            f"The reference is {np.rad2deg(worst):.6g}° at {times[index]:g} s; "
            "bend angles must be numbers from -180° to 180°."
        )
    return angles


def _initial_state(statics: StaticEquilibria, initial_state) -> np.ndarray:
    wires = statics.wires
    rest = statics.resting_state(wires.cold_states[: wires.num_wires])
    if initial_state is None:
        return rest
    state = np.asarray(initial_state, float)
    if state.shape != rest.shape or not np.isfinite(state).all():
        raise PlanningError(
            f"initial_state must be {rest.size} finite numbers, a state of this limb's `Limb`."
        )
    return state


def _refine_knots(
    times: np.ndarray, sample_times: np.ndarray, differences: np.ndarray, tolerance: float
) -> np.ndarray:
    """Return the knots with a new knot in the middle of each interval that caused a difference.

    An interval may cause a difference within it and, because the limb rings, shortly after it.

    Args:
        times: times of the knots (N,), s.
        sample_times: increasing times (M,), s.
        differences: of the bend in the plan and in simulation at these times (M,), rad.
        tolerance: largest difference of a plan, rad; half of it is to be met, so that fewer rounds
            are needed.
    """
    starts = times[:-1]
    ends = times[1:]
    bad_times = sample_times[differences > tolerance / 2]
    # An interval is to blame if bad times are between its start and some time after its end.
    num_before = np.searchsorted(bad_times, starts)
    num_until_ringing_ends = np.searchsorted(bad_times, ends + RINGING_TIME, side="right")
    is_blamed = num_until_ringing_ends > num_before
    middles = 0.5 * (starts + ends)[is_blamed]
    return np.sort(np.concatenate([times, middles]))
