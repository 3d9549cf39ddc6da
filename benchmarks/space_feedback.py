"""Feedback and learning on limbs that bend in space: how near they come to a plan in truth.

Three or four wires draw a circle, of the limb as it is known: at 20° wires cool fast enough for a
circle in 46 s with three of them, in 33 s with four. The limbs that follow it are the model with
other wires: each is 10% stronger or weaker than known, and runs some degrees beside its place.
Their sensors have noise and drift. Shown are mean distances from the reference in truth, and from
the plan in truth and as read, and the highest reading and temperature. A receding horizon and
learning go to the reference, and all others follow the plan, which leaves room for them. Learning
is shown as it is in its last repetition of five.

    python benchmarks/space_feedback.py [--limbs 3]
"""

import argparse
import copy
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: matrices are small

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from controllers import Learner, PlanFeedback, RecedingHorizon
from hardware import replay
from hardware.emulation.sensors import SensedLimb
from limb_systems import Limb, LimbParameters, Recording, Trajectory, WireParameters, simulate
from limb_systems.tracking import reference_distances, tracking_errors
from planners import Task, plan, references

RADIUS_DEG, PERIODS = 18.0, {3: 55.0, 4: 40.0}  # s, of a turn, by the number of wires
GAINS, BESIDE_DEG = 0.1, 4.0
DRIFTS_DEG, REPETITIONS = (1.0, 0.1), 5
WAYS = {"open loop": None, "PlanFeedback": PlanFeedback, "RecedingHorizon": RecedingHorizon}


def unlike(known: LimbParameters, seed: int) -> LimbParameters:
    """A limb whose wires are not as they are known."""
    limb, rng = copy.deepcopy(known), np.random.default_rng(seed)
    for number, wire in enumerate(limb.wires):
        angle = np.degrees(np.arctan2(wire.e3, wire.e2)) + rng.uniform(-1, 1) * BESIDE_DEG
        place = WireParameters.at(wire.name, angle)
        wire.e2, wire.e3 = place.e2, place.e3
        wire.law.beta *= 1 + GAINS * (-1) ** (number + seed)
    return limb


def figures(course: Trajectory, limb: LimbParameters, read: Recording) -> list[float]:
    """Distances from the reference, the plan, and the plan as read, °; the highest V and T, °C."""
    duty = PiecewisePolynomial.ZeroOrderHold(read.time, read.duty)
    truth = simulate(Limb(limb), duty, read.time[-1], initial_state=course.state[:, 0])
    missed = [tracking_errors(course, [one]).mean for one in (truth, read)]
    distances = np.rad2deg([reference_distances(course, [truth]).measured, *missed])
    return [*distances, read.measured_temperature.max(), truth.wire_temperature.max()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--limbs", type=int, default=3, help="limbs that are unlike the known one")
    limbs = parser.parse_args().limbs
    print(f"{'wires, drift, way':<30}{'reference':>10}{'plan':>7}{'read':>8}{'V':>9}{'T':>10}")
    for wires, period in PERIODS.items():
        known = LimbParameters.in_space(wires)
        reference = references.circle(np.radians(RADIUS_DEG), period)
        course = plan(known, reference, task=Task.closed_loop(known))
        for drift in DRIFTS_DEG:
            course.parameters.segments[0].bend_sensor.drift = float(np.radians(drift))
            shown: dict[str, list] = {}
            for seed in range(limbs):
                limb = unlike(course.parameters, seed)
                for name, way in WAYS.items():
                    sensed = SensedLimb(Limb(limb), seed=seed)
                    read = replay(course, sensed, controller=way and way(course))
                    shown.setdefault(name, []).append(figures(course, limb, read))
                learner = Learner(course)
                for repetition in range(REPETITIONS):
                    sensed = SensedLimb(Limb(limb), seed=1000 * repetition + seed)
                    learner.update(read := replay(course, sensed, controller=learner.source()))
                shown.setdefault("Learner", []).append(figures(course, limb, read))
            for name, rows in shown.items():
                print(
                    f"{wires} wires, {drift:g}°, {name:<16}"
                    + "".join(f"{mean:>7.2f}°" for mean in np.mean(rows, axis=0)[:3])
                    + "".join(f"{most:>7.1f} °C" for most in np.max(rows, axis=0)[3:]),
                    flush=True,
                )


if __name__ == "__main__":
    main()
