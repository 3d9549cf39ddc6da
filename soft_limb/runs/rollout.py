"""Rollouts: a limb is driven along a plan by what the command line names, and how that went."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.systems.framework import System

import controllers
from controllers import RecedingHorizon
from controllers.estimator import Estimator
from hardware.board.serial_limb import COMMAND_DEADLINE, SerialLimb
from hardware.live_feed import LiveView
from hardware.replaying import replay
from limb_systems import LimbSystem, Recording, Trajectory
from limb_systems.drake_python import weak_method
from limb_systems.files.output import OutputError
from limb_systems.limb_system import check_limb
from limb_systems.simulation import PERIOD
from limb_systems.summary import Entry, Summary
from limb_systems.tracking import ReferenceDistances, reference_distances, tracking_errors
from planners import nearest_bend_angle
from soft_limb.results.summaries import distances_summary, troubles
from soft_limb.runs import CONTROLLERS, OPEN

# The controller that has come nearest to references, on limbs of several physics.
NEAREST = "receding-horizon"
UNEXPLAINED_TIME = 5.0  # s, that a bend may be read otherwise than explained before a user is told


@dataclasses.dataclass(frozen=True)
class Rollout:
    """How a limb was driven along a plan.

    - ``controller``: key of the controller in `CONTROLLERS`.
    - ``trajectory``, ``recording``: the plan and what came of it.
    - ``late``: time by which each command was late, s; None in simulated time.
    - ``lost_samples``: number of samples that the cable lost; None in simulated time.
    - ``replans``: how many plans were begun, late and failed; None if none were to be made.
    - ``limb``: the limb that was driven; a robot's port is closed.
    """

    controller: str
    trajectory: Trajectory
    recording: Recording
    late: np.ndarray | None
    lost_samples: int | None
    replans: np.ndarray | None
    limb: LimbSystem | None = None

    @functools.cached_property
    def distances(self) -> ReferenceDistances:
        """How near limb, plan and the best plan within the limits are to the reference."""
        nearest = nearest_bend_angle(self.trajectory)
        recordings = [self.recording] if self.has_bend else []
        return reference_distances(self.trajectory, recordings, nearest)

    @property
    def has_bend(self) -> bool:
        """Whether a bend was measured, which not all boards do."""
        return bool(np.isfinite(self.recording.bend_angle).any())

    def summary(self) -> Summary:
        """How near the limb came to the reference and to the plan, and what went wrong."""
        recording = self.recording
        read = recording.measured_temperature[:, ~recording.implausible]
        hottest = [max(row[np.isfinite(row)].tolist(), default=None) for row in read]
        heat = ", ".join(
            f"{name} {value:.0f} °C"
            for name, value in zip(recording.parameters.wire_names, hottest, strict=True)
            if value is not None
        )
        return distances_summary(self.distances) + Summary(
            [
                self._tracking(),
                Entry("highest_readings_c", hottest, sentence=None),
                Entry("heat", sentence=f"read at most: {heat}" if heat else "not measured"),
                self._timing(),
                Entry("source", recording.source),
                Entry("controller", self.controller, sentence=None),
                self._replans(),
                self._unexplained(),
                *troubles(recording).entries,
            ]
        )

    def _tracking(self) -> Entry:
        if not self.has_bend:
            return Entry("tracking", sentence="not known, as no bend was measured")
        errors = tracking_errors(self.trajectory, [self.recording])
        mean, median, most = np.rad2deg([errors.mean, errors.median, errors.percentile_90]).tolist()
        return Entry(
            "tracking",
            {"mean_deg": mean, "median_deg": median, "percentile_90_deg": most},
            "°",
            f"|φ* - φ|: mean {mean:.2f}°, median {median:.2f}°, 90th percentile {most:.2f}°",
        )

    def _unexplained(self) -> Entry:
        """Whether wires, heat and bend disagreed for longer than the calibration's errors last."""
        if not self.has_bend:
            return Entry("unexplained")
        seconds, most = Estimator(self.trajectory.parameters).unexplained(self.recording)
        values = {"longest_s": seconds, "most_deg": float(np.rad2deg(most))}
        said = (
            f"for {seconds:.0f} s the bend was read up to {values['most_deg']:.1f}° from where "
            "heat and rest angle explain it; look whether the bend sensor has drifted or the limb "
            "is loaded, and else calibrate it again"
        )
        return Entry("unexplained", values, sentence=said if seconds > UNEXPLAINED_TIME else None)

    def _timing(self) -> Entry:
        if self.late is None:
            return Entry("timing")
        median, most = 1000 * np.percentile(self.late, [50, 99])
        missed, reduced = int(np.sum(self.late > COMMAND_DEADLINE)), reduced_time(self.recording)
        said = (
            f"commands were late by {median:.1f} ms (median), {most:.1f} ms (99%); {missed} "
            f"({missed / len(self.late):.1%}) by more than {1000 * COMMAND_DEADLINE:g} ms; "
            f"{self.lost_samples} samples were lost"
        )
        if reduced:
            said += (
                f"; the duty was reduced for {reduced:.1f} s, as a wire got hot, all asked for "
                "too much or the board was just started"
            )
        values = {
            "late_median_ms": float(median),
            "late_percentile_99_ms": float(most),
            "missed_deadline": missed,
            "missed_deadline_share": missed / len(self.late),
            "lost_samples": self.lost_samples,
            "reduced_s": reduced,
        }
        return Entry("timing", values, sentence=said)

    def _replans(self) -> Entry:
        if self.replans is None:
            return Entry("replans")
        counts = dict(
            zip(("begun", "late", "failed"), self.replans.astype(int).tolist(), strict=True)
        )
        said = ", ".join(f"{count} {what}" for what, count in counts.items())
        return Entry("replans", counts, sentence=said)


