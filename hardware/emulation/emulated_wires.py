"""The emulated wires: heat in two masses, and the shape-memory law of eqn (3)."""

import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import InputPortIndex, LeafSystem

from hardware.emulation.specimen import Specimen, WirePhysics
from limb_systems.drake_python import declare_state_output, weak_method
from limb_systems.limb_model import LimbModel

# The wires' fastest rates are those of heating, some °C in a tenth of a second,
# and far below the limb's 4.6 Hz mode, which hardly feels smoothed steps at 20 Hz.
from limb_systems.simulation import PERIOD

LONGEST_STEP = 0.1  # s, of Euler's method
PWM_STEP = 1 / 255  # of a timer of eight bits


class ShapeMemoryWires(LeafSystem):
    """Wires with the physics that the model's eqns (4) and (6) approximate.

    Heat flows from the wire, T, to the silicone around it, S, and from there
    to the room:

        Ṫ = -c (T - S) + h D + L ξ̇
        Ṡ = d (T - S) - e (S - T_room)

    with the duty D in the steps of the PWM.

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
    the wire's lever that turns the joint, from where the wire runs in truth. A
    straight limb at the temperature of the room is free of torque. All this is
    integrated by Euler's method, at 20 Hz by default; while a limb rests, several of
    its steps are in a period, in which the strain changes evenly.

    - input 0 ``duty``: D (W), in [0, 1]
    - input 1 ``joint_state``: [θ, θ̇] (2n), rad and rad/s; only angles are used
    - output 0 ``generalized_force``: f (n), N·m
    - output 1 ``wire_temperature``: T (W), °C
    - output 2 ``state``: as below
    - output 3 ``applied_duty``: D (W) in the steps of the PWM
    - state, discrete: [T (W), S (W), ξ (W), ε (W)], °C, °C, 1 and 1
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, specimen: Specimen, period: float = PERIOD):
        """
        Args:
            specimen: the limb, with the state after its last use.
            period: s, after which they see duty and bend again, and show another torque.
        """
        super().__init__()
        self._num_steps = max(1, round(period / LONGEST_STEP))
        self._step_size = period / self._num_steps
        parameters, wires = specimen.description, specimen.wires
        num_wires, num_joints = len(wires), parameters.num_joints
        self._room, self._num_wires, self._num_joints = specimen.ambient, num_wires, num_joints
        self._wires = wires
        self._rates = [_heat_rates(w.fast_time, w.slow_time, w.silicone_share) for w in wires]
        mechanics = LimbModel.of(specimen.mechanics()).mechanics
        # φ towards the wire's own side is the mean angle that it sees on the links, over what
        # equal ones are for a bend of one, eqn (11).
        twice, links = np.empty((2, num_joints, 1))
        for chain, joints in mechanics.chains_with_joints:
            twice[joints], links[joints] = 2 / chain.equal_angle, len(chain.lengths)
        relief = mechanics.levers * [wire.strain_relief for wire in wires]
        self._strain = np.ascontiguousarray(-(relief * twice / (2 * links)).T)
        self._torque = mechanics.levers * [wire.torque for wire in wires]

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
        self.DeclareVectorOutputPort(
            "applied_duty",
            num_wires,
            weak_method(self._calc_duty),
            {self.input_port_ticket(InputPortIndex(0))},
        )

    def _step(self, context, discrete_state):
        strain = self._strain @ self.get_input_port(1).Eval(context)[: self._num_joints]
        duty, state = self.get_output_port(3).Eval(context).tolist(), self._state(context)
        change = ((strain - state[3]) / self._num_steps).tolist()
        for _ in range(self._num_steps):
            parts = self._wires, self._rates, duty, change, *state
            stepped = [self._after_step(*part) for part in zip(*parts, strict=True)]
            state = list(zip(*stepped, strict=True))
        discrete_state.set_value([number for row in state for number in row])

    # Numbers of one wire, because arrays of two take several times as long.
    def _after_step(
        self,
        wire: WirePhysics,
        rates: tuple[float, float, float],
        duty: float,
        change: float,
        temperature: float,
        silicone: float,
        martensite: float,
        strain_before: float,
    ) -> tuple[float, float, float, float]:
        """T, S, ξ and ε of a wire after a step from the latter four, in which ε changes."""
        to_silicone, from_wire, to_room = rates
        strain, strain_rate = strain_before + change, change / self._step_size

        # Without transformation T' would change at this rate, and its sign is that of Ṫ'.
        heating = wire.heating * duty - to_silicone * (temperature - silicone)
        softness = 1 - wire.modulus_ratio
        modulus = 1 - martensite * softness
        stress = self._stress(wire, temperature, martensite, strain)
        shifted = temperature - wire.stress_shift * stress
        free_share = 1 - wire.stress_shift * wire.expansion
        free_rate = free_share * heating - wire.stress_shift * modulus * strain_rate
        # ξ̇ = -κ Ṫ', and Ṫ' depends on ξ̇ in turn: by latent heat, and by stress.
        if free_rate > 0:
            curve = _logistic((shifted - wire.austenite) / wire.austenite_width)
            kappa = martensite * (1 - curve) / wire.austenite_width
        else:
            curve = _logistic((shifted - wire.martensite) / wire.martensite_width)
            kappa = (1 - martensite) * curve / wire.martensite_width
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

    def _state(self, context) -> Sequence[Sequence[float]]:
        """T, S, ξ and ε of all wires."""
        state = context.get_discrete_state_vector().value()
        return state.reshape(4, self._num_wires).tolist()

    def _stress(
        self, wire: WirePhysics, temperature: float, martensite: float, strain: float
    ) -> float:
        modulus = 1 - martensite * (1 - wire.modulus_ratio)
        return modulus * (strain + 1 - martensite) + wire.expansion * (temperature - self._room)

    def _calc_force(self, context, output):
        temperature, _, martensite, strain = self._state(context)
        parts = self._wires, temperature, martensite, strain
        stress = [self._stress(*part) for part in zip(*parts, strict=True)]
        output.SetFromVector(self._torque @ stress)

    def _calc_duty(self, context, output):
        duty = self.get_input_port(0).Eval(context)
        output.SetFromVector(PWM_STEP * np.rint(duty / PWM_STEP))


def _logistic(x: float) -> float:
    """1 / (1 + exp(x)), which does not overflow."""
    return 0.5 - 0.5 * math.tanh(0.5 * x)


def _heat_rates(fast_time: float, slow_time: float, share: float) -> tuple[float, float, float]:
    """c, d and e, 1/s, of a wire that cools with two time constants.

    In a lasting heat the silicone warms by ``share`` = d / (d + e) of the
    wire. The characteristic polynomial has c + d + e = p + q and
    c e = p q, where p, q are the rates 1/time.
    """
    rate_sum = 1 / fast_time + 1 / slow_time
    product = 1 / (fast_time * slow_time * (1 - share))
    silicone = (rate_sum - math.sqrt(rate_sum**2 - 4 * product)) / 2  # d + e, the slower root
    return rate_sum - silicone, share * silicone, (1 - share) * silicone
