"""Compare the numbers of a log: which thermocouple a duty warms, to which side a wire bends.

Numbers decide by one rule: an effect is larger than its rivals by a factor, and by `MIN_VOTE`
standard errors.
"""

import numpy as np

from limb_systems.low_pass import low_pass

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


class Steps:
    """Even steps to which the signals of a log are reduced to be compared.

    In shapes, K are rows, N steps, W wires, M signals and F bends. The heat of a wire is its duty
    through a low pass, which its warmth and the bend follow.

    - ``step_of_row``: number of the step of each row (K,).
    - ``times``: (N,), s from the first row.
    - ``step``: s.
    """

    def __init__(self, row_times: np.ndarray):
        """Make steps for rows at some times (K,), s, increasing."""
        since = row_times - row_times[0]
        self.step = max(MIN_STEP, since[-1] / MAX_STEPS, float(np.median(np.diff(row_times))))
        self.step_of_row = (since // self.step).astype(int)
        self.times = self.step * np.arange(self.step_of_row[-1] + 1)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Return the mean of a signal (K,) in each step (N,); nan in steps without a reading."""
        is_present = ~np.isnan(values)
        num_steps = len(self.times)
        sums = np.bincount(self.step_of_row[is_present], values[is_present], num_steps)
        counts = np.bincount(self.step_of_row[is_present], minlength=num_steps)
        return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)

    def heat(self, duty: np.ndarray) -> np.ndarray:
        """Return the heat of a duty (K,) in each step (N,)."""
        mean_duty = forward_fill(self.means(forward_fill(duty)))
        kept = np.exp(-self.step / WIRE_MEMORY)
        return low_pass(np.append(0.0, mean_duty[:-1]), kept)

    def response(self, heats: np.ndarray, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much a signal (N,) changes for a unit of the heat of W wires (W, N).

        The second value is the standard error of each gain (W,): infinite for wires without heat.
        """
        gains = np.zeros(len(heats))
        errors = np.full(len(heats), np.inf)
        is_present = ~np.isnan(np.vstack([heats, signal])).any(axis=0)
        if is_present.sum() < MIN_STEPS:
            return gains, errors
        # The causes (N, C) are the wires' heat, the decay of the heat at first, and a constant.
        is_heated = np.ptp(heats[:, is_present], axis=1) > 1e-9
        decays = np.exp(-self.times / np.array([[WIRE_MEMORY], [SILICONE_MEMORY]]))
        causes = np.vstack([heats[is_heated], decays, np.ones(len(signal))])[:, is_present].T
        signal = signal[is_present]
        # Residuals are correlated from step to step: estimate the correlation, and take it out.
        memory = 0.0
        for _ in range(3):
            left_side = causes[1:] - memory * causes[:-1]
            right_side = signal[1:] - memory * signal[:-1]
            fitted, _, rank, _ = np.linalg.lstsq(left_side, right_side, rcond=1e-9)
            residuals = signal - causes @ fitted
            memory = min(max(correlation(residuals[1:], residuals[:-1]), 0.0), 0.99)
        # The scatter of the residuals gives the standard errors.
        freedom = len(right_side) - len(fitted)
        if rank == len(fitted) and freedom >= 3:
            variance = np.sum((right_side - left_side @ fitted) ** 2) / freedom
            spread = variance * np.diag(np.linalg.inv(left_side.T @ left_side))
            num_heated = int(is_heated.sum())
            gains[is_heated] = fitted[:num_heated]
            errors[is_heated] = np.sqrt(np.maximum(spread[:num_heated], 0.0)) + 1e-12
        return gains, errors


def margin(
    gains: np.ndarray, errors: np.ndarray, rivals: np.ndarray, rival_errors: np.ndarray
) -> np.ndarray:
    """Return by how many standard errors gains exceed rivals by `WARMING_FACTOR`, elementwise."""
    lead = gains - WARMING_FACTOR * np.maximum(rivals, 0.0)
    with np.errstate(invalid="ignore"):  # infinite errors have no margin
        return np.nan_to_num(lead / np.hypot(errors, WARMING_FACTOR * rival_errors))


def clear_pairs(gains: np.ndarray, errors: np.ndarray) -> list[int | None]:
    """Return the thermocouple that each wire clearly warms (W,); None where none is clear.

    A wire warms its thermocouple more than others do, and more than the others, by a factor; one
    of both by `MIN_VOTE` standard errors. Pairs that are clear leave fewer rivals to the others.

    Gains and errors are the warming of M thermocouples by W wires, and its standard error (M, W).
    """
    pairs: list[int | None] = [None] * gains.shape[1]
    is_open = np.isfinite(errors) & np.isfinite(errors).all(axis=0)  # wires without heat warm none
    for _ in pairs:
        for sensor, wire in np.argwhere(is_open & (gains > MIN_VOTE * errors)):
            # Compare with other thermocouples of the wire, and other wires of the thermocouple.
            margins = margin(gains[sensor, wire], errors[sensor, wire], gains, errors)
            is_rival = is_open.copy()
            is_rival[sensor, wire] = False
            leads = []
            for line in (margins[is_rival[:, wire], wire], margins[sensor, is_rival[sensor]]):
                if line.size:
                    leads.append(line.min())
            is_clear = not leads or (min(leads) > 0.0 and max(leads) > MIN_VOTE)
            if is_open[sensor, wire] and is_clear:
                pairs[wire] = int(sensor)
                is_open[sensor] = False
                is_open[:, wire] = False
    return pairs


def clear_votes(
    steps: Steps, causes: list[np.ndarray], bends: np.ndarray, levers: np.ndarray
) -> np.ndarray:
    """Return how clearly each wire bends a limb to its side (W,), in standard errors.

    A bend must follow the heat of the duty and what thermocouples read: a vote is the clearer of
    both, and 0 if they contradict each other. Causes are the heat of the wires, and the readings of
    their thermocouples, (W, N) each; bends (F, N) are in rad; levers are the direction of each wire
    among the bends (F, W).
    """
    votes = []
    for cause in causes:
        turns = np.zeros(len(cause))
        variances = np.zeros(len(cause))
        for bend, lever in zip(bends, levers, strict=True):
            gains, errors = steps.response(cause, bend)
            turns += lever * gains
            variances += np.where(lever != 0, lever * errors, 0.0) ** 2
        votes.append(turns / np.sqrt(np.maximum(variances, 1e-24)))
    by_heat, by_warmth = votes
    clearer = np.where(np.abs(by_heat) > np.abs(by_warmth), by_heat, by_warmth)
    return np.where(by_heat * by_warmth > 0, clearer, 0.0)
