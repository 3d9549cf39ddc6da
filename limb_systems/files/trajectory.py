"""A planned state-input trajectory with the record of its check."""

import dataclasses
import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.errors import LimbError
from limb_systems.files.samples import check_samples, column_names, group_columns, ungroup_columns
from limb_systems.files.tables import FileFormatError, read_table, write_table
from limb_systems.model.kinematics import bend_angle
from limb_systems.model.parameters import LimbParameters
from limb_systems.schema import dump_typed, load_typed

DEFECT_TOLERANCE = 1e-6


@dataclasses.dataclass
class ActiveConstraint:
    """A bound of eqns (18)-(20) that holds a plan back from ``start`` to ``end``, s."""

    bound: str = ""
    start: float = 0.0
    end: float = 0.0


@dataclasses.dataclass
class PlanCheck:
    """How a plan was found and what came of simulating it again.

    - ``solver``, ``status``: who solved the program, and what it said.
    - ``iterations``, ``solve_time``, ``total_time``: of the solver, s; from
      the request to the checked plan, s.
    - ``refinements``: how often knots were added to meet the tolerance.
    - ``cost``, ``guess_cost``: value of eqn (15) at the plan and at the
      quasi-static guess.
    - ``largest_defect``: of the collocation constraints as Drake evaluates
      them, acceleration scaled by M(0)/k to rad, others by their time step.
    - ``largest_difference_deg``: between the bend angle of the plan and that
      of an accurate simulation of its duty, degrees.
    - ``tolerance_deg``: what the difference was allowed to be, degrees.
    - ``active_constraints``: where the plan runs along a bound.
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
    largest_difference_deg: float = math.nan
    tolerance_deg: float = math.nan
    active_constraints: list[ActiveConstraint] = dataclasses.field(default_factory=list)

    def failure(self) -> str | None:
        """One sentence on why the plan must not be used, or None if it may."""
        if not self.largest_defect <= DEFECT_TOLERANCE:
            return (
                f"the dynamics are violated by {self.largest_defect:.1e} (scaled), "
                f"more than {DEFECT_TOLERANCE:.0e}."
            )
        if not self.largest_difference_deg <= self.tolerance_deg:
            return (
                f"simulating the planned duty ends up to {self.largest_difference_deg:.3f}° away "
                f"from the plan, more than {self.tolerance_deg:g}°; use more knots per second."
            )
        return None


@dataclasses.dataclass
class TrajectoryHeader:
    """What a trajectory's file says before its columns begin.

    - ``sample_rate_hz``: of the knots, Hz.
    - ``check``: how the plan was found and checked.
    - ``parameters``: of the limb that it was planned for.
    """

    sample_rate_hz: float
    check: PlanCheck
    parameters: LimbParameters


@dataclasses.dataclass(eq=False)
class Trajectory:
    """A feasible motion of a limb with S segments, n joints and W = 2 S wires.

    Between the K knots duty is linear and joint angles are cubic, as in
    direct collocation.

    - ``time``: of the knots (K,), s.
    - ``reference``: φ_ref (S, K), rad, what was asked for.
    - ``duty``: D (W, K), in [0, 1].
    - ``joint_state``: [θ, θ̇] (2n, K), rad and rad/s.
    - ``wire_temperature``, ``measured_temperature``: T, V (W, K), °C.
    - ``parameters``: of the limb that it was planned for.
    - ``check``: how it was found and checked.
    - ``other_wire_state``: what other states than T the wires' laws have
      (N - W, K), in the order of `Wires`; None if they have no others.

    Raises:
        LimbError: at construction, if shapes disagree, values are not finite,
            time does not increase or duty leaves [0, 1].
    """

    time: np.ndarray
    reference: np.ndarray
    duty: np.ndarray
    joint_state: np.ndarray
    wire_temperature: np.ndarray
    measured_temperature: np.ndarray
    parameters: LimbParameters
    check: PlanCheck
    other_wire_state: np.ndarray | None = None

    def __post_init__(self):
        self.parameters.validate()
        check_samples(self)
        if len(self.time) < 2:
            raise LimbError("a trajectory needs two knots at least.")

    @property
    def duration(self) -> float:
        """From the first to the last knot, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def joint_angles(self) -> np.ndarray:
        """θ at the knots (n, K), rad."""
        return self.joint_state[: self.parameters.num_joints]

    @property
    def joint_rates(self) -> np.ndarray:
        """θ̇ at the knots (n, K), rad/s."""
        return self.joint_state[self.parameters.num_joints :]

    @property
    def bend_angle(self) -> np.ndarray:
        """φ* at the knots (S, K), rad, by forward kinematics."""
        return bend_angle(self.parameters, self.joint_angles)

    @property
    def state(self) -> np.ndarray:
        """[θ, θ̇, x, V] at the knots, a column for each: states of `Limb`."""
        others = [] if self.other_wire_state is None else [self.other_wire_state]
        return np.vstack(
            [self.joint_state, self.wire_temperature, *others, self.measured_temperature]
        )

    def duty_trajectory(self) -> PiecewisePolynomial:
        """Duty between the knots, for a `TrajectorySource`."""
        return PiecewisePolynomial.FirstOrderHold(self.time, self.duty)

    def bend_angle_at(self, times: ArrayLike) -> np.ndarray:
        """φ* at any times (M,) within the trajectory, (S, M), rad."""
        if not np.isfinite(times).all():
            raise LimbError("times must be finite.")
        joints = PiecewisePolynomial.CubicHermite(self.time, self.joint_angles, self.joint_rates)
        return bend_angle(self.parameters, joints.vector_values(np.asarray(times, float)))

    @classmethod
    def load(cls, path: str | Path) -> "Trajectory":
        """Reads a trajectory's file.

        Raises:
            FileFormatError: one sentence that says what is wrong and where.
        """
        header_text, columns = read_table(path, "trajectory")
        try:
            header = load_typed(TrajectoryHeader, header_text)
            header.parameters.validate()
            signals = group_columns(columns, column_names(header.parameters))
            del signals["bend_angle"]  # it follows from the joint angles
            return cls(**signals, parameters=header.parameters, check=header.check)
        except LimbError as error:
            raise FileFormatError(f"{path}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Writes the trajectory whole or not at all.

        Raises:
            LimbError: if its check failed; such a plan is not written.
        """
        if failure := self.check.failure():
            raise LimbError(f"This plan failed its check and is not saved: {failure}")
        sample_rate = (len(self.time) - 1) / self.duration
        header = TrajectoryHeader(sample_rate, self.check, self.parameters)
        columns = ungroup_columns(self, column_names(self.parameters))
        write_table(path, "trajectory", dump_typed(header), columns)
