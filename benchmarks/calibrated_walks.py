"""How emulated robots walk that are calibrated by the commands: collect, fit, gait(s), walk.

The robots are crawlers, some of them unlike the default one: ``long`` has limbs of 8 cm and a
light body, ``heavy`` a body of 30 g, feet of 2 g and weak wires, ``unlike`` limbs of other lengths
and stiffness up a slope of 2°. Shown are the announced stride and period, eight strides and their
durations as shares of them, and falls.

``three`` and ``four`` are robots in space of so many limbs, which go to (0.5, 0) m, turn there by
90°, and come back. Shown are their speed ahead as planned, when and how near they came to the last
place, and their hottest wire.

    python benchmarks/calibrated_walks.py [default:3 default:11 long:5 three:2 four:0 ...]

Each robot takes four minutes, or twenty in space. Its files are left in out/calibrated_walks/.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from limb_systems import Recording
from walking import Gait, RobotParameters

USUAL = tuple(f"default:{seed}" for seed in (0, 1, 2, 3, 4, 11, 12, 13, 14))
UNLIKE = ("long:5", "heavy:6", "unlike:7")
IN_SPACE = {"three": 3, "four": 4}
FOLDER = Path("out/calibrated_walks")
STRIDES = 8


def described(name: str) -> RobotParameters:
    if name in IN_SPACE:
        return RobotParameters.in_space(IN_SPACE[name])
    robot = RobotParameters()
    rear, front = (limb.parameters.segments[0] for limb in robot.limbs)
    if name == "long":
        for limb, x in zip(robot.limbs, (-0.035, 0.035), strict=True):
            limb.position[0] = x
        for segment in (rear, front):
            segment.length, segment.mass, segment.stiffness = 0.08, 0.02, 0.25
        robot.body.mass, robot.body.length, robot.ground.friction = 0.012, 0.09, 0.5
    if name == "heavy":
        robot.body.mass, robot.feet.mass = 0.03, 0.002
        for segment in (rear, front):
            segment.stiffness = 0.26
            for wire in segment.wires:
                wire.law.beta *= 0.9
    if name == "unlike":
        rear.length, front.length, front.stiffness = 0.065, 0.055, 0.19
        robot.ground.friction, robot.ground.slope = 0.4, 0.035
    return robot


def command(folder: Path, *words: str) -> dict:
    """What a command of soft-limb says in JSON, or its error as ``fall``."""
    line = [sys.executable, "-m", "soft_limb", *words, "--force"]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    return json.loads(done.stdout) if done.stdout.startswith("{") else {"fall": done.stderr.strip()}


def row(robot: str) -> None:
    name, _, seed = robot.partition(":")
    folder = FOLDER / f"{name}_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    described(name).save(folder / "robot.yaml")
    command(folder, "collect", "-l", "robot.yaml", "-o", "recordings", "--emulated", seed)
    fitted = command(folder, "fit", "recordings", "-o", "calibrated.yaml", "--json")
    if "fall" in fitted:
        print(f"| {robot} | {fitted['fall']} |", flush=True)
        return
    if name in IN_SPACE:
        row_in_space(folder, robot)
        return
    said = command(folder, "gait", "calibrated.yaml", "-o", "gait.csv", "--json")
    if "speed" not in said:
        print(f"| {robot} | {said['fall']} |", flush=True)
        return
    gait = Gait.load(folder / "gait.csv")
    cells = [robot, f"{1e3 * gait.stride:.1f} mm in {gait.period:.1f} s"]
    words = ["-n", str(STRIDES), "-o", "walk.csv", "--json"]
    said = command(folder, "walk", "gait.csv", *words)
    if "strides" in said:
        strides = np.array(said["strides"]) / gait.stride
        durations = np.array(said["stride_durations"]) / gait.period
        cells.append(" ".join(f"{stride:.2f}" for stride in strides))
        cells.append(f"{strides[1:].mean():.2f} in {durations[1:].mean():.2f}")
    cells.append(said["fall"] or "no fall")
    print(f"| {' | '.join(cells)} |", flush=True)


def row_in_space(folder: Path, robot: str) -> None:
    said = command(folder, "gait", "calibrated.yaml", "--set", "-o", "gaits", "--json")
    if "fall" in said:
        print(f"| {robot} | {said['fall']} |", flush=True)
        return
    ahead, places = Gait.load(folder / "gaits" / "ahead.csv"), ("--to", "0.5,0,90", "--to", "0,0")
    pictured = "--plot", "way.png", "--json"
    said = command(folder, "walk", "gaits", *places, "-o", "walk.csv", *pictured)
    cells = [robot, f"{1e3 * ahead.speed:.2f} mm/s", said.get("fall") or "no fall"]
    if "missed" in said:
        cells.append(f"{said['duration']:.0f} s, {1e3 * said['missed']:.0f} mm")
        hottest = Recording.load(folder / "walk.csv").wire_temperature
        cells.append(f"{hottest.max():.1f} °C")
    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("robots", nargs="*", default=[*USUAL, *UNLIKE], help="NAME:SEED")
    print("| robot and seed | announced | strides | mean from the second on | fall |")
    print("| --- | --- | --- | --- | --- |")
    for robot in parser.parse_args().robots:
        row(robot)
