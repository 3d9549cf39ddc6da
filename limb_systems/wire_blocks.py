"""All wires of a limb as Drake systems: heat (6), measurement (7) and torque (4).

Affine laws, such as the paper's, make affine blocks. Their dynamics run in
Drake's C++ for every scalar type. Other laws make blocks of `LawDynamics` and
`VectorFunction`. Drake's SymbolicVectorSystem would run these in C++, but it must
have a state to be part of a continuous diagram, and that state can only start at
zero. Drake names the ports of an AffineSystem ``u0`` and ``y0``.
"""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import (
    Diagram,
    DiagramBuilder,
    InputPort,
    LeafSystem_,
    OutputPort,
    System,
)
from pydrake.systems.primitives import AffineSystem, Integrator, MatrixGain, Multiplexer
from pydrake.systems.scalar_conversion import TemplateSystem

from limb_systems.drake_python import weak_method
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import LimbParameters, ParameterError
from limb_systems.wires import Wires


class JouleHeating(AffineSystem):
    """The states of the wires under Joule heating and convection, eqn (6).

        Ṫ = a1 (T - T0) + a2 D

    - state: x (N): T (W), °C, then the other states of the wires' laws, as
      in `Wires`; by default the state of wires that were never heated
    - input 0: duty D (W), in [0, 1]
    - output 0: x (N)
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters | LimbModel):
        """
        Args:
            parameters: the limb or its description.

        Raises:
            ParameterError: if the heat of a wire is not linear.
        """
        wires = _affine(parameters, "rates_are_affine", "heat")
        A, B, _ = wires.affine_rates()
        N, W = B.shape
        super().__init__(A=A, B=B, f0=wires.rates(np.zeros(N), np.zeros(W)), C=np.eye(N))
        self.configure_default_state(wires.cold_states)


class ThermocoupleLag(AffineSystem):
    """Temperature that the glued-on thermocouple measures, eqn (7).

        V̇ = a3 (V - T)

    - state: V (W), °C; T0 by default
    - input 0: x (N) of the wires, which begins with T (W), °C
    - output 0: measured temperature V (W), °C
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters | LimbModel):
        """
        Args:
            parameters: the limb or its description.

        Raises:
            ParameterError: if the heat of a wire is not linear.
        """
        wires = _affine(parameters, "rates_are_affine", "heat")
        N = wires.num_states
        W = wires.num_wires
        # The slopes of the readings' rates by [x, V, D].
        _, slopes = wires.heat.first(np.zeros(N + 2 * W))
        slopes = slopes[N:]  # of the readings
        super().__init__(
            A=slopes[:, N : N + W],
            B=slopes[:, :N],
            f0=wires.reading_rates(np.zeros(W), np.zeros(N)),
            C=np.eye(W),
        )
        self.configure_default_state(np.full(W, wires.ambient_temperature))


class TorqueMap(AffineSystem):
    """Generalized force of the wires on the joints, eqn (4).

        f(T) = β_r (T_r - T0) 1 - β_l (T_l - T0) 1   for each segment

    Each wire's torque has the direction of its lever.

    - input 0: x (N) of the wires, which begins with T (W), °C
    - output 0: generalized force f (n), N·m
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters | LimbModel):
        """
        Args:
            parameters: the limb or its description.

        Raises:
            ParameterError: if the torque of a wire is not linear.
        """
        wires = _affine(parameters, "torque_is_affine", "torque")
        states = np.zeros(wires.num_states)
        straight = np.zeros(len(wires.levers))
        # The slopes of the forces by the states.
        _, slopes = wires.force.first(np.concatenate([states, straight]))
        super().__init__(D=slopes[:, : wires.num_states], y0=wires.forces(states, straight))


def _affine(parameters: LimbParameters | LimbModel, property_name: str, quantity: str) -> Wires:
    """Return the wires of a limb; raise ParameterError if the quantity is not affine."""
    wires = LimbModel.of(parameters).wires
    if not getattr(wires, property_name):
        raise ParameterError(
            f"The {quantity} of a wire of this limb is not linear; make_blocks makes the blocks of "
            "any limb."
        )
    return wires


# With the scope given, Drake need not look it up, which takes 50 ms.
@TemplateSystem.define("VectorFunction_", scope=sys.modules[__name__])
def VectorFunction_(T: type) -> Any:
    """Return the class `VectorFunction` for a scalar type: float, AutoDiffXd or Expression."""

    class Impl(LeafSystem_[T]):
        """A block that evaluates a function of its inputs.

        - inputs: vectors of the given sizes, in this order
        - output 0 ``value``: the value of the function
        """

        __slots__ = ()  # see limb_systems.drake_python

        def _construct(
            self,
            function: Callable[..., np.ndarray],
            input_sizes: Sequence[int],
            output_size: int,
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            self._arguments = function, input_sizes, output_size
            # The output depends on the inputs only, so that Drake keeps its value.
            tickets = set()
            for index, size in enumerate(input_sizes):
                port = self.DeclareVectorInputPort(f"u{index}", size)
                tickets.add(self.input_port_ticket(port.get_index()))
            self.DeclareVectorOutputPort("value", output_size, weak_method(self._calc), tickets)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other._arguments, converter=converter)

        def _calc(self, context, output):
            function, input_sizes, _ = self._arguments
            inputs = [self.get_input_port(i).Eval(context) for i in range(len(input_sizes))]
            with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
                output.SetFromVector(function(*inputs))

    return Impl


VectorFunction = VectorFunction_[None]


class LawDynamics(Diagram):
    """A block with ẋ = f(x, u), and the state as its output.

    - state, continuous: x
    - input 0 ``u``: u
    - output 0 ``x``: x
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        rates: Callable[[np.ndarray, np.ndarray], np.ndarray],
        num_inputs: int,
        initial: np.ndarray,
    ):
        """
        Args:
            rates: f, for arrays of any of Drake's scalar types.
            num_inputs: size of u.
            initial: x of the default state.
        """
        super().__init__()
        builder = DiagramBuilder()
        size = len(initial)
        # Integrate the rates, and feed the state back.
        function = builder.AddSystem(VectorFunction(rates, [size, num_inputs], size))
        integrator = builder.AddSystem(Integrator(np.asarray(initial, float)))
        builder.Connect(function.get_output_port(), integrator.get_input_port())
        builder.Connect(integrator.get_output_port(), function.get_input_port(0))
        builder.ExportInput(function.get_input_port(1), "u")
        builder.ExportOutput(integrator.get_output_port(), "x")
        builder.BuildInto(self)


