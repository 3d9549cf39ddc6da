"""Decides whether the wires may be heated. All of the board's safety rules are here.

Runs under MicroPython and CPython alike. Times are in ms and count on without
wrapping; duty is in [0, 1]; temperatures are in °C.
"""

# States. Only in ARMED is there any duty.
DISARMED, ARMED = 0, 1

# Reasons for which the board is off, in every sample.
NONE = 0
NO_COMMAND = 1  # no valid command came for HEARTBEAT
OUT_OF_RANGE = 2  # a command had a duty out of range
HOST = 3  # the host disarmed it
POWER_UP = 4
# From here on they latch until they are cleared.
OVER_TEMPERATURE = 16
THERMOCOUPLE_OPEN = 17
THERMOCOUPLE_TO_GROUND = 18
THERMOCOUPLE_TO_SUPPLY = 19
TEMPERATURE_JUMP = 20
NOT_WARMING = 21
BEND_SILENT = 22
BEND_STUCK = 23
LATCHING = 16

TEXTS = {
    NONE: "all is well",
    NO_COMMAND: "no valid command came for 250 ms",
    OUT_OF_RANGE: "a command was out of range",
    HOST: "the host switched it off",
    POWER_UP: "it was just switched on",
    OVER_TEMPERATURE: "a wire is too hot",
    THERMOCOUPLE_OPEN: "a thermocouple is open",
    THERMOCOUPLE_TO_GROUND: "a thermocouple is shorted to ground",
    THERMOCOUPLE_TO_SUPPLY: "a thermocouple is shorted to supply",
    TEMPERATURE_JUMP: "a measured temperature jumped as no wire's can",
    NOT_WARMING: "a wire is heated, but its thermocouple does not warm",
    BEND_SILENT: "the bend sensor does not answer",
    BEND_STUCK: "the bend sensor is stuck",
}

HEARTBEAT = 250  # ms
TEMPERATURE_LIMIT = 110.0  # °C, measured
LARGEST_JUMP = 20.0  # °C from one sample to the next
HOLDING_DUTY = 0.3  # enough to hold any temperature below the limit; more must warm the wire
UNANSWERED_HEAT = 1.0  # s of full duty above it, within which the temperature must rise by
RISE = 1.0  # °C
STUCK_SAMPLES = 10  # equal to the last bit, which a working bend sensor never sends


class Guard:
    """Holds the duty, and sets it to zero after any fault."""

    def __init__(self, now, challenge):
        """now: ms. challenge: number that the next arming must repeat."""
        self.state = DISARMED
        self.reason = POWER_UP
        self.challenge = challenge
        self.session = None
        self.acknowledged = 0
        self.duty = [0.0, 0.0]
        self._heard = now
        self._sampled = None  # ms, of the sample before
        self._temperatures = [None, None]
        self._lowest = [None, None]
        self._unanswered = [0.0, 0.0]
        self._bend = None
        self._alike = 0

    def arm(self, challenge, now):
        """Arms the board if the host repeats the challenge and nothing is latched."""
        if challenge != self.challenge or self.reason >= LATCHING or self._sampled is None:
            return
        if self.state == ARMED:
            return
        self.state, self.reason = ARMED, NONE
        self.session, self.acknowledged = challenge, 0
        self._heard = now
        self._lowest = list(self._temperatures)
        self._unanswered = [0.0, 0.0]

    def command(self, session, sequence, left, right, now):
        """Takes a duty if it is newer than any before in this session."""
        if self.state != ARMED or session != self.session or sequence <= self.acknowledged:
            return
        if not (0.0 <= left <= 1.0 and 0.0 <= right <= 1.0):
            self.trip(OUT_OF_RANGE)
            return
        self.acknowledged = sequence
        self.duty[0], self.duty[1] = left, right
        self._heard = now

    def disarm(self):
        """Disarms the board, on the host's request."""
        if self.state == ARMED:
            self.trip(HOST)

    def clear(self, challenge):
        """Clears a latched reason; the board stays off until it is armed."""
        if challenge == self.challenge and self.reason >= LATCHING:
            self.reason = HOST
            self._renew()

    def tick(self, now):
        """Checks the heartbeat; must be called continually."""
        if self.state == ARMED and now - self._heard >= HEARTBEAT:
            self.trip(NO_COMMAND)

    def sample(self, now, temperatures, faults, bend):
        """Checks a sample of all sensors.

        temperatures: °C, left and right; faults: of their amplifiers;
        bend: raw, or None if the sensor does not answer.
        """
        interval = 0.0 if self._sampled is None else (now - self._sampled) / 1000
        for wire in (0, 1):
            self._check_wire(wire, temperatures[wire], faults[wire], interval)
        if bend is None:
            self.trip(BEND_SILENT)
        self._alike = self._alike + 1 if bend == self._bend else 0
        if self._alike >= STUCK_SAMPLES:
            self.trip(BEND_STUCK)
        self._bend, self._sampled = bend, now
        self._temperatures = list(temperatures)

    def _check_wire(self, wire, temperature, faults, interval):
        if faults & 1:
            self.trip(THERMOCOUPLE_OPEN)
        elif faults & 2:
            self.trip(THERMOCOUPLE_TO_GROUND)
        elif faults & 4:
            self.trip(THERMOCOUPLE_TO_SUPPLY)
        elif temperature > TEMPERATURE_LIMIT:
            self.trip(OVER_TEMPERATURE)
        before = self._temperatures[wire]
        if before is not None and abs(temperature - before) > LARGEST_JUMP:
            self.trip(TEMPERATURE_JUMP)
        # Duty above HOLDING_DUTY must raise the reading, counted from the lowest reading.
        if self._lowest[wire] is None or temperature < self._lowest[wire]:
            self._lowest[wire] = temperature
        if temperature >= self._lowest[wire] + RISE:
            self._lowest[wire] = temperature
            self._unanswered[wire] = 0.0
        self._unanswered[wire] += max(0.0, self.duty[wire] - HOLDING_DUTY) * interval
        if self._unanswered[wire] > UNANSWERED_HEAT:
            self.trip(NOT_WARMING)

    def trip(self, reason):
        """Switches off. The first latching reason is kept; others are replaced by newer ones."""
        self.duty[0] = self.duty[1] = 0.0
        if self.reason < LATCHING:
            self.reason = reason
        if self.state == ARMED:
            self.state = DISARMED
            self._renew()

    def _renew(self):
        """Sets a new challenge: frames that were sent before can neither arm nor command."""
        self.session = None
        self.challenge = (self.challenge * 25173 + 13849) & 0xFFFF
