"""The time of one step of each controller, for a limb with wires that remember.

Each controller gets the readings of an emulated limb that follows Fig. 5 by it, one
step after the other, and nothing else is timed: estimate, feedback, and bounds of duty; every
fifth step of a `RecedingHorizon` plans the next 10 s, too. The limb is not calibrated, but its law
is the costliest, `CoupledLaw`, with rubber that stiffens. So is a limb with three wires that
draws a circle, without gravity and lying across it.

    python benchmarks/controller_step_time.py
"""

import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: matrices are small

import numpy as np
from pydrake.systems.analysis import Simulator

from controllers import PlanFeedback, PlanRegulator, RecedingHorizon, TemperatureSupervisor
from hardware import LimbTwin, replay
from limb_systems import CoupledLaw, LimbParameters
from limb_systems.simulation import PERIOD
from planners import Task, plan, references


def main() -> None:
    planar = LimbParameters()
    across = [0.0, -9.81, 0.0]
    step = references.step_and_decaying_sine()
    circle = references.circle(np.radians(12.0), 50.0)
    planar.segments[0].stiffening = 0.05
    print(f"{'one step':<32}{'median':>10}{'99%':>10}{'largest':>10}")
    for name, parameters, gravity, reference in (
        ("planar", planar, planar.gravity, step),
        ("in space", LimbParameters.in_space(), planar.gravity, circle),
        ("across", LimbParameters.in_space(), across, circle),
    ):
        parameters.gravity = gravity
        for wire in parameters.wires:
            wire.law = CoupledLaw(heating_drop=0.1, stress_shift=6.0, creep_share=0.1)
        trajectory = plan(parameters, reference, task=Task.closed_loop(parameters))
        recording = replay(trajectory, LimbTwin(parameters), controller=PlanFeedback(trajectory))
        for controller in (
            PlanFeedback(trajectory),
            PlanRegulator(trajectory),
            TemperatureSupervisor(parameters),
            RecedingHorizon(trajectory),
        ):
            took = 1000 * np.array(steps(controller, recording))
            figures = [np.median(took), np.percentile(took, 99), took.max()]
            print(
                f"{name:<9}{type(controller).__name__:<23}"
                + "".join(f"{figure:>7.2f} ms" for figure in figures)
            )


def steps(controller, recording) -> list[float]:
    """Return the time of each step of a controller that gets a recording's readings, s."""
    simulator = Simulator(controller)
    context = simulator.get_mutable_context()
    times = []
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
