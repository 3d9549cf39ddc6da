"""Tracking errors: distances of a limb from its plan and from its reference, as in Table I.

The distance between bends of a segment is ``|φ - φ'|``. If the segment bends about two axes, it is
the distance of both angles, √((φ2 - φ2')² + (φ3 - φ3')²), which does not depend on the direction
of +E2.
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

    - ``measured``: |φ_ref - φ| of the recordings; None without recordings.
    - ``planned``: |φ_ref - φ*| of the plan.
    - ``nearest``: distance of the best plan within the limb's limits; None if unknown.
    """

    measured: float | None
    planned: float
    nearest: float | None


def tracking_errors(trajectory: Trajectory, recordings: Sequence[Recording]) -> TrackingErrors:
    """Return statistics of the tracking error |φ* - φ| of rollouts, as in Table I.

    Args:
        trajectory: the plan φ*.
        recordings: recordings of one or more rollouts. Samples after the end of the plan and
            samples without a bend do not count. Implausible samples do not count, with a
            warning. An interrupted rollout counts until its end.

    Raises:
        LimbError: if there is nothing to compare.
    """
    # Warn of samples that are left out.
    for recording in recordings:
        if recording.implausible.any():
            warnings.warn(f"Left out of the tracking errors: {recording.doubt}.", stacklevel=2)
    plan = trajectory.since_start()
    times, bends = _samples(plan, recordings)
    errors = plan.model.layout.distances(plan.bend_angle_at(times) - bends)
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
    """Return the mean distances of rollouts, their plan and the best plan from the reference.

    Args:
        trajectory: the plan φ*, with its reference φ_ref, which is linear between the knots.
        recordings: recordings of rollouts; the same samples count as in `tracking_errors`.
            Without recordings the plan counts over its whole time, at 20 Hz.
        nearest: bend angles of the best plan at the knots (F, K), rad, from
            `planners.nearest_bend_angle`; None if unknown.

    Raises:
        LimbError: if there are recordings, and nothing to compare in them.
    """
    plan = trajectory.since_start()
    # Collect the samples to compare.
    if recordings:
        times, bends = _samples(plan, recordings)
    else:
        times = np.linspace(0.0, plan.duration, int(np.ceil(plan.duration / PERIOD)) + 1)
    reference = plan.interpolated(plan.reference, times)

    def distance(bend: np.ndarray) -> float:
        """Return the mean distance of bends (F, M), rad, from the reference."""
        return float(plan.model.layout.distances(reference - bend).mean())

    return ReferenceDistances(
        measured=distance(bends) if recordings else None,
        planned=distance(plan.bend_angle_at(times)),
        nearest=None if nearest is None else distance(plan.interpolated(nearest, times)),
    )


def true_bend(recording: Recording) -> Recording:
    """Return a recording whose bend angles are replaced by the readings of sensors without errors.

    Args:
        recording: recording of an emulated limb, with its ``joint_state``.
    """
    assert recording.joint_state is not None
    # Calculate the bends from the joint angles.
    angles = recording.joint_state[: recording.parameters.num_joints]
    bend = recording.model.mechanics.recorded_bend_angle(angles)
    return dataclasses.replace(recording, bend_angle=bend)


def _samples(plan: Trajectory, recordings: Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Return times (M,), s, and bend angles (F, M), rad, of all recordings' samples that count."""
    times = [np.empty(0)]
    bends = [np.empty((plan.model.layout.num_bends, 0))]
    for recording in recordings:
        has_bend = np.isfinite(recording.bend_angle).all(axis=0)
        counts = has_bend & ~recording.implausible & (recording.time <= plan.duration)
        times.append(recording.time[counts])
        bends.append(recording.bend_angle[:, counts])
    all_times = np.concatenate(times)
    if not all_times.size:
        raise LimbError("There are no recorded samples during the plan to compare it with.")
    return all_times, np.hstack(bends)
