"""The fault table over a cable: what happens while a wire is hot at full duty, in real time.

Each fault is injected into an emulated board in another process, which runs the
firmware's own files; times are from the fault to duty zero at its pins. Faults for
which neither cable nor host matters are in test_simulated_faults.py.
"""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from hardware import BoardLink, HardwareError, SerialLimb, replay
from hardware.firmware import guard, heat
from limb_systems import Recording, simulate
from soft_limb.command import run_command

from .conftest import BOUNDS, Heating, wait_for

HEARTBEAT = 0.3  # s
SAMPLE = 0.13  # s: thermocouples are read every 100 ms, and the machine may be busy

HOST = """
import numpy as np
from hardware import SerialLimb
from limb_systems import simulate
simulate(SerialLimb({port!r}), [0.0, 1.0], 4.0)
"""


def report(record_property, fault, seconds):
    record_property(fault, f"{1000 * seconds:.0f} ms")
    print(f"\n{fault}: {1000 * seconds:.0f} ms")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_host_that_dies_or_freezes(emulator, start_host, number, record_property):
    process = start_host([sys.executable, "-c", HOST.format(port=emulator.port)])
    assert wait_for(lambda: emulator.duty()[1] == 1.0, 20.0)
    time.sleep(0.5)
    since = time.monotonic()
    os.kill(process.pid, number)
    off = emulator.off_after(since)
    report(record_property, f"host gets {number.name}", off)
    assert off < HEARTBEAT
    if number == signal.SIGSTOP:
        # It wakes up and goes on sending, but nothing restarts by itself.
        os.kill(process.pid, signal.SIGCONT)
        said = process.communicate(timeout=20)[1]
        assert "no valid command came for 250 ms" in said or "fell behind" in said
        assert emulator.duty() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("number", "controller"),
    [(signal.SIGTERM, "open"), (signal.SIGINT, "mpc"), (signal.SIGHUP, "pi")],
)
def test_host_that_is_told_to_stop(
    emulator, start_host, fig5_plan, number, controller, tmp_path, record_property
):
    fig5_plan.save(tmp_path / "plan.csv")
    output = tmp_path / "out.csv"
    command = [sys.executable, "-m", "hardware", "replay", tmp_path / "plan.csv", "-o", output]
    process = start_host([*command, "--port", emulator.port, "--controller", controller])
    assert wait_for(lambda: emulator.duty()[1] > 0.0, 20.0)
    time.sleep(0.5)
    since = time.monotonic()
    process.send_signal(number)
    off = emulator.off_after(since)
    report(record_property, f"host gets {number.name}", off)
    assert off < HEARTBEAT
    assert "stopped; wires are off" in process.communicate(timeout=10)[1]
    assert process.returncode == 128 + number


def test_a_signal_between_plan_and_arming(emulator, start_host, tmp_path):
    """The plan is on the disk, and nothing has been armed yet."""
    (tmp_path / "taught.csv").write_text("0,0\n2,6\n3,6\n")
    command = [sys.executable, "-m", "hardware", "follow", tmp_path / "taught.csv"]
    process = start_host([*command, "-o", tmp_path / "out", "--port", emulator.port])
    assert wait_for((tmp_path / "out" / "plan.csv").exists, 60.0)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=10)[1].endswith("stopped; wires are off\n")
    assert process.returncode == 130
    assert_never_armed(emulator)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_whose_exception_is_lost_keeps_the_board_from_being_armed(emulator, fig5_plan):
    """Python drops what a handler raises in a finalizer, and in parts of some imports."""

    class Finalized:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)

    def run():
        Finalized()
        replay(fig5_plan, SerialLimb(emulator.port, fig5_plan.parameters))
        return 0

    assert run_command(run, "stopped; wires are off") == 128 + signal.SIGTERM
    assert_never_armed(emulator)


def assert_never_armed(emulator):
    with BoardLink(emulator.port) as link:
        assert link.sample().reason == guard.POWER_UP
    assert emulator.duty() == [0.0, 0.0]


