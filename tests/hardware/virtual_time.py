"""Time that passes only while all threads of a program wait for it: no computer is too slow.

A program that drives boards, and the emulated boards, share a clock. It goes on by a millisecond
when every thread that counts waits; then each board makes a pass of its loop, and the host's
threads take what came before time goes on again. Verdicts are the same on any computer.
"""

import concurrent.futures
import functools
import random
import threading
from collections.abc import Callable
from typing import Any

from hardware import HardwareError
from hardware.board.link import BoardLink, SerialPort, check_port_exists
from hardware.emulation.emulator import LOOP_PAUSE

HANG = 600.0  # s of the computer, after which threads of the host are given up
# Modules with clocks of the program that drives boards.
MODULES = (
    "calibration.collecting.measurement_protocol",
    "hardware.board.link",
    "hardware.board.serial_limb",
    "limb_systems.progress",
    "limb_systems.simulation",
    "ros_bridge.drive",
    "soft_limb.runs.repetitions",
)


class VirtualTime:
    """The clock, in place of the module ``time``, and the boards that run along it."""

    def __init__(self, monkeypatch):
        self._turns, self._changed = 0, threading.Condition(threading.RLock())
        self._busy, self._waiting = 1, list[tuple[Callable, float]]()
        self.cables: dict[str, VirtualCable] = {}
        self._hooks: list[Callable[[], Any]] = []
        for module in MODULES:
            monkeypatch.setattr(f"{module}.time", self)
        monkeypatch.setattr("hardware.board.link.SerialPort", self._open)
        bench = functools.partial(self._open, has_thread=False)
        monkeypatch.setattr("soft_limb.commands.hardware.SerialPort", bench)
        exists = lambda port: port in self.cables or check_port_exists(port)  # noqa: E731
        monkeypatch.setattr("soft_limb.commands.hardware.check_port_exists", exists)
        monkeypatch.setattr(BoardLink, "_wait_for", self._method_of_link())
        monkeypatch.setattr(BoardLink, "_send", _send_now)
        several = "hardware.board.several_boards"
        monkeypatch.setattr(f"{several}.ThreadPoolExecutor", lambda size: _Pool(self, size))
        monkeypatch.setattr(f"{several}.wait", self._wait_of_pool)
        monkeypatch.setattr(random, "SystemRandom", lambda: random.Random(0))
        random.seed(0)

    def monotonic(self) -> float:
        return 1000.0 + self._turns * LOOP_PAUSE

    def sleep(self, seconds: float) -> None:
        self.wait_for(lambda: False, seconds)

    def wait_for(self, condition: Callable[[], Any], limit: float = 60.0) -> bool:
        """Lets time pass until something is so; whether it is."""
        me = condition, self.monotonic() + limit - LOOP_PAUSE / 2
        with self._changed:
            self._waiting.append(me)
            self._changed.notify_all()
            try:
                while not self._is_over(me):
                    is_ready = any(map(self._is_over, self._waiting))
                    if len(self._waiting) == self._busy and not is_ready:
                        self._turn()
                        self._changed.notify_all()
                    else:
                        assert self._changed.wait(HANG)
            finally:
                self._waiting.remove(me)
        return bool(condition())

    def at_each_turn(self, action: Callable[[], Any]) -> None:
        """Does something each millisecond from now on, until it returns something true."""
        self._hooks.append(action)

    def when(self, condition: Callable[[], Any], action: Callable[[], Any], after: float = 0.0):
        """Does something once, some time after a condition is met."""
        due: list[float] = []

        def look():
            if not due and condition():
                due.append(self.monotonic() + after)
            if due and self.monotonic() >= due[0] - LOOP_PAUSE / 2:
                # It may raise, as a signal does.
                self._hooks.remove(look)
                action()

        self._hooks.append(look)

    def _is_over(self, waiting) -> bool:
        condition, end = waiting
        return self.monotonic() >= end or bool(condition())

    def _turn(self) -> None:
        cables = list(self.cables.values())
        for cable in cables:
            cable.settle()
        self._turns += 1
        for cable in cables:
            if cable.board:
                cable.board.step()
            if self._turns % 10 == 0:
                cable.time_out()
        for cable in cables:
            cable.settle()
        for hook in list(self._hooks):
            if hook() and hook in self._hooks:
                self._hooks.remove(hook)

    def _open(self, port: str, has_thread: bool = True) -> Any:
        if port not in self.cables:
            return SerialPort(port)
        return self.cables[port].open(has_thread)

    def _method_of_link(self):
        def wait_for(link: BoardLink, done, limit: float) -> bool:
            return self.wait_for(lambda: done() or link._failure, limit)

        return wait_for

    def _wait_of_pool(self, futures, seconds: float):
        self.wait_for(lambda: all(future.done() for future in futures), seconds)
        return concurrent.futures.wait(futures, 0)

    def count(self, change: int) -> None:
        """Counts a thread that time waits for, or no longer."""
        with self._changed:
            self._busy += change
            self._changed.notify_all()


