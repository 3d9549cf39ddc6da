"""Rollouts: drive a limb along a plan with a controller, and summarize the result."""

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
from limb_systems.files.output import OutputError
from limb_systems.limb_system import check_limb
from limb_systems.summary import Entry, Summary
from limb_systems.tracking import ReferenceDistances, reference_distances, tracking_errors
from planners import nearest_bend_angle
from soft_limb.results.summaries import distances_summary, troubles
from soft_limb.runs import CONTROLLERS, OPEN_LOOP

# The controller with the smallest distance from references, on limbs of several physics.
DEFAULT_FEEDBACK = "receding-horizon"
UNEXPLAINED_TIME = 5.0  # s of disagreement between bend and heat, after which the user is warned


@dataclasses.dataclass(frozen=True)
class Rollout:
    """The result of driving a limb along a plan.

    - ``controller``: key of the controller in `CONTROLLERS`.
    - ``trajectory``, ``recording``: the plan and its recording.
    - ``late``: time by which each command was late, s; None in simulated time.
    - ``lost_samples``: number of samples that the cable lost; None in simulated time.
    - ``replans``: numbers of plans that were begun, late and failed (3,); None for controllers
      that do not plan.
    """

    controller: str
    trajectory: Trajectory
    recording: Recording
    late: np.ndarray | None
    lost_samples: int | None
    replans: np.ndarray | None

    @functools.cached_property
    def distances(self) -> ReferenceDistances:
        """The mean distances of limb, plan and best plan within the limits from the reference."""
        nearest = nearest_bend_angle(self.trajectory)
        recordings = [self.recording] if self.has_bend else []
        return reference_distances(self.trajectory, recordings, nearest)

    @property
    def has_bend(self) -> bool:
        """True if a bend was measured; some boards have no bend sensor."""
        return bool(np.isfinite(self.recording.bend_angle).any())

    def summary(self) -> Summary:
        """Return the distances from reference and plan, temperatures, timing and problems."""
        # Find the highest plausible reading of each wire.
        recording = self.recording
        readings = recording.measured_temperature[:, ~recording.implausible]
        hottest = [max(row[np.isfinite(row)].tolist(), default=None) for row in readings]
        texts = []
        for name, value in zip(recording.parameters.wire_names, hottest, strict=True):
            if value is not None:
                texts.append(f"{name} {value:.0f} °C")
        heat = f"read at most: {', '.join(texts)}" if texts else "not measured"
        # Begin with the distances from the reference.
        return distances_summary(self.distances) + Summary(
            [
                self._tracking(),
                Entry("highest_readings_c", hottest, sentence=None),
                Entry("heat", sentence=heat),
                self._timing(),
                Entry("source", recording.source),
                Entry("controller", self.controller, sentence=None),
                self._replans(),
                self._unexplained(),
                *troubles(recording).entries,
            ]
        )

    def _tracking(self) -> Entry:
        """Return mean, median and 90th percentile of the tracking error."""
        if not self.has_bend:
            return Entry("tracking", sentence="not known, as no bend was measured")
        errors = tracking_errors(self.trajectory, [self.recording])
        degrees = np.rad2deg([errors.mean, errors.median, errors.percentile_90])
        mean, median, percentile_90 = degrees.tolist()
        text = f"mean {mean:.2f}°, median {median:.2f}°, 90th percentile {percentile_90:.2f}°"
        return Entry(
            "tracking",
            {"mean_deg": mean, "median_deg": median, "percentile_90_deg": percentile_90},
            "°",
            f"|φ* - φ|: {text}",
        )

    def _unexplained(self) -> Entry:
        """Return the longest disagreement of bend and heat; a sentence if it is no model error."""
        if not self.has_bend:
            return Entry("unexplained")
        seconds, angle = Estimator(self.trajectory.parameters).unexplained(self.recording)
        values = {"longest_s": seconds, "most_deg": float(np.rad2deg(angle))}
        text = (
            f"for {seconds:.0f} s the bend was read up to {values['most_deg']:.1f}° from where "
            "heat and rest angle explain it; look whether the bend sensor has drifted or the limb "
            "is loaded, and else calibrate it"
        )
        if self.trajectory.parameters.calibration:
            text += " again"
        return Entry("unexplained", values, sentence=text if seconds > UNEXPLAINED_TIME else None)

    def _timing(self) -> Entry:
        """Return the delays of commands, lost samples, and the time of reduced duty."""
        if self.late is None:
            return Entry("timing")
        # Count late commands, and the time for which the board reduced the duty.
        median, percentile_99 = 1000 * np.percentile(self.late, [50, 99])
        num_missed = int(np.sum(self.late > COMMAND_DEADLINE))
        missed_share = num_missed / len(self.late)
        reduced = reduced_time(self.recording)
        # Put them into words.
        text = (
            f"commands were late by {median:.1f} ms (median), {percentile_99:.1f} ms (99%); "
            f"{num_missed} ({missed_share:.1%}) by more than {1000 * COMMAND_DEADLINE:g} ms; "
            f"{self.lost_samples} samples were lost"
        )
        if reduced:
            text += (
                f"; the board reduced the duty for {reduced:.1f} s: a wire got hot, the total duty "
                "was too high, or the board had just started"
            )
        values = {
            "late_median_ms": float(median),
            "late_percentile_99_ms": float(percentile_99),
            "missed_deadline": num_missed,
            "missed_deadline_share": missed_share,
            "lost_samples": self.lost_samples,
            "reduced_s": reduced,
        }
        return Entry("timing", values, sentence=text)

    def _replans(self) -> Entry:
        """Return the numbers of plans that a receding horizon began, completed late and failed."""
        if self.replans is None:
            return Entry("replans")
        begun, late, failed = self.replans.astype(int).tolist()
        counts = {"begun": begun, "late": late, "failed": failed}
        return Entry("replans", counts, sentence=f"{begun} begun, {late} late, {failed} failed")


