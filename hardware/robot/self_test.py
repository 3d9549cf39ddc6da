"""The guided self test of a robot, before it is trusted with a plan."""

import time
from collections.abc import Callable

import numpy as np

from hardware.robot.link import BoardLink, Sample
from limb_systems import LimbParameters, bend_angle_from_tip_tangent

DUTY = 0.3
HEATING_TIME = 6.0  # s for each wire
PERIOD = 0.05  # s between commands
ROOM = (5.0, 45.0)  # °C, that cold wires may have
RISE = 3.0  # °C
BEND = np.deg2rad(1.0)
SIDES = ("left", "right")
BOUNDS = LimbParameters().heat_bounds  # of the nominal limb


def self_test(link: BoardLink, say: Callable[[bool, str], None]) -> bool:
    """Whether sensors are alive and each wire does what it should.

    Heats each wire a little: it must warm its own thermocouple, more than the
    other, and bend the limb to its own side. The board is disarmed at the end.

    Args:
        link: to the board.
        say: takes whether it was good, and a sentence, for each thing that was looked at.

    Raises:
        HardwareError: if the board fails on the way.
    """
    passed = True

    def judge(good: bool, what: str) -> None:
        nonlocal passed
        good = bool(good)  # not numpy's
        passed = passed and good
        say(good, what)

    info = link.info()
    judge(True, f"board {info.serial_number} answers, firmware {info.firmware_version}")
    cold = _average(link)
    for side, temperature in zip(SIDES, cold[:2], strict=True):
        good = ROOM[0] < temperature < ROOM[1]
        judge(good, f"{side} thermocouple reads {temperature:.1f} °C, as in a room")
    judge(abs(cold[2]) < np.deg2rad(30.0), f"bend sensor reads {np.rad2deg(cold[2]):+.1f}° at rest")
    if not passed:
        return False
    try:
        for wire, side in enumerate(SIDES):
            before = _average(link)
            link.arm(BOUNDS)
            end = time.monotonic() + HEATING_TIME
            while time.monotonic() < end:
                link.command(DUTY * np.eye(2)[wire])
                time.sleep(PERIOD)
            change = _average(link) - before
            link.disarm()
            own, other = change[wire], change[1 - wire]
            judge(
                own > RISE and own > 2 * other,
                f"{side} wire warms its own thermocouple by {own:.1f} °C, the other by "
                f"{other:.1f} °C",
            )
            towards = change[2] if wire else -change[2]
            judge(
                towards > BEND,
                f"{side} wire bends the limb by {np.rad2deg(towards):.1f}° to the {side}",
            )
    finally:
        link.disarm()
    return passed


def _average(link: BoardLink) -> np.ndarray:
    """[V (2), φ] over ten samples, °C and rad."""
    samples: list[Sample] = []
    while len(samples) < 10:
        sample = link.sample()
        if not samples or sample.sequence != samples[-1].sequence:
            samples.append(sample)
        if sample.armed:
            link.command(sample.duty)  # as before, or the heartbeat would end it
        time.sleep(PERIOD / 2)
    average = np.mean([[*sample.temperature, sample.tip_tangent] for sample in samples], axis=0)
    return np.append(average[:2], bend_angle_from_tip_tangent(average[2]))
