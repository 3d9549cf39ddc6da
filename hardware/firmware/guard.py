"""Decides whether the wires may be heated, and how much. All safety rules of the board are here.

Runs under MicroPython and CPython alike. Times are in ms and count on without
wrapping; duty is in [0, 1]; temperatures are in °C.
"""

from . import heat

# States. Only in ARMED is there any duty.
DISARMED, ARMED = 0, 1

# Reasons for which the board is off, in every sample.
NO_REASON = 0
NO_COMMAND = 1  # no valid command came for HEARTBEAT
OUT_OF_RANGE = 2  # a command had a duty out of range
BY_HOST = 3  # the host disarmed it
POWER_UP = 4
WAS_RESET = 5  # by its button, or by a program
LATE_COMMANDS = 6  # those that came were older than HEARTBEAT
BAD_BOUNDS = 7  # the host armed it with bounds out of their ranges
DISAGREEING = 8  # thermocouples and amplifiers of cold wires, when it was to be armed
# From here on they latch until they are cleared.
OVER_TEMPERATURE = 16
THERMOCOUPLE_OPEN = 17
THERMOCOUPLE_TO_GROUND = 18
THERMOCOUPLE_TO_SUPPLY = 19
TEMPERATURE_JUMP = 20
NOT_WARMING = 21
BEND_SILENT = 22
BEND_STUCK = 23
TOO_WARM = 24
BELOW_ROOM = 25
AMPLIFIER = 26
RESTARTED = 27
CLOCK_STANDS = 28  # it stands still
LATCHING = 16

AVERAGING_TIME = 1000  # ms, over which readings are averaged against their noise
HEARTBEAT = 250  # ms, for which a duty holds, and the age of a sample that is answered too late
LONGEST_HOLD = 290  # ms, for which a duty holds after the sample that its command answered
SETTLING_SAMPLES = 10  # before it can be armed: its clock runs, and noise is averaged
TEMPERATURE_LIMIT = 110.0  # °C, measured
OVERSHOOT = 10.0  # °C above that limit, of a wire whose thermocouple lags behind
LEAD_FACTOR = 2.5  # AVERAGING_TIMEs, by which average and thermocouple do
NO_DUTY_TEMPERATURE = 105.0  # °C, of a wire, at which there is no duty
TAPER_WIDTH = 5.0  # °C below that, over which the duty is reduced
HOT_SAMPLES = 4  # above that limit: two readings, so that noise alone does not do it
BAD_SAMPLES = 3  # in series: two bad readings, each of which is in two samples, as for HOT_SAMPLES;
# a single bad frame of an amplifier comes of a MOSFET that switches near it
MAX_WIRE_TEMPERATURE = 127.0  # °C, the most that a wire may have by the heat that it was given
EXCESS_HEAT_FACTOR = 1.5  # times the heat of the most, by which a supply may be too high
LAST_TAPER_WIDTH = 10.0  # °C below MAX_WIRE_TEMPERATURE, of a reading and what is hidden from it
COLDEST_ROOM = 10.0  # °C, of amplifiers
WARM_ROOM = 25.0  # °C, that the room may have whatever the amplifiers say
PROOF_RISE = 2.0  # °C, that a thermocouple must rise by heat, to be believed after a start
PROVEN_MARGIN = 10.0  # °C, beside twice its reading, that a wire can have then
STILL_TIMES = 5000, 10000, 15000  # ms, for which a reading of a heated wire does not change at all:
# duty is reduced, to zero, and then it should have cooled
LARGEST_JUMP = 10.0  # °C from one reading to the next
MAX_SHORTFALL = 3.0  # °C, of a reading below the least that its wire's heat explains
MAX_EXCESS = 15.0  # °C, of a reading above the most
CROSSTALK = 0.25  # share of another wire's temperature that may reach this one through the limb
COLD_RISE = 3.0  # °C above the room: wires whose readings must agree
AGREEMENT_TOLERANCE = 8.0  # °C, of that agreement
STUCK_SAMPLES = 10  # equal to the last bit, which a working bend sensor never sends
MIN_TIP_MOTION = 3 * 64  # 1/64 degrees, by which the tip must turn when the wires'
MIN_PULL_CHANGE = 60.0  # °C, of difference between right and left, change


