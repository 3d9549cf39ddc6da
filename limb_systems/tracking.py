"""How well a limb followed its plan: the numbers of Table I."""

import dataclasses
import warnings
from collections.abc import Sequence

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory


@dataclasses.dataclass(frozen=True)
class TrackingErrors:
    """Statistics of |φ* - φ| over all samples of all rollouts, rad."""

    mean: float
    median: float
    percentile_90: float


def tracking_errors(trajectory: Trajectory, recordings: Sequence[Recording]) -> TrackingErrors:
    """The tracking errors of Table I.

    Args:
        trajectory: the plan φ*.
        recordings: recordings of one or more rollouts. Samples after the end of the plan
            and missing ones do not count, nor, with a warning, those that are not plausible.
            An interrupted rollout counts as far as it came.

    Raises:
        LimbError: if there is nothing to compare.
    """
    errors, plan = [], trajectory.since_start()
    for recording in recordings:
        if recording.implausible.any():
            warnings.warn(f"Left out of the tracking errors: {recording.doubt}.", stacklevel=2)
        during = (recording.time <= trajectory.duration) & recording.usable
        planned = plan.bend_angle_at(recording.time[during])
        errors.append(np.abs(planned - recording.bend_angle[:, during]).ravel())
    if not sum(error.size for error in errors):
        raise LimbError("There are no recorded samples during the plan to compare it with.")
    all_errors = np.concatenate(errors)
    return TrackingErrors(
        mean=float(all_errors.mean()),
        median=float(np.median(all_errors)),
        percentile_90=float(np.percentile(all_errors, 90)),
    )