class _Pool(concurrent.futures.ThreadPoolExecutor):
    """Whose threads time waits for, while they have something to do."""

    def __init__(self, time: VirtualTime, size: int):
        super().__init__(size)
        self._time = time

    def submit(self, function, /, *arguments):
        self._time.count(1)

        def run():
            try:
                return function(*arguments)
            finally:
                self._time.count(-1)

        return super().submit(run)


def _send_now(link: BoardLink, frame: bytes) -> None:
    """In place of the thread that writes."""
    try:
        link._cable.send(frame)
    except HardwareError as error:
        link._fail(error)


class VirtualCable:
    """A cable between a board and the host's `SerialPort`, in whose place ``open`` returns it."""

    def __init__(self, time: VirtualTime, port: str):
        self._time, self.port = time, port
        self.board: Any = None  # makes a pass by ``step``
        self._to_board, self._to_host = b"", b""
        self._changed = threading.Condition()
        self._is_open = self._is_unplugged = self._has_thread = self._timed_out = False
        self._idle, self._reader = True, None
        time.cables[port] = self

    # The board's end.

    def read(self) -> bytes:
        with self._changed:
            data, self._to_board = self._to_board, b""
        return data

    def write(self, data: bytes) -> None:
        with self._changed:
            if self._is_open and not self._is_unplugged:
                self._to_host += data
                self._idle = not self._has_thread
                self._changed.notify_all()

    def unplug(self) -> None:
        with self._changed:
            self._is_unplugged = True
            self._changed.notify_all()

    def time_out(self) -> None:
        """Lets the host's thread see that nothing came, as it does each 10 ms at a serial port."""
        with self._changed:
            if self._has_thread:
                self._timed_out, self._idle = True, False
                self._changed.notify_all()

    def settle(self) -> None:
        """Waits until the host's thread has taken what came."""
        if self._is_unplugged and self._reader:
            self._reader.join(HANG)  # it says that its cable is gone
        with self._changed:
            taken = self._changed.wait_for(
                lambda: self._is_unplugged or not self._has_thread or self._idle, HANG
            )
            assert taken

    # The host's end.

    def open(self, has_thread: bool) -> "VirtualCable":
        if self._is_unplugged:
            raise HardwareError(f"Cannot open {self.port}: it is gone.")
        if self._is_open:
            raise HardwareError(f"{self.port} is in use by another program.")
        self._is_open, self._has_thread, self._idle = True, has_thread, not has_thread
        return self

    def __enter__(self) -> "VirtualCable":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def send(self, data: bytes) -> None:
        if self._is_unplugged:
            raise HardwareError(f"The cable to {self.port} is gone: it was unplugged.")
        with self._changed:
            self._to_board += data

    def receive(self) -> bytes:
        with self._changed:
            if self._has_thread:
                self._reader = threading.current_thread()
                self._idle = not (self._to_host or self._timed_out)
                self._changed.notify_all()
                self._changed.wait_for(
                    lambda: self._to_host or self._is_unplugged or self._timed_out, 0.01
                )
                self._timed_out = False
            if self._is_unplugged:
                raise HardwareError(f"The cable to {self.port} is gone: it was unplugged.")
            data, self._to_host = self._to_host, b""
        return data

    def now(self) -> float:
        return self._time.monotonic()

    def wait(self, seconds: float) -> None:
        self._time.sleep(seconds)

    def close(self) -> None:
        with self._changed:
            self._is_open = self._has_thread = False
            self._to_host, self._reader = b"", None
            self._changed.notify_all()
