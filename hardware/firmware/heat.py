"""Bounds of a wire's temperature by the heat that it got: the paper's eqns (6) and (7).

This runs under MicroPython and CPython. Bounds of a wire are the five numbers (a1 slowest, a1
fastest, a2 least, a2 most, a3 slowest), all positive, in 1/s and °C/s. Temperatures are in °C above
the room.
"""

# The accepted range of each bound, and the bounds of the nominal limb.
RANGES = ((0.005, 0.2), (0.01, 0.5), (4.0, 60.0), (8.0, 100.0), (0.1, 4.0))
NOMINAL_BOUNDS = (0.042, 0.095, 17.0, 23.0, 0.5)

# The silicone around a wire stores heat: in a lasting heat it has at most this share of the wire's
# temperature, which it reaches within a minute.
SILICONE_SHARE = 0.35
SILICONE_RATE = 0.02  # 1/s

LITTLE_DUTY = 0.12  # makes no wire too hot, also if its bounds are wrong
MIN_DETECTABLE_RISE = 6.0  # °C, by the least heat of LITTLE_DUTY, for more duty to be allowed
HIGHEST_RISE = 102.0  # °C above the room, of a wire in a lasting heat

AVERAGING_TIME = 1.0  # s, over which a difference from readings is averaged
LONGEST_STEP = 0.1  # s, of Euler's method
APPROACH_TIME = 0.5  # s, within which a wire may reach the highest temperature


def are_acceptable(bounds):
    """Return whether bounds are in their ranges and in order."""
    for bound, (low, high) in zip(bounds, RANGES):
        if not low <= bound <= high:
            return False
    return bounds[0] <= bounds[1] and bounds[2] <= bounds[3]


def can_detect_overheating(bounds, total):
    """Return whether readings show too much heat of a wire with wrong bounds.

    total: the largest duty of the wire.
    """
    a1_slow, a1_fast, a2_least, a2_most, _ = bounds
    lasting = HIGHEST_RISE * a1_slow * (1.0 - SILICONE_SHARE) / a2_most  # duty for HIGHEST_RISE
    if min(total, lasting) <= LITTLE_DUTY:
        return True
    return a2_least / a1_fast * LITTLE_DUTY >= MIN_DETECTABLE_RISE


class WireObserver:
    """Bounds of a wire's temperature by its duty, in addition to its thermocouple.

    - ``least``: lowest temperature of the wire, if all of its heat arrives.
    - ``least_reading``: lowest reading of its thermocouple at this temperature.
    - ``most``: highest temperature of the wire.
    - ``hidden``: part of ``most`` that a thermocouple with a lag may not show yet.
    - ``shortfall``: mean difference of the reading below ``least_reading``.
    """

    def __init__(self, most):
        """most: highest temperature at the start."""
        self.bounds = NOMINAL_BOUNDS
        self.least = self.least_reading = 0.0
        self.most = most
        self._silicone = SILICONE_SHARE * most
        self.hidden = self.shortfall = 0.0

    def advance(self, duty, interval, reading):
        """duty: mean since the last call; interval: s since then; reading: °C above the room."""
        steps = int(interval / LONGEST_STEP) + 1
        for _ in range(steps):
            self._step(duty, interval / steps, reading)

    def _step(self, duty, interval, reading):
        a1_slow, a1_fast, a2_least, a2_most, a3_slow = self.bounds
        least = self.least
        most = self.most
        silicone = self._silicone
        # Lower bounds of thermocouple and wire.
        self.least_reading += interval * a3_slow * (least - self.least_reading)
        self.least += interval * (a2_least * duty - a1_fast * least)
        # Upper bound of the wire, and its part that the thermocouple may not show yet.
        rate = a2_most * duty - a1_slow * (most - silicone)
        self.most += interval * rate
        self.hidden = max(0.0, self.hidden + interval * (rate - a3_slow * self.hidden))
        self._silicone += interval * SILICONE_RATE * (SILICONE_SHARE * most - silicone)
        # Compare the reading with its lower bound.
        below = self.least_reading - reading
        self.shortfall += interval / AVERAGING_TIME * (below - self.shortfall)

    def begin(self, most):
        """Set the highest temperature by another estimate; the silicone may be warm from before."""
        self.most = min(most, HIGHEST_RISE)
        self._silicone = min(self.most, SILICONE_SHARE * HIGHEST_RISE)

    def allowed_duty(self, highest):
        """Return the duty, in [0, 1], at which the wire cannot get above ``highest``."""
        a1_slow, _, _, a2_most, _ = self.bounds
        loss = a1_slow * (self.most - self._silicone)
        duty = (loss + (highest - self.most) / APPROACH_TIME) / a2_most
        return min(1.0, max(0.0, duty))
