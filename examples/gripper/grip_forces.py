"""Compare planned grips with simulations with contact: forces, and times until the ball is free.

The gripper of gripper.py is simulated with other forces, balls, hands and wires. `grip` plans for
a free finger; Drake simulates the hand with hydroelastic contact.

    python examples/gripper/grip_forces.py
"""

import copy
import shutil
import tempfile
from pathlib import Path

import numpy as np
from grip import fingers_duty, grip

from hardware import Station, drive
from limb_systems import HystereticLaw, LimbParameters, SaturatingLaw
from planners import Task, plan, references

FOLDER = Path(__file__).parent
ALONG = 0.085  # m, from the base to the ball along the finger
OPENS = 22.0  # s
END = 26.0  # s
CASES = (  # ball's radius, distance of the finger from its centre, m; force, N; law
    ("light", 0.02, 0.035, 0.05, None),
    ("as the example", 0.02, 0.035, 0.1, None),
    ("strong", 0.02, 0.035, 0.2, None),
    ("larger ball", 0.025, 0.04, 0.1, None),
    ("smaller ball", 0.0175, 0.033, 0.1, None),
    ("wider hand", 0.02, 0.04, 0.1, None),
    ("saturating wires", 0.02, 0.035, 0.1, SaturatingLaw),
    ("hysteretic wires", 0.02, 0.035, 0.1, HystereticLaw),
)


def station(finger: LimbParameters, radius: float, distance: float, folder: Path) -> Station:
    """Return the example's station with another finger, ball and width of the hand."""
    shutil.copytree(FOLDER, folder, dirs_exist_ok=True)
    finger.save(folder / "finger.yaml")
    for name, changes in {
        "scenario.yaml": {"0.035": f"{distance}", "0.02]": f"{radius}]"},
        "ball.sdf": {"0.02</radius>": f"{radius}</radius>"},
        "wrist.sdf": {"0 0 0.105": f"0 0 {ALONG + radius}"},
    }.items():
        text = (folder / name).read_text()
        for old, new in changes.items():
            text = text.replace(old, new)
        (folder / name).write_text(text)
    return Station(folder / "scenario.yaml")


def main() -> None:
    # Print the header of a table: force, heat and duty of the plan, and the simulation.
    nominal = LimbParameters.load(FOLDER / "finger.yaml")
    row = "{:<18}{:>9}{:>9}{:>9}{:>9}{:>11}{:>11}{:>8}{:>8}"
    print(row.format("grip", "force", "wire", "duty", "at most", "simulated", "", "open", "free"))
    print(row.format("", "N", "°C", "", "N", "N", "", "s", "s"))
    for name, radius, distance, force, law in CASES:
        finger = copy.deepcopy(nominal)
        for wire in finger.wires:
            wire.law = law() if law else wire.law
        # Plan the bend for the force.
        grip_state = grip(finger, [ALONG, distance], radius, force)
        closed = grip_state.bend_angle
        bends = np.array([[0.0, 0.0, closed, closed, 0.0, 0.0]])
        motion = references.from_samples([0.0, 12.0, 14.0, OPENS, OPENS + 1.0, END], bends)
        trajectory = plan(finger, motion, task=Task(duty_weight=0.05))
        # Simulate both fingers.
        inputs = fingers_duty(trajectory)
        with tempfile.TemporaryDirectory() as folder:
            hand = station(finger, radius, distance, Path(folder))
            signals = drive(hand, {**inputs, "wrist.desired_state": [0.0, 0.0]}, END)
        # Compare the force, and the time until the ball is free.
        forces = np.linalg.norm(signals["left_finger.contact_force"], axis=0)
        simulated = forces[signals["time"] >= OPENS - 2.0][0]
        is_pressing = trajectory.bend_angle[0] > grip_state.gripping_bend_angle
        opens = trajectory.time[is_pressing][-1] - OPENS
        # Print them with the plan's numbers.
        cells = (
            f"{force:.2f}",
            f"{grip_state.wire_temperature.max():.0f}",
            f"{trajectory.duty[:, trajectory.time >= OPENS - 2.0][:, 0].max():.2f}",
            f"{grip_state.largest_force:.2f}",
            f"{simulated:.3f}",
            f"{simulated / force - 1:+.1%}",
            f"{opens:.1f}",
            f"{signals['time'][np.flatnonzero(forces)[-1]] - OPENS:.1f}",
        )
        print(row.format(name, *cells), flush=True)


if __name__ == "__main__":
    main()
