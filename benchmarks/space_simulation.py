"""How far plans of limbs in space are from full simulations of their duty.

Plans of limbs in space are quasi-static: the limb is always where it would rest if its wires stayed
as warm as they are, but for the delay σ/k. A limb of five links and three wires is planned to
draw a circle of 20° in 46 s, as quickly as three wires can, from cold and at once, and its duty is
simulated with radau3. Distances are those of the two bend angles from plan to simulation: the
largest one before and after 2 s, the rms, and the rms had the plan no delay. f1 is the limb's
lowest mode where it begins.

    python benchmarks/space_simulation.py
"""

import dataclasses
import warnings

import numpy as np
from scipy.linalg import eigh

from limb_systems import Limb, LimbParameters, Trajectory, simulate
from limb_systems.model.limb import make_manipulator
from limb_systems.model.statics import HeldAngles, static_equilibrium
from planners import plan, references

START = 2.0  # s
NOWHERE, ACROSS, HANGING = (0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (9.81, 0.0, 0.0)
PLAIN, LOADED, ANY = (0.3, 0.06, 0.025), (0.7, 0.7, np.inf), (np.inf,) * 3
CASES = [  # gravity, payload in g, targets before and after 2 s and of the rms, °
    ("none", NOWHERE, 0, PLAIN),
    ("across", ACROSS, 0, PLAIN),
    ("hanging", HANGING, 0, PLAIN),
    ("none", NOWHERE, 20, LOADED),
    ("across", ACROSS, 20, LOADED),
    ("hanging", HANGING, 20, LOADED),
    ("none", NOWHERE, 50, ANY),
    ("across", ACROSS, 50, ANY),
]


def lowest_mode(limb: LimbParameters) -> float:
    """Frequency of the lowest mode about the static equilibrium of a cold limb, Hz."""
    angles, compliance = static_equilibrium(limb)
    plant = make_manipulator(limb)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, angles)
    stiffness = np.linalg.inv(compliance)
    squares = eigh((stiffness + stiffness.T) / 2, plant.CalcMassMatrix(context), eigvals_only=True)
    return float(np.sqrt(squares[0])) / (2 * np.pi)


def distances(planned: Trajectory) -> tuple[float, float, float, float]:
    """Largest before and after `START`, rms, and rms without delay, °."""
    limb, begin = planned.parameters, planned.state[:, 0]
    moved = simulate(Limb(limb), planned, accuracy=1e-5, initial_state=begin)
    at_rest = HeldAngles(limb).bends(moved.wire_temperature.T).T
    off, off_at_rest = (
        np.degrees(np.linalg.norm(moved.bend_angle - bends, axis=0))
        for bends in (planned.bend_angle_at(moved.time), at_rest)
    )
    first = moved.time < START
    rms, rms_at_rest = (float(np.sqrt(np.mean(x**2))) for x in (off, off_at_rest))
    return off[first].max(), off[~first].max(), rms, rms_at_rest


def main() -> None:
    warnings.simplefilter("ignore")  # that limbs with payloads swing is what is measured
    print(
        "gravity  payload g  f1 Hz  before 2 s °     after °          rms °            undelayed °"
    )
    for name, gravity, payload, targets in CASES:
        limb = LimbParameters.in_space()
        limb = dataclasses.replace(limb, gravity=list(gravity), payload=payload / 1000)
        reference = references.circle(np.deg2rad(20.0), 46.0, wait=0.0)
        *found, at_rest = distances(plan(limb, reference, tolerance_deg=10.0))
        columns = (f"{x:6.3f} ({target:5g})" for x, target in zip(found, targets, strict=True))
        row = f"{name:<9}{payload:>9}{lowest_mode(limb):>7.2f}  {'  '.join(columns)}"
        print(f"{row}  {at_rest:6.3f}", flush=True)


if __name__ == "__main__":
    main()
