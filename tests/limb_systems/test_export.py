"""Rows of duty for programs of one's own, read back by numpy and by a C compiler."""

import dataclasses
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from scipy.interpolate import make_interp_spline

from limb_systems import (
    Limb,
    LimbParameters,
    PlanCheck,
    Provenance,
    add_limb_actuation,
    simulate,
)
from soft_limb.command import main


@pytest.fixture(scope="module")
def recording():
    recorded = simulate(Limb(), [0.0, 0.3], 1.0)
    recorded.bend_angle = recorded.bend_angle + np.deg2rad(0.4)
    return recorded


@pytest.fixture
def path(recording, tmp_path):
    recording.save(tmp_path / "recording.csv")
    return tmp_path / "recording.csv"


@pytest.fixture
def plan(recording, tmp_path, plan_like):
    """Duty that ramps between uneven knots, from off to full."""
    size = len(recording.time)
    rng = np.random.default_rng(0)
    duty = rng.uniform(0.0, 1.0, (2, size))
    duty[:, 5:9], duty[1, 9:12] = 0.0, 1.0
    plan = plan_like(
        recording,
        time=3.0 + np.cumsum(rng.uniform(0.01, 0.2, size)),
        duty=duty,
        check=PlanCheck("*/", largest_defect=0.0, largest_difference_deg=0.0, tolerance_deg=0.1),
        provenance=Provenance("0.1.0", "", "soft-limb plan */ fig5", "", "2030-01-31T12:00:00Z"),
    )
    plan.save(tmp_path / "plan.csv")
    return plan


def export(folder, name, *options) -> Path:
    assert main(["export", str(folder / "plan.csv"), "-o", str(folder / name), *options]) == 0
    return folder / name


def rows(path):
    return np.loadtxt(path, delimiter=",", comments=("#", "time_s"))


@pytest.mark.parametrize("options", [[], ["--rate", "30", "--duty-max", "255"]])
def test_rows_that_are_held_give_the_heat_of_the_plan(plan, tmp_path, options):
    """The sum of all rows so far is the integral of the ramps, and the last row is off."""
    rate, top = (float(options[1]), 255) if options else (20.0, 1)
    path = export(tmp_path, "runner.csv", *options)
    said = path.read_text(encoding="utf-8")
    assert "ramps between its knots" in said
    assert f"Hold each row for {1 / rate:.9g} s." in said
    cells = said.splitlines()[-1].split(",")
    assert all(("." in cell) == (top == 1) for cell in cells[1:])  # counts are whole numbers
    time, *held = rows(path).T
    assert np.diff(time) == pytest.approx(1 / rate, abs=1e-7)
    assert 0 <= time[-1] - plan.duration < 1 / rate
    rounding = 1e-8 if top == 1 else 0.5001
    for duty, sent in zip(plan.duty, held, strict=True):
        ramps = make_interp_spline(plan.time - plan.time[0], duty, k=1).antiderivative()
        dose = ramps(np.minimum(time[1:], plan.duration))
        away = np.cumsum(sent[:-1]) / top / rate - dose
        assert np.abs(away).max() <= rounding / top / rate + 1e-8
        assert (sent.min(), sent[-1]) == (0.0, 0.0)
        assert sent.max() <= top
    assert held[1].max() == top  # where the plan is on


def test_c_header_has_the_numbers_of_the_rows(plan, tmp_path):
    compiler = shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        pytest.skip("there is no C compiler here")
    for name, top, size in (("plain", 1, 4), ("words", 1000, 2)):
        options = ["--rate", "12.5", "--duty-max", str(top)]
        header = export(tmp_path, f"{name}.h", *options)
        (tmp_path / "main.c").write_text(
            f"""#include "{header.name}"
#include <stdio.h>
int main(void) {{
    printf("%s %s %g %d %d\\n", plan_wires[0], plan_wires[1], (double)PLAN_RATE_HZ,
           PLAN_DUTY_MAX, (int)sizeof plan_duty[0][0]);
    for (int i = 0; i < PLAN_ROWS; i++)
        printf("%.9g %.9g\\n", (double)plan_duty[i][0], (double)plan_duty[i][1]);
    return 0;
}}
"""
        )
        strict = ["-std=c99", "-Wall", "-Wextra", "-Werror"]
        subprocess.run([compiler, *strict, "-o", name, "main.c"], cwd=tmp_path, check=True)
        done = subprocess.run([tmp_path / name], capture_output=True, text=True, check=True)
        first, *printed = done.stdout.splitlines()
        assert first == f"left right 12.5 {top} {size}"
        written = rows(export(tmp_path, f"{name}.csv", *options))[:, 1:]
        assert np.loadtxt(printed) == pytest.approx(written, abs=1e-7 * (top == 1))


def test_a_limb_becomes_a_model_with_its_springs(tmp_path):
    limb = LimbParameters(payload=0.004)
    limb.segments[0].stiffness = 0.2
    limb.save(tmp_path / "finger.yaml")
    assert main(["export", str(tmp_path / "finger.yaml"), "-o", str(tmp_path / "finger.sdf")]) == 0
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(1e-3))
    (finger,) = Parser(plant).AddModels(tmp_path / "finger.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    assert plant.GetModelInstanceName(finger) == "finger"
    add_limb_actuation(builder, plant, finger, tmp_path / "finger.yaml")  # which compares them


def test_only_plans_that_may_drive_a_limb_are_made_into_rows(plan, path, tmp_path, capsys):
    assert main(["export", str(path), "-o", str(tmp_path / "rows.h")]) == 1
    assert "is a recording; only a trajectory can be exported as" in capsys.readouterr().err
    order = ["export", str(tmp_path / "plan.csv"), "-o", str(tmp_path / "rows.h")]
    for wrong, sentence in (
        (["--rate", "nan"], "The rate is nan Hz; it must be from 0.1 to 1000 Hz."),
        (["--duty-max", "0"], "The largest duty is 0;"),
    ):
        assert main([*order, *wrong]) == 1
        assert sentence in capsys.readouterr().err
    dataclasses.replace(plan, check=PlanCheck()).save(tmp_path / "plan.csv")
    assert main(order) == 1
    assert "must not drive a limb: it was never checked" in capsys.readouterr().err
    assert not (tmp_path / "rows.h").exists()
