"""A gait: one cycle of a robot that walks, in which everything but travel repeats."""

import dataclasses
import math
from typing import Any, ClassVar

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.signal_table import Planned, clip_rounding, not_saved, signal
from limb_systems.summary import Entry, Summary
from walking.robot import body_positions
from walking.robot_parameters import RobotParameters

CONTACTS = ("stick", "slide_forward", "slide_backward", "slide", "swing")
VIOLATION_TOLERANCE = 1e-6
STRIDE_TOLERANCE = 0.05  # share of the planned stride by which each simulated one may differ
# Strides may differ more in space, where feedback sees by a camera how far the robot goes.
STRIDE_TOLERANCE_IN_SPACE = 0.1
ASIDE_TOLERANCE = 0.1  # share of the planned stride, aside of it
NUM_REPLAYED_CYCLES = 3  # cycles that a page replays


@dataclasses.dataclass
class GaitPhase:
    """A phase of a gait's cycle, which ends when the next begins.

    - ``start``: s from the start of the cycle.
    - ``contacts``: the contact of each limb's foot, one of `CONTACTS`.
    """

    start: float
    contacts: list[str]


@dataclasses.dataclass
class GaitVariation:
    """The simulation of a gait's duty on a robot and ground.

    - ``what``: the change from the description, such as "friction x 0.7".
    - ``strides``: each stride as a share of the planned stride; a turn counts as the way of a point
      that is a limb's length away.
    - ``highest_temperature``: largest T of any wire, °C.
    - ``fall``: how the robot fell; empty if it did not.
    - ``aside``: travel aside of the planned stride in each cycle, turn included, as a share of the
      planned stride; empty in the plane.
    """

    what: str = ""
    strides: list[float] = dataclasses.field(default_factory=list)
    highest_temperature: float = math.nan
    fall: str = ""
    aside: list[float] = dataclasses.field(default_factory=list)

    @property
    def settled_strides(self) -> list[float]:
        """The strides after the first, which is still settling; the first if it is the only one."""
        return self.strides[1:] or self.strides

    @property
    def settled_aside(self) -> list[float]:
        """The travel aside in the same cycles."""
        return self.aside[1:] or self.aside


@dataclasses.dataclass
class GaitCheck:
    """The result of planning a gait, and of simulating it with contact.

    - ``solver``, ``status``: name of the solver, and its status.
    - ``objective``: "speed" or "energy".
    - ``iterations``, ``solve_time``: iterations and time of the solver, s.
    - ``violation``: largest violation of the program's constraints, scaled.
    - ``simulation``: the gait as planned; without strides if it was not simulated.
    - ``spread``: the gait on robots and grounds that differ from the description.
    - ``tolerance``: share of the planned stride by which a simulated one may differ.
    - ``steadiness``: least stiffness against pitch, as a multiple of weight times limb length.
    - ``sticking_share``: share of μ that feet that stick may use.
    - ``remark``: why it is not as steady as requested, or, in space, uses less friction; empty if
      it is as requested.
    - ``checked_by``: the engines that simulated it; empty if none did.
    - ``made``: the gait's stride as a share of the program's stride; the gait gets the stride of
      the simulation.
    """

    solver: str = ""
    status: str = ""
    objective: str = ""
    iterations: int = 0
    solve_time: float = 0.0
    violation: float = math.nan
    simulation: GaitVariation = dataclasses.field(default_factory=GaitVariation)
    spread: list[GaitVariation] = dataclasses.field(default_factory=list)
    tolerance: float = STRIDE_TOLERANCE
    steadiness: float = math.nan
    sticking_share: float = math.nan
    remark: str = ""
    checked_by: str = ""
    made: float = 1.0

    @property
    def is_missing(self) -> bool:
        """True if the gait was never simulated."""
        return not (self.simulation.strides or self.simulation.fall)

    def failure(self) -> str | None:
        """One sentence on why the gait must not be used, or None if it may."""
        if not self.violation <= VIOLATION_TOLERANCE:
            return (
                f"its constraints are violated by {self.violation:.1e} (scaled), more than "
                f"{VIOLATION_TOLERANCE:.0e}."
            )
        if self.is_missing:
            return "it was never checked by simulating it."
        if self.simulation.fall:
            return f"the robot falls in simulation: {self.simulation.fall}."
        worst = max(self.simulation.settled_strides, key=lambda share: abs(share - 1))
        if not abs(worst - 1) <= self.tolerance:
            return (
                f"in simulation a stride is {worst:.1%} of the planned one, which misses it by "
                f"more than {self.tolerance:.0%}."
            )
        if (aside := max(self.simulation.settled_aside, default=0.0)) > ASIDE_TOLERANCE:
            return (
                f"in simulation it goes or turns aside by {aside:.1%} of the planned stride, more "
                f"than {ASIDE_TOLERANCE:.0%}."
            )
        return None


