"""The board's program, apart from the board. Runs under MicroPython and CPython alike.

A board is an object with

- ``ticks()``: ms, counting on without wrapping;
- ``receive()``: bytes from the host, maybe none;
- ``send(data)``: bytes to the host, which may get lost; it does not wait;
- ``read_thermocouple(wire)``: the 4 bytes of its MAX31855;
- ``read_bend()``: the 3 bytes of the bend sensor, or none if it is silent;
- ``set_duty(wire, duty)``: PWM, duty in [0, 1];
- ``keep_supply()``: holds the relay in the wires' supply for some passes of the loop;
- ``feed()``: the watchdog;
- ``remember(reason)``: a byte, which outlives a reset, and is ``remembered`` after it;
- ``reset_cause``: cause of the last reset, as below;
- ``serial_number``: 8 bytes; ``random``: 16 bits, other ones at each start.
"""

from . import guard, protocol, readings

FIRMWARE_VERSION = 3
CHANNELS = 2  # wires, each with its thermocouple
SAMPLE_PERIOD = 50  # ms
LONGEST_STANDSTILL = 50  # passes of the loop, in which the clock must go on
THERMOCOUPLE_TURN = 2  # samples: a MAX31855 needs 100 ms between readings to convert

# Causes of a reset.
POWER_ON, PIN_RESET, WATCHDOG_RESET, SOFT_RESET, LOCKUP_RESET, UNKNOWN_RESET = 0, 1, 2, 3, 4, 5
_REASONS = {POWER_ON: guard.POWER_UP, PIN_RESET: guard.RESET, SOFT_RESET: guard.RESET}


class Firmware:
    """The board's program, in steps."""

    def __init__(self, board):
        self._board = board
        self._parser = protocol.Parser(
            (protocol.HELLO, protocol.ARM, protocol.COMMAND, protocol.DISARM, protocol.CLEAR)
        )
        now = board.ticks()
        reason = _REASONS.get(board.reset_cause, guard.RESTARTED)
        if board.reset_cause != POWER_ON and board.remembered >= guard.LATCHING:
            reason = board.remembered
        self.guard = guard.Guard(now, board.random, reason)
        self._remembered = board.remembered
        self._next = self._now = now
        self._standing = 0  # passes, for which the clock stood still
        self._sequence = 0
        self._quarters = [0, 0]
        self._junctions = [0, 0]
        self._faults = [0, 0]
        self._bend = None
        self._applied = [None, None]
        self._apply()

    def step(self):
        """One pass of the loop; the board makes some hundred per second."""
        board = self._board
        now = board.ticks()
        self._standing = self._standing + 1 if now == self._now else 0
        self._now = now
        if self._standing > LONGEST_STANDSTILL:  # and a watchdog of the same clock stands, too
            self.guard.trip(guard.CLOCK, now)
        for kind, values in self._parser.feed(board.receive()):
            self._handle(kind, values, now)
        self.guard.tick(now)
        sampling = now >= self._next
        if sampling:
            self._next = max(self._next + SAMPLE_PERIOD, now + SAMPLE_PERIOD // 2)
            self._read(now)
        self._apply()
        if self.guard.state == guard.ARMED and not self._standing:
            board.keep_supply()
        if sampling:
            self._send_sample(now)
            board.feed()  # only here: sensors were read, and the guard has seen it

    def _handle(self, kind, values, now):
        if kind == protocol.COMMAND:
            session, sequence, heard, left, right = values
            full = protocol.FULL_DUTY
            self.guard.command(session, sequence, heard, left / full, right / full, now)
        elif kind == protocol.ARM:
            self.guard.arm(*protocol.read_arm_values(values), now)
        elif kind == protocol.DISARM:
            self.guard.disarm(now)
        elif kind == protocol.CLEAR:
            self.guard.clear(values[0])
        else:
            self._board.send(
                protocol.encode(
                    protocol.INFO,
                    FIRMWARE_VERSION,
                    SAMPLE_PERIOD,
                    int(4 * guard.TEMPERATURE_LIMIT),
                    self._board.serial_number,
                    CHANNELS,
                    self._board.reset_cause,
                )
            )

    def _read(self, now):
        board = self._board
        if self._sequence % THERMOCOUPLE_TURN == 0:
            for wire in (0, 1):
                reading = readings.thermocouple(board.read_thermocouple(wire))
                self._faults[wire] = reading[2]
                if not reading[2]:  # else it is no temperature, and the one before is kept
                    self._quarters[wire], self._junctions[wire] = reading[:2]
        self._bend = readings.bend(board.read_bend())
        temperatures = [quarters / 4 for quarters in self._quarters]
        junctions = [sixteenths / 16 for sixteenths in self._junctions]
        self.guard.sample(now, temperatures, junctions, self._faults, self._bend)

    def _apply(self):
        for wire in (0, 1):
            if self._applied[wire] != self.guard.duty[wire]:
                self._applied[wire] = self.guard.duty[wire]
                self._board.set_duty(wire, self._applied[wire])
        latched = self.guard.reason if self.guard.reason >= guard.LATCHING else 0
        if latched != self._remembered:
            self._remembered = latched
            self._board.remember(latched)

    def _send_sample(self, now):
        self._sequence = (self._sequence + 1) & 0xFFFF
        frame = protocol.encode(
            protocol.SAMPLE,
            self._sequence,
            now & 0xFFFFFFFF,
            self.guard.challenge,
            self.guard.state,
            self.guard.reason,
            self.guard.acknowledged & 0xFFFF,
            self._quarters[0],
            self._quarters[1],
            0 if self._bend is None else self._bend,
            int(protocol.FULL_DUTY * self._applied[0] + 0.5),
            int(protocol.FULL_DUTY * self._applied[1] + 0.5),
            self.guard.warmest(0),
            self.guard.warmest(1),
        )
        for _ in (1, 2):  # one may get lost, and a host that hears nothing may not heat
            self._board.send(frame)
