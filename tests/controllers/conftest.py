"""What several tests share: a system that is given readings by hand, and a short plan."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from limb_systems import LimbParameters, Trajectory
from planners import plan, references

PERIOD = 0.05  # s


def outputs_under(system, inputs, context=None):
    """What a system shows at each of the controllers' ticks, before it takes the inputs in.

    Args:
        system: with events every 0.05 s.
        inputs: by the name of the port, one row for each tick (K, size).
        context: to go on from; that of the system by default if None.

    Returns:
        The outputs by the name of their port, each (K, size), and ``context``, that of the
        end.
    """
    simulator = Simulator(system, context or system.CreateDefaultContext())
    context = simulator.get_mutable_context()
    start = round(context.get_time() / PERIOD)
    ports = [system.get_output_port(index) for index in range(system.num_output_ports())]
    shown = {port.get_name(): [] for port in ports}
    for k in range(len(next(iter(inputs.values())))):
        for name, rows in inputs.items():
            system.GetInputPort(name).FixValue(context, np.asarray(rows[k], float))
        for port in ports:
            shown[port.get_name()].append(port.Eval(context).copy())
        simulator.AdvanceTo(PERIOD * (start + k + 1))  # begins with the tick's update
    return SimpleNamespace(
        **{name: np.array(rows) for name, rows in shown.items()}, context=context.Clone()
    )


@pytest.fixture(scope="session")
def fed():
    """`outputs_under`."""
    return outputs_under


@pytest.fixture(scope="session")
def short_plan() -> Trajectory:
    """Two joints that bend by 12° after a second, from cold, within four."""
    parameters = LimbParameters()
    parameters.segments[0].links = 2
    parameters.temperature_limits.warm_up_time = 1000.0
    reference = references.from_samples([0.0, 1.0, 2.0, 4.0], np.deg2rad([0.0, 0.0, 12.0, 12.0]))
    return plan(parameters, reference, knot_rate=5.0, tolerance_deg=0.5)
