"""An emulated board in simulated time at a host's `Bench`, with any limb, or one on paper."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from hardware.board.link import shares_of
from hardware.emulation.emulated_board import RunningTwin
from hardware.emulation.emulator import Emulation
from limb_systems import LimbParameters, SerialBoard

from .firmware_checks import ROOM

STEP = 10  # ms, of the loop
TURN = np.deg2rad(0.25)  # rad of bend angle by 1 °C of one wire


class PaperTwin(RunningTwin):
    """A limb on paper: nominal wires by (6) and (7), whose heat alone bends it."""

    def __init__(self, limb: LimbParameters | None = None):
        limb = dataclasses.replace(limb or LimbParameters(), board=SerialBoard("paper000"))
        self.twin = SimpleNamespace(parameters=limb, specimen=SimpleNamespace(ambient=ROOM))
        self.duty = np.zeros(len(limb.wires))
        self._shares = shares_of(limb)
        self._time = 0.0
        self.cool()

    def cool(self):
        self._wires = np.full(len(self.duty), ROOM)
        self._thermocouples = self._wires.copy()

    def advance(self, time):
        if time <= self._time:
            return
        interval = time - self._time
        self._time = time
        lag = self._wires - self._thermocouples
        self._wires += interval * (20.0 * self.duty - 0.07 * (self._wires - ROOM))
        self._thermocouples += interval * lag

    def reading(self, name):
        if name == "measured_temperature":
            return self._thermocouples
        return TURN * self._shares @ self._wires

    def wire_temperature(self):
        return self._wires


class EmulatedCable:
    """Both ends of the cable to an emulated board, in simulated time."""

    def __init__(self, twin):
        self.milliseconds = 0
        self.to_board = b""
        self.to_host = b""
        self.emulation = Emulation(twin, self, self.note, clock=self.now)
        self.duty = None

    def note(self, event, time, **duty):
        if event == "duty":
            self.duty = list(duty.values())

    def read(self):
        data = self.to_board
        self.to_board = b""
        return data

    def write(self, data):
        self.to_host += data

    def send(self, data):
        self.to_board += data

    def receive(self):
        data = self.to_host
        self.to_host = b""
        return data

    def now(self):
        return self.milliseconds / 1000

    def wait(self, seconds):
        for _ in range(round(1000 * seconds / STEP)):
            self.milliseconds += STEP
            self.emulation.step()

    def ask(self, order, by_hand):
        self.emulation.inject_fault(order)
        return True
