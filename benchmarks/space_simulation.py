"""How far limbs in space are from rest as they move: what plans leave out that take them at rest.

Plans of limbs in space are quasi-static: at any time the limb is where it would rest if its wires
stayed as warm as they are. Here three wires heat in turn for 60 s, from cold, and the limb begins
at rest. Its chain is simulated with radau3 and its bend compared with that at rest for the wires'
temperatures of the time: the largest distance before and after 2 s and the rms after 2 s, also
where the motion at rest comes later by σ/k. f1 is the limb's lowest mode where it begins.

    python benchmarks/space_simulation.py
"""

import dataclasses

import numpy as np
from pydrake.trajectories import PiecewisePolynomial
from scipy.linalg import eigh

from limb_systems import Limb, LimbParameters, simulate
from limb_systems.model.manipulator import make_manipulator
from limb_systems.model.statics import HeldAngles, static_equilibrium

DURATION, PERIOD, START = 60.0, 46.0, 2.0  # s; in 46 s three wires can draw a circle of 20°
NOWHERE, ACROSS, HANGING = (0.0, 0.0, 0.0), (0.0, -9.81, 0.0), (9.81, 0.0, 0.0)
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


def in_turn() -> PiecewisePolynomial:
    """Duty of three wires."""
    times = np.arange(0.0, DURATION + 0.05, 0.1)
    turns = 2 * np.pi * (times / PERIOD - np.arange(3)[:, None] / 3)
    return PiecewisePolynomial.FirstOrderHold(times, 0.18 + 0.14 * np.cos(turns))


def lowest_mode(limb: LimbParameters, angles: np.ndarray, compliance: np.ndarray) -> float:
    """Frequency of the lowest mode about a static equilibrium, Hz."""
    plant = make_manipulator(limb)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, angles)
    stiffness = np.linalg.inv(compliance)
    squares = eigh((stiffness + stiffness.T) / 2, plant.CalcMassMatrix(context), eigvals_only=True)
    return float(np.sqrt(squares[0])) / (2 * np.pi)


def distances(limb: LimbParameters) -> list[float]:
    """f1, Hz, and the four distances, °."""
    angles, compliance = static_equilibrium(limb)
    cold = np.full(len(limb.wires), limb.ambient_temperature)
    begin = np.concatenate([angles, 0 * angles, cold, cold])
    moved = simulate(Limb(limb), in_turn(), DURATION, accuracy=1e-5, initial_state=begin)
    at_rest = np.degrees(HeldAngles(limb).bends(moved.wire_temperature.T).T)
    bends, times = np.degrees(moved.bend_angle), moved.time
    segment = limb.segments[0]
    later = times - segment.damping / segment.stiffness
    delayed = np.array([np.interp(later, times, bend) for bend in at_rest])
    off, off_later = (np.linalg.norm(bends - rest, axis=0) for rest in (at_rest, delayed))
    first = times < START
    rms = [np.sqrt(np.mean(distance[~first] ** 2)) for distance in (off, off_later)]
    return [lowest_mode(limb, angles, compliance), off[first].max(), off[~first].max(), *rms]


def main() -> None:
    print("gravity  payload g  f1 Hz  before 2 s °     after °       rms °         delayed rms °")
    for name, gravity, payload, targets in CASES:
        limb = LimbParameters.in_space()
        limb = dataclasses.replace(limb, gravity=list(gravity), payload=payload / 1000)
        f1, *found, delayed = distances(limb)
        columns = (
            f"{value:6.3f} ({target:5g})" for value, target in zip(found, targets, strict=True)
        )
        print(f"{name:<9}{payload:>9}{f1:>7.2f}  {'  '.join(columns)}  {delayed:6.3f}", flush=True)


if __name__ == "__main__":
    main()
