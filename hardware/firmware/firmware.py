"""The board's program, for any board. It runs under MicroPython and CPython.

A board is an object with

- ``channels``: number of wires, each with its thermocouple; ``angles``: number of bend angles;
- ``ticks()``: ms, counting on without wrapping;
- ``receive()``: returns bytes from the host, possibly none;
- ``send(data)``: sends bytes to the host, which may get lost, without waiting;
- ``read_thermocouple(wire)``: returns the 4 bytes of its MAX31855;
- ``read_bend()``: returns a byte 0, and 2 bytes for each angle, in 1/64 degree, low byte first; no
  bytes if a bend sensor is silent;
- ``set_duty(wire, duty)``: sets the PWM, duty in [0, 1];
- ``keep_supply()``: holds the relay in the wires' supply for some passes of the loop;
- ``feed()``: feeds the watchdog;
- ``remember(reason)``: stores a byte that outlives a reset, and is ``remembered`` after it;
- ``reset_cause``: cause of the last reset, see below;
- ``serial_number``: 8 bytes; ``random``: 16 bits that differ at each start.
"""

from . import guard, protocol, readings

SAMPLE_PERIOD = 50  # ms
LONGEST_STANDSTILL = 50  # passes of the loop, within which the clock must go on
THERMOCOUPLE_TURN = 2  # samples: a MAX31855 needs 100 ms between readings to convert

# Causes of a reset.
POWER_ON, PIN_RESET, WATCHDOG_RESET, SOFT_RESET, LOCKUP_RESET, UNKNOWN_RESET = 0, 1, 2, 3, 4, 5
_REASONS = {POWER_ON: guard.POWER_UP, PIN_RESET: guard.WAS_RESET, SOFT_RESET: guard.WAS_RESET}


