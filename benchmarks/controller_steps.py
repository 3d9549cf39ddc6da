"""How long one step of a controller takes, for a limb with wires that remember.

Each controller gets the readings of an emulated limb that follows Fig. 5 by it, one
step after the other, and nothing else is timed: estimate, feedback, and bounds of duty.
Receding horizons are in benchmarks/horizon.py. The limb is not calibrated, but its law
is the costliest, `HystereticLaw`, with rubber that stiffens.

    python benchmarks/controller_steps.py
"""

import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: matrices are small

import numpy as np
from pydrake.systems.analysis import Simulator

from controllers import PlanFeedback, PlanRegulator, TemperatureSupervisor
from hardware import LimbTwin, replay
from limb_systems import HystereticLaw, LimbParameters
from limb_systems.simulation import PERIOD
from planners import Task, plan, references


def main() -> None:
    parameters = LimbParameters()
    parameters.segments[0].stiffening = 0.05
    for wire in parameters.wires:
        wire.law = HystereticLaw()
    trajectory = plan(
        parameters, references.step_and_decaying_sine(), task=Task.closed_loop(parameters)
    )
    recording = replay(trajectory, LimbTwin(), controller=PlanFeedback(trajectory))
    print(f"{'one step':<24}{'median':>10}{'99%':>10}{'largest':>10}")
    for controller in (
        PlanFeedback(trajectory),
        PlanRegulator(trajectory),
        TemperatureSupervisor(parameters),
    ):
        took = 1000 * np.array(steps(controller, recording))
        figures = [np.median(took), np.percentile(took, 99), took.max()]
        print(f"{type(controller).__name__:<24}" + "".join(f"{f:>7.2f} ms" for f in figures))


def steps(controller, recording) -> list[float]:
    """s, that each step takes which a recording's readings are given to."""
    simulator = Simulator(controller)
    context, times = simulator.get_mutable_context(), []
    names = ("measured_temperature", "bend_angle", "duty")
    signals = {n: getattr(recording, n).T for n in names if controller.HasInputPort(n)}
    for number in range(len(recording.time)):
        for name, rows in signals.items():
            controller.GetInputPort(name).FixValue(context, rows[number])
        started = time.perf_counter()
        simulator.AdvanceTo(PERIOD * (number + 1))
        times.append(time.perf_counter() - started)
    return times


if __name__ == "__main__":
    main()