class _Failing(LeafSystem):
    """A controller that heats, and fails after a second."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("bend_angle", 1)
        self.DeclareStateOutputPort("duty", self.DeclareDiscreteState([0.0, 0.3]))
        self.DeclarePeriodicDiscreteUpdateEvent(0.05, 0.0, self._update)

    def _update(self, context, _):
        if context.get_time() > 1.0:
            self.failed = time.monotonic()
            raise ArithmeticError("of the controller")


def test_a_controller_that_fails(emulator, fig5_plan, tmp_path, record_property):
    controller, path = _Failing(), tmp_path / "recording.csv"
    robot = SerialLimb(emulator.port, fig5_plan.parameters)
    with pytest.raises(ArithmeticError), pytest.warns(UserWarning, match="unfinished"):
        replay(fig5_plan, robot, controller=controller, journal=path)
    assert max(event["right"] for event in emulator.events("duty")) > 0.1
    off = emulator.off_after(controller.failed)
    report(record_property, "controller fails", off)
    assert off < HEARTBEAT
    kept = Recording.load(tmp_path / "recording.unfinished.csv")
    assert "of the controller" in kept.interrupted


def test_cable_that_is_unplugged(emulator, heating, record_property):
    off = emulator.off_after(emulator.order("unplug"))
    report(record_property, "cable unplugged", off)
    assert off < HEARTBEAT
    assert "The cable to" in heating.failure() or "Nothing new came" in heating.failure()


def test_commands_that_come_later_and_later(emulator, heating, record_property):
    """Behind a buffer that fills up: after 0.4 s they answer samples of 250 ms before."""
    off = emulator.off_after(emulator.order("creep 0.3"))
    report(record_property, "delay creeping up", off)
    assert off < 1.0
    assert "late" in heating.failure()


def test_a_line_that_damages_most_bytes(emulator, heating, record_property):
    off = emulator.off_after(emulator.order("corrupt 0.3"))
    report(record_property, "30% of bytes corrupted", off)
    assert off < 1.0  # as long as a command in some comes through it is not to blame
    duties = {(event["left"], event["right"]) for event in emulator.events("duty")}
    assert {(0.0, 0.0), (0.0, 1.0)} <= duties
    assert duties <= {(0.0, 0.0), (0.0, heat.LITTLE_DUTY), (0.0, 1.0)}


def test_sensor_fault_latches_until_cleared(emulator, link, heating, record_property):
    off = emulator.off_after(emulator.order("open right"))
    report(record_property, "open right", off)
    assert off < SAMPLE
    assert "a thermocouple is open" in heating.failure()
    with pytest.raises(HardwareError, match=r"refuses to be armed.*Mend it"):
        link.arm(BOUNDS)
    emulator.order("mend")
    time.sleep(0.3)
    with pytest.raises(HardwareError, match="refuses to be armed"):
        link.arm(BOUNDS)  # mended is not cleared
    link.clear()
    assert emulator.duty() == [0.0, 0.0]
    again = Heating(link, (0.0, 0.2))  # and now it heats again
    assert wait_for(lambda: emulator.duty() == [0.0, 0.2])
    again.stop()


def test_board_that_hangs_is_reset_by_its_watchdog(emulator, heating, record_property):
    off = emulator.off_after(emulator.order("stall 5.0"))
    report(record_property, "board hangs", off)
    assert off < 0.25
    assert "restarted by itself" in heating.failure()
    assert emulator.duty() == [0.0, 0.0]


def test_board_that_is_no_longer_heard_is_noticed_by_the_host(emulator, heating):
    emulator.order("drop 1.0")
    assert "Nothing new came from the board" in heating.failure()


@pytest.mark.parametrize("duty", [(0.0, 1.01), (-0.1, 0.0), (np.nan, 0.0), (0.0, np.inf)])
def test_duty_out_of_range_is_not_sent(emulator, link, duty):
    link.arm(BOUNDS)
    with pytest.raises(HardwareError, match="must be two numbers from 0 to 1"):
        link.command(np.array(duty))
    assert emulator.duty() == [0.0, 0.0]


def test_simulation_that_falls_behind(emulator, record_property):
    class Slow(SerialLimb):
        """Thinks for a while at 1 s."""

        __slots__ = ()

        def _update(self, context, state):
            if context.get_time() == pytest.approx(1.0):
                time.sleep(0.4)
            super()._update(context, state)

    with (
        Slow(emulator.port) as limb,
        pytest.raises(HardwareError, match=r"fell behind|switched off"),
    ):
        simulate(limb, [0.0, 0.1], 3.0)
    on = next(e["time"] for e in emulator.events("duty") if e["right"] == 0.1)
    off = emulator.off_after(on) - 1.0  # the simulation stops at 1 s
    report(record_property, "simulation falls behind", off)
    assert off < HEARTBEAT
    assert emulator.duty() == [0.0, 0.0]


def test_second_program_on_a_port_is_refused(emulator, link):
    with pytest.raises(HardwareError, match="is in use by another program"):
        BoardLink(emulator.port)
    said = subprocess.run(
        [sys.executable, "-m", "hardware", "status", emulator.port], capture_output=True, text=True
    )
    assert said.returncode == 1
    assert said.stderr == f"error: {emulator.port} is in use by another program.\n"


def test_port_without_a_board_is_named(tmp_path):
    with pytest.raises(HardwareError, match="Cannot open /dev/nothing"):
        BoardLink("/dev/nothing")
    master, slave = os.openpty()
    with BoardLink(os.ttyname(slave)) as silent, pytest.raises(HardwareError, match="not answer"):
        silent.info()
    os.close(master)
