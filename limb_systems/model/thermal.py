"""The heat of the wires: eqns (6) and (7), and (7) read backwards.

All wires share one block, in the order [left, right] of each segment. The
blocks are affine, so their dynamics run in Drake's C++ for every scalar type;
Drake names the ports of an AffineSystem ``u0`` and ``y0``.
"""

import numpy as np
from pydrake.systems.primitives import AffineSystem, LinearSystem

from limb_systems.model.parameters import LimbParameters


class JouleHeating(AffineSystem):
    """Wire temperature under Joule heating and convection, eqn (6).

        Ṫ = a1 (T - T0) + a2 D

    - state: T (wires), °C; T0 by default
    - input 0: duty D (wires), in [0, 1]
    - output 0: wire temperature T (wires), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.
        """
        a1 = np.array([wire.a1 for wire in parameters.wires])
        a2 = np.array([wire.a2 for wire in parameters.wires])
        num_wires, ambient = len(a1), parameters.ambient_temperature
        super().__init__(
            A=np.diag(a1),
            B=np.diag(a2),
            f0=-a1 * ambient,
            C=np.eye(num_wires),
            D=np.zeros((num_wires, num_wires)),
            y0=np.zeros(num_wires),
        )
        self.configure_default_state(np.full(num_wires, ambient))
        self.set_name("joule_heating")


class ThermocoupleLag(LinearSystem):
    """Temperature that the glued-on thermocouple measures, eqn (7).

        V̇ = a3 (V - T)

    - state: V (wires), °C; T0 by default
    - input 0: wire temperature T (wires), °C
    - output 0: measured temperature V (wires), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.
        """
        a3 = np.array([wire.a3 for wire in parameters.wires])
        num_wires = len(a3)
        super().__init__(
            A=np.diag(a3),
            B=-np.diag(a3),
            C=np.eye(num_wires),
            D=np.zeros((num_wires, num_wires)),
        )
        self.configure_default_state(np.full(num_wires, parameters.ambient_temperature))
        self.set_name("thermocouple_lag")


class InverseThermocoupleLag(AffineSystem):
    """Wire temperature from the measured one, V⁻¹ in Fig. 3: eqn (7) for T.

        T = V - V̇ / a3

    - input 0: [V, V̇] (2 * wires), °C and °C/s
    - output 0: wire temperature T (wires), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.
        """
        a3 = np.array([wire.a3 for wire in parameters.wires])
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
