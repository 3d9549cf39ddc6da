"""How near a limb came to its reference and to its plan: the numbers of Table I.

A distance between bends is ``|φ - φ'|`` of a segment. If it bends about two axes, it is that of
both angles together, √((φ2 - φ2')² + (φ3 - φ3')²), which does not depend on where +E2 is.
"""

import dataclasses
import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.simulation import PERIOD


@dataclasses.dataclass(frozen=True)
class TrackingErrors:
    """Statistics of |φ* - φ| over all samples of all rollouts, rad."""

    mean: float
    median: float
    percentile_90: float


@dataclasses.dataclass(frozen=True)
class ReferenceDistances:
    """Mean distances of bend angles from the reference over the same samples, rad.

    - ``measured``: |φ_ref - φ| of what was recorded; None without recordings.
    - ``planned``: |φ_ref - φ*| of the plan.
    - ``nearest``: distance that the limb's limits leave, of the best plan within them; None if
      it is not known.
    """

    measured: float | None
    planned: float
    nearest: float | None


def tracking_errors(trajectory: Trajectory, recordings: Sequence[Recording]) -> TrackingErrors:
    """How well rollouts followed their plan: |φ* - φ|, as in Table I.

    Args:
        trajectory: the plan φ*.
        recordings: recordings of one or more rollouts. Samples after the end of the plan
            and those without a bend do not count, nor, with a warning, those that are not
            plausible. An interrupted rollout counts as far as it came.

    Raises:
        LimbError: if there is nothing to compare.
    """
    for recording in recordings:
        if recording.implausible.any():
            warnings.warn(f"Left out of the tracking errors: {recording.doubt}.", stacklevel=2)
    plan = trajectory.since_start()
    samples = _samples(plan, recordings)
    errors = np.concatenate(
        [
            plan.model.layout.distances(plan.bend_angle_at(times) - bend).ravel()
            for times, bend in samples
        ]
    )
    return TrackingErrors(
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        percentile_90=float(np.percentile(errors, 90)),
    )


def reference_distances(
    trajectory: Trajectory,
    recordings: Sequence[Recording] = (),
    nearest: ArrayLike | None = None,
) -> ReferenceDistances:
    """How near rollouts, their plan and the best plan are to the reference, on average.

    Args:
        trajectory: the plan φ*, with its reference φ_ref, which is linear between the knots.
        recordings: recordings of rollouts, of which the samples count that count in
            `tracking_errors`; without any the plan counts over its whole time, at 20 Hz.
        nearest: bend angles of the best plan at the knots (F, K), rad, as of
            `planners.nearest_bend_angle`; None if it is not known.

    Raises:
        LimbError: if there are recordings, and nothing to compare in them.
    """
    plan = trajectory.since_start()
    if recordings:
        samples = _samples(plan, recordings)
    else:
        times = np.linspace(0.0, plan.duration, int(np.ceil(plan.duration / PERIOD)) + 1)
        samples = [(times, plan.bend_angle_at(times))]
    times = np.concatenate([times for times, _ in samples])
    wanted = plan.interpolated(plan.reference, times)

    def distance(bend: np.ndarray) -> float:
        return float(plan.model.layout.distances(wanted - bend).mean())

    return ReferenceDistances(
        measured=distance(np.hstack([bend for _, bend in samples])) if recordings else None,
        planned=distance(plan.bend_angle_at(times)),
        nearest=None if nearest is None else distance(plan.interpolated(nearest, times)),
    )


def true_bend(recording: Recording) -> Recording:
    """A recording that has the truth, as bend sensors without errors would have made it.

    Args:
        recording: emulated limb's, with its ``joint_state``.
    """
    assert recording.joint_state is not None
    angles = recording.joint_state[: recording.parameters.num_joints]
    bend = recording.model.mechanics.recorded_bend_angle(angles)
    return dataclasses.replace(recording, bend_angle=bend)


def _samples(
    plan: Trajectory, recordings: Sequence[Recording]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times (M,), s, and bend angles (F, M), rad, of each recording that count."""
    samples = []
    for recording in recordings:
        read = np.isfinite(recording.bend_angle).all(axis=0) & ~recording.implausible
        during = (recording.time <= plan.duration) & read
        samples.append((recording.time[during], recording.bend_angle[:, during]))
    if not sum(times.size for times, _ in samples):
        raise LimbError("There are no recorded samples during the plan to compare it with.")
    return samples
