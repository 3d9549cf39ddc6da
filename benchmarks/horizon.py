"""How long a horizon takes to plan, while a calibrated limb follows Fig. 5.

An emulated limb is calibrated from its recordings, as on a robot, and replays the plan
of the Fig. 5 reference with `RecedingHorizon`, which plans 10 s at 5 Hz four times a
second. Every 10 s, `Planner` plans the same seconds with the chain's dynamics from the
same heat, for comparison. All in one process, one thread of BLAS.

    python benchmarks/horizon.py [LIMB.yaml] [--seed SEED]

With the calibrated parameters of an emulated limb in a file, it is not calibrated again.
"""

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from calibration import calibrate, collect_from_twin
from controllers import RecedingHorizon, ReducedModel
from controllers.horizon import HorizonPlanner, horizon_task
from hardware import LimbTwin, replay
from limb_systems import LimbParameters
from planners import InfeasibleError, Planner, plan, references

EVERY = 10.0  # s, between comparisons


def main(options: argparse.Namespace) -> None:
    if options.limb:
        parameters = LimbParameters.load(options.limb)
    else:
        recordings = collect_from_twin(LimbTwin(seed=options.seed), seed=options.seed)
        parameters = calibrate(recordings).parameters
    fig5 = references.step_and_decaying_sine()
    trajectory = plan(parameters, fig5)
    asked: list[tuple] = []
    times: list[float] = []
    untimed = HorizonPlanner.plan

    def noted(planner, *given):
        asked.append(given)
        started = time.perf_counter()
        made = untimed(planner, *given)
        times.append(time.perf_counter() - started)
        return made

    HorizonPlanner.plan = noted
    recording = replay(trajectory, LimbTwin.of(parameters), controller=RecedingHorizon(trajectory))
    reference = fig5.vector_values(np.minimum(recording.time, fig5.end_time()))
    missed = np.rad2deg(np.abs(recording.bend_angle - reference)).mean()
    law = type(parameters.wires[0].law).__name__
    print(f"{law}, {len(times)} horizons; mean distance from the reference {missed:.2f}°")
    report("horizon", times)
    whole, solving = times_of_planner(parameters, fig5, asked)
    report("Planner, solving alone", solving)
    report("Planner, whole", whole)


def times_of_planner(parameters, reference, asked) -> tuple[list[float], list[float]]:
    """Times of all and of solving, s, of plans from what was asked of the horizon's planner."""
    model, knots = ReducedModel(parameters), np.linspace(0.0, 10.0, 51)
    planner = Planner(parameters, knots, task=horizon_task(), tolerance_deg=1.0)
    whole, solving = [], []
    for start, heat, *_ in asked:
        if start % EVERY > 0.1:
            continue
        angles = model.joint_angles(heat)
        times = np.minimum(start + knots, reference.end_time())
        ahead = references.from_samples(knots, reference.vector_values(times))
        state = np.concatenate([angles, np.zeros_like(angles), heat])
        started = time.perf_counter()
        try:
            found, _, _ = planner.plan_unchecked(ahead, state, elapsed=start)
        except InfeasibleError as error:
            print(f"at {start:.0f} s Planner has no plan: {error}")
            continue
        whole.append(time.perf_counter() - started)
        solving.append(found.check.solve_time)
    return whole, solving


def report(name: str, times: list[float]) -> None:
    print(f"{name:<24}median {1e3 * np.median(times):4.0f} ms, worst {1e3 * max(times):4.0f} ms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Times plans of a receding horizon.")
    parser.add_argument("limb", nargs="?", help="calibrated parameters of an emulated limb (.yaml)")
    parser.add_argument("--seed", type=int, default=0, help="of the limb (default %(default)s)")
    main(parser.parse_args())
