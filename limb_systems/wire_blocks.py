"""All wires of a limb as Drake systems: heat (6), measurement (7) and torque (4).

Laws that are affine, as the paper's is, make affine blocks. Their dynamics run in
Drake's C++ for every scalar type. `LawDynamics` and `VectorFunction` take their place
for other laws. Drake's SymbolicVectorSystem would run these in C++, but it must
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

    - state: x (N): T (W), °C, then what other states the wires' laws have, as
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
        N, W = wires.num_states, wires.num_wires
        slopes = wires.heat.first(np.zeros(N + 2 * W))[1][N:]
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
        n = len(wires.levers)
        nothing, straight = np.zeros(wires.num_states), np.zeros(n)
        _, slopes = wires.force.first(np.concatenate([nothing, straight]))
        super().__init__(D=slopes[:, : wires.num_states], y0=wires.forces(nothing, straight))


def _affine(parameters: LimbParameters | LimbModel, property_name: str, what: str) -> Wires:
    wires = LimbModel.of(parameters).wires
    if not getattr(wires, property_name):
        raise ParameterError(
            f"The {what} of a wire of this limb is not linear; make_blocks makes the blocks of "
            "any limb."
        )
    return wires


@TemplateSystem.define("VectorFunction_", scope=sys.modules[__name__])  # to find it out takes 50 ms
def VectorFunction_(T: type) -> Any:
    """`VectorFunction` for the scalar type T: float, AutoDiffXd or Expression."""

    class Impl(LeafSystem_[T]):
        """Evaluates a function of its inputs.

        - inputs: vectors of the sizes that are given, in this order
        - output 0 ``value``: what the function returns for them
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
            ports = [
                self.DeclareVectorInputPort(f"u{index}", size)
                for index, size in enumerate(input_sizes)
            ]
            self.DeclareVectorOutputPort(
                "value",
                output_size,
                weak_method(self._calc),
                {self.input_port_ticket(port.get_index()) for port in ports},
            )

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
    """ẋ = f(x, u), with the state as its output.

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
        builder, size = DiagramBuilder(), len(initial)
        function = builder.AddSystem(VectorFunction(rates, [size, num_inputs], size))
        integrator = builder.AddSystem(Integrator(np.asarray(initial, float)))
        builder.Connect(function.get_output_port(), integrator.get_input_port())
        builder.Connect(integrator.get_output_port(), function.get_input_port(0))
        builder.ExportInput(function.get_input_port(1), "u")
        builder.ExportOutput(integrator.get_output_port(), "x")
        builder.BuildInto(self)


def make_blocks(parameters: LimbParameters | LimbModel) -> tuple[System, System, System]:
    """The blocks of heat, measurement and torque, affine if the wires' laws are."""
    model = LimbModel.of(parameters)
    wires = model.wires
    n = model.layout.num_joints
    heating: System
    lag: System
    torque_map: System
    if wires.rates_are_affine:
        heating, lag = JouleHeating(model), ThermocoupleLag(model)
    else:
        cold = wires.cold_states
        heating = LawDynamics(wires.rates, wires.num_wires, cold)
        lag = LawDynamics(wires.reading_rates, wires.num_states, cold[: wires.num_wires])
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
    """Adds the blocks of Fig. 3 about mechanics, and exports the outputs 0 to 4 of `Limb`.

    Args:
        builder: builder of the diagram that has the mechanics.
        parameters: the limb, or all limbs of a robot together.
        joint_state: [θ, θ̇] (2n) of the mechanics, rad and rad/s.

    Returns:
        Output ports by name, with ``torque`` on the joints (n), N·m, which is not exported; and
        the input port of the duty, which is neither connected nor exported.
    """
    model = LimbModel.of(parameters)
    layout = model.layout
    n, num_wires, num_bends = layout.num_joints, layout.num_wires, layout.num_bends
    heating, lag, torque_map = make_blocks(model)
    builder.AddNamedSystem("joule_heating", heating)
    builder.AddNamedSystem("thermocouple_lag", lag)
    builder.AddNamedSystem("torque_map", torque_map)
    bend = builder.AddNamedSystem(
        "bend_angle",
        VectorFunction(lambda state: model.mechanics.bend_angle(state[:n]), [2 * n], num_bends),
    )
    measurement = builder.AddSystem(Multiplexer([num_wires, num_bends]))
    wire_state = wire_temperature = heating.get_output_port()
    builder.Connect(wire_state, torque_map.get_input_port(0))
    builder.Connect(wire_state, lag.get_input_port())
    if torque_map.num_input_ports() > 1:
        builder.Connect(joint_state, torque_map.get_input_port(1))
    builder.Connect(joint_state, bend.get_input_port())
    builder.Connect(lag.get_output_port(), measurement.get_input_port(0))
    builder.Connect(bend.get_output_port(), measurement.get_input_port(1))
    if wire_state.size() > num_wires:
        first = builder.AddSystem(MatrixGain(np.eye(num_wires, wire_state.size())))
        builder.Connect(wire_state, first.get_input_port())
        wire_temperature = first.get_output_port()
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
