"""How long planning again takes, and which start is best after which change.

Five links, 301 knots over 30 s, in the middle of the Fig. 5 reference with
warm wires: the plan before is changed by a bend angle or moved in time, and
solved again from the quasi-static start and from the plan before. Medians
over repetitions, all in one process; the state to start from is that of the
plan before, at the time that has passed.

    python benchmarks/replanning.py
"""

import statistics

import numpy as np

import planners.planning as planning
from limb_systems import LimbParameters
from limb_systems.statics import static_equilibrium
from planners import Planner, Task, references

REPETITIONS = 5
HORIZON, KNOTS, START = 30.0, 301, 25.0  # s, 1, s
TIMES = ("solve_time", "total_time")


def reference_from(time: float, offset_deg: float):
    """Fig. 5 from a time on, moved by an angle."""
    whole = references.step_and_decaying_sine()
    times = np.arange(0.0, HORIZON + 0.01, 0.01)
    angles = whole.vector_values(np.minimum(time + times, whole.end_time()))
    return references.from_samples(times, angles + np.deg2rad(offset_deg))


def main() -> None:
    wires = [50.0, 80.0]
    angles, _ = static_equilibrium(LimbParameters(), wires)
    warm = np.r_[angles, np.zeros(5), wires, wires]
    print("change                    start           iterations   solve    whole, with check")
    for name, offset_deg, later in (
        ("none", 0.0, 0.0),
        ("reference by 0.1°", 0.1, 0.0),
        ("reference by 2°", 2.0, 0.0),
        ("reference by 10°", 10.0, 0.0),
        ("1 s later", 0.0, 1.0),
    ):
        for start, small in (("plan before", np.inf), ("quasi-static", 0.0)):
            planning.SMALL_REFERENCE_CHANGE = planning.SMALL_STATE_CHANGE = small
            checks = []
            for _ in range(REPETITIONS):
                planner = Planner(
                    LimbParameters(),
                    np.linspace(0.0, HORIZON, KNOTS),
                    task=Task.paper(),
                    tolerance_deg=0.5,
                )
                before = planner.plan(reference_from(START, 0.0), warm, elapsed=START)
                knot = round(later / HORIZON * (KNOTS - 1))
                again = planner.plan(
                    reference_from(START + later, offset_deg),
                    before.state[:, knot],
                    elapsed=START + later,
                )
                checks.append(again.check)
            times = [statistics.median(getattr(c, key) for c in checks) for key in TIMES]
            print(
                f"{name:<26}{start:<16}{checks[0].iterations:>10}"
                f"{times[0]:>8.3f} s{times[1]:>12.3f} s"
            )


if __name__ == "__main__":
    main()
