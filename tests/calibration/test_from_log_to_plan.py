"""Another program's logs become a limb and a plan, by the commands as they are printed."""

import functools
import shlex
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from logged_limb import OwnLimb

from calibration import calibrate
from hardware import HardwareError, SerialLimb
from hardware.replaying import _check_robot
from limb_systems import LimbParameters, Recording, SaturatingLaw, Trajectory
from soft_limb.command import main
from walking import RobotLimb, RobotParameters

LEFT, RIGHT = 0, 1


def write_log(path: Path, recording: Recording) -> None:
    """A table as German loggers write it: decimal commas, per cent and degrees Fahrenheit."""
    columns = [
        recording.time,
        *100 * recording.duty,
        *1.8 * recording.measured_temperature + 32.0,
        *np.rad2deg(recording.bend_angle),
    ]
    head = "Zeit [s];PWM links [%];PWM rechts [%];T links [°F];T rechts [°F];Biegung [°]"
    rows = [
        ";".join(f"{x:.2f}".replace(".", ",") for x in row) for row in zip(*columns, strict=True)
    ]
    path.write_text("\n".join([head, *rows, ""]), encoding="utf-8")


def without_temperatures(log: Path, path: Path) -> None:
    """Write the same log without its thermocouples' columns."""
    rows = [line.split(";") for line in log.read_text(encoding="utf-8").splitlines()]
    lines = [";".join([*row[:3], row[5]]) for row in rows]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> list[Path]:
    """A log from cold, a log that begins while a wire is hot, and a log of dead thermocouples."""
    folder = tmp_path_factory.mktemp("my logs")
    limb = OwnLimb(4)
    pulses = [(RIGHT, 0.5, 5.0, 9.0), (LEFT, 0.5, 45.0, 9.0), (RIGHT, 0.3, 75.0, 12.0)]
    cold = limb.record(pulses, 110.0, 5.0)
    limb.record([(RIGHT, 0.6, 0.0, 9.0)], 9.0, 5.0)
    warm = limb.record([(LEFT, 0.5, 25.0, 9.0), (RIGHT, 0.5, 60.0, 8.0)], 100.0, 5.0)
    assert warm.measured_temperature[RIGHT, 0] > 60.0
    dead = OwnLimb(5).record(pulses, 110.0, 5.0)
    dead.measured_temperature[:] = 25.0
    recordings = {"messung": cold, "77 heiß begonnen": warm, "tot": dead}
    for name, recording in recordings.items():
        write_log(folder / f"{name}.csv", recording)
    return [folder / f"{name}.csv" for name in recordings]


def named(printed: str) -> list[str]:
    """The words of the command that a command has named."""
    (line,) = [line for line in printed.splitlines() if line.startswith("next ")]
    return shlex.split(line)[2:]


@pytest.mark.whole
def test_from_logs_to_a_plan(logs, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "limb.yaml").touch()  # which is somebody's
    quick = functools.partial(calibrate, laws=[SaturatingLaw])
    monkeypatch.setattr("soft_limb.commands.calibration.calibrate", quick)
    left_out = "tot.csv is left out: the left thermocouple is dead: it moves by 0.0 °C while "
    left_out += "its wire gets 4.5 s of full duty in all."

    Path("no log.csv").write_text("t,x\n1,foo\n")
    assert main(["import", *map(str, logs), "no log.csv", "-o", "my recordings"]) == 1
    printed, complained = capsys.readouterr()
    assert "no log.csv has no rows of numbers; save" in complained
    assert f"soft-limb fit: {left_out}" in printed
    assert named(printed) == ["fit", "my recordings", "-o", "limb_2.yaml"]
    assert Recording.load("my recordings/77_heiß_begonnen.csv").kind == "both"

    assert main(named(printed)) == 0
    printed = capsys.readouterr().out
    assert f"note: {left_out}" in printed
    limb = LimbParameters.load("limb_2.yaml")
    assert limb.ambient_temperature == pytest.approx(OwnLimb(4)._room, abs=0.5)

    Path("wanted.csv").write_text("time_s,bend_deg\n0,0\n6,8\n12,8\n20,0\n")
    assert main(["plan", "wanted.csv", "-l", "limb_2.yaml", "-o", "plan.csv"]) == 0
    assert Trajectory.load("plan.csv").parameters == limb

    assert main(["import", str(logs[2]), "-o", "dead"]) == 0
    assert "next " not in capsys.readouterr().out
    assert main(["fit", "dead", "-o", "no.yaml"]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "error: There is no recording with heat, which tells the wires' laws.",
        left_out,
    ]
    assert not Path("no.yaml").exists()


def test_a_log_without_thermocouples_becomes_a_plan_that_boards_refuse(
    logs, tmp_path, monkeypatch, capsys
):
    """The bend alone tells the model; heat is counted from the duty, and no plan is hotter."""
    monkeypatch.chdir(tmp_path)
    quick = functools.partial(calibrate, laws=[SaturatingLaw])
    monkeypatch.setattr("soft_limb.commands.calibration.calibrate", quick)
    without_temperatures(logs[0], Path("bends.csv"))
    assert main(["import", "bends.csv", "-o", "recordings"]) == 0
    capsys.readouterr()
    assert main(["fit", "recordings", "-o", "limb.yaml"]) == 0
    printed = capsys.readouterr().out
    assert "boards refuse to heat without thermocouples" in printed
    assert "right.a2" in next(x for x in printed.splitlines() if x.startswith("as_described"))
    limb = LimbParameters.load("limb.yaml")
    assert limb.calibration
    assert not limb.calibration.heat_measured
    assert [wire.law.a2 for wire in limb.wires] == pytest.approx(2 * [SaturatingLaw().a2])
    assert not any(wire.heat_bounds for wire in limb.wires)
    counted = limb.temperature_limits.maximum
    assert limb.ambient_temperature + 10.0 < counted < 100.0

    Path("wanted.csv").write_text("time_s,bend_deg\n0,0\n5,6\n8,6\n")
    assert main(["plan", "wanted.csv", "-l", "limb.yaml", "-o", "plan.csv"]) == 0
    planned = Trajectory.load("plan.csv")
    assert planned.wire_temperature.max() <= counted + 1e-6
    assert main(["replay", "plan.csv", "--emulated", "0", "-o", "replayed.csv"]) == 0
    assert main(["validate", "limb.yaml", "recordings/bends.csv"]) == 0
    assert "not measured" in capsys.readouterr().out
    rear = RobotLimb("rear", parameters=LimbParameters())
    robot = RobotParameters(limbs=[rear, RobotLimb("front", parameters=limb)])
    robot.as_single_limb.save("robot_limb.yaml")
    refused = functools.partial(pytest.raises, HardwareError, match="without thermocouples")
    with refused():
        _check_robot(planned, mock.Mock())
    for heated in (limb, planned.parameters, "limb.yaml", robot.as_single_limb, "robot_limb.yaml"):
        with refused():
            SerialLimb("no port", heated)
    with pytest.raises(HardwareError, match="no port"):
        SerialLimb("no port", limb, heated=False)

    assert main(["fit", "recordings", "-o", "no.yaml", "--method", "paper"]) == 1
    assert not Path("no.yaml").exists()
