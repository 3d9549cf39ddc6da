"""The board's safety rules: whether the wires may be heated, and how much.

This runs under MicroPython and CPython. Times are in ms and do not wrap; duty is in [0, 1];
temperatures are in °C.
"""

from . import heat

# States. Duty is zero except in ARMED.
DISARMED, ARMED = 0, 1

# Reasons for which the board is off, in every sample.
NO_REASON = 0
NO_COMMAND = 1  # no valid command came for HEARTBEAT
OUT_OF_RANGE = 2  # a command had a duty out of range
BY_HOST = 3  # the host disarmed it
POWER_UP = 4
WAS_RESET = 5  # by its button, or by a program
LATE_COMMANDS = 6  # the commands that came were older than HEARTBEAT
BAD_BOUNDS = 7  # the host armed it with bounds out of their ranges
DISAGREEING = 8  # thermocouples and amplifiers of cold wires, when it was to be armed
# These latch until they are cleared.
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
CLOCK_STANDS = 28
LATCHING = 16

AVERAGING_TIME = 1000  # ms, over which readings are averaged against their noise
HEARTBEAT = 250  # ms, for which a duty holds; an answer to an older sample is too late
LONGEST_HOLD = 290  # ms, for which a duty holds after the sample that its command answered
SETTLING_SAMPLES = 10  # before it can be armed: its clock runs, and noise is averaged
TEMPERATURE_LIMIT = 110.0  # °C, measured
OVERSHOOT = 10.0  # °C above that limit, for the estimate of a wire's temperature
LEAD_FACTOR = 2.5  # AVERAGING_TIMEs, lag of average and thermocouple behind the wire
NO_DUTY_TEMPERATURE = 105.0  # °C of a wire, at which its duty is zero
TAPER_WIDTH = 5.0  # °C below it, over which the duty is reduced
# Samples in series; each reading is in two. One hot reading may be noise, and a MOSFET that
# switches near an amplifier may spoil one reading.
HOT_SAMPLES = 4  # above TEMPERATURE_LIMIT
BAD_SAMPLES = 3  # with a fault
MAX_WIRE_TEMPERATURE = 127.0  # °C, largest upper bound of a wire's temperature
EXCESS_HEAT_FACTOR = 1.5  # largest heat of a supply over the bound of the most heat
LAST_TAPER_WIDTH = 10.0  # °C below MAX_WIRE_TEMPERATURE, for a reading plus its hidden rise
COLDEST_ROOM = 10.0  # °C, by the amplifiers
WARM_ROOM = 25.0  # °C, possible temperature of the room for any reading of the amplifiers
PROOF_RISE = 2.0  # °C; a thermocouple is proven after a start when heat has raised it so much
PROVEN_MARGIN = 10.0  # °C; a wire has at most twice its rise and this margin then
# ms, for which a heated wire's reading does not change at all: then its duty is reduced, is zero,
# and at last the reading should have fallen.
STILL_TIMES = 5000, 10000, 15000
LARGEST_JUMP = 10.0  # °C from one reading to the next
MAX_SHORTFALL = 3.0  # °C, of a reading below the least by its wire's heat
MAX_EXCESS = 15.0  # °C, of a reading above the most by its wire's heat
CROSSTALK = 0.25  # share of another wire's temperature that may reach this wire through the limb
COLD_RISE = 3.0  # °C above the room; colder wires must have equal readings
AGREEMENT_TOLERANCE = 8.0  # °C, within which these readings are equal
STUCK_SAMPLES = 10  # equal to the last bit, which a working bend sensor never sends
# The tip must turn by so much (1/64 degrees) when the pull, the difference in temperature between
# wires on opposite sides, has changed by so much (°C).
MIN_TIP_MOTION = 3 * 64
MIN_PULL_CHANGE = 60.0


