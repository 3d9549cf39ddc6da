"""A robot whose limbs have boards of their own: they heat together, and go off together."""

import re

import numpy as np
import pytest

from hardware import (
    BoardLink,
    HardwareError,
    LimbDriver,
    ReplayError,
    Scenario,
    SerialLimb,
    Station,
    drive,
)
from hardware.board.several_boards import SeveralBoards, limbs_of
from hardware.replaying import check_replayable
from limb_systems import LimbError, LimbParameters, Recording, SerialBoard
from planners import plan, references
from soft_limb.command import main
from walking import RobotLimb, RobotParameters

from .conftest import BOUNDS, Heating, VirtualBoard, report

NAMES = ["rear", "front"]
DUTY = [0.02, 0.08, 0.06, 0.04]  # another one for each wire
HEARTBEAT = 0.3  # s, as in test_faults.py
BY_HOST = 0.06  # s, before the heartbeat
LONGEST = 0.25  # s from a board's fault until the other one is off
AFTER_KNOWN = 0.01  # s from when a fault is known until the other board is off
# Faults of a board, and what the error says of it.
FAULTS = {
    "unplug": "The cable to",
    "restart": "it was just switched on",
    "reset": "it was reset",
    "open left": "a thermocouple is open",
    "stall 0.19": "restarted by itself|Nothing new came",  # as its watchdog is early or late
    "stall 1.0": "restarted by itself|Nothing new came",
    "drop 1.0": "Nothing new came from the board",
    "delay 0.4": "Nothing new came from the board",
}


@pytest.fixture
def boards(virtual_time):
    """The emulated boards of the rear and the front limb."""
    return [VirtualBoard(virtual_time, f"/dev/{name}") for name in NAMES]


@pytest.fixture
def ports(boards):
    return {name: board.port for name, board in zip(NAMES, boards, strict=True)}


@pytest.fixture(scope="module")
def robot():
    """Two nominal limbs, such as the emulated boards have."""
    return RobotParameters(limbs=[RobotLimb(name) for name in NAMES])


def test_limbs_have_their_segments_by_name():
    robot = RobotParameters(limbs=[RobotLimb("rear"), RobotLimb("front_1")])
    robot.limbs[1].parameters.segments *= 2
    limbs = limbs_of(robot.as_single_limb, ["front_1", "rear"])
    assert {name: len(limb.wires) for name, limb in limbs.items()} == {"rear": 2, "front_1": 4}
    assert list(limbs) == ["rear", "front_1"]
    for names in (["rear"], ["rear", "front"], ["rear", "front_1", "middle"]):
        with pytest.raises(LimbError, match="are rear, front_1_1, front_1_2; give a port for each"):
            limbs_of(robot.as_single_limb, names)
    with pytest.raises(LimbError, match="for rear, but this is a single limb; give one port with"):
        limbs_of(LimbParameters(), ["rear"])


def test_a_plan_is_replayed_on_all_boards_in_one_time(
    virtual_time, ports, boards, robot, tmp_path, capsys
):
    for limb in robot.limbs:
        limb.parameters.temperature_limits.warm_up_time = 100.0
    reference = references.from_samples([0.0, 0.8], [[0.0, 0.01], [0.0, -0.02]])
    planned = plan(robot.as_single_limb, reference, knot_rate=10.0)
    planned.save(tmp_path / "plan.csv")
    command = ["replay", str(tmp_path / "plan.csv"), "-o", str(tmp_path / "recording.csv")]
    # In another order than the robot's.
    command += ["-p", f"front={ports['front']}", "-p", f"rear={ports['rear']}"]
    assert main(command) == 0, capsys.readouterr().err
    recording = Recording.load(tmp_path / "recording.csv")
    assert recording.parameters.wire_names[0] == "rear_left"
    duty = planned.duty_trajectory().vector_values(recording.time)
    virtual_time.sleep(0.01)
    for board, part in zip(boards, np.split(duty, 2), strict=True):
        applied = np.array([(event["left"], event["right"]) for event in board.events("duty")])
        away = np.abs(applied[:, :, np.newaxis] - part[:, :-1]).max(axis=1)
        assert away.min(axis=0).max() < 1e-4
        assert not any(board.duty())
    first = [next(e for e in board.events("duty") if e["left"] + e["right"]) for board in boards]
    assert abs(first[0]["time"] - first[1]["time"]) < 0.02
    assert recording.sample_age[1:].max() < 0.25

    # Plugged in the other way round, each board would get what is for the other's limb.
    for limb, number in zip(robot.limbs, ("front000", "twin0000"), strict=True):
        limb.parameters.board = SerialBoard(number)
    planned.parameters.board = robot.as_single_limb.board
    with SerialLimb(ports, robot.as_single_limb) as limb:
        assert limb.GetOutputPort("front.sample_age").size() == 1
        with pytest.raises(ReplayError, match=r"the limb front000, twin0000, but .* is twin0000"):
            check_replayable(planned, limb)


