"""The thermal blocks against the closed-form solutions of eqns (6) and (7).

For constant duty D the wire approaches T∞ = T0 - a2/a1 D as exp(a1 t). The
measured temperature is a sum of two exponentials: put V = T∞ + B exp(a1 t) +
C exp(a3 t) into (7) and B = a3 (T(0) - T∞) / (a3 - a1), C = V(0) - T∞ - B.
"""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from limb_systems import (
    JouleHeating,
    LimbParameters,
    ThermocoupleLag,
    TorqueMap,
)


def wire_constants(parameters) -> np.ndarray:
    """a1, a2 and a3 of each wire, three rows."""
    return np.array([[wire.law.a1, wire.law.a2, wire.law.a3] for wire in parameters.wires]).T


def exact_temperatures(parameters, duty, wire0, measured0, time):
    """T and V after some time of constant duty."""
    a1, a2, a3 = wire_constants(parameters)
    final = parameters.ambient_temperature - a2 / a1 * duty
    slow = a3 * (wire0 - final) / (a3 - a1)
    fast = measured0 - final - slow
    wire = final + (wire0 - final) * np.exp(a1 * time)
    measured = final + slow * np.exp(a1 * time) + fast * np.exp(a3 * time)
    return wire, measured


def thermal_simulator(parameters, duty, wire0, measured0):
    """A tight simulator of heating and lag alone; its state is [T, V]."""
    builder = DiagramBuilder()
    heating = builder.AddSystem(JouleHeating(parameters))
    lag = builder.AddSystem(ThermocoupleLag(parameters))
    builder.Connect(heating.get_output_port(), lag.get_input_port())
    builder.ExportInput(heating.get_input_port(), "duty")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    context = simulator.get_mutable_context()
    diagram.get_input_port().FixValue(context, duty)
    context.SetContinuousState(np.concatenate([wire0, measured0]))
    return simulator


def temperatures(simulator) -> tuple[np.ndarray, np.ndarray]:
    state = simulator.get_context().get_continuous_state_vector().CopyToVector()
    return tuple(np.split(state, 2))


def test_wire_and_measured_temperature_are_the_exponentials(uneven_limb):
    rng = np.random.default_rng(1)
    duty = rng.uniform(0, 1, 4)
    wire0, measured0 = rng.uniform(20, 120, (2, 4))
    simulator = thermal_simulator(uneven_limb, duty, wire0, measured0)
    for time in (0.1, 1.0, 7.0, 30.0):
        simulator.AdvanceTo(time)
        wire, measured = temperatures(simulator)
        expected = exact_temperatures(uneven_limb, duty, wire0, measured0, time)
        np.testing.assert_allclose(wire, expected[0], atol=1e-6)
        np.testing.assert_allclose(measured, expected[1], atol=1e-6)


def torque(parameters, wire_temperature) -> np.ndarray:
    torque_map = TorqueMap(parameters)
    context = torque_map.CreateDefaultContext()
    torque_map.get_input_port().FixValue(context, wire_temperature)
    return torque_map.get_output_port().Eval(context)


def test_torque_is_the_same_on_every_joint_and_right_minus_left():
    parameters = LimbParameters()
    parameters.segments[0].wire("left").law.beta, parameters.segments[0].wire("right").law.beta = (
        2e-4,
        5e-4,
    )
    expected = 5e-4 * (85.0 - 25.0) - 2e-4 * (60.0 - 25.0)  # (4) by hand: 0.023 N·m
    np.testing.assert_allclose(torque(parameters, [60.0, 85.0]), [expected] * 5, rtol=1e-12)
