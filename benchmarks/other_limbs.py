"""An emulated limb that shares no law with `LimbTwin` nor with the model.

The physics "lumped" of `LimbTwin` and the model grew up together, so what works on it may work on
nothing else. The wires of an `OtherLimb` follow Liang and Rogers' cosine kinetics, with
heat that flows through three masses to a room by natural convection, a resistance that changes
with the phase, and thermocouples that lag twice; its body is one bending mode on a cubic
spring with a Maxwell element. Its numbers are ours, within what is published of such wires
and silicones. It is an emulation, and not a measurement of a limb.
"""

import math
import types
from collections.abc import Sequence

import numpy as np
import witness  # noqa: F401 (its physics)
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.trajectories import Trajectory

from hardware import LimbTwin
from hardware.emulation.sensors import Noise, SampledSensors, limb_sensors
from limb_systems import LimbParameters, simulate
from limb_systems.drake_python import weak_method
from limb_systems.limb_parameters import EmulatedLimb

OTHER = "other"
STEP = 0.005  # s, of the limb's own integration
SEED = 900_000  # of the first limb, far from seeds of `LimbTwin`
GRIP = 30.0  # stiffness of a hand over the limb's


class OtherLimb(Diagram):
    """A limb of another physics, with the ports and the attributes of `LimbTwin`.

    - input 0 ``duty``: D (2), in [0, 1]
    - output 0 ``measured_temperature``: V (2), °C
    - output 1 ``bend_angle``: φ (1), rad
    - output 2 ``measurement``: [V (2), φ (1)]
    - output 3 ``applied_duty``: D (2)
    - outputs 4 and 5, only if the truth is asked for: ``wire_temperature`` (2), °C, and
      ``joint_state`` [θ, θ̇] (2n), rad and rad/s, of equal joints
    """

    __slots__ = ()  # see limb_systems.drake_python

    real_time, accuracy = False, 1e-2

    def __init__(
        self,
        seed: int = 0,
        *,
        specimen: types.SimpleNamespace | None = None,
        hand: Trajectory | None = None,
        bend_rate: float = 20.0,
        truth: bool = False,
    ):
        """
        Args:
            seed: of the particular limb.
            specimen: the particular limb in its present state, in place of it.
            hand: bend angle over time, rad, to which a hand bends the limb.
            bend_rate: at which the bend sensor is read, Hz.
            truth: whether it shows what no sensor could.
        """
        super().__init__()
        self.specimen = specimen = specimen or draw(seed)
        self.parameters = LimbParameters()
        self.parameters.board = specimen.board
        self.source = f"limb of another physics, seed {specimen.seed}"
        builder = DiagramBuilder()
        # The name by which an emulated board finds the wires' temperature.
        body = builder.AddNamedSystem(
            "shape_memory_wires", _Body(specimen, self.parameters.num_joints, hand)
        )
        readings = limb_sensors(
            self.parameters,
            bend_rate,
            bend_response=lambda angle: specimen.sensor_gain * angle,
            bend_noise=[specimen.sensor_noise],
            bend_drift=[specimen.sensor_drift],
        )
        specimen.uses += 1
        noise = Noise(np.random.default_rng([8, specimen.seed, specimen.uses]))
        sensors = builder.AddSystem(SampledSensors(readings, noise))
        for name in ("measured_temperature", "bend_angle"):
            builder.Connect(body.GetOutputPort(name), sensors.GetInputPort(name))
        builder.ExportInput(body.GetInputPort("duty"), "duty")
        for name in ("measured_temperature", "bend_angle", "measurement"):
            builder.ExportOutput(sensors.GetOutputPort(name), name)
        builder.ExportOutput(body.GetOutputPort("applied_duty"), "applied_duty")
        if truth:
            for name in ("wire_temperature", "joint_state"):
                builder.ExportOutput(body.GetOutputPort(name), name)
        builder.BuildInto(self)

    def after_rest(
        self,
        pause: float = 0.0,
        *,
        gravity: Sequence[float] | None = None,
        payload: float | None = None,
        **options,
    ):
        """Return the same limb now, or after a pause, s, without heat; see `LimbTwin`.

        Gravity and payload do not bend it.
        """
        if pause > 0:
            simulate(OtherLimb(specimen=self.specimen, bend_rate=1.0), [0, 0], pause, sample_rate=1)
        return OtherLimb(specimen=self.specimen, **options)

    def without_cut_out(self, context) -> None:
        """Do nothing: this limb has no cut-out."""


