"""The fault table over a cable: what happens while a wire is heated.

Each fault is injected into an emulated board, which runs the firmware's own files; times are
from the fault to duty zero at its pins. Host and board share a clock; a host that is a process of
its own is stopped in test_serial_limb.py. Faults for which neither cable nor host matters are in
test_simulated_faults.py.
"""

import contextlib
import json
import os
import signal

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem
from ros_bridge.drive import drive
from ros_bridge.messages import ReceivedCommands

from hardware import BoardLink, HardwareError, SerialLimb, replay
from hardware.firmware import guard, heat
from limb_systems import Recording, simulate
from soft_limb.command import main, run_command

from .conftest import BOUNDS, Heating, report

HEARTBEAT = 0.3  # s
SAMPLE = 0.11  # s: thermocouples are read every 100 ms


def test_a_host_that_is_told_to_stop(virtual_time, emulator, fig5_plan, tmp_path, capsys):
    fig5_plan.save(tmp_path / "plan.csv")
    command = ["replay", str(tmp_path / "plan.csv"), "--port", emulator.port, "--force"]
    for number, controller in (
        (signal.SIGTERM, "open-loop"),
        (signal.SIGINT, "receding-horizon"),
        (signal.SIGHUP, "plan-feedback"),
    ):
        told = []

        def tell(number=number, told=told):
            told.append(virtual_time.monotonic())
            os.kill(os.getpid(), number)

        virtual_time.when(lambda: emulator.duty()[1] > 0.0, tell, after=0.3)
        output = ["-o", str(tmp_path / "out.csv"), "--controller", controller]
        assert main([*command, *output]) == 128 + number
        off = emulator.off_after(told[0])
        report(f"host gets {number.name}", off)
        assert off < HEARTBEAT
        assert "stopped; wires are off" in capsys.readouterr().err


def test_a_bridge_that_is_told_to_stop(virtual_time, emulator, monkeypatch):
    """It says on its topic that it has ended."""
    told = []

    class Node:
        """In place of the process on the network: somebody commands all the time."""

        def __init__(self, *_):
            self.publish, self.close = told.append, lambda: None

        def receive(self):
            return ReceivedCommands(duty=[0.0, 0.2], born=virtual_time.monotonic())

    monkeypatch.setattr("ros_bridge.drive.NodeProcess", Node)

    def stop():
        raise KeyboardInterrupt  # as the handler of a signal does

    virtual_time.when(lambda: emulator.duty()[1] > 0.0, stop, after=0.3)
    with pytest.raises(KeyboardInterrupt):
        drive(SerialLimb(emulator.port))
    last = virtual_time.monotonic()
    assert emulator.off_after(last) < 0.05
    assert json.loads(told[-1]["/limb/state"]) == {"state": "idle", "why": "the bridge has ended"}


def test_a_signal_between_plan_and_arming(virtual_time, emulator, tmp_path, capsys):
    """The plan is on the disk, and nothing has been armed yet."""
    (tmp_path / "taught.csv").write_text("0,0\n2,6\n3,6\n")
    virtual_time.when(
        (tmp_path / "out" / "plan.csv").exists, lambda: os.kill(os.getpid(), signal.SIGINT)
    )
    command = ["follow", str(tmp_path / "taught.csv"), "-o", str(tmp_path / "out")]
    assert main([*command, "--port", emulator.port]) == 130
    assert capsys.readouterr().err.endswith("stopped; wires are off\n")
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

    def __init__(self, time):
        super().__init__()
        self._time = time
        self.DeclareVectorInputPort("bend_angle", 1)
        self.DeclareStateOutputPort("duty", self.DeclareDiscreteState([0.0, 0.3]))
        self.DeclarePeriodicDiscreteUpdateEvent(0.05, 0.0, self._update)

    def _update(self, context, _):
        if context.get_time() > 1.0:
            self.failed = self._time.monotonic()
            raise ArithmeticError("of the controller")


def test_a_controller_that_fails(virtual_time, emulator, fig5_plan, tmp_path):
    controller, path = _Failing(virtual_time), tmp_path / "recording.csv"
    robot = SerialLimb(emulator.port, fig5_plan.parameters)
    with pytest.raises(ArithmeticError), pytest.warns(UserWarning, match="unfinished"):
        replay(fig5_plan, robot, controller=controller, journal=path)
    assert max(event["right"] for event in emulator.events("duty")) > 0.1
    off = emulator.off_after(controller.failed)
    report("controller fails", off)
    assert off < HEARTBEAT
    kept = Recording.load(tmp_path / "recording.unfinished.csv")
    assert "of the controller" in kept.interrupted