def make_blocks(parameters: LimbParameters | LimbModel) -> tuple[System, System, System]:
    """Return the blocks of heat, measurement and torque, affine if the wires' laws are affine."""
    model = LimbModel.of(parameters)
    wires = model.wires
    n = model.layout.num_joints
    heating: System
    lag: System
    torque_map: System
    # Make the blocks of heat and measurement.
    if wires.rates_are_affine:
        heating = JouleHeating(model)
        lag = ThermocoupleLag(model)
    else:
        cold = wires.cold_states
        heating = LawDynamics(wires.rates, wires.num_wires, cold)
        lag = LawDynamics(wires.reading_rates, wires.num_states, cold[: wires.num_wires])
    # Make the block of torque, which has the joint state as an input if it needs the angle.
    if wires.torque_is_affine:
        torque_map = TorqueMap(model)
    elif wires.torque_needs_angle:
        torque_map = VectorFunction(
            lambda states, joint_state: wires.forces(states, joint_state[:n]),
            [wires.num_states, 2 * n],
            n,
        )
    else:
        straight = np.zeros(n)
        torque_map = VectorFunction(
            lambda states: wires.forces(states, straight), [wires.num_states], n
        )
    return heating, lag, torque_map


def add_wire_blocks(
    builder: DiagramBuilder, parameters: LimbParameters | LimbModel, joint_state: OutputPort
) -> tuple[dict[str, OutputPort], InputPort]:
    """Add the blocks of Fig. 3 about mechanics, and export the outputs 0 to 4 of `Limb`.

    Args:
        builder: builder of the diagram that has the mechanics.
        parameters: the limb, or all limbs of a robot together.
        joint_state: [θ, θ̇] (2n) of the mechanics, rad and rad/s.

    Returns:
        Output ports by name, with ``torque`` on the joints (n), N·m, which is not exported; and
        the input port of the duty, which is neither connected nor exported.
    """
    model = LimbModel.of(parameters)
    n = model.layout.num_joints
    num_wires = model.layout.num_wires
    num_bends = model.layout.num_bends
    # Add the blocks.
    heating, lag, torque_map = make_blocks(model)
    builder.AddNamedSystem("joule_heating", heating)
    builder.AddNamedSystem("thermocouple_lag", lag)
    builder.AddNamedSystem("torque_map", torque_map)
    bend = builder.AddNamedSystem(
        "bend_angle",
        VectorFunction(lambda state: model.mechanics.bend_angle(state[:n]), [2 * n], num_bends),
    )
    measurement = builder.AddSystem(Multiplexer([num_wires, num_bends]))
    # Connect them.
    wire_state = heating.get_output_port()
    builder.Connect(wire_state, torque_map.get_input_port(0))
    builder.Connect(wire_state, lag.get_input_port())
    if torque_map.num_input_ports() > 1:
        builder.Connect(joint_state, torque_map.get_input_port(1))
    builder.Connect(joint_state, bend.get_input_port())
    builder.Connect(lag.get_output_port(), measurement.get_input_port(0))
    builder.Connect(bend.get_output_port(), measurement.get_input_port(1))
    # The first states of the wires are their temperatures.
    wire_temperature = wire_state
    if wire_state.size() > num_wires:
        selection = builder.AddSystem(MatrixGain(np.eye(num_wires, wire_state.size())))
        builder.Connect(wire_state, selection.get_input_port())
        wire_temperature = selection.get_output_port()
    # Export the outputs.
    ports = {
        "measured_temperature": lag.get_output_port(),
        "bend_angle": bend.get_output_port(),
        "wire_temperature": wire_temperature,
        "joint_state": joint_state,
        "measurement": measurement.get_output_port(),
    }
    for name, port in ports.items():
        builder.ExportOutput(port, name)
    return ports | {"torque": torque_map.get_output_port()}, heating.get_input_port()