def limb_of(physics: str, seed: int) -> LimbTwin | OtherLimb:
    """Return an emulated limb of a physics, `OTHER` among them."""
    return OtherLimb(seed) if physics == OTHER else LimbTwin(seed=seed, physics=physics)


def draw(seed: int) -> types.SimpleNamespace:
    """Return a particular limb, cold and at rest."""
    uniform = np.random.default_rng([7, seed]).uniform
    specimen = types.SimpleNamespace(
        seed=seed,
        board=EmulatedLimb(SEED + seed),
        ambient=25.0 + uniform(-3.0, 3.0),
        uses=0,  # of the sensors, each of which has noise of its own
        frequency=uniform(3.5, 6.0),  # Hz
        damping_ratio=uniform(0.08, 0.15),
        cubic=uniform(-0.1, 0.3),  # of the stiffness, per rad²
        maxwell=uniform(0.05, 0.2),  # of the stiffness
        maxwell_time=uniform(1.0, 8.0),  # s
        rest=np.deg2rad(uniform(-6.0, 6.0)),
        sensor_gain=uniform(0.97, 1.03),
        sensor_noise=np.deg2rad(uniform(0.1, 0.3)),
        sensor_drift=np.deg2rad(uniform(0.3, 1.0)),
        wires=[_draw_wire(uniform) for _ in range(2)],
    )
    room, states = specimen.ambient, []
    for _ in specimen.wires:
        # T, its two silicones, V before and after its second lag, ξ; where it turned, what was left
        # to transform over what was left of the whole branch; rising
        states.append([room, room, room, room, room, 1.0, 1.0, 0.0])
    specimen.state = [*np.ravel(states), specimen.rest, 0.0, specimen.rest]
    return specimen


def _draw_wire(uniform) -> types.SimpleNamespace:
    start = uniform(46.0, 58.0)
    back = uniform(30.0, 36.0)
    return types.SimpleNamespace(
        heating=uniform(16.0, 25.0),  # °C/s at full duty, as martensite
        resistance_drop=uniform(0.1, 0.2),  # share of the resistance that austenite lacks
        cooling=1 / uniform(10.0, 18.0),  # 1/s, of a wire 50 °C warmer than its silicone
        inner_share=uniform(0.06, 0.12),  # heat capacity over the inner silicone's
        outer_share=uniform(0.3, 0.6),  # inner over outer silicone
        inner_time=uniform(15.0, 30.0),  # s, from inner to outer silicone
        outer_time=uniform(80.0, 160.0),  # s, from outer silicone to the room
        lag=uniform(0.7, 1.8),  # s
        second_lag=uniform(0.1, 0.6),  # s
        latent=uniform(6.0, 16.0),  # °C, of a whole transformation
        austenite=(start, start + uniform(24.0, 34.0)),  # °C, where it begins and ends
        martensite=(back, back + uniform(20.0, 28.0)),  # °C, where it ends and begins
        shift=uniform(4.0, 12.0),  # °C, of all four by full stress
        bend=np.deg2rad(uniform(45.0, 60.0)),  # held by a wire that is all austenite
        relief=uniform(0.1, 0.3),  # share of its pull that is lost per rad towards its side
    )