def test_faults_of_cable_and_board_while_a_wire_is_hot(virtual_time, emulator):
    """One after the other, as its thermocouple has to follow some heat only after a start."""

    def heat_fully():
        heating = Heating(virtual_time, link)
        assert virtual_time.wait_for(lambda: emulator.duty() == [0.0, 1.0], 10.0)
        return heating

    def off_after(fault, limit, said):
        heating = heat_fully()
        off = emulator.off_after(emulator.order(fault))
        report(fault, off)
        assert off < limit
        assert said in heating.failure()

    def mend():
        emulator.order("mend")
        wait_for_calm(virtual_time, link)

    with BoardLink(emulator.port) as link:
        # A host that freezes and wakes up goes on sending, but nothing restarts by itself.
        heating = heat_fully()
        heating.freeze()
        off = emulator.off_after(virtual_time.monotonic())
        report("host freezes", off)
        assert off < HEARTBEAT
        heating.wake_up()
        assert "no valid command came" in heating.failure()
        assert emulator.duty() == [0.0, 0.0]
        # Behind a buffer that fills up: after 0.4 s commands answer samples of 250 ms before.
        off_after("creep 0.3", 1.0, "late")
        mend()
        # As long as a command in some comes through the line is not to blame.
        off_after("corrupt 0.3", 1.0, "")
        duties = {(event["left"], event["right"]) for event in emulator.events("duty")}
        assert duties <= {(0.0, 0.0), (0.0, heat.LITTLE_DUTY), (0.0, 1.0)}
        mend()

        off_after("open right", SAMPLE, "a thermocouple is open")
        with pytest.raises(HardwareError, match=r"refuses to be armed.*Mend it"):
            link.arm(BOUNDS)
        mend()
        with pytest.raises(HardwareError, match="refuses to be armed"):
            link.arm(BOUNDS)  # mended is not cleared
        link.clear()
        assert emulator.duty() == [0.0, 0.0]

        off_after("stall 5.0", 0.25, "restarted by itself")  # its watchdog resets it
        link.clear()
        off_after("drop 1.0", HEARTBEAT, "Nothing new came from the board")
        mend()
        heating = heat_fully()
        off = emulator.off_after(emulator.order("unplug"))
        report("cable unplugged", off)
        assert off < HEARTBEAT
        said = heating.failure()
        assert "The cable to" in said or "Nothing new came" in said


def wait_for_calm(time, link):
    """Until samples come in time, of a board that is off."""

    def calm():
        with contextlib.suppress(HardwareError):
            return not link.sample().armed and link.delay < 0.1
        return False

    time.sleep(0.15)  # until its thermocouples were read
    assert time.wait_for(calm)


def test_duty_out_of_range_is_not_sent(virtual_time, emulator):
    with BoardLink(emulator.port) as link:
        link.arm(BOUNDS)
        for duty in ((0.0, 1.01), (-0.1, 0.0), (np.nan, 0.0), (0.0, np.inf)):
            with pytest.raises(HardwareError, match="must be 2 numbers from 0 to 1"):
                link.command(np.array(duty))
            virtual_time.sleep(0.05)
    assert emulator.duty() == [0.0, 0.0]


def test_simulation_that_falls_behind(virtual_time, emulator):
    class Slow(SerialLimb):
        """Thinks for a while at 0.5 s."""

        __slots__ = ()

        def _update(self, context, state):
            if context.get_time() == pytest.approx(0.5):
                virtual_time.sleep(0.15)  # the board itself bears that
            super()._update(context, state)

    with (
        Slow(emulator.port) as limb,
        pytest.raises(HardwareError, match=r"fell behind|switched off"),
    ):
        simulate(limb, [0.0, 0.1], 3.0)
    on = next(e["time"] for e in emulator.events("duty") if e["right"] == 0.1)
    off = emulator.off_after(on) - 0.5  # the simulation stops at 0.5 s
    report("simulation falls behind", off)
    assert off < HEARTBEAT
    assert emulator.duty() == [0.0, 0.0]
