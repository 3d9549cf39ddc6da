"""What the recordings so far tell of a limb."""

import copy
import itertools
from collections.abc import Iterable

import numpy as np
from threadpoolctl import threadpool_limits

from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import LawFit, fit_law
from calibration.recordings.at_rest import ambient_temperature, rest_angle
from calibration.recordings.kinds import gravity_bends, only_segment
from limb_systems import HystereticLaw, LimbParameters, Recording


class Knowledge:
    """What the recordings so far tell of a limb, and how well they predict the next one.

    Args:
        described: the limb as it was described.
        recordings: made before: of ring-downs, for the angle at rest, and with heat.
    """

    LAW = HystereticLaw  # which has the other laws' shapes

    def __init__(self, described: LimbParameters, recordings: Iterable[Recording] = ()):
        self._described, self._recordings = copy.deepcopy(described), list(recordings)
        self._known: LawFit | None = None
        self._motions: list[np.ndarray] = []

    @property
    def limb(self) -> LimbParameters:
        """The limb as it is calibrated so far."""
        return self._fit().calibrated(self._described)

    def add(self, recording: Recording, kind: str) -> str:
        """Takes in a recording; says how well it was predicted before."""
        with threadpool_limits(1, "blas"):
            (predicted,) = self._fit().predict([HeatedRun.of(recording)])
        said = (
            f"predicted to {np.rad2deg(predicted.bend_error):.1f}° and "
            f"{predicted.temperature_error:.1f} °C on average before it was fitted"
        )
        if kind != "motion":
            if not gravity_bends(recording.parameters):  # others tell little more of the heat
                self._recordings.append(recording)
                self._known = None
            return said
        self._motions.append(recording.bend_angle)
        if len(self._motions) > 1:
            differences = []
            for one, other in itertools.combinations(self._motions, 2):
                length = min(one.shape[1], other.shape[1])
                away = one[:, :length] - other[:, :length]
                differences.append(np.linalg.norm(away, axis=0).mean())
            said += f"; motions differ by {np.rad2deg(np.mean(differences)):.1f}° from each other"
        return said

    def _fit(self) -> LawFit:
        if self._known is None:
            ambient = ambient_temperature(self._recordings).value
            segment = copy.deepcopy(only_segment(self._described))
            segment.rest_angle = rest_angle(self._recordings, ambient).value
            runs = [
                HeatedRun.of(recording) for recording in self._recordings if recording.duty.any()
            ]
            with threadpool_limits(1, "blas"):
                self._known = fit_law(self.LAW, runs, segment, ambient)
        return self._known
