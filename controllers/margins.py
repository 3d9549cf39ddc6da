"""How much a limb may differ from its model before feedback makes it oscillate."""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_discrete_are

from controllers.plan_feedback import PlanFeedback
from controllers.plan_regulator import PlanRegulator
from controllers.reduced_model import PERIOD

LARGEST_GAIN = 100.0
LARGEST_DELAY = 10.0  # s
SLOW = 20.0  # s; what grows by less than e in this time is not seen in a loop that is frozen


@dataclasses.dataclass(frozen=True)
class Margins:
    """Up to where a limb and its feedback are stable, each alone.

    - ``gain``: factor by which wires may heat more than the model says, 100 if more.
    - ``delay``: of the bend readings in addition to those of the loop itself, s, 10 if more.
    """

    gain: float
    delay: float


def stability_margins(controller: PlanFeedback | PlanRegulator, time: float) -> Margins:
    """The margins about a plan at a time, of the linearized loop that is frozen there.

    The loop has the model, the estimator with its steady gain, the feedback, and the two
    periods that readings and duty take. Bounds of duty are not active.

    Args:
        controller: of which the margins are.
        time: since the start of the plan, s.
    """
    loop = _Loop(controller, time)
    periods = int(LARGEST_DELAY / PERIOD)
    return Margins(
        gain=_last(lambda gain: loop.is_stable(gain=gain), np.geomspace(1, LARGEST_GAIN, 93)),
        delay=PERIOD * _last(lambda d: loop.is_stable(delay=int(d)), np.arange(periods + 1)),
    )


class _Loop:
    """Deviations from a plan: [heat, duty before, readings before, estimate]."""

    def __init__(self, controller: PlanFeedback | PlanRegulator, time: float):
        heat, duty, self._feedback = controller.linearized(time)
        estimator = controller.estimator
        _, self._F, self._B = estimator.transition(heat, duty)
        _, self._C = estimator.sensing(heat)
        Q, R = np.diag(estimator.walk_variances(duty)), np.diag(estimator.reading_variances)
        P = solve_discrete_are(self._F.T, self._C.T, Q, R)
        self._gain = P @ self._C.T @ np.linalg.inv(self._C @ P @ self._C.T + R)
        self._size = estimator.model.size

    def is_stable(self, gain: float = 1.0, delay: int = 0) -> bool:
        """With a limb that heats more by a factor, and readings that are periods late."""
        H, (M, W), sensors = self._size, self._B.shape, len(self._C)
        late = delay + 1  # a sensor's reading is that of its period before
        A = np.zeros((H + W + late * sensors + M,) * 2)
        limb, before = slice(0, H), slice(H, H + W)
        queue = [slice(H + W + k * sensors, H + W + (k + 1) * sensors) for k in range(late)]
        mean = slice(H + W + late * sensors, None)
        A[limb, limb], A[limb, before] = self._F[:H, :H], gain * self._B[:H]
        A[queue[0], limb] = self._C[:, :H]
        for newer, older in itertools.pairwise(queue):
            A[older, newer] = np.eye(sensors)
        # m + L (y - C m), of which duty and the next estimate are made
        corrected = np.zeros((M, len(A)))
        corrected[:, mean] = np.eye(M) - self._gain @ self._C
        corrected[:, queue[-1]] = self._gain
        A[before] = -self._feedback @ corrected
        A[mean] = self._F @ corrected + self._B @ A[before]
        return bool(np.abs(np.linalg.eigvals(A)).max() < np.exp(PERIOD / SLOW))


def _last(holds: Callable[[float], bool], values: np.ndarray) -> float:
    """The last of some values before the first for which it does not hold."""
    last = 0.0
    for value in values:
        if not holds(value):
            break
        last = float(value)
    return last