def test_boards_go_off_together(virtual_time, ports, boards, robot):
    rear, front = boards

    def off(board, since, what, limit):
        seconds = board.off_after(since)
        report(what, seconds)
        assert seconds < limit

    def heating(link):
        heating = Heating(virtual_time, link, DUTY)
        heated = virtual_time.wait_for(
            lambda: [*rear.duty(), *front.duty()] == pytest.approx(DUTY, abs=1e-4)
        )
        assert heated, heating.error
        return heating

    def fails(link, order, board, said):
        """Makes a heated board fail, after which the host says why it ends; the fault's time."""
        host = heating(link)
        since = board.order(order)
        assert said in host.failure()
        return since

    with SeveralBoards(ports, robot.as_single_limb) as link:
        since = fails(link, "open left", front, "thermocouple is open")
        front.off_after(since)
        off(rear, front.events("duty")[-1]["time"], "after another board's fault", BY_HOST)
        count = len(rear.events("duty"))
        with pytest.raises(HardwareError, match="refuses to be armed: a thermocouple is open"):
            link.arm(2 * BOUNDS)
        assert virtual_time.wait_for(lambda: not any(part.armed for part in link.sample().parts))
        with pytest.raises(HardwareError, match="thermocouple is open"):  # not: by the host
            link.command(np.array(DUTY))
        virtual_time.sleep(0.1)
        assert len(rear.events("duty")) == count
    front.order("mend")
    front.order("restart")  # it is ready later than the other, which has to wait
    with SeveralBoards(ports, robot.as_single_limb) as link:
        host = heating(link)
        since = virtual_time.monotonic()
        host.freeze()
        for board in boards:
            off(board, since, "host does nothing", HEARTBEAT)
    front.order("restart")
    with SeveralBoards(ports, robot.as_single_limb) as link:
        since = fails(link, "unplug", front, "The cable to")
        off(front, since, "cable unplugged", HEARTBEAT)
    with pytest.raises(HardwareError, match=f"Cannot open {front.port}"):
        SeveralBoards(ports, robot.as_single_limb)
    with BoardLink(rear.port) as link:  # is free, and off
        assert not link.sample().armed


@pytest.mark.parametrize(
    ("fault", "kind"),
    [*((fault, "robot") for fault in FAULTS), ("unplug", "station"), ("open left", "station")],
)
def test_a_board_that_fails_switches_the_other_off_at_once(
    fault, kind, virtual_time, ports, boards, robot, monkeypatch
):
    """Of a robot, and of a station; times are from the fault, and from when the host knows it."""
    rear, front = boards
    known, since = [], []
    tell_off = BoardLink._report_off

    def note(link, why):
        known.append(virtual_time.monotonic())
        tell_off(link, why)

    def fail():
        known.clear()
        since.append(front.order(fault))

    monkeypatch.setattr(BoardLink, "_report_off", note)
    virtual_time.when(lambda: any(rear.duty()) and any(front.duty()), fail, after=0.31)
    if kind == "station":
        drivers = {name: LimbDriver(port=port) for name, port in ports.items()}
        station = Station(Scenario(model_drivers=drivers), "board")
        with pytest.raises(HardwareError) as ended:
            drive(station, {f"{name}.duty": [0.05, 0.05] for name in NAMES}, 3.0)
        said = str(ended.value)
    else:
        with SeveralBoards(ports, robot.as_single_limb) as link:
            said = Heating(virtual_time, link, DUTY).failure()
    assert re.search(FAULTS[fault], said)
    assert front.port in said
    seconds = rear.off_after(since[0])
    after_known = rear.off_after(known[0])
    report(f"{kind}, {fault}", seconds)
    report(f"{kind}, {fault}, from when it is known", after_known)
    assert seconds <= LONGEST
    assert after_known <= AFTER_KNOWN
