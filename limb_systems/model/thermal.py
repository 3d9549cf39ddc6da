"""The heat of the wires as Drake systems: eqns (6) and (7), and (7) read backwards.

All wires share one block. The dynamics are those of the wires' laws, written
out symbolically once, so that they run in Drake's C++ for every scalar type:
as an `AffineSystem` where they are affine, as the paper's are, and else as a
`SymbolicVectorSystem`.
"""

import numpy as np
from pydrake.symbolic import DecomposeAffineExpressions
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import (
    AffineSystem,
    Integrator,
    Multiplexer,
    SymbolicVectorSystem,
)

from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires, as_expressions, make_expressions


class JouleHeating(Diagram):
    """The states of the wires under Joule heating and convection, eqn (6).

        Ṫ = a1 (T - T0) + a2 D, or what the wires' laws say

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``wire_state``: x (N): T (W), °C, then what other states the
      laws have, as in `Wires`
    - state, continuous: x (N); by default that of wires that were never heated
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.
        """
        super().__init__()
        wires = Wires(parameters)
        state, duty = (
            make_expressions("x", wires.num_states),
            make_expressions("D", wires.num_wires),
        )
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            rates = wires.rates(state, duty)
        add_dynamics(self, state, duty, rates, wires.cold_states, ("duty", "wire_state"))
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
        readings = make_expressions("V", wires.num_wires)
        state = make_expressions("x", wires.num_states)
        with np.errstate(invalid="ignore"):
            rates = wires.reading_rates(readings, state)
        if initial is None:
            initial = np.full(wires.num_wires, parameters.ambient_temperature)
        add_dynamics(self, readings, state, rates, initial, ("wire_state", "measured_temperature"))
        self.set_name("thermocouple_lag")


def add_dynamics(
    diagram: Diagram,
    state: np.ndarray,
    inputs: np.ndarray,
    rates: np.ndarray,
    initial: np.ndarray,
    names: tuple[str, str],
) -> None:
    """Builds a diagram whose state is its output and has the given rates.

    Args:
        diagram: empty.
        state, inputs: variables, as `make_expressions` makes them.
        rates: expressions in these, one for each state.
        initial: default of the state.
        names: of the input and of the output.
    """
    builder = DiagramBuilder()
    symbols = [next(iter(v.GetVariables())) for v in (*state, *inputs)]
    rates, size = as_expressions(rates), len(state)
    try:
        matrix, offset = DecomposeAffineExpressions(rates, symbols)
    except RuntimeError:  # not affine
        function = builder.AddSystem(SymbolicVectorSystem(input=np.array(symbols), output=rates))
        join = builder.AddSystem(Multiplexer([size, len(inputs)]))
        integrator = builder.AddSystem(Integrator(np.asarray(initial, float)))
        builder.Connect(join.get_output_port(), function.get_input_port())
        builder.Connect(function.get_output_port(), integrator.get_input_port())
        builder.Connect(integrator.get_output_port(), join.get_input_port(0))
        entry, exit_ = join.get_input_port(1), integrator.get_output_port()
    else:
        system = builder.AddSystem(
            AffineSystem(
                A=matrix[:, :size],
                B=matrix[:, size:],
                f0=offset,
                C=np.eye(size),
                D=np.zeros((size, len(inputs))),
                y0=np.zeros(size),
            )
        )
        system.configure_default_state(initial)
        entry, exit_ = system.get_input_port(), system.get_output_port()
    builder.ExportInput(entry, names[0])
    builder.ExportOutput(exit_, names[1])
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
