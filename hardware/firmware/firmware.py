"""The board's program, apart from the board. Runs under MicroPython and CPython alike.

A board is an object with

- ``ticks()``: ms, counting on without wrapping;
- ``receive()``: bytes from the host, maybe none;
- ``send(data)``: bytes to the host, which may get lost;
- ``read_thermocouple(wire)``: the 4 bytes of its MAX31855;
- ``read_bend()``: the 3 bytes of the bend sensor, or none if it is silent;
- ``set_duty(wire, duty)``: PWM, duty in [0, 1];
- ``feed()``: the watchdog;
- ``serial_number``: 8 bytes; ``random``: 16 bits, other ones at each start.
"""

from . import guard, protocol, readings

# What reset the board at its last start, as it tells the firmware.
POWER_ON, PIN_RESET, WATCHDOG_RESET, SOFT_RESET, LOCKUP_RESET, UNKNOWN_RESET = 0, 1, 2, 3, 4, 5

FIRMWARE_VERSION = 2
CHANNELS = 2  # wires, each with its thermocouple
SAMPLE_PERIOD = 50  # ms
THERMOCOUPLE_TURN = 2  # samples: a MAX31855 needs 100 ms between readings to convert


class Firmware:
    """The board's program, in steps."""

    def __init__(self, board):
        self._board = board
        self._parser = protocol.Parser(
            (protocol.HELLO, protocol.ARM, protocol.COMMAND, protocol.DISARM, protocol.CLEAR)
        )
        now = board.ticks()
        self.guard = guard.Guard(now, board.random)
        self._next = now
        self._sequence = 0
        self._quarters = [0, 0]
        self._faults = [0, 0]
        self._bend = None
        self._applied = [None, None]
        self._apply()

    def step(self):
        """One pass of the loop; the board makes some hundred per second."""
        board = self._board
        now = board.ticks()
        for kind, values in self._parser.feed(board.receive()):
            self._handle(kind, values, now)
        self.guard.tick(now)
        if now >= self._next:
            self._next = max(self._next + SAMPLE_PERIOD, now + SAMPLE_PERIOD // 2)
            self._read(now)
            self._apply()
            self._send_sample(now)
        self._apply()
        board.feed()

    def _handle(self, kind, values, now):
        if kind == protocol.COMMAND:
            session, sequence, left, right = values
            self.guard.command(
                session, sequence, left / protocol.FULL_DUTY, right / protocol.FULL_DUTY, now
            )
        elif kind == protocol.ARM:
            self.guard.arm(values[0], now)
        elif kind == protocol.DISARM:
            self.guard.disarm()
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
                )
            )

    def _read(self, now):
        board = self._board
        if self._sequence % THERMOCOUPLE_TURN == 0:
            for wire in (0, 1):
                self._quarters[wire], self._faults[wire] = readings.thermocouple(
                    board.read_thermocouple(wire)
                )
        self._bend = readings.bend(board.read_bend())
        temperatures = [quarters / 4 for quarters in self._quarters]
        self.guard.sample(now, temperatures, self._faults, self._bend)

    def _apply(self):
        for wire in (0, 1):
            if self._applied[wire] != self.guard.duty[wire]:
                self._applied[wire] = self.guard.duty[wire]
                self._board.set_duty(wire, self._applied[wire])

    def _send_sample(self, now):
        self._sequence = (self._sequence + 1) & 0xFFFF
        self._board.send(
            protocol.encode(
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
            )
        )
