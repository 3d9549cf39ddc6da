"""(17) of the heat of wires around a period, with duty held over intervals of free length.

For an interval of length h between heat z0 and z1 at duty D, with ż = f(z, D), it is

    z1 - z0 = h/6 (f(z0, D) + 4 f(zc, D) + f(z1, D)),  zc = (z0 + z1)/2 + h/8 (f(z0, D) - f(z1, D))

which is that of `planners.transcription.collocation`, times the length. There, duty is linear
between knots, and lengths of intervals with heat alone do not count as variables.
"""

from collections.abc import Collection

import numpy as np
from pydrake.solvers import Binding

from limb_systems import Wires


class PeriodicHeat:
    """The equation above as a `planners.transcription.ipopt.ConstraintBlock`, scaled.

    Args:
        wires: heat of the wires.
        heat, duty: indices of [x, V] at the knots (K, M) and of the duty of the interval after each
            (K, W) among the program's variables.
        time_steps: indices of the lengths of these intervals (K,).
    """

    replaces: Collection[Binding] = ()

    def __init__(self, wires: Wires, heat: np.ndarray, duty: np.ndarray, time_steps: np.ndarray):
        self._wires, (K, M) = wires, heat.shape
        after = np.roll(heat, -1, axis=0)
        self._places = np.column_stack([heat, after, duty, time_steps])  # (K, P)
        self._M, self._P = M, self._places.shape[1]
        self.lower = self.upper = np.zeros(K * M)

        of_rates = wires.heat_pattern.astype(float)
        ends = [self._spread(of_rates, end) for end in (0, 1)]
        middle = self._middle_slopes(ends, np.ones(M), 1.0) != 0
        point = np.vstack([middle, np.eye(self._P)[2 * M : -1]]).astype(float)
        slopes = sum(ends) + of_rates @ point + np.eye(M, self._P) + np.eye(M, self._P, M)
        slopes[:, -1] = 1.0
        self._nonzeros = slopes.nonzero()
        curved = point.T @ wires.heat_curvature @ point
        for end in (0, 1):
            at_end = self._embedding(end)
            curved += at_end.T @ wires.heat_curvature @ at_end
        curved[-1] = 1.0
        self._triangle = np.tril(curved).nonzero()
        self.rows = (M * np.arange(K)[:, None] + self._nonzeros[0]).ravel()
        self.columns = self._places[:, self._nonzeros[1]].ravel()
        self.hessian_rows, self.hessian_columns = (
            self._places[:, places].ravel() for places in self._triangle
        )

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        first, second, duty, h = self._split(x)
        rates = [self._wires.heat_rates(heat, duty) for heat in (first, second)]
        middle = 0.5 * (first + second) + h / 8 * (rates[0] - rates[1])
        mean = (rates[0] + 4 * self._wires.heat_rates(middle, duty) + rates[1]) / 6
        return ((second - first - h * mean) / self._wires.heat_scales).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        *_, h = self._split(x)
        _, _, mean, mean_slopes, *_ = self._expanded(x)
        jacobian = np.eye(self._M, self._P, self._M) - np.eye(self._M, self._P)
        jacobian = jacobian - h[:, :, None] * mean_slopes
        jacobian[:, :, -1] -= mean
        jacobian /= self._wires.heat_scales[:, None]
        rows, columns = self._nonzeros
        return jacobian[:, rows, columns].ravel()

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        first, second, duty, h = self._split(x)
        weights = multipliers.reshape(-1, self._M) / self._wires.heat_scales
        middle, slopes, _, mean_slopes, mid_slopes, point = self._expanded(x)
        on_middle = (weights[:, None] @ mid_slopes[:, :, : self._M])[:, 0]
        share = h / 12  # of zc's curvature: h 4/6 times 1/8
        by_step = -(weights[:, None] @ mean_slopes)[:, 0]
        by_step -= share * (on_middle[:, None] @ (slopes[0] - slopes[1]))[:, 0]
        hessian = np.zeros((len(h), self._P, self._P))
        if not self._wires.rates_are_affine:
            on_ends = [-h / 6 * weights - sign * share * h * on_middle for sign in (1, -1)]
            for end, (heat, on_rates) in enumerate(zip((first, second), on_ends, strict=True)):
                at_end = self._embedding(end)
                hessian += at_end.T @ self._wires.heat_hessian(heat, duty, on_rates) @ at_end
            on_rates = -2 * h / 3 * weights
            curvature = self._wires.heat_hessian(middle, duty, on_rates)
            hessian += point.swapaxes(1, 2) @ curvature @ point
        hessian[:, -1] += by_step
        hessian[:, :, -1] += by_step
        rows, columns = self._triangle
        return hessian[:, rows, columns].ravel()

    def _split(self, x: np.ndarray) -> list[np.ndarray]:
        return np.split(x[self._places], [self._M, 2 * self._M, self._P - 1], axis=1)

    def _expanded(self, x: np.ndarray) -> tuple:
        """zc, derivatives of f at both ends by p = [z0, z1, D, h] (K, M, P), the mean of f and its
        derivatives by p, those of f at zc by [z, D], and those of [zc, D] by p."""
        first, second, duty, h = self._split(x)
        at_ends = [self._wires.expanded_heat_rates(heat, duty) for heat in (first, second)]
        slopes = [self._spread(by_point, end) for end, (_, by_point) in enumerate(at_ends)]
        change = at_ends[0][0] - at_ends[1][0]
        middle = 0.5 * (first + second) + h / 8 * change
        rates, mid_slopes = self._wires.expanded_heat_rates(middle, duty)
        by_duty = np.eye(self._P)[2 * self._M : -1]
        zc = self._middle_slopes(slopes, change, h[:, :, None])
        point = np.concatenate([zc, np.broadcast_to(by_duty, (len(h), *by_duty.shape))], axis=1)
        mean = (at_ends[0][0] + 4 * rates + at_ends[1][0]) / 6
        mean_slopes = (slopes[0] + 4 * mid_slopes @ point + slopes[1]) / 6
        return middle, slopes, mean, mean_slopes, mid_slopes, point

    def _middle_slopes(
        self, at_ends: list[np.ndarray], change: np.ndarray, h: np.ndarray | float
    ) -> np.ndarray:
        """Derivatives of zc by p, from those of f at both ends."""
        both = np.eye(self._M, self._P) + np.eye(self._M, self._P, self._M)
        slopes = 0.5 * both + h / 8 * (at_ends[0] - at_ends[1])
        slopes[..., -1] += change / 8
        return slopes

    def _embedding(self, end: int) -> np.ndarray:
        """[z, D] at an end of the interval from p (M + W, P)."""
        identity = np.eye(self._P)
        return np.vstack(
            [identity[end * self._M : (end + 1) * self._M], identity[2 * self._M : -1]]
        )

    def _spread(self, by_point: np.ndarray, end: int) -> np.ndarray:
        """Derivatives by [z, D] at an end of the interval (..., M, M + W) as those by p."""
        return by_point @ self._embedding(end)