def roll_out(
    trajectory: Trajectory,
    make_limb: Callable[[], LimbSystem],
    output: Path,
    *,
    controller: str = OPEN,
    real_time: bool = False,
    live: LiveView | None = None,
) -> Rollout:
    """Drives a limb along a plan and writes the recording.

    Args:
        make_limb: function that gives the limb once its controller is there.
        output: file of the recording; that of a limb in real time is written while it runs.
        controller: key in `CONTROLLERS`.
        real_time: whether the limb is a robot.
        live: page on which the limb is shown, as for `replay`.

    Raises:
        ReplayError, HardwareError, OutputError, LimbError: as `replay` does.
    """
    driver = controller_of(controller, trajectory, real_time=real_time)
    limb = make_limb()
    if kind := CONTROLLERS[controller]:
        limb.source += f", driven by {kind}"
    recording = record_replay(trajectory, limb, output, controller=driver, live=live)
    robot = limb if isinstance(limb, SerialLimb) else None
    return Rollout(
        controller,
        trajectory,
        recording,
        np.array(robot.timing_errors) if robot else None,
        robot.link.lost_samples if robot else None,
        driver.counts if isinstance(driver, _CountingHorizon) else None,
        limb,
    )


def record_replay(
    trajectory: Trajectory,
    limb: LimbSystem,
    output: Path,
    *,
    controller: System | None = None,
    live: LiveView | None = None,
) -> Recording:
    """Replay a plan into a file, to which each sample goes on the way, see `TableWriter`.

    Raises:
        OutputError: as for `replay`; what was recorded until then is in an unfinished file.
    """
    is_slow = check_limb(limb).real_time or live is not None
    recording = replay(trajectory, limb, controller=controller, journal=output, live=live)
    if not is_slow:
        try:
            recording.save(output)  # again, with what an emulation knows besides
        except OutputError as error:
            error.add_note(f"What was measured is in {output}, without what only emulations show.")
            raise
    return recording


def controller_of(name: str, trajectory: Trajectory, *, real_time: bool = False) -> System | None:
    """A controller by its key in `CONTROLLERS`; None for open loop."""
    kind = CONTROLLERS[name]
    if kind == "RecedingHorizon":
        return _CountingHorizon(trajectory, real_time)
    return getattr(controllers, kind)(trajectory) if kind else None


def reduced_time(recording: Recording) -> float:
    """Time for which the board applied less than a duty that was commanded before and after, s."""
    assert recording.applied_duty is not None  # a robot's
    commanded = np.minimum(recording.duty[:, :-2], recording.duty[:, 1:-1])
    reduced = (recording.applied_duty[:, 2:] < commanded - 2e-3).any(axis=0)
    return float(np.sum(reduced) / recording.sample_rate)


class _CountingHorizon(RecedingHorizon):
    """A `RecedingHorizon` that remembers what it counted, after a simulation and its Context.

    - ``counts``: what its output ``replans`` was last (3,).
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, trajectory: Trajectory, real_time: bool):
        super().__init__(trajectory, real_time=real_time)
        self.counts = np.zeros(3)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._count))

    def _count(self, context) -> None:
        self.counts = self.GetOutputPort("replans").Eval(context).copy()
