"""The heat of the wires as Drake systems: eqns (6) and (7), and (7) read backwards.

All wires share one block, made of their laws. The blocks here are for laws
whose heat is linear, as the paper's is: they are affine, so their dynamics run
in Drake's C++ for every scalar type. `LawDynamics` takes their place for other
laws. Drake names the ports of an AffineSystem ``u0`` and ``y0``.
"""

import numpy as np
from pydrake.systems.primitives import AffineSystem

from limb_systems.model.parameters import LimbParameters, ParameterError
from limb_systems.model.wires import Wires


class JouleHeating(AffineSystem):
    """The states of the wires under Joule heating and convection, eqn (6).

        Ṫ = a1 (T - T0) + a2 D

    - state: x (N): T (W), °C, then what other states the wires' laws have, as
      in `Wires`; that of wires that were never heated by default
    - input 0: duty D (W), in [0, 1]
    - output 0: x (N)
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.

        Raises:
            ParameterError: if the heat of a wire is not linear.
        """
        wires = _linear_wires(parameters)
        A, B, _ = wires.affine_rates()
        N, W = B.shape
        offset = wires.rates(np.zeros(N), np.zeros(W))
        super().__init__(A=A, B=B, f0=offset, C=np.eye(N), D=np.zeros((N, W)), y0=np.zeros(N))
        self.configure_default_state(wires.cold_states)
        self.set_name("joule_heating")


class ThermocoupleLag(AffineSystem):
    """Temperature that the glued-on thermocouple measures, eqn (7).

        V̇ = a3 (V - T)

    - state: V (W), °C; T0 by default
    - input 0: x (N) of the wires, which begins with T (W), °C
    - output 0: measured temperature V (W), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.

        Raises:
            ParameterError: if the heat of a wire is not linear.
        """
        wires = _linear_wires(parameters)
        N, W = wires.num_states, wires.num_wires
        slopes = wires.heat_jacobian(np.zeros(N + W), np.zeros(W))[N:]
        super().__init__(
            A=slopes[:, N : N + W],
            B=slopes[:, :N],
            f0=wires.reading_rates(np.zeros(W), np.zeros(N)),
            C=np.eye(W),
            D=np.zeros((W, N)),
            y0=np.zeros(W),
        )
        self.configure_default_state(np.full(W, parameters.ambient_temperature))
        self.set_name("thermocouple_lag")


def _linear_wires(parameters: LimbParameters) -> Wires:
    wires = Wires(parameters)
    if not wires.rates_are_affine:
        raise ParameterError(
            "The heat of a wire of this limb is not linear; use LawDynamics in place of "
            "JouleHeating and ThermocoupleLag."
        )
    return wires


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