class Firmware:
    """The board's program, in steps."""

    def __init__(self, board):
        channels = board.channels
        self._board = board
        self._wires = range(channels)
        self._parser = protocol.Parser(protocol.KINDS)
        self._bounds_frames = [None] * channels  # values of each wire's last BOUNDS frame
        # The guard begins with the reason of the reset, or with a latched fault from before it.
        now = board.ticks()
        reason = _REASONS.get(board.reset_cause, guard.RESTARTED)
        if board.reset_cause != POWER_ON and board.remembered >= guard.LATCHING:
            reason = board.remembered
        self.guard = guard.Guard(now, board.random, reason, channels, board.angles)
        self._remembered = board.remembered  # reason that the board stores over a reset
        self._next_sample = now  # ms, when the sensors are read next
        self._last_pass = now  # ms, when the loop was run last
        self._standstill = 0  # passes of the loop in which the clock stood still
        self._sequence = 0  # number of the last sample
        # The last readings of the sensors: of each wire's thermocouple, and of the bend.
        self._quarters = [0] * channels  # temperature, 1/4 °C
        self._junctions = [0] * channels  # temperature of the amplifier, 1/16 °C
        self._faults = [0] * channels  # fault bits
        self._bends = None  # each angle, 1/64 degree; None without a valid reading
        # The duty that is set at the pins, in [0, 1]; None before it is first set.
        self._applied_duty = [None] * channels
        self._apply()

    def step(self):
        """Run one pass of the loop; the board makes some hundred per second."""
        # Check the clock.
        board = self._board
        now = board.ticks()
        self._standstill = self._standstill + 1 if now == self._last_pass else 0
        self._last_pass = now
        if self._standstill > LONGEST_STANDSTILL:  # a watchdog with the same clock stands, too
            self.guard.trip(guard.CLOCK_STANDS, now)
        # Handle frames, end a duty that is too old, and read the sensors every 50 ms.
        for kind, values in self._parser.feed(board.receive()):
            self._handle(kind, values, now)
        self.guard.tick(now)
        sampling = now >= self._next_sample
        if sampling:
            self._next_sample = max(self._next_sample + SAMPLE_PERIOD, now + SAMPLE_PERIOD // 2)
            self._read(now)
        # Set the pins, and send the sample.
        self._apply()
        if self.guard.state == guard.ARMED and not self._standstill:
            board.keep_supply()
        if sampling:
            self._send_sample(now)
            board.feed()  # only here, after sensors were read and checked

    def _handle(self, kind, values, now):
        if kind == protocol.BOUNDS:
            if values[1] < len(self._bounds_frames):
                self._bounds_frames[values[1]] = values
        elif kind == protocol.ARM:
            self._arm(values, now)
        elif kind == protocol.COMMAND:
            duty = [ticks / protocol.FULL_DUTY for ticks in values[3:]]
            self.guard.command(values[0], values[1], values[2], duty, now)
        elif kind == protocol.DISARM:
            self.guard.disarm(now)
        elif kind == protocol.CLEAR:
            self.guard.clear(values[0])
        else:
            board = self._board
            info = [protocol.VERSION, SAMPLE_PERIOD, int(4 * guard.TEMPERATURE_LIMIT)]
            info += [board.serial_number, board.channels, board.angles, board.reset_cause]
            board.send(protocol.encode(protocol.INFO, *info))

    def _arm(self, values, now):
        """Arm, with no bounds unless all BOUNDS came that the ARM is for."""
        challenge, channels, total, expected = values
        frames = self._bounds_frames
        complete = channels == len(frames) and all(
            frame and frame[0] == challenge for frame in frames
        )
        if not complete or protocol.checksum(frames) != expected:
            frames = ()
        # Decode bounds and pulls.
        bounds = []
        for frame in frames:
            bounds.append([value / s for value, s in zip(frame[2:7], protocol.BOUND_SCALES)])
        pulls = [frame[7] for frame in frames]
        shares = [protocol.shares(pulls, angle) for angle in range(self._board.angles)]
        self.guard.arm(challenge, bounds, total / protocol.FULL_DUTY, shares, now)

    def _read(self, now):
        # Read thermocouples in every second sample.
        board = self._board
        if self._sequence % THERMOCOUPLE_TURN == 0:
            for wire in self._wires:
                reading = readings.thermocouple(board.read_thermocouple(wire))
                self._faults[wire] = reading[2]
                if not reading[2]:  # with a fault the reading before is kept
                    self._quarters[wire] = reading[0]
                    self._junctions[wire] = reading[1]
        # Read the bend, and check all readings.
        self._bends = readings.bends(board.read_bend(), board.angles)
        temperatures = [quarters / 4 for quarters in self._quarters]
        junctions = [sixteenths / 16 for sixteenths in self._junctions]
        self.guard.sample(now, temperatures, junctions, self._faults, self._bends)

    def _apply(self):
        for wire in self._wires:
            if self._applied_duty[wire] != self.guard.duty[wire]:
                self._applied_duty[wire] = self.guard.duty[wire]
                self._board.set_duty(wire, self._applied_duty[wire])
        latched = self.guard.reason if self.guard.reason >= guard.LATCHING else 0
        if latched != self._remembered:
            self._remembered = latched
            self._board.remember(latched)

    def _send_sample(self, now):
        # A SAMPLE has the state and the bends.
        self._sequence = (self._sequence + 1) & 0xFFFF
        subject = self.guard
        header = [self._sequence, now & 0xFFFFFFFF, subject.challenge, subject.state]
        header += [subject.reason, subject.acknowledged]
        bends = [0] * self._board.angles if self._bends is None else list(self._bends)
        frames = [protocol.encode(protocol.SAMPLE, *(header + bends))]
        # CHANNELS have the wires, in groups.
        for first in range(0, len(self._wires), protocol.GROUP):
            values = [self._sequence, first, len(self._wires)]
            for wire in self._wires[first : first + protocol.GROUP]:
                ticks = int(protocol.FULL_DUTY * self._applied_duty[wire] + 0.5)
                quarters = protocol.NO_READING if self._faults[wire] else self._quarters[wire]
                values += [quarters, ticks, subject.warmest(wire)]
            frames.append(protocol.encode(protocol.CHANNELS, *values))
        # Send all twice, because a frame may get lost, and a host without samples must not heat.
        for _ in (1, 2):
            for frame in frames:
                self._board.send(frame)
