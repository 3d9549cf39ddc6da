"""From a limb's description to its recording, in one file to read from top to bottom.

    python examples/yaml_to_recording.py                            # an emulated board and limb
    python examples/yaml_to_recording.py [REFERENCE.csv] [-l LIMB.yaml] [-p PORT] [-o FOLDER]

Numbers in brackets are the paper's equations. With a port (`soft-limb status` lists them) the plan
goes to your robot, whose wires get hot. Ctrl-C switches the wires off, and every sample up to there
is in `replay.unfinished.csv`. A reference is a CSV of time in s and bend angle in degrees.
"""

import argparse
import contextlib
import sys
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from hardware import SerialLimb, emulated_port, replay
from limb_systems import Limb, LimbError, LimbParameters, Trajectory
from limb_systems.tracking import reference_distances, tracking_errors
from limb_systems.views.plots import plot_tracking, save_figure
from planners import Task, plan, references

# 1. The limb: what is left out has its default, and docs/limb_systems.md lists all fields.
LIMB = """
format: 2
segments:
  - links: 5            # the beam as a chain of rigid links (1)
    length: 0.1         # m
    mass: 0.025         # kg
    stiffness: 0.1246   # k of each joint, N·m/rad (2), by which the limb sags by 10° (9)
    damping: 1.0e-3     # σ of each joint, N·m·s/rad (2), of which its oscillation dies (10)
    wires:              # a1 in 1/s and a2 in °C/s (6), a3 in 1/s (7), beta in N·m/°C (4)
      - name: left
        e2: -0.0034     # m, from the axis
        law: !LinearLaw {a1: -0.07, a2: 20.0, a3: -1.0, beta: 4.7e-4}
      - name: right
        e2: 0.0034
        law: !LinearLaw {a1: -0.07, a2: 20.0, a3: -1.0, beta: 4.7e-4}
ambient_temperature: 25.0                                           # T0, °C (6)
temperature_limits: {maximum: 100.0, warm: 45.0, warm_up_time: 20.0}  # °C, °C and s (19), (20)
"""


def heat(parameters: LimbParameters) -> None:
    """2. Simulate the limb as a Drake system: its state is (14), its dynamics (1) to (7)."""
    builder = DiagramBuilder()
    limb = builder.AddSystem(Limb(parameters))
    hot = [0.0] * (len(parameters.wires) - 1) + [0.2]  # left, right
    duty = builder.AddSystem(ConstantVectorSource(hot))
    builder.Connect(duty.get_output_port(), limb.GetInputPort("duty"))
    log = LogVectorOutput(limb.GetOutputPort("bend_angle"), builder, publish_period=0.05)
    simulator = Simulator(builder.Build())
    # The chain is stiff: explicit integrators are a hundred times slower.
    ApplySimulatorConfig(SimulatorConfig(integration_scheme="radau3"), simulator)
    simulator.AdvanceTo(60.0)
    angle = log.FindLog(simulator.get_context()).data()[0]
    print(f"heated      bend angle after 60 s: {np.rad2deg(angle[-1]):.1f}°")  # (12)


def make_plan(parameters: LimbParameters, drawn: Path | None, path: Path) -> None:
    """3. Plan the feasible motion nearest to a reference, feasible or not: (15) to (20)."""
    reference = references.from_samples([0.0, 10.0, 14.0], np.deg2rad([0.0, 35.0, 35.0]))
    if drawn:
        reference = references.load(drawn)
    task = Task(angle_weight=100.0, duty_weight=2.0)  # Q and R of (15)
    # The plan starts at rest and cold (16), and is compared with a simulation of (17).
    trajectory = plan(parameters, reference, task=task, knot_rate=10.0)
    print(f"planned     within {trajectory.check.largest_difference_deg:.2f}° of its simulation")
    trajectory.save(path)  # a program at the robot needs only this file


def drive(trajectory: Trajectory, port: str | None, folder: Path) -> None:
    """4. Drive a limb through its board in real time, and print the errors as in Table I."""
    with contextlib.nullcontext(port) if port else emulated_port() as address:
        limb = SerialLimb(address, trajectory.parameters)  # it has the ports of `Limb`
        recording = replay(trajectory, limb, journal=folder / "replay.csv")
    source = recording.source if port else f"{recording.source}, emulated"
    distance = reference_distances(trajectory, [recording]).measured
    error = tracking_errors(trajectory, [recording]).mean
    print(f"recorded    {source}: {len(recording.time)} samples, {limb.link.lost_samples} lost")
    print(f"commands    99% within {1000 * np.percentile(limb.timing_errors, 99):.1f} ms")
    print(f"reference   |φ_ref - φ|: mean {np.rad2deg(distance):.2f}°")
    print(f"tracking    |φ* - φ|: mean {np.rad2deg(error):.2f}°")
    save_figure(plot_tracking(trajectory, [recording], source), folder / "replay.png")
    print(f"written     replay.csv, replay.png in {folder}")


def main(options: argparse.Namespace) -> None:
    path = options.out / "plan.csv"
    limb = options.limb
    parameters = LimbParameters.load(limb) if limb else LimbParameters.from_yaml(LIMB)
    heat(parameters)
    make_plan(parameters, options.reference, path)
    drive(Trajectory.load(path), options.port, options.out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Describe, plan for and drive a limb.")
    parser.add_argument("reference", nargs="?", type=Path, help="CSV of time (s), angle (degrees)")
    parser.add_argument("-l", "--limb", type=Path, help="parameters (.yaml) in place of those here")
    parser.add_argument("-p", "--port", help="of the robot; an emulated limb if left out")
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
    try:
        main(parser.parse_args())
    except LimbError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped; wires are off")
