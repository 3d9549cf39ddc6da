"""The heat of the wires as Drake systems: eqns (6) and (7), and (7) read backwards.

All wires share one block, whose dynamics are those of their laws. Where they
are affine, as the paper's are, the block is an `AffineSystem`, which runs in
Drake's C++ for every scalar type.
"""

from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import AffineSystem, Integrator

from limb_systems.model.law_function import LawFunction
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires


class JouleHeating(Diagram):
    """The states of the wires under Joule heating and convection, eqn (6).

        Ṫ = a1 (T - T0) + a2 D, or what the wires' laws say

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``wire_state``: x (N): T (W), °C, then what other states the
      laws have, as in `Wires`
    - state, continuous: x (N); that of wires that were never heated by default
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.
        """
        super().__init__()
        wires = Wires(parameters)
        A, B, _ = wires.affine_rates()
        _build_dynamics(self, ("duty", "wire_state"), wires, wires.rates, A, B, wires.cold_states)
        self.set_name("joule_heating")


class ThermocoupleLag(Diagram):
    """Temperature that the glued-on thermocouple measures, eqn (7).

        V̇ = a3 (V - T), or what the wires' laws say

    - input 0 ``wire_state``: x (N), as that of `JouleHeating`
    - output 0 ``measured_temperature``: V (W), °C
    - state, continuous: V (W), °C; T0 by default
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters, initial: np.ndarray | None = None):
        """
        Args:
            parameters: of the limb, for its wires.
            initial: V (W) of the default state, °C; T0 if None.
        """
        super().__init__()
        wires = Wires(parameters)
        if initial is None:
            initial = np.full(wires.num_wires, parameters.ambient_temperature)
        N, off = wires.num_states, np.zeros(wires.num_wires)
        heat = np.concatenate([wires.cold_states, initial])
        slopes = wires.heat_jacobian(heat, off).reshape(len(heat), -1)[N:]
        A, B = slopes[:, N : len(heat)], slopes[:, :N]
        names = ("wire_state", "measured_temperature")
        _build_dynamics(self, names, wires, wires.reading_rates, A, B, initial)
        self.set_name("thermocouple_lag")


def _build_dynamics(
    diagram: Diagram,
    names: tuple[str, str],
    wires: Wires,
    rates: Callable[[np.ndarray, np.ndarray], np.ndarray],
    A: np.ndarray,
    B: np.ndarray,
    initial: np.ndarray,
) -> None:
    """Makes an empty diagram a system whose output is its state.

    Args:
        names: of the input and of the output.
        rates: of the state, from the state and the input.
        A, B: derivatives of the rates by these, where they are affine.
        initial: default of the state.
    """
    builder, (size, num_inputs) = DiagramBuilder(), B.shape
    if wires.rates_are_affine:
        system = builder.AddSystem(
            AffineSystem(
                A=A,
                B=B,
                f0=rates(np.zeros(size), np.zeros(num_inputs)),
                C=np.eye(size),
                D=np.zeros_like(B),
                y0=np.zeros(size),
            )
        )
        system.configure_default_state(initial)
        builder.ExportInput(system.get_input_port(), names[0])
        builder.ExportOutput(system.get_output_port(), names[1])
    else:
        function = builder.AddSystem(LawFunction(rates, [size, num_inputs], size))
        integrator = builder.AddSystem(Integrator(np.asarray(initial, float)))
        builder.Connect(function.get_output_port(), integrator.get_input_port())
        builder.Connect(integrator.get_output_port(), function.get_input_port(0))
        builder.ExportInput(function.get_input_port(1), names[0])
        builder.ExportOutput(integrator.get_output_port(), names[1])
    builder.BuildInto(diagram)


class InverseThermocoupleLag(AffineSystem):
    """Wire temperature from the measured one, V⁻¹ in Fig. 3: eqn (7) for T.

        T = V - V̇ / a3

    For wires of the paper's law, `LinearLaw`.

    - input 0: [V, V̇] (2 * wires), °C and °C/s
    - output 0: wire temperature T (wires), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.

        Raises:
            ParameterError: if a wire has another law.
        """
        a3 = np.array([wire.linear_law.a3 for wire in parameters.wires])
        num_wires = len(a3)
        super().__init__(
            A=np.zeros((0, 0)),
            B=np.zeros((0, 2 * num_wires)),
            f0=np.zeros(0),
            C=np.zeros((num_wires, 0)),
            D=np.hstack([np.eye(num_wires), np.diag(-1 / a3)]),
            y0=np.zeros(num_wires),
        )
        self.set_name("inverse_thermocouple_lag")
