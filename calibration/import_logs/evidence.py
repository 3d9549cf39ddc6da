"""Show what the numbers of a log tell: which thermocouple a duty warms, where a wire bends."""

import dataclasses

import numpy as np
from scipy.signal import lfilter

WIRE_MEMORY = 15.0  # s, over which a wire keeps its heat, roughly
SILICONE_MEMORY = 90.0  # s, over which silicone gives its heat back
MIN_STEP = 0.5  # s, of the signals that are compared
MAX_STEPS = 20_000
MIN_VOTE = 3.0  # standard errors that decide
WARMING_FACTOR = 1.5  # by which a wire warms its thermocouple more than others
MIN_STEPS = 12  # steps, from which on a regression tells anything


def forward_fill(duty: np.ndarray) -> np.ndarray:
    """Fill missing duty (K,) with the last value; loggers that write only changes leave gaps."""
    indices = np.arange(len(duty))
    last_known = np.maximum.accumulate(np.where(np.isnan(duty), 0, indices))
    return np.nan_to_num(duty[last_known])  # before the first value the wire is off


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Return the correlation of two signals where both are there; 0 where one does not move."""
    is_present = ~(np.isnan(first) | np.isnan(second))
    if is_present.sum() < 5 or not np.ptp(first[is_present]) or not np.ptp(second[is_present]):
        return 0.0
    with np.errstate(all="ignore"):  # of numbers that are almost nothing
        coefficient = float(np.corrcoef(first[is_present], second[is_present])[0, 1])
    return coefficient if np.isfinite(coefficient) else 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """Times of a log's rows, and even steps to which signals are reduced to be compared.

    - ``step_of_row``: number of the step of each row (K,).
    - ``times``: (N,), s.
    - ``step``: s.
    """

    step_of_row: np.ndarray
    times: np.ndarray
    step: float

    @classmethod
    def of(cls, times: np.ndarray) -> "Steps":
        """Return steps for rows at some times (K,), s, increasing."""
        step = max(MIN_STEP, (times[-1] - times[0]) / MAX_STEPS, float(np.median(np.diff(times))))
        step_of_row = ((times - times[0]) // step).astype(int)
        return cls(step_of_row, step * np.arange(step_of_row[-1] + 1), step)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Return the mean of a signal (K,) in each step (N,); nan in steps without a reading."""
        is_present = ~np.isnan(values)
        count = len(self.times)
        sums = np.bincount(self.step_of_row[is_present], values[is_present], count)
        numbers = np.bincount(self.step_of_row[is_present], minlength=count)
        return np.where(numbers > 0, sums / np.maximum(numbers, 1), np.nan)

    def heat(self, duty: np.ndarray) -> np.ndarray:
        """Return the heat of a duty (K,) in each step (N,): warmth and bend follow it."""
        mean_duty = forward_fill(self.means(forward_fill(duty)))
        kept = np.exp(-self.step / WIRE_MEMORY)
        return lfilter([0.0, 1.0 - kept], [1.0, -kept], mean_duty)


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """The responses of signals to the heat of wires, by regression.

    - ``gains``: change of each signal for a unit of heat of each wire (M, W).
    - ``errors``: standard errors of the gains (M, W); infinite for wires that were not heated.
    """

    gains: np.ndarray
    errors: np.ndarray

    @classmethod
    def of(cls, times: np.ndarray, heats: np.ndarray, signals: np.ndarray) -> "Responses":
        """Return the responses of signals (M, N) to heats (W, N) at times (N,), s."""
        gains = np.zeros((len(signals), len(heats)))
        errors = np.full(gains.shape, np.inf)
        for row, signal in enumerate(signals):
            gains[row], errors[row] = _regression(times, heats, signal)
        return cls(gains, errors)

    @property
    def votes(self) -> np.ndarray:
        """The gains in standard errors (M, W); 0 for wires that were not heated."""
        return self.gains / self.errors

    def pairs(self) -> list[int | None]:
        """Return the thermocouple that each wire clearly warms (W,); None where none is clear.

        A wire warms its thermocouple more than others do, or warms it more than the others, by
        `WARMING_FACTOR` and by `MIN_VOTE` standard errors. Only thermocouples and wires that
        are not paired yet are compared.
        """
        paired_sensors: list[int | None] = [None] * self.gains.shape[1]
        wires = [int(i) for i in np.flatnonzero(np.isfinite(self.errors).all(axis=0))]
        sensors = list(range(len(self.gains)))
        while pair := next(
            ((j, i) for i in wires for j in sensors if self._is_clear(j, i, sensors, wires)), None
        ):
            sensor, wire = pair
            paired_sensors[wire] = sensor
            wires.remove(wire)
            sensors.remove(sensor)
        return paired_sensors

    def _is_clear(self, sensor: int, wire: int, sensors: list[int], wires: list[int]) -> bool:
        """Return whether a thermocouple is clearly of a wire, among others."""
        gain = self.gains[sensor, wire]
        error = self.errors[sensor, wire]
        if gain <= MIN_VOTE * error:
            return False
        leads = []
        for rivals in (
            [(rival, wire) for rival in sensors if rival != sensor],
            [(sensor, rival) for rival in wires if rival != wire],
        ):
            gains = np.array([self.gains[rival] for rival in rivals])
            errors = np.array([self.errors[rival] for rival in rivals])
            lead = gain - WARMING_FACTOR * np.maximum(gains, 0.0)
            if (lead <= 0.0).any():
                return False
            leads += (
                [(lead > MIN_VOTE * np.hypot(error, WARMING_FACTOR * errors)).all()]
                if rivals
                else []
            )
        return not leads or any(leads)


