"""The emulated wires: heat in two masses, and the shape-memory law of eqn (3)."""

import math

import numpy as np
from pydrake.systems.framework import LeafSystem

from hardware.emulation.specimen import Specimen, WirePhysics
from limb_systems.drake_python import declare_state_output, weak_method
from limb_systems.limb_model import LimbModel

# Heating is the wires' fastest rate, some °C in a tenth of a second. It is far below the limb's
# mode of 4.6 Hz, so that the limb does not respond to smoothed steps at 20 Hz.
from limb_systems.simulation import PERIOD

LONGEST_STEP = 0.1  # s, of Euler's method


class ShapeMemoryWires(LeafSystem):
    """Wires with the physics that the model's eqns (4) and (6) approximate.

    Heat flows from the wire, T, to the silicone around it, S, and from there
    to the room:

        Ṫ = -c (T - S) + h D + L ξ̇
        Ṡ = d (T - S) - e (S - T_room)

    with the duty D.

    The martensite fraction ξ follows the logistic curves of Ikuta, one for
    heating and one for cooling, in Duhem's form, whose memory is where heating
    and cooling changed. With T' = T - s τ, the temperature minus the shift by
    stress,

        ξ̇ = -ξ (1 - ξ_A(T')) / w_A Ṫ'   where T' rises
        ξ̇ = -(1 - ξ) ξ_M(T') / w_M Ṫ'   where it falls

    and ξ_A, ξ_M = 1 / (1 + exp((T' - T_A,M) / w_A,M)). The stress is eqn (3),
    in units of the stress of full transformation at constant strain:

        τ = G(ξ) (ε + 1 - ξ) + Θ (T - T_room),  G(ξ) = 1 - ξ (1 - G_M/G_A)

    with the strain ε = -r φ_own, which bending towards the wire's own side
    reduces. The torque on each joint of the segment is proportional to τ, and to the share of
    the wire's lever that turns the joint, at the wire's true place. A straight limb at the
    temperature of the room is free of torque. Euler's method integrates all this, at 20 Hz by
    default; while a limb rests, a period has several steps, in which the strain changes evenly.

    - input 0 ``duty``: D (W), in [0, 1]
    - input 1 ``joint_state``: [θ, θ̇] (2n), rad and rad/s; only angles are used
    - output 0 ``generalized_force``: f (n), N·m
    - output 1 ``wire_temperature``: T (W), °C
    - output 2 ``state``: as below
    - state, discrete: [T (W), S (W), ξ (W), ε (W)], °C, °C, 1 and 1
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, specimen: Specimen, period: float = PERIOD):
        """
        Args:
            specimen: the limb, with the state after its last use.
            period: s, after which duty, bend and torque are updated.
        """
        super().__init__()
        self._num_steps = max(1, round(period / LONGEST_STEP))
        self._step_size = period / self._num_steps
        self._room = specimen.ambient
        self._wires = wires = specimen.wires
        num_wires = len(wires)
        num_joints = specimen.description.num_joints
        self._rates = [_heat_rates(w.fast_time, w.slow_time, w.silicone_share) for w in wires]

        # Strain of each wire by the joint state (W, 2n), and torque of wires on the joints (n, W).
        # φ towards the wire's own side is the mean angle of the links, over the equal angles that
        # make a bend of one, eqn (11).
        mechanics = LimbModel.of(specimen.mechanics()).mechanics
        angle_factor = np.empty((num_joints, 1))
        num_links = np.empty((num_joints, 1))
        for chain, joints in mechanics.chains_with_joints:
            angle_factor[joints] = 2 / chain.equal_angle
            num_links[joints] = len(chain.lengths)
        relief = mechanics.levers * [wire.strain_relief for wire in wires]
        self._strain = np.zeros((num_wires, 2 * num_joints))
        self._strain[:, :num_joints] = -(relief * angle_factor / (2 * num_links)).T
        self._torque = mechanics.levers * [wire.torque for wire in wires]

        # Declare state, inputs and outputs; an unused limb is at the temperature of the room.
        room = np.full(num_wires, specimen.ambient)
        rest = np.concatenate([room, room, np.ones(num_wires), np.zeros(num_wires)])
        index = self.DeclareDiscreteState(specimen.state.get("wires", rest))
        self.DeclareVectorInputPort("duty", num_wires)
        self.DeclareVectorInputPort("joint_state", 2 * num_joints)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weak_method(self._step))
        tickets = {self.discrete_state_ticket(index)}
        self.DeclareVectorOutputPort(
            "generalized_force", num_joints, weak_method(self._calc_force), tickets
        )
        declare_state_output(self, "wire_temperature", index, slice(0, num_wires))
        self.DeclareStateOutputPort("state", index)

    def _step(self, context, discrete_state):
        duty = self.EvalVectorInput(context, 0).value().tolist()
        strain = (self._strain @ self.EvalVectorInput(context, 1).value()).tolist()
        state = context.get_discrete_state_vector().value().tolist()
        num_wires = len(self._wires)
        for index, wire in enumerate(self._wires):
            # T, S, ξ and ε of the wire.
            values = state[index::num_wires]
            strain_change = (strain[index] - values[3]) / self._num_steps
            for _ in range(self._num_steps):
                values = self._after_step(
                    wire, self._rates[index], duty[index], strain_change, *values
                )
            state[index::num_wires] = values
        discrete_state.set_value(state)

    # It takes the numbers of one wire, because arrays of two numbers take several times as long.
    def _after_step(
        self,
        wire: WirePhysics,
        rates: tuple[float, float, float],
        duty: float,
        strain_change: float,
        temperature: float,
        silicone: float,
        martensite: float,
        strain_before: float,
    ) -> tuple[float, float, float, float]:
        """Return T, S, ξ and ε of a wire after a step, from their values before it."""
        to_silicone, from_wire, to_room = rates
        strain = strain_before + strain_change
        strain_rate = strain_change / self._step_size

        # Without transformation T' changes at ``free_rate``, which has the sign of Ṫ'.
        heating = wire.heating * duty - to_silicone * (temperature - silicone)
        softness = 1 - wire.modulus_ratio
        modulus = 1 - martensite * softness
        stress = self._stress(wire, temperature, martensite, strain)
        shifted = temperature - wire.stress_shift * stress
        free_share = 1 - wire.stress_shift * wire.expansion
        free_rate = free_share * heating - wire.stress_shift * modulus * strain_rate
        # ξ̇ = -κ Ṫ' by the curve of heating or cooling.
        if free_rate > 0:
            curve = _logistic((shifted - wire.austenite) / wire.austenite_width)
            kappa = martensite * (1 - curve) / wire.austenite_width
        else:
            curve = _logistic((shifted - wire.martensite) / wire.martensite_width)
            kappa = (1 - martensite) * curve / wire.martensite_width
        # Ṫ' depends on ξ̇ in turn, through latent heat and stress.
        stress_by_martensite = -softness * (strain + 1 - martensite) - modulus
        feedback = free_share * wire.latent_heat - wire.stress_shift * stress_by_martensite
        martensite_rate = -kappa * free_rate / (1 + kappa * feedback)
        temperature_rate = heating + wire.latent_heat * martensite_rate
        silicone_rate = from_wire * (temperature - silicone) - to_room * (silicone - self._room)
        return (
            temperature + self._step_size * temperature_rate,
            silicone + self._step_size * silicone_rate,
            martensite + self._step_size * martensite_rate,
            strain,
        )

    def _stress(
        self, wire: WirePhysics, temperature: float, martensite: float, strain: float
    ) -> float:
        modulus = 1 - martensite * (1 - wire.modulus_ratio)
        return modulus * (strain + 1 - martensite) + wire.expansion * (temperature - self._room)

    def _calc_force(self, context, output):
        state = context.get_discrete_state_vector().value().tolist()
        stress = []
        for index, wire in enumerate(self._wires):
            temperature, _, martensite, strain = state[index :: len(self._wires)]
            stress.append(self._stress(wire, temperature, martensite, strain))
        output.SetFromVector(self._torque @ stress)


def _logistic(x: float) -> float:
    """Return 1 / (1 + exp(x)) without overflow."""
    return 0.5 - 0.5 * math.tanh(0.5 * x)


def _heat_rates(fast_time: float, slow_time: float, share: float) -> tuple[float, float, float]:
    """Return c, d and e, 1/s, of a wire that cools with two time constants.

    In a lasting heat the silicone warms by ``share`` = d / (d + e) of the
    wire. The characteristic polynomial has c + d + e = p + q and
    c e = p q, where p, q are the rates 1/time.
    """
    rate_sum = 1 / fast_time + 1 / slow_time
    product = 1 / (fast_time * slow_time * (1 - share))
    silicone = (rate_sum - math.sqrt(rate_sum**2 - 4 * product)) / 2  # d + e, the slower root
    return rate_sum - silicone, share * silicone, (1 - share) * silicone