@dataclasses.dataclass(eq=False, repr=False, kw_only=True)
class Gait(Planned):
    """One cycle of a robot with L limbs, F bends, n joints and W wires in all.

    The robot is in balance at each of the K knots. The last knot is the first knot again, a
    stride further, and turned: heat, states of wires, angles and forces are equal. Duty is constant
    from each knot to the next.

    - ``time``: time of the knots (K,), s, from 0 to the period.
    - ``duty``: D (W, K), in [0, 1], from each knot on.
    - ``joint_state``: [θ, θ̇] (2n, K), rad and rad/s, of the limbs' joints.
    - ``wire_temperature``, ``measured_temperature``: T, V (W, K), °C.
    - ``body_pose``: x, z, m, and θ, rad, from +x towards +z (3, K); in space x, y, z, m, and roll,
      pitch and yaw, rad (6, K).
    - ``contact_force``: force from the ground on each foot along x and z (2L, K), N; in space along
      x, y and z (3L, K).
    - ``robot``: the robot; ``parameters`` are all its limbs together.
    - ``phases``: contacts of the feet, `GaitPhase`.
    - ``check``: result of planning and simulation.
    - ``other_wire_state``: the states of the wires' laws other than T (N - W, K), in the order
      of `Wires`; None if there are no others.
    - ``provenance``: software and inputs that made it; None if unknown.

    Raises:
        LimbError: at construction, if shapes disagree, values are not finite, time does not
            increase from 0, duty leaves [0, 1], or a phase is not within the cycle.
    """

    KIND: ClassVar[str] = "gait"
    HOLDS_DUTY: ClassVar[bool] = True

    robot: RobotParameters = dataclasses.field()  # without the default of `Samples`
    phases: list[GaitPhase]
    check: GaitCheck
    provenance: Provenance | None = None
    time: np.ndarray = signal()
    duty: np.ndarray = signal()
    joint_state: np.ndarray = signal()
    wire_temperature: np.ndarray = signal()
    measured_temperature: np.ndarray = signal()
    body_pose: np.ndarray = signal()
    contact_force: np.ndarray = signal()
    other_wire_state: np.ndarray | None = not_saved(None)

    def __post_init__(self):
        self.robot.validate()
        self.parameters = self.robot.as_single_limb
        self._check()
        if len(self.time) < 3 or self.time[0] != 0:
            raise LimbError("a gait needs at least three knots, the first of them at 0 s.")
        starts = self.phase_starts
        if starts != sorted(starts) or not starts or starts[0] != 0 or starts[-1] >= self.period:
            raise LimbError(
                f"the phases begin at {starts} s; they must begin one after the other from 0 s to "
                f"the period of {self.period:g} s."
            )
        for phase in self.phases:
            if len(phase.contacts) != len(self.robot.limbs) or set(phase.contacts) - {*CONTACTS}:
                raise LimbError(
                    f"the phase at {phase.start:g} s has the contacts {phase.contacts}; it must "
                    f"have one of {', '.join(CONTACTS)} for each of {len(self.robot.limbs)} limbs."
                )

    @property
    def in_space(self) -> bool:
        """True if the body moves in space, False if in the vertical plane."""
        return len(self.body_pose) == 6

    @property
    def displacement(self) -> np.ndarray:
        """Travel of the body in a cycle (1,) or (3,), see `body_travel`."""
        return body_travel(self.body_pose[:, [0, -1]])[:, 0]

    @property
    def stride(self) -> float:
        """Travel of the body in a cycle, m."""
        return float(np.linalg.norm(self.displacement[:2]))

    @property
    def period(self) -> float:
        """Duration of a cycle, s."""
        return float(self.time[-1])

    @property
    def speed(self) -> float:
        """Stride by period, m/s."""
        return self.stride / self.period

    @property
    def turn(self) -> float:
        """Turn of the body to the left in a cycle, rad; 0 in the plane."""
        return float(self.displacement[2]) if self.in_space else 0.0

    @property
    def on_the_spot(self) -> bool:
        """True if the gait has no stride, so that the robot turns on the spot."""
        return self.stride < 1e-6

    @property
    def reach(self) -> float:
        """Travel in a cycle, m; a turn on the spot counts by the way at a limb's length."""
        if not self.on_the_spot:
            return self.stride
        return self.robot.longest_limb * abs(self.turn)

    @property
    def merit(self) -> float:
        """The maximized value: `reach` by time, or by time of full duty of a wire, m/s."""
        if self.check.objective != "energy":
            return self.reach / self.period
        return self.reach / float(np.diff(self.time) @ self.duty[:, :-1].sum(axis=0))

    @property
    def schedule(self) -> list[list[str]]:
        """The contact of each foot in each phase (P, L)."""
        return [phase.contacts for phase in self.phases]

    @property
    def phase_starts(self) -> list[float]:
        """Times at which the phases begin (P,), s."""
        return [phase.start for phase in self.phases]

    @property
    def intervals(self) -> list[int]:
        """Number of intervals between knots of each phase (P,)."""
        edges = [*self.phase_starts, self.period]
        return np.diff(np.searchsorted(self.time, edges)).tolist()

    @property
    def initial_heat(self) -> np.ndarray:
        """[x, V] of the wires at the first knot (N + W,)."""
        return np.append(self.wire_states[:, 0], self.measured_temperature[:, 0])

    @property
    def initial_state(self) -> np.ndarray:
        """State of a `Robot` at rest at the first knot, for `simulate`."""
        pose = self.body_pose[:, 0]
        angles = self.joint_angles[:, 0]
        rates = np.zeros(len(pose) + len(angles))
        return np.concatenate([body_positions(pose), angles, rates, self.initial_heat])

    def duty_trajectory(self, cycles: int = 1) -> PiecewisePolynomial:
        """Duty over some cycles from time 0, for a `TrajectorySource`."""
        starts = np.arange(cycles)[:, None] * self.period
        times = np.append((starts + self.time[:-1]).ravel(), cycles * self.period)
        duty = np.hstack([*[self.duty[:, :-1]] * cycles, self.duty[:, :1]])
        return PiecewisePolynomial.ZeroOrderHold(times, clip_rounding(duty))

    @property
    def origin(self) -> str:
        """The origin of the motion, for a caption."""
        return f"planned gait, {NUM_REPLAYED_CYCLES} cycles, nothing measured"

    def for_replay(self) -> "Gait":
        """Return the cycles that a page replays."""
        return self.repeated(NUM_REPLAYED_CYCLES)

    def repeated(self, cycles: int) -> "Gait":
        """Return a gait whose single cycle is some cycles of this gait, one after the other."""

        def join(parts: list[np.ndarray]) -> np.ndarray:
            """Join cycles (..., K), each of which ends at the first knot of the next."""
            return np.concatenate([*(part[..., :-1] for part in parts), parts[-1][..., -1:]], -1)

        # Body and forces begin each cycle where the body was at the end of the last.
        forces = self.contact_force.reshape(len(self.robot.limbs), -1, len(self.time))
        cycle_poses = []
        cycle_forces = []
        phases = []
        start = self.body_pose[:, 0]
        for cycle in range(cycles):
            pose = self.moved(start)
            yaw = pose[-1, 0] - self.body_pose[-1, 0] if len(pose) == 6 else 0.0
            cycle_poses.append(pose)
            cycle_forces.append(rotate_to_heading(forces.swapaxes(0, 1), -yaw).swapaxes(0, 1))
            start = pose[:, -1]
            for phase in self.phases:
                phases.append(GaitPhase(phase.start + cycle * self.period, phase.contacts))

        # All other signals repeat.
        names = ["duty", "joint_state", "wire_temperature", "measured_temperature"]
        names += ["other_wire_state"] if self.other_wire_state is not None else []
        repeating: dict[str, Any] = {name: join([getattr(self, name)] * cycles) for name in names}
        return dataclasses.replace(
            self,
            time=np.array(self.duty_trajectory(cycles).get_segment_times()),
            body_pose=join(cycle_poses),
            contact_force=join(cycle_forces).reshape(len(self.contact_force), -1),
            **repeating,
            phases=phases,
        )

    def progress(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the travel of cycles as shares of the planned stride.

        Turns count by the way of a point that is a limb's length away.

        Args:
            poses: poses of the body between the cycles (3 or 6, K).

        Returns:
            The travel along the planned stride, and aside of it (K - 1,), as shares of it.
        """
        scales = np.array([1.0, 1.0, self.robot.longest_limb])[: len(self.displacement)]
        planned = self.displacement * scales
        measured = body_travel(poses).T * scales
        along = measured @ planned / (planned @ planned)
        aside = np.linalg.norm(measured - along[:, None] * planned, axis=1)
        return along, aside / np.linalg.norm(planned)

    def moved(self, start: np.ndarray) -> np.ndarray:
        """Return the body's pose (3 or 6, K) in a cycle that begins at the place of a pose.

        Args:
            start: pose of the body (3,) or (6,), of which x, y and yaw count.
        """
        pose = self.body_pose.copy()
        if len(pose) == 3:
            pose[0] += start[0] - pose[0, 0]
            return pose
        turn = start[5] - pose[5, 0]
        pose[:2] = rotate_to_heading(pose[:2] - pose[:2, :1], -turn) + start[:2, None]
        pose[5] += turn
        return pose

    def summary(self) -> Summary:
        """Summarize stride, turn, period, speed, largest temperature, and the check."""
        travels = []
        speeds = []
        if not self.on_the_spot:
            travels.append(Entry("stride", self.stride, "m", f"stride {1e3 * self.stride:.1f} mm"))
            speeds.append(Entry("speed", self.speed, "m/s", f"{1e3 * self.speed:.2f} mm/s"))
        turn_deg = np.rad2deg(self.turn)
        if abs(turn_deg) > 1e-6:
            rate = self.turn / self.period
            travels.append(Entry("turn", self.turn, "rad", f"turn {turn_deg:.1f}°"))
            speeds.append(Entry("turn_rate", rate, "rad/s", f"{np.rad2deg(rate):.2f} °/s"))
        temperature = float(self.wire_temperature.max())
        return Summary(
            [
                *travels,
                Entry("period", self.period, "s", f"period {self.period:.1f} s"),
                *speeds,
                Entry("heat", temperature, "°C", f"up to {temperature:.0f} °C"),
                self._check_entry,
            ]
        )


def rotate_to_heading(vectors: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    """Return vectors of the world in axes turned by a yaw, rad.

    Args:
        vectors: x, y and any other components (2 or more, ...).
    """
    x, y, *rest = vectors
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, *rest])


def body_travel(poses: np.ndarray) -> np.ndarray:
    """Return the travel of a body between poses (3 or 6, K), in the heading before each travel.

    Returns:
        Along x (1, K - 1), m; in space along x and y, m, and the turn, rad (3, K - 1).
    """
    if len(poses) == 3:
        return np.diff(poses[:1])
    yaw = np.unwrap(poses[5])
    return np.vstack([rotate_to_heading(np.diff(poses[:2]), yaw[:-1]), np.diff(yaw)])