class Guard:
    """Sets the duty: reduces it where a wire gets hot, and to zero after any fault."""

    def __init__(self, now, challenge, reason=POWER_UP, channels=2, angles=1):
        """now: ms. challenge: number that the next arming must repeat. reason: why it is off."""
        self._wires = range(channels)
        self._angles = range(angles)
        self.state = DISARMED
        self.reason = reason
        self.challenge = challenge
        self.session = None
        self.acknowledged = 0
        self.duty = [0.0] * channels
        # Nobody knows how warm the wires are after a reset.
        most = 0.0 if reason == POWER_UP else heat.HIGHEST_RISE
        self.observers = [heat.WireObserver(most) for _ in self._wires]
        # A thermocouple is proven when it has followed some heat since the start.
        self.proven = [False] * channels
        self._unheated = [0.0] * channels  # °C, averages before the heat
        self._readings = [None] * channels  # °C, and the time since which it is the same
        self._still_since = [now] * channels
        self._commanded = [0.0] * channels
        self._allowed = [0.0] * channels
        self._total = 0.0
        self._heat_given = [0.0] * channels  # duty times ms since the last sample
        self._heat_counted_until = now
        # Times of the last command, and of the sample that it answers; whether a later one is late.
        self._command_time = now
        self._answered_time = now
        self._late = False
        # Samples: temperatures of wires and amplifiers, °C, averaged once and twice (trends).
        self._samples = 0
        self._sample_time = now
        self._faulty = False
        self._temperatures = self._averages = self._trends = self._junctions = None
        self._offsets = [0.0] * channels  # °C, cold thermocouple above the amplifiers
        self._rooms = [0.0] * channels  # °C, reading of a thermocouple in the room
        self._hot_samples = [0] * channels
        self._bad_samples = [0] * channels
        # Bends: readings, their averages now and when the tip last moved, and since then the least
        # and largest pull.
        self._bends = [None] * angles
        self._equal_bends = [0] * angles
        self._tips = [None] * angles
        self._tips_before = [0.0] * angles
        self._shares = [[0.0] * channels] * angles
        self._pulls = [(0.0, 0.0)] * angles

    def arm(self, challenge, bounds, total, shares, now):
        """Arm the board if the host repeats the challenge, nothing is latched and sensors agree.

        bounds: bounds of each wire, see `heat`; total: largest sum of all duties; shares: for each
        angle, the shares of the wires' torques that turn it.
        """
        if challenge != self.challenge or self.state == ARMED or self.reason >= LATCHING:
            return
        if self._samples < SETTLING_SAMPLES or self._faulty:
            return
        # Refuse bad bounds, and sensors that disagree.
        acceptable = len(bounds) == len(self.duty) and 0.0 < total <= len(self.duty)
        if not acceptable or not all(
            heat.are_acceptable(bound) and heat.can_detect_overheating(bound, total)
            for bound in bounds
        ):
            self.reason = BAD_BOUNDS
            return
        if not self._sensors_agree():
            self.reason = DISAGREEING
            return
        self.state = ARMED
        self.reason = NO_REASON
        self.session = challenge
        self.acknowledged = 0
        self._command_time = self._answered_time = now
        self._late = False
        self._total = total
        if shares != self._shares:
            self._shares = shares
            self._pulls = [(pull, pull) for pull in map(self._pull, self._angles)]
        for observer, bound in zip(self.observers, bounds):
            observer.bounds = bound

    def _sensors_agree(self):
        """Return whether cold wires and amplifiers have the same temperature, of a room."""
        cold = [self._averages[w] for w in self._wires if self.observers[w].most < COLD_RISE]
        cold += self._junctions
        return max(cold) - min(cold) <= AGREEMENT_TOLERANCE and min(self._junctions) >= COLDEST_ROOM

    def command(self, session, sequence, sample_time, duty, now):
        """Set the duty if the command is newer than all commands before in this session.

        sequence: modulo 2**16; sample_time: time of the newest sample that the host had, ms modulo
        2**32; duty: of each wire.
        """
        # Ignore commands of another session, copies and older ones.
        if self.state != ARMED or session != self.session or len(duty) != len(self.duty):
            return
        if not 0 < (sequence - self.acknowledged) & 0xFFFF < 0x8000:
            return
        if min(duty) < 0.0 or max(duty) > 1.0:
            self.trip(OUT_OF_RANGE, now)
            return
        # Ignore a command that answers an older sample.
        age = (now - sample_time) & 0xFFFFFFFF
        if age >= HEARTBEAT:
            self._late = True
            return
        self.acknowledged = sequence
        self._command_time = now
        self._answered_time = max(self._answered_time, now - age)
        self._late = False
        self._commanded = duty
        self._apply(now)

    def disarm(self, now):
        """Disarm the board, on the host's request."""
        if self.state == ARMED:
            self.trip(BY_HOST, now)

    def clear(self, challenge):
        """Clear a latched reason; the board stays off until it is armed."""
        if challenge == self.challenge and self.reason >= LATCHING:
            self.reason = BY_HOST
            self._renew_challenge()

    def tick(self, now):
        """Check the heartbeat; must be called continually."""
        if self.state == ARMED and (
            now - self._command_time >= HEARTBEAT or now - self._answered_time >= LONGEST_HOLD
        ):
            self.trip(LATE_COMMANDS if self._late else NO_COMMAND, now)

    def sample(self, now, temperatures, junctions, faults, bends):
        """Check a sample of all sensors.

        temperatures: readings of each wire, °C; junctions, faults: temperatures, °C, and fault
        bits of their amplifiers. Temperatures with a fault are from the reading before. bends: raw
        readings, or None if a sensor does not answer.
        """
        # Average the readings, which begin with a sample without faults.
        self._faulty = any(faults)
        self._account(now)
        elapsed = now - self._sample_time
        if self._samples or not self._faulty:
            self._average(temperatures, junctions, elapsed)
        # Check each sensor, then allow as much duty as the checks leave.
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
        """Average over noise, and estimate the reading of each thermocouple in the room."""
        if not self._samples:
            self._averages = list(temperatures)
            self._junctions = list(junctions)
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
            # No wire is below the room, so a cold wire has the least difference.
            if self._samples > SETTLING_SAMPLES:
                offset = min(offset, self._offsets[wire])
            self._offsets[wire] = offset
            self._rooms[wire] = self._amplifiers + offset

    def _check_wire(self, wire, temperature, faults, elapsed, now):
        """Check a wire's reading, and set the duty that is allowed for the wire."""
        # Trip after several samples with a fault.
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
        # Trip if the reading is too hot, or jumps.
        if not faults:
            is_hot = temperature > TEMPERATURE_LIMIT
            self._hot_samples[wire] = self._hot_samples[wire] + 1 if is_hot else 0
        if self._hot_samples[wire] >= HOT_SAMPLES:
            self.trip(OVER_TEMPERATURE, now)
        if self._temperatures and abs(temperature - self._temperatures[wire]) > LARGEST_JUMP:
            self.trip(TEMPERATURE_JUMP, now)
        # Update the bounds of the temperature by the heat, and trip if the reading is below them.
        observer = self.observers[wire]
        room = self._rooms[wire]
        if self._samples <= SETTLING_SAMPLES:
            observer.most = max(observer.most, self._averages[wire] - room)
        if elapsed > 0:
            observer.advance(self._heat_given[wire] / elapsed, elapsed / 1000, temperature - room)
        if not self.proven[wire]:
            self._prove(wire)
        if observer.shortfall > MAX_SHORTFALL:
            self.trip(NOT_WARMING, now)
        # Estimate the wire, which is ahead of its thermocouple; trip if it is above its bounds.
        lead = LEAD_FACTOR * max(0.0, self._averages[wire] - self._trends[wire])
        ahead = self._averages[wire] + lead
        if ahead > TEMPERATURE_LIMIT + OVERSHOOT:
            self.trip(OVER_TEMPERATURE, now)
        warmest_neighbor = 0.0
        for neighbor in self._wires:
            if neighbor != wire:
                warmest_neighbor = max(warmest_neighbor, self.observers[neighbor].most)
        if ahead - room > observer.most + MAX_EXCESS + CROSSTALK * warmest_neighbor:
            self.trip(TOO_WARM, now)
        # Reduce the duty near the limits. A supply may give more heat than the bound of the most
        # heat, and a thermocouple that lags shows that late.
        tapered = (NO_DUTY_TEMPERATURE - ahead) / TAPER_WIDTH
        with_excess = temperature + EXCESS_HEAT_FACTOR * observer.hidden
        tapered = min(tapered, (MAX_WIRE_TEMPERATURE - with_excess) / LAST_TAPER_WIDTH)
        highest_rise = MAX_WIRE_TEMPERATURE - max(room, self._amplifiers, WARM_ROOM)
        allowed = observer.allowed_duty(highest_rise) if self.proven[wire] else heat.LITTLE_DUTY
        allowed = min(allowed, tapered, self._duty_of_still_reading(wire, temperature, now))
        self._allowed[wire] = 0.0 if faults else max(0.0, allowed)

    def _prove(self, wire):
        """Mark a thermocouple as proven if it follows heat: it shows about the wire's rise."""
        observer = self.observers[wire]
        average = self._averages[wire]
        if observer.least < PROOF_RISE / 4 or average < self._unheated[wire]:
            self._unheated[wire] = average
        if observer.least > PROOF_RISE / 2 and average - self._unheated[wire] > PROOF_RISE:
            self.proven[wire] = True
            observer.begin(2 * (average - self._rooms[wire]) + PROVEN_MARGIN)

    def _duty_of_still_reading(self, wire, temperature, now):
        """Return the allowed duty of a wire, less and less while its reading stands still."""
        if temperature != self._readings[wire] or self.observers[wire].least < MAX_SHORTFALL:
            self._readings[wire] = temperature
            self._still_since[wire] = now
        begin, end, latest = STILL_TIMES
        still = now - self._still_since[wire]
        if still > latest and temperature - self._rooms[wire] > AGREEMENT_TOLERANCE:
            self.trip(NOT_WARMING, now)
        return (end - still) / (end - begin)

    def _pull(self, angle):
        """Return the least pull on an angle: °C of wires on one side minus °C on the other."""
        pull = 0.0
        for wire in self._wires:
            pull += self._shares[angle][wire] * self.observers[wire].least
        return pull

    def _check_bend(self, angle, bend, elapsed, now):
        """Check that a bend sensor is not stuck, and never sends the same number several times."""
        self._equal_bends[angle] = self._equal_bends[angle] + 1 if bend == self._bends[angle] else 0
        if self._equal_bends[angle] >= STUCK_SAMPLES:
            self.trip(BEND_STUCK, now)
        # The averaged tip must turn when the pull of the wires has changed by much.
        self._bends[angle] = bend
        tip = bend if self._tips[angle] is None else self._tips[angle]
        tip += min(1.0, elapsed / AVERAGING_TIME) * (bend - tip)
        self._tips[angle] = tip
        pull = self._pull(angle)
        low, high = self._pulls[angle]
        if abs(tip - self._tips_before[angle]) > MIN_TIP_MOTION:
            self._tips_before[angle] = tip
            low = high = pull
        low = min(low, pull)
        high = max(high, pull)
        self._pulls[angle] = low, high
        if high - low > MIN_PULL_CHANGE:
            self.trip(BEND_STUCK, now)

    def _account(self, now):
        """Count the heat that the wires got up to now."""
        for wire in self._wires:
            self._heat_given[wire] += self.duty[wire] * (now - self._heat_counted_until)
        self._heat_counted_until = now

    def _apply(self, now):
        """Set the duty to the commanded duty, as far as temperatures and total duty allow it."""
        self._account(now)
        for wire in self._wires:
            self.duty[wire] = min(self._commanded[wire], self._allowed[wire])
        total = sum(self.duty)
        if total > self._total:
            for wire in self._wires:
                self.duty[wire] *= self._total / total

    def warmest(self, wire):
        """Return the highest temperature that a wire can have by its heat, °C, in a byte."""
        if not self.proven[wire]:
            return int(MAX_WIRE_TEMPERATURE)
        return min(255, max(0, int(self._rooms[wire] + self.observers[wire].most + 0.5)))

    def trip(self, reason, now):
        """Switch off. The first latching reason is kept; newer reasons replace other reasons."""
        self._commanded = [0.0] * len(self.duty)
        self._apply(now)
        self._faulty = self._faulty or reason >= LATCHING
        if self.reason < LATCHING:
            self.reason = reason
        if self.state == ARMED:
            self.state = DISARMED
            self._renew_challenge()

    def _renew_challenge(self):
        """Set a new challenge: older frames can neither arm nor command."""
        self.session = None
        self.challenge = (self.challenge * 25173 + 13849) & 0xFFFF
