"""The thermal blocks against the matrix exponential of eqns (6) and (7), and (4) by hand."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.linalg import expm

from limb_systems import JouleHeating, LimbParameters, ThermocoupleLag, TorqueMap


def test_wire_and_measured_temperature_are_the_exponentials(uneven_limb):
    """Of T and V above ambient and of constant duty, for each wire."""
    # Connect heating and lag alone.
    builder = DiagramBuilder()
    heating = builder.AddSystem(JouleHeating(uneven_limb))
    lag = builder.AddSystem(ThermocoupleLag(uneven_limb))
    builder.Connect(heating.get_output_port(), lag.get_input_port())
    builder.ExportInput(heating.get_input_port())
    # Start from any temperatures, under any duty.
    rng = np.random.default_rng(1)
    duty = rng.uniform(0, 1, 4)
    start = rng.uniform(20, 120, 8)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    context = simulator.get_mutable_context()
    simulator.get_system().get_input_port().FixValue(context, duty)
    context.SetContinuousState(start)
    ambient = uneven_limb.ambient_temperature
    for time in (0.1, 1.0, 7.0, 30.0):
        simulator.AdvanceTo(time)
        actual = context.get_continuous_state_vector().CopyToVector() - ambient
        for index, wire in enumerate(uneven_limb.wires):
            a1, a2, a3 = wire.law.a1, wire.law.a2, wire.law.a3
            rates = np.array([[a1, 0.0, a2], [-a3, a3, 0.0], [0.0, 0.0, 0.0]])
            rises = start[[index, 4 + index]] - ambient
            expected = expm(rates * time) @ [*rises, duty[index]]
            np.testing.assert_allclose(actual[[index, 4 + index]], expected[:2], atol=1e-6)


def test_torque_is_the_same_on_every_joint_and_right_minus_left():
    parameters = LimbParameters()
    parameters.wires[0].law.beta = 2e-4
    parameters.wires[1].law.beta = 5e-4
    torque_map = TorqueMap(parameters)
    context = torque_map.CreateDefaultContext()
    torque_map.get_input_port().FixValue(context, [60.0, 85.0])
    expected = 5e-4 * (85.0 - 25.0) - 2e-4 * (60.0 - 25.0)  # (4) by hand: 0.023 N·m
    actual = torque_map.get_output_port().Eval(context)
    np.testing.assert_allclose(actual, [expected] * 5, rtol=1e-12)