def roll_out(
    trajectory: Trajectory,
    make_limb: Callable[[], LimbSystem],
    output: Path,
    *,
    controller: str = OPEN_LOOP,
    real_time: bool = False,
    live: LiveView | None = None,
) -> Rollout:
    """Drive a limb along a plan and write the recording; errors as in `replay`.

    Args:
        make_limb: function that returns the limb; it is called after the controller is made.
        output: file of the recording, which is written while the limb runs.
        controller: key in `CONTROLLERS`.
        real_time: whether the limb is a robot.
    """
    # Make the controller before the limb: the board waits for no computation.
    driver = make_controller(controller, trajectory, real_time=real_time)
    limb = make_limb()
    if kind := CONTROLLERS[controller]:
        limb.source += f", driven by {kind}"
    # Drive it.
    recording = record_replay(trajectory, limb, output, controller=driver, live=live)
    robot = limb if isinstance(limb, SerialLimb) else None
    return Rollout(
        controller,
        trajectory,
        recording,
        np.array(robot.timing_errors) if robot else None,
        robot.link.lost_samples if robot else None,
        driver.counts if isinstance(driver, RecedingHorizon) else None,
    )


def record_replay(
    trajectory: Trajectory,
    limb: LimbSystem,
    output: Path,
    *,
    controller: System | None = None,
    live: LiveView | None = None,
) -> Recording:
    """Replay a plan, and write each sample to a file when it arrives, see `TableWriter`.

    Raises:
        OutputError: see `replay`; the samples until then are in an unfinished file.
    """
    is_slow = check_limb(limb).real_time or live is not None
    recording = replay(trajectory, limb, controller=controller, journal=output, live=live)
    if not is_slow:
        try:
            recording.save(output)  # again, with the true state of an emulation
        except OutputError as error:
            error.add_note(f"{output} has what was measured, without the emulation's true state.")
            raise
    return recording


def make_controller(name: str, trajectory: Trajectory, *, real_time: bool = False) -> System | None:
    """Return a controller by its key in `CONTROLLERS`; None for open loop."""
    kind = CONTROLLERS[name]
    if kind == "RecedingHorizon":
        return RecedingHorizon(trajectory, real_time=real_time)
    return getattr(controllers, kind)(trajectory) if kind else None


def reduced_time(recording: Recording) -> float:
    """Return the time for which the board applied less than the commanded duty, s."""
    assert recording.applied_duty is not None  # every robot measures it
    # A sample may belong to the command before or after: take the smaller of the two.
    commanded = np.minimum(recording.duty[:, :-2], recording.duty[:, 1:-1])
    reduced = (recording.applied_duty[:, 2:] < commanded - 2e-3).any(axis=0)
    return float(np.sum(reduced) / recording.sample_rate)