class _Body(LeafSystem):
    """Wires and beam, with the ports of `OtherLimb` and without sensors."""

    __slots__ = ()

    def __init__(self, specimen: types.SimpleNamespace, num_joints: int, hand: Trajectory | None):
        super().__init__()
        self._specimen, self._num_joints, self._hand = specimen, num_joints, hand
        state = self.DeclareDiscreteState(list(specimen.state))
        self.DeclareVectorInputPort("duty", 2)
        self.DeclarePeriodicDiscreteUpdateEvent(4 * STEP, 0.0, weak_method(self._update))
        tickets = {self.discrete_state_ticket(state)}
        self.DeclareVectorOutputPort("measured_temperature", 2, self._showing(4), tickets)
        self.DeclareVectorOutputPort(
            "bend_angle",
            1,
            lambda context, output: output.SetFromVector([context.get_discrete_state(0)[16]]),
            tickets,
        )
        self.DeclareVectorOutputPort("wire_temperature", 2, self._showing(0), tickets)
        self.DeclareVectorOutputPort(
            "joint_state", 2 * num_joints, weak_method(self._joints), tickets
        )
        duty = self.input_port_ticket(self.get_input_port(0).get_index())
        self.DeclareVectorOutputPort("applied_duty", 2, weak_method(self._applied), {duty})

    @staticmethod
    def _showing(part: int):
        return lambda context, output: output.SetFromVector(
            [context.get_discrete_state(0)[8 * wire + part] for wire in (0, 1)]
        )

    def _joints(self, context, output):
        state = context.get_discrete_state(0)
        one = 2 / (self._num_joints + 1)  # of a chain of equal joints, by the chord's angle
        output.SetFromVector(np.repeat([one * state[16], one * state[17]], self._num_joints))

    def _applied(self, context, output):
        output.SetFromVector(np.clip(self.get_input_port(0).Eval(context), 0.0, 1.0))

    def _update(self, context, after):
        values = context.get_discrete_state_vector().value().tolist()
        duty = np.clip(self.get_input_port(0).Eval(context), 0.0, 1.0).tolist()
        specimen, now = self._specimen, context.get_time()
        left, right, beam = values[:8], values[8:16], values[16:]
        held = self._hand is not None and now < self._hand.end_time()
        wanted = self._hand.value(now).item() if held else None
        for _ in range(4):
            pulls = [
                _heat(wire, state, D, side * beam[0], specimen.ambient)
                for wire, state, D, side in zip(
                    specimen.wires, (left, right), duty, (-1, 1), strict=True
                )
            ]
            _bend(specimen, beam, pulls[1] - pulls[0], wanted)
        specimen.state = [*left, *right, *beam]
        after.set_value(specimen.state)


def _heat(
    wire: types.SimpleNamespace, state: list[float], duty: float, bend: float, room: float
) -> float:
    """Advance a wire by a step, and return the bend that its pull would hold, rad."""
    T, inner, outer, first, second, xi, turned, rising = state
    austenite = 1 - xi
    pull = austenite * (1 - wire.relief * bend)
    to_inner = wire.cooling * ((abs(T - inner) + 5.0) / 55.0) ** 0.25 * (T - inner)
    to_outer = (inner - outer) / wire.inner_time
    to_room = (outer - room) / wire.outer_time * ((abs(outer - room) + 2.0) / 20.0) ** 0.25
    free = wire.heating * (1 - wire.resistance_drop * austenite) * duty - to_inner
    # Kinetics by the temperature that stress has shifted. What is left to transform where the wire
    # turns is spread over the rest of the branch, so that minor loops have no jumps.
    shifted = T - wire.shift * pull
    begin, end = wire.austenite if free > 0 else wire.martensite
    x = min(1.0, max(0.0, (shifted - begin) / (end - begin)))
    left = (1 + math.cos(math.pi * x)) / 2 if free > 0 else (1 - math.cos(math.pi * x)) / 2
    if (free > 0) != (rising > 0):
        rising, turned = float(free > 0), (xi if free > 0 else 1 - xi) / max(left, 1e-3)
    change = min(0.0, turned * left - xi) if free > 0 else max(0.0, 1 - turned * left - xi)
    change = math.copysign(min(abs(change), 0.5 * STEP), change)  # no faster than in two seconds
    state[:] = [
        T + STEP * free + wire.latent * change,
        inner + STEP * (wire.inner_share * to_inner - to_outer),
        outer + STEP * (wire.outer_share * to_outer - to_room),
        first + STEP * (T - first) / wire.lag,
        second + STEP * (first - second) / wire.second_lag,
        xi + change,
        turned,
        rising,
    ]
    return wire.bend * pull


def _bend(
    specimen: types.SimpleNamespace, beam: list[float], pull: float, wanted: float | None
) -> None:
    """Advance the bending mode by a step."""
    angle, rate, dashpot = beam
    omega = 2 * math.pi * specimen.frequency
    away = angle - specimen.rest
    force = pull - away * (1 + specimen.cubic * away**2) - specimen.maxwell * (angle - dashpot)
    damping = 2 * specimen.damping_ratio * omega
    if wanted is not None:
        force += GRIP * (wanted - angle)
        damping += omega * math.sqrt(GRIP)
    rate = (rate + STEP * omega**2 * force) / (1 + STEP * damping)
    beam[:] = [
        angle + STEP * rate,
        rate,
        dashpot + STEP * (angle - dashpot) / specimen.maxwell_time,
    ]