def bend_votes(
    steps: Steps, heats: np.ndarray, warmth: np.ndarray, bends: np.ndarray, levers: np.ndarray
) -> np.ndarray:
    """Return how clearly each wire bends a limb to its side (W,), in standard errors.

    The bend must follow the heat of the duty and what thermocouples read: a vote is the clearer
    of both, and 0 if they contradict each other.

    Args:
        heats: heat of the wires (W, N), as `Steps.heat` gives it.
        warmth: readings of their thermocouples (W, N), or heat of wires that have none.
        bends: (F, N).
        levers: direction of each wire among the bends (W, F).
    """
    votes = np.zeros((2, len(heats)))
    for number, causes in enumerate((heats, warmth)):
        responses = Responses.of(steps.times, causes, bends)
        gains_along = (levers * responses.gains.T).sum(axis=1)
        errors = np.linalg.norm(np.where(levers, levers * responses.errors.T, 0.0), axis=1)
        votes[number] = gains_along / np.where(errors > 0, errors, np.inf)
    clearer = votes[np.abs(votes).argmax(axis=0), np.arange(len(heats))]
    return np.where(np.sign(votes[0]) == np.sign(votes[1]), clearer, 0.0)


def _regression(
    times: np.ndarray, heats: np.ndarray, signal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains and their standard errors (W,) of a signal that follows heats (W, N).

    What is left over is correlated from step to step: it is estimated, and taken into account.
    """
    gains = np.zeros(len(heats))
    errors = np.full(len(heats), np.inf)
    is_present = ~np.isnan(np.vstack([heats, signal])).any(axis=0)
    if (
        is_present.sum() < MIN_STEPS
        or not (is_heated := np.ptp(heats[:, is_present], axis=1) > 1e-9).any()
    ):
        return gains, errors
    since = times - times[0]
    decays = np.array(
        [np.ones(len(times)), np.exp(-since / WIRE_MEMORY), np.exp(-since / SILICONE_MEMORY)]
    )
    factors = np.vstack([heats[is_heated], decays])[:, is_present].T
    response = signal[is_present]
    memory = 0.0
    for _ in range(3):
        # Without what is left over of the step before.
        left_side = factors[1:] - memory * factors[:-1]
        right_side = response[1:] - memory * response[:-1]
        solution, _, rank, _ = np.linalg.lstsq(left_side, right_side, rcond=1e-9)
        residuals = response - factors @ solution
        memory = min(max(correlation(residuals[1:], residuals[:-1]), 0.0), 0.99)
    freedom = len(right_side) - len(solution)
    if rank < len(solution) or freedom < 3:
        return gains, errors
    variance = float(np.sum((right_side - left_side @ solution) ** 2)) / freedom
    spread = variance * np.diag(np.linalg.inv(left_side.T @ left_side))
    gains[is_heated] = solution[: is_heated.sum()]
    errors[is_heated] = np.sqrt(np.maximum(spread[: is_heated.sum()], 0.0)) + 1e-12
    return gains, errors