class Guard:
    """Holds the duty: reduces it where a wire gets hot, sets it to zero after any fault."""

    def __init__(self, now, challenge, reason=POWER_UP, channels=2, angles=1):
        """now: ms. challenge: number that the next arming must repeat. reason: why it is off."""
        self._wires, self._angles = range(channels), range(angles)
        self.state = DISARMED
        self.reason = reason
        self.challenge = challenge
        self.session = None
        self.acknowledged = 0
        self.duty = [0.0] * channels
        # Nobody knows how warm the wires are after a reset.
        most = 0.0 if reason == POWER_UP else heat.HIGHEST_RISE
        self.observers = [heat.WireObserver(most) for _ in self._wires]
        # Nor, after any start, what thermocouples are worth until each has followed some heat.
        self.proven = [False] * channels
        self._unheated = [0.0] * channels
        self._readings, self._still_since = [None] * channels, [now] * channels
        self._commanded, self._allowed, self._total = [0.0] * channels, [0.0] * channels, 0.0
        self._heat_given, self._heat_counted_until = (
            [0.0] * channels,
            now,
        )  # duty times ms since the last sample
        self._command_time, self._answered_time, self._late = now, now, False
        self._samples, self._sample_time, self._faulty = 0, now, False
        self._temperatures = self._averages = self._trends = self._junctions = None
        self._offsets, self._rooms = [0.0] * channels, [0.0] * channels
        self._hot_samples, self._bad_samples = [0] * channels, [0] * channels
        self._bends, self._equal_bends = [None] * angles, [0] * angles
        self._tips, self._tips_before = [None] * angles, [0.0] * angles
        self._shares = [[0.0] * channels] * angles
        self._pulls = [(0.0, 0.0)] * angles  # least and largest since it moved

    def arm(self, challenge, bounds, total, shares, now):
        """Arms the board if the host repeats the challenge, nothing is latched and sensors agree.

        bounds: bounds of each wire, see `heat`; total: largest sum of all duties; shares: for
        each angle, those of the wires' torques that turn it.
        """
        if challenge != self.challenge or self.state == ARMED or self.reason >= LATCHING:
            return
        if self._samples < SETTLING_SAMPLES or self._faulty:
            return
        whole = len(bounds) == len(self.duty) and 0.0 < total <= len(self.duty)
        if not whole or not all(
            heat.are_acceptable(bound) and heat.can_detect_overheating(bound, total)
            for bound in bounds
        ):
            self.reason = BAD_BOUNDS
            return
        if not self._sensors_agree():
            self.reason = DISAGREEING
            return
        self.state, self.reason = ARMED, NO_REASON
        self.session, self.acknowledged = challenge, 0
        self._command_time, self._answered_time, self._late = now, now, False
        self._total = total
        if shares != self._shares:
            self._shares = shares
            self._pulls = [(pull, pull) for pull in map(self._pull, self._angles)]
        for observer, bound in zip(self.observers, bounds):
            observer.bounds = bound

    def _sensors_agree(self):
        """Whether cold wires and all amplifiers have the same temperature, that of a room."""
        cold = [self._averages[n] for n in self._wires if self.observers[n].most < COLD_RISE]
        cold += self._junctions
        return max(cold) - min(cold) <= AGREEMENT_TOLERANCE and min(self._junctions) >= COLDEST_ROOM

    def command(self, session, sequence, sample_time, duty, now):
        """Takes a duty if it is newer than any before in this session.

        sequence: modulo 2**16; sample_time: time of the newest sample that the host had, ms modulo
        2**32; duty: of each wire.
        """
        if self.state != ARMED or session != self.session or len(duty) != len(self.duty):
            return
        if not 0 < (sequence - self.acknowledged) & 0xFFFF < 0x8000:
            return
        if min(duty) < 0.0 or max(duty) > 1.0:
            self.trip(OUT_OF_RANGE, now)
            return
        age = (now - sample_time) & 0xFFFFFFFF
        if age >= HEARTBEAT:
            self._late = True
            return
        self.acknowledged = sequence
        self._command_time, self._answered_time, self._late = (
            now,
            max(self._answered_time, now - age),
            False,
        )
        self._commanded = duty
        self._apply(now)

    def disarm(self, now):
        """Disarms the board, on the host's request."""
        if self.state == ARMED:
            self.trip(BY_HOST, now)

    def clear(self, challenge):
        """Clears a latched reason; the board stays off until it is armed."""
        if challenge == self.challenge and self.reason >= LATCHING:
            self.reason = BY_HOST
            self._renew_challenge()

    def tick(self, now):
        """Checks the heartbeat; must be called continually."""
        if self.state == ARMED and (
            now - self._command_time >= HEARTBEAT or now - self._answered_time >= LONGEST_HOLD
        ):
            self.trip(LATE_COMMANDS if self._late else NO_COMMAND, now)

    def sample(self, now, temperatures, junctions, faults, bends):
        """Checks a sample of all sensors.

        temperatures: readings of each wire, °C; junctions, faults: temperatures, °C, and fault
        bits of their amplifiers; with a fault they are those of the reading before. bends: raw
        readings, or None if a sensor does not answer.
        """
        self._faulty = any(faults)
        self._account(now)
        elapsed = now - self._sample_time
        if self._samples or not self._faulty:  # it begins with a reading of each wire
            self._average(temperatures, junctions, elapsed)
        for wire in self._wires:
            self._check_wire(wire, temperatures[wire], faults[wire], elapsed, now)
        if bends is None:
            self.trip(BEND_SILENT, now)
        for angle in self._angles if bends else ():
            self._check_bend(angle, bends[angle], elapsed, now)
        self._heat_given = [0.0] * len(self.duty)
        self._sample_time = now
        if self._averages:
            self._temperatures = temperatures
            self._samples += 1
        self._apply(now)

    def _average(self, temperatures, junctions, elapsed):
        """Averages over noise, and learns what thermocouples read in the room."""
        if not self._samples:
            self._averages, self._junctions = list(temperatures), list(junctions)
            self._trends = list(temperatures)
        share = min(1.0, elapsed / AVERAGING_TIME)
        for wire in self._wires:
            self._averages[wire] += share * (temperatures[wire] - self._averages[wire])
            self._trends[wire] += share * (self._averages[wire] - self._trends[wire])
            self._junctions[wire] += share * (junctions[wire] - self._junctions[wire])
        self._amplifiers = sum(self._junctions) / len(self._junctions)
        for wire in self._wires:
            offset = self._averages[wire] - self._amplifiers
            if offset < -AGREEMENT_TOLERANCE:
                self.trip(BELOW_ROOM, self._heat_counted_until)
            offset = min(AGREEMENT_TOLERANCE, max(-AGREEMENT_TOLERANCE, offset))
            # No wire is below the room, so the least difference is that of a cold wire.
            if self._samples > SETTLING_SAMPLES:
                offset = min(offset, self._offsets[wire])
            self._offsets[wire] = offset
            self._rooms[wire] = self._amplifiers + offset

    def _check_wire(self, wire, temperature, faults, elapsed, now):
        self._bad_samples[wire] = self._bad_samples[wire] + 1 if faults else 0
        if self._bad_samples[wire] >= BAD_SAMPLES:
            if faults & 1:
                self.trip(THERMOCOUPLE_OPEN, now)
            elif faults & 2:
                self.trip(THERMOCOUPLE_TO_GROUND, now)
            elif faults & 4:
                self.trip(THERMOCOUPLE_TO_SUPPLY, now)
            else:
                self.trip(AMPLIFIER, now)
        if not self._averages:
            return
        if not faults:
            self._hot_samples[wire] = (
                self._hot_samples[wire] + 1 if temperature > TEMPERATURE_LIMIT else 0
            )
        if self._hot_samples[wire] >= HOT_SAMPLES:
            self.trip(OVER_TEMPERATURE, now)
        if self._temperatures and abs(temperature - self._temperatures[wire]) > LARGEST_JUMP:
            self.trip(TEMPERATURE_JUMP, now)
        observer, room = self.observers[wire], self._rooms[wire]
        if self._samples <= SETTLING_SAMPLES:
            observer.most = max(observer.most, self._averages[wire] - room)
        if elapsed > 0:
            observer.advance(self._heat_given[wire] / elapsed, elapsed / 1000, temperature - room)
        if not self.proven[wire]:
            self._prove(wire)
        if observer.shortfall > MAX_SHORTFALL:
            self.trip(NOT_WARMING, now)
        rise = LEAD_FACTOR * max(0.0, self._averages[wire] - self._trends[wire])
        ahead = self._averages[wire] + rise  # of its thermocouple, as the wire is
        if ahead > TEMPERATURE_LIMIT + OVERSHOOT:
            self.trip(OVER_TEMPERATURE, now)
        others = 0.0
        for other in self._wires:
            if other != wire:
                others = max(others, self.observers[other].most)
        if ahead - room > observer.most + MAX_EXCESS + CROSSTALK * others:
            self.trip(TOO_WARM, now)
        # Its supply may give more heat than the most, which a thermocouple that lags shows late.
        outdone = temperature + EXCESS_HEAT_FACTOR * observer.hidden
        tapered = min(
            (NO_DUTY_TEMPERATURE - ahead) / TAPER_WIDTH,
            (MAX_WIRE_TEMPERATURE - outdone) / LAST_TAPER_WIDTH,
        )
        highest = MAX_WIRE_TEMPERATURE - max(
            room, self._amplifiers, WARM_ROOM
        )  # if in doubt, it is warm
        allowed = observer.allowed_duty(highest) if self.proven[wire] else heat.LITTLE_DUTY
        allowed = min(allowed, tapered, self._duty_of_still_reading(wire, temperature, now))
        self._allowed[wire] = 0.0 if faults else max(0.0, allowed)

    def _prove(self, wire):
        """Believes a thermocouple that follows heat: its wire is about as warm as it says."""
        observer, average = self.observers[wire], self._averages[wire]
        if observer.least < PROOF_RISE / 4 or average < self._unheated[wire]:
            self._unheated[wire] = average
        if observer.least > PROOF_RISE / 2 and average - self._unheated[wire] > PROOF_RISE:
            self.proven[wire] = True
            observer.begin(2 * (average - self._rooms[wire]) + PROVEN_MARGIN)

    def _duty_of_still_reading(self, wire, temperature, now):
        """The duty of a wire whose reading may stand still: without duty it must fall."""
        if temperature != self._readings[wire] or self.observers[wire].least < MAX_SHORTFALL:
            self._readings[wire], self._still_since[wire] = temperature, now
        begin, end, latest = STILL_TIMES
        still = now - self._still_since[wire]
        if still > latest and temperature - self._rooms[wire] > AGREEMENT_TOLERANCE:
            self.trip(NOT_WARMING, now)
        return (end - still) / (end - begin)

    def _pull(self, angle):
        """How much warmer the wires that turn an angle one way are than others, at least, °C."""
        pull = 0.0
        for wire in self._wires:
            pull += self._shares[angle][wire] * self.observers[wire].least
        return pull

    def _check_bend(self, angle, bend, elapsed, now):
        self._equal_bends[angle] = self._equal_bends[angle] + 1 if bend == self._bends[angle] else 0
        if self._equal_bends[angle] >= STUCK_SAMPLES:
            self.trip(BEND_STUCK, now)
        self._bends[angle] = bend
        tip = bend if self._tips[angle] is None else self._tips[angle]
        tip += min(1.0, elapsed / AVERAGING_TIME) * (bend - tip)
        self._tips[angle] = tip
        pull = self._pull(angle)
        low, high = self._pulls[angle]
        if abs(tip - self._tips_before[angle]) > MIN_TIP_MOTION:
            self._tips_before[angle], low, high = tip, pull, pull
        low, high = min(low, pull), max(high, pull)
        self._pulls[angle] = low, high
        if high - low > MIN_PULL_CHANGE:
            self.trip(BEND_STUCK, now)

    def _account(self, now):
        """Counts the heat that the wires were given up to now."""
        for wire in self._wires:
            self._heat_given[wire] += self.duty[wire] * (now - self._heat_counted_until)
        self._heat_counted_until = now

    def _apply(self, now):
        """Sets the duty to what was asked for, as far as temperatures and power allow it."""
        self._account(now)
        for wire in self._wires:
            self.duty[wire] = min(self._commanded[wire], self._allowed[wire])
        total = sum(self.duty)
        if total > self._total:
            for wire in self._wires:
                self.duty[wire] *= self._total / total

    def warmest(self, wire):
        """The most that a wire can have by the heat that it was given, °C, in a byte."""
        if not self.proven[wire]:
            return int(MAX_WIRE_TEMPERATURE)
        return min(255, max(0, int(self._rooms[wire] + self.observers[wire].most + 0.5)))

    def trip(self, reason, now):
        """Switches off. The first latching reason is kept; others are replaced by newer ones."""
        self._commanded = [0.0] * len(self.duty)
        self._apply(now)
        self._faulty = self._faulty or reason >= LATCHING
        if self.reason < LATCHING:
            self.reason = reason
        if self.state == ARMED:
            self.state = DISARMED
            self._renew_challenge()

    def _renew_challenge(self):
        """Sets a new challenge: frames that were sent before can neither arm nor command."""
        self.session = None
        self.challenge = (self.challenge * 25173 + 13849) & 0xFFFF
