"""The true properties of one emulated limb, which planner and calibration must not see.

A seed draws a `Specimen` around a description of its kind. Each draw is uniform
within a range that is listed below with its source; "ours" marks ranges without
a published source, chosen for the effects that the paper reports. No range was
fitted to make the model look good or bad.

Sources:

- [paper] Wertz, Sabelhaus, Majidi: trajectory optimization for thermally
  actuated soft planar robot limbs, Secs. III, VII and VIII.
- [records] Published recordings of SMA limbs of this family: a1 from -0.04 to
  -0.07 1/s, a lag or dead time of 0.8 to 2.5 s and of up to 9 s in one wire,
  cooling of two exponentials of 11-19 s and 78-134 s, loops of bend against
  measured temperature that are up to 14-20° wide, an angle at rest that moves
  by 1-4° with the wire that was hot last.
- [Ikuta] Ikuta, Tsukamoto, Hirose: Mathematical model and experimental
  verification of shape memory alloy for designing micro actuator, MEMS 1991:
  martensite fraction as logistic curves with hysteresis.
- [Cheng] Cheng, Kim, Desai: Modeling and characterization of shape memory
  alloy springs with water cooling strategy in a neurosurgical robot, 2017, the
  paper's [29]: eqn (3), whose Ω(ξ) is minus the recoverable strain times G(ξ).
- [An] An, Ryu, Cho, Cho: Engineering design framework for a shape memory alloy
  coil spring actuator using a static two-state model, 2012: shear moduli of
  martensite and austenite.
- [Flexinol] Dynalloy: Technical characteristics of Flexinol actuator wires:
  hysteresis of 10 to 20 °C and more, latent heat 24 kJ/kg at 0.84 kJ/(kg °C).
"""

import copy
import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np

from hardware.emulation.sensors import Noise
from limb_systems import (
    EmulatedLimb,
    LimbError,
    LimbModel,
    LimbParameters,
    LinearLaw,
    NoBoard,
    WireLaw,
    joint_angles_from_bend_angle,
)
from limb_systems.bend_sensor import roll_bends
from limb_systems.limb_parameters import BoardIdentity, SegmentParameters

EFFECTS = ("hysteresis", "silicone", "stress", "rubber", "bend sensor", "places")
EXTRA_EFFECTS = ("memory", "bond")  # only on request
# Changes of a limb, with their neutral values.
DISTURBANCES = {
    "ambient": 0.0,
    "payload": 0.0,
    "payload_e3": 0.0,
    "stiffness": 1.0,
    "cooling": 1.0,
    "supply": 1.0,
    "noise": 1.0,
}


@dataclasses.dataclass(frozen=True)
class WirePhysics:
    """The physics of one wire, the silicone around it and its thermocouple.

    - ``heating``: heating rate at full duty, °C/s.
    - ``fast_time``, ``slow_time``: time constants of cooling, s.
    - ``silicone_share``: steady temperature rise of the silicone over the wire's.
    - ``lag_rate``: rate of the thermocouple's lag, 1/s, negative.
    - ``latent_heat``: heat of the transformation, as °C of the wire.
    - ``austenite``, ``martensite``: temperature at which half of the wire is
      transformed on heating and on cooling, free of stress, °C.
    - ``austenite_width``, ``martensite_width``: widths of the logistic curves, °C.
    - ``stress_shift``: shift of both curves upwards at full stress, °C.
    - ``torque``: torque of the fully transformed wire on each joint when the limb is
      held straight, N·m.
    - ``modulus_ratio``: G of martensite over G of austenite.
    - ``strain_relief``: recoverable strain that is lost by bending one radian
      towards the wire.
    - ``expansion``: Θ of (3) over the stress of full transformation, 1/°C.
    - ``bond_time``: time constant of the thermocouple's lag if it is badly bonded, s, in place of
      ``lag_rate``; 0 for a good bond.
    - ``misplaced``: angle about E1 from the described to the true place, rad.
    """

    heating: float
    fast_time: float
    slow_time: float
    silicone_share: float
    lag_rate: float
    latent_heat: float
    austenite: float
    martensite: float
    austenite_width: float
    martensite_width: float
    stress_shift: float
    torque: float
    modulus_ratio: float
    strain_relief: float
    expansion: float
    bond_time: float = 0.0
    misplaced: float = 0.0


@dataclasses.dataclass(frozen=True)
class SegmentPhysics:
    """The physics of one segment's rubber and its bend sensor.

    - ``stiffness``: k of each joint when bent slowly, N·m/rad.
    - ``damping``: σ of each joint, N·m·s/rad.
    - ``stiffening``: share that is added to k where the segment bends by 45°.
    - ``viscous_share``: additional share of k in fast motions.
    - ``relaxation_time``: time constant with which this share decays, s.
    - ``rest_offset``: offset of the bend angle at rest from the described one, rad.
    - ``sensor_gain``, ``sensor_offset``: slope and reading, rad, of the bend sensor at zero.
    - ``sensor_curvature``: share of the reading that is lost or gained at 45°.
    - ``sensor_noise``, ``sensor_drift``: standard deviations, rad.
    - ``memory_angle``: angle at rest, towards the wire that was hot last, to which it is
      drawn, rad.
    - ``memory_share``: λ of a whole transformation, see `RestShift`.

    In addition, for a segment that bends about two axes:

    - ``stiffness_ratio``: stiffness against bends towards E3 over k.
    - ``rest_offset_e3``, ``sensor_gain_e3``, ``sensor_offset_e3``, ``sensor_curvature_e3``: as
      above, for the bend towards E3.
    - ``sensor_roll``: angle about E1 from E2 to the sensor's first axis, rad.
    """

    stiffness: float
    damping: float
    stiffening: float
    viscous_share: float
    relaxation_time: float
    rest_offset: float
    sensor_gain: float
    sensor_offset: float
    sensor_curvature: float
    sensor_noise: float
    sensor_drift: float
    memory_angle: float = 0.0
    memory_share: float = 0.0
    stiffness_ratio: float = 1.0
    rest_offset_e3: float = 0.0
    sensor_gain_e3: float = 1.0
    sensor_offset_e3: float = 0.0
    sensor_curvature_e3: float = 0.0
    sensor_roll: float = 0.0


class Specimen:
    """A particular limb: its physics, and its state after the last use.

    - ``description``: `LimbParameters`, as a lab knows them before calibration.
    - ``seed``: seed of the draw.
    - ``wires``: `WirePhysics` (W), in the order of the description.
    - ``segments``: `SegmentPhysics` (S).
    - ``ambient``: temperature of the room, °C.
    - ``state``: state of each part of the emulation after its last run, by name;
      empty for a limb that was never used.
    - ``noise``: numbers of the sensors' noise; the state has the count of used numbers.
    - ``extra``: effects in addition to the effects of every limb.
    - ``absent``: effects that were taken out, see `without`.
    - ``disturbances``: changes, see `disturbed`.
    - ``around_calibrated``: whether it was drawn around a calibrated limb, as another limb.

    A new specimen is unused: its wires are cold, its rubber is at rest, and its
    noise is at the beginning.

    - ``physics``: name of the physics, "lumped" or your own name in `SPECIMENS`.
    - ``build``: method of a subclass with other physics; None for the lumped physics. It takes a
      builder, ``hand``, ``bend_rate``, ``wire_period`` and ``truth``, adds the limb's systems and
      exports the ports of `LimbTwin`.
    - ``rest_period``: longest step of a rest without heat, s.
    - ``effects``, ``extra_effects``: effects that can be taken out, and added on request.
    """

    kind: type[Any] = LimbParameters  # class of the description
    physics = "lumped"
    rest_period = 1.0
    effects: tuple[str, ...] = EFFECTS
    extra_effects: tuple[str, ...] = EXTRA_EFFECTS
    build: Callable[..., None] | None = None
    wires: list[Any]
    segments: list[Any]

    def __init__(self, description: LimbParameters, seed: int, extra: Sequence[str] = ()):
        """
        Args:
            description: parameters around which it is drawn.
            seed: seed of the draw, which does not depend on ``extra``.
            extra: any of

                - "memory": the angle at rest moves by some degrees towards the
                  wire that was hot last;
                - "bond": in one wire of ten, the thermocouple is badly bonded and
                  lags by 3 to 9 s.

        Raises:
            LimbError: if the seed is negative, an effect is unknown, or a law has no
                `WireLaw.typical_rates`.
        """
        # Check the arguments, and describe the limb as one without board and calibration.
        description.validate()
        _check_effects(extra, self.extra_effects)
        if seed < 0:
            raise LimbError(f"The seed of an emulated limb is {seed}; it must be zero or more.")
        self.description = copy.deepcopy(description)
        self.around_calibrated = description.calibration is not None
        self.description.board = NoBoard()
        self.description.calibration = None
        is_nominal = self.description == LimbParameters()
        self._drawn_around = "" if is_nominal else self.description.to_yaml()
        self.seed = seed
        self.extra = tuple(extra)
        self.absent: tuple[str, ...] = ()
        self.disturbances: dict[str, float] = {}
        self.state: dict[str, np.ndarray] = {}
        # Draw it. Each group of numbers has a seed of its own, which no other group changes.
        draw_seed, noise_seed, extra_seed, space_seed = np.random.SeedSequence(seed).spawn(4)
        self.noise = Noise(np.random.default_rng(noise_seed))
        self._draw(np.random.default_rng(draw_seed).uniform, extra_seed)
        self._draw_in_space(np.random.default_rng(space_seed).uniform)

    def _draw(self, uniform, extra_seed: np.random.SeedSequence) -> None:
        """Draw the limb from a generator's uniform numbers, and the effects on request."""
        description = self.description
        self.segments = [_draw_segment(uniform, segment) for segment in description.segments]
        self.wires = [_draw_wire(uniform, wire.law, description) for wire in description.wires]
        self.ambient = description.ambient_temperature + uniform(-3.0, 3.0)  # °C, ours
        # The ranges are from [records], the frequency of bad bonds is ours. All numbers are drawn
        # in any case, so that an effect does not change the numbers of another.
        uniform = np.random.default_rng(extra_seed).uniform
        for index, segment in enumerate(self.segments):
            angle = np.deg2rad(uniform(0.75, 2.0))
            share = uniform(1.1, 2.6)
            if "memory" in self.extra:
                memory = {"memory_angle": angle, "memory_share": share}
                self.segments[index] = dataclasses.replace(segment, **memory)
        for index, wire in enumerate(self.wires):
            is_bad = uniform(0.0, 1.0) < 0.1
            time = uniform(3.0, 9.0)
            if "bond" in self.extra and is_bad:
                self.wires[index] = dataclasses.replace(wire, bond_time=time)

    def _draw_in_space(self, uniform) -> None:
        """Draw the numbers that only segments of two axes have."""
        layout = LimbModel.of(self.description).layout
        for number, described in enumerate(self.description.segments):
            if described.axes != 2:
                continue
            drawn = self._draw_second_axis(uniform, described)
            self.segments[number] = dataclasses.replace(self.segments[number], **drawn)
            for index in range(layout.num_wires)[layout.wires_of[number]]:
                # 4° of standard deviation, ours: wires are laid into the mould by hand
                misplaced = np.deg2rad(uniform(-7.0, 7.0))
                self.wires[index] = dataclasses.replace(self.wires[index], misplaced=misplaced)

    def _draw_second_axis(self, uniform, segment: SegmentParameters) -> dict[str, float]:
        """Return the numbers of `SegmentPhysics` that only a segment of two axes has."""
        sensor = segment.bend_sensor
        return {
            # Width and thickness are cast to 1%, and their ratio counts squared; ours.
            "stiffness_ratio": segment.stiffness_ratio * uniform(0.97, 1.03),
            "rest_offset_e3": np.deg2rad(uniform(-2.0, 2.0)),  # as towards E2
            "sensor_gain_e3": sensor.gain * uniform(0.97, 1.03),
            "sensor_curvature_e3": uniform(-0.03, 0.03),
            "sensor_offset_e3": sensor.offset_e3,
            "sensor_roll": np.deg2rad(uniform(-5.0, 5.0)),  # ours, glued on by eye
        }

    @classmethod
    def of(cls, board: EmulatedLimb) -> Self:
        """Return the limb with an identity, unused.

        Raises:
            LimbError: if the identity is invalid.
        """
        text = board.description
        description = cls.kind.from_yaml(text) if text else cls.kind()
        specimen = cls(description, board.seed, board.extra).without(*board.absent)
        return specimen.disturbed(**dict(map(_parse_disturbance, board.disturbances)))

    @property
    def board(self) -> Any:
        """The limb's identity, an `EmulatedLimb` from which `of` makes it again."""
        changes = [f"{name} {value!r}" for name, value in self.disturbances.items()]
        effects = list(self.absent), list(self.extra)
        return EmulatedLimb(self.seed, self._drawn_around, *effects, changes, physics=self.physics)

    @property
    def label(self) -> str:
        """A text that identifies it among limbs of its kind: seed, effects and changes."""
        names = [f"seed {self.seed}", *(f"with {name}" for name in self.extra)]
        names += [f"without {name}" for name in self.absent]
        names += [f"{name} changed by {value:.4g}" for name, value in self.disturbances.items()]
        names += ["not the calibrated one"] * self.around_calibrated
        names += [f"physics {self.physics}"] * (self.physics != "lumped")
        return ", ".join(names)

    def without(self, *effects: str) -> Self:
        """Return this limb in its present state, with the same noise, without some effects.

        Args:
            effects: any of

                - "hysteresis": heating and cooling follow one curve, midway;
                - "silicone": the second thermal mass stays at the temperature
                  of the room;
                - "stress": there is no latent heat, and stress and strain do not
                  change the transformation; torque is an S-curve of temperature;
                - "rubber": it is linear, and rests at the described angle;
                - "bend sensor": it reads α/2, or the chord's angle, exactly, except
                  for its steps;
                - "places": wires of limbs that bend about two axes are at the described places;
                - "memory", "bond": effects on request.

        Raises:
            LimbError: if an effect is unknown.
        """
        _check_effects(effects, self.effects + self.extra_effects)
        specimen = copy.deepcopy(self)
        for effect in effects:
            if effect == "hysteresis":
                specimen.wires = list(map(_without_hysteresis, specimen.wires))
            # Set the fields of wires and segments to their values without the effect.
            wire_changes = dict.fromkeys(_WIRES_WITHOUT.get(effect, ()), 0.0)
            if effect == "stress":
                wire_changes["modulus_ratio"] = 1.0
            specimen.wires = _with_changes(specimen.wires, wire_changes)
            segment_changes = dict.fromkeys(_SEGMENTS_WITHOUT.get(effect, ()), 0.0)
            if effect == "bend sensor":
                segment_changes |= {"sensor_gain": 1.0, "sensor_gain_e3": 1.0}
            specimen.segments = _with_changes(specimen.segments, segment_changes)
        specimen.absent += effects
        return specimen

    def with_noise(self, *numbers: int) -> Self:
        """Return this limb in its present state, with a sensor noise seeded by the numbers."""
        specimen = copy.copy(self)
        specimen.noise = Noise(np.random.default_rng([self.seed, *numbers]))
        specimen.state = self.state | {"draws": np.zeros(1)} if self.state else {}
        return copy.deepcopy(specimen)

    def disturbed(self, **changes: float) -> Self:
        """Return this limb in its present state, with the same noise, after changes.

        It has rested after the changes: its temperatures move with the room, and its joints with
        the payload.

        Args:
            changes: any of

                - "ambient": rise of the room's temperature, °C;
                - "payload", "payload_e3": bend of the rubber alone by a constant torque on all
                  joints, rad, towards E2 and E3; cold wires hold back a tenth of it;
                - "stiffness": factor of the rubber's k;
                - "cooling": factor of the rates at which wires and silicone cool, as by a fan;
                - "supply": factor of the heat for the same duty;
                - "noise": factor of the bend sensors' noise.

        Raises:
            LimbError: if a change is unknown, a factor is not a positive number, or the limb was
                disturbed before or cannot bend towards E3.
        """
        # Check the changes.
        for name, value in changes.items():
            if name not in DISTURBANCES:
                raise LimbError(f"{name!r} is not one of the changes {', '.join(DISTURBANCES)}.")
            if not np.isfinite(value) or (DISTURBANCES[name] and value <= 0):
                raise LimbError(f"{name} of a limb is changed by {value!r}, which makes no sense.")
        if changes and self.disturbances:
            raise LimbError("This limb is disturbed already; disturb the original by both at once.")
        if "payload_e3" in changes and LimbModel.of(self.description).layout.is_planar:
            raise LimbError("A limb that bends in a plane takes no payload_e3; give it a payload.")
        # Change a copy of this limb, and its state.
        specimen = copy.deepcopy(self)
        given = {name: float(value) for name, value in changes.items()}
        change = DISTURBANCES | given
        specimen.disturbances = self.disturbances | given
        specimen.ambient += change["ambient"]
        specimen._change(change)
        specimen._move_state(change["ambient"], specimen.rest_angles() - self.rest_angles())
        return specimen

    def _change(self, change: dict[str, float]) -> None:
        """Change wires and segments by all of `DISTURBANCES`."""
        self.wires = [
            dataclasses.replace(
                wire,
                heating=wire.heating * change["supply"],
                fast_time=wire.fast_time / change["cooling"],
                slow_time=wire.slow_time / change["cooling"],
            )
            for wire in self.wires
        ]
        self.segments = [
            dataclasses.replace(
                segment,
                stiffness=segment.stiffness * change["stiffness"],
                # A constant torque on a spring changes the angle at rest.
                rest_offset=segment.rest_offset + change["payload"] / change["stiffness"],
                rest_offset_e3=segment.rest_offset_e3 + change["payload_e3"] / change["stiffness"],
                sensor_noise=segment.sensor_noise * change["noise"],
            )
            for segment in self.segments
        ]

    def _move_state(self, warmer: float, bent: np.ndarray) -> None:
        """Add to the temperatures, °C, and the joint angles (n,), rad, of a used limb."""
        if not self.state:
            return
        state = self.state
        # The first half of the wires' state is T and S, then come ξ and ε.
        is_temperature = np.arange(len(state["wires"])) < 2 * len(self.wires)
        self.state = state | {
            "wires": state["wires"] + warmer * is_temperature,
            "measured": state["measured"] + warmer,
            "joints": state["joints"] + np.append(bent, np.zeros(len(bent))),
            "rubber": state["rubber"] + bent,
        }

    def rest_angles(self) -> np.ndarray:
        """Return joint angles of the unused limb at rest (n,), rad, by eqn (11)."""
        rest_bends = []
        for described, segment in zip(self.description.segments, self.segments, strict=True):
            rest_bends.append(described.rest_angle + segment.rest_offset)
            if described.axes == 2:
                rest_bends.append(described.rest_angle_e3 + segment.rest_offset_e3)
        return joint_angles_from_bend_angle(self.description, rest_bends)

    def places(self) -> np.ndarray:
        """Return the true places of the wires (W, 2), m along E2 and E3."""
        described = np.array([[wire.e2, wire.e3] for wire in self.description.wires])
        return roll_bends(described.T, [-wire.misplaced for wire in self.wires]).T

    def mechanics(self) -> LimbParameters:
        """Return parameters of the linear part: true k, σ, places of wires, ambient and lag.

        Gravity is as described. The springs are free of torque at the described angle at rest.
        """
        parameters = copy.deepcopy(self.description)
        parameters.ambient_temperature = self.ambient
        for segment, physics in zip(parameters.segments, self.segments, strict=True):
            segment.stiffness = physics.stiffness
            segment.damping = physics.damping
            segment.stiffness_ratio = physics.stiffness_ratio
            # Other systems have the nonlinear effects of the rubber.
            segment.stiffening = 0.0
            segment.rest_memory = None
        places = self.places().tolist()
        for wire, drawn, place in zip(parameters.wires, self.wires, places, strict=True):
            wire.law = LinearLaw(a3=-1 / drawn.bond_time if drawn.bond_time else drawn.lag_rate)
            wire.e2, wire.e3 = place
        return parameters


def emulated_limb(board: BoardIdentity) -> EmulatedLimb | None:
    """Return the emulated limb of a board, by its serial number; None for a real board.

    Limbs that are calibrated through the port of an emulated board have its number, like limbs on
    a robot.

    Raises:
        LimbError: if the number is an emulated board's, but does not identify the limb.
    """
    if isinstance(board, EmulatedLimb):
        return board
    if match := re.fullmatch(r"twin(\d{4})", board.identity):
        return EmulatedLimb(int(match[1]))
    if re.fullmatch(r"t[0-9a-f]{7}", board.identity):
        raise LimbError(
            f"The emulated limb {board.identity} was calibrated through its port, and its number "
            "does not tell which one it is; emulate it again and give its port."
        )
    return None


def _check_effects(effects: Sequence[str], choices: Sequence[str]) -> None:
    for effect in effects:
        if not choices:
            raise LimbError(
                f"A limb of this physics has no effect {effect!r}, nor any other choice."
            )
        if effect not in choices:
            raise LimbError(f"{effect!r} is not one of the effects {', '.join(choices)}.")


def _parse_disturbance(text: str) -> tuple[str, float]:
    """Return name and value of an entry of `EmulatedLimb.disturbances`."""
    try:
        name, value = text.split()
        return name, float(value)
    except ValueError:
        raise LimbError(
            f"{text!r} of an emulated limb's disturbances is not a name and a number."
        ) from None


def _draw_wire(uniform, law: WireLaw, description: LimbParameters) -> WirePhysics:
    """Return a wire drawn around a law's torque at T_max and its rates of heat."""
    rates = law.typical_rates()
    ambient = description.ambient_temperature
    time = 1 / rates["fastest_cooling"]
    hot = law.warm_states(description.temperature_limits.maximum, ambient)
    austenite = uniform(58.0, 66.0)  # °C, ours: motion begins below T_warm [paper, VIII-B]
    return WirePhysics(
        heating=rates["heating"] * uniform(0.85, 1.15),  # ours: supply, resistance, coil
        fast_time=time * uniform(0.8, 1.35),  # 11-19 s for the nominal 14 s [records]
        slow_time=time * uniform(5.5, 9.4),  # 79-134 s [records]
        silicone_share=uniform(0.20, 0.35),  # ours
        lag_rate=-rates["reading"] * uniform(0.5, 1.2),  # 0.8 to 2 s [records]
        latent_heat=uniform(8.0, 20.0),  # below [Flexinol]'s 29 °C: epoxy and silicone share heat
        austenite=austenite,
        martensite=austenite - uniform(8.0, 14.0),  # hysteresis [Flexinol], [records]
        austenite_width=uniform(9.0, 13.0),  # ours: saturates towards T_max
        martensite_width=uniform(6.0, 9.0),  # ours
        stress_shift=uniform(5.0, 12.0),  # 70-170 MPa at 7-14 MPa/°C [Flexinol], [Cheng]
        torque=float(law.torque(hot, ambient, 0.0)) * uniform(0.9, 1.1),  # ours: the sides differ
        modulus_ratio=uniform(0.35, 0.5),  # 7.5 of 18 GPa [An]
        strain_relief=uniform(0.10, 0.20),  # ours: 3.4 mm off axis, stretched by 50 mm
        expansion=-uniform(2e-4, 6e-4),  # small, as the paper assumes [Cheng]
    )


def _draw_segment(uniform, segment) -> SegmentPhysics:
    """Return rubber and bend sensor drawn around `SegmentParameters`."""
    sensor = segment.bend_sensor
    return SegmentPhysics(
        stiffness=segment.stiffness * uniform(0.9, 1.1),  # 2° of 10° between trials [paper, VIII-B]
        damping=segment.damping * uniform(0.8, 1.25),  # ours
        stiffening=uniform(0.03, 0.15),  # ours, silicone at strains below 15%
        viscous_share=uniform(0.05, 0.15),  # ours
        relaxation_time=uniform(0.5, 4.0),  # s, ours
        rest_offset=np.deg2rad(uniform(-2.0, 2.0)),  # ours
        sensor_gain=sensor.gain * uniform(0.97, 1.03),  # with the sensors' noise and drift the
        sensor_curvature=uniform(-0.03, 0.03),  # 2° that the paper saw in use [paper, VII]
        sensor_offset=sensor.offset,
        sensor_noise=sensor.noise,
        sensor_drift=sensor.drift,
    )


def _with_changes(parts: Sequence[Any], changes: dict[str, float]) -> list[Any]:
    return [dataclasses.replace(part, **changes) for part in parts]


def _without_hysteresis(wire: WirePhysics) -> WirePhysics:
    middle = (wire.austenite + wire.martensite) / 2
    width = (wire.austenite_width + wire.martensite_width) / 2
    return dataclasses.replace(
        wire,
        austenite=middle,
        martensite=middle,
        austenite_width=width,
        martensite_width=width,
    )


# Fields that are zero without an effect.
_WIRES_WITHOUT = {
    "silicone": ["silicone_share"],
    "stress": ["latent_heat", "stress_shift", "strain_relief", "expansion"],
    "bond": ["bond_time"],
    "places": ["misplaced"],
}
_SEGMENTS_WITHOUT = {
    "memory": ["memory_angle", "memory_share"],
    "rubber": ["stiffening", "viscous_share", "rest_offset", "rest_offset_e3"],
    "bend sensor": [
        *("sensor_offset", "sensor_curvature", "sensor_noise", "sensor_drift"),
        *("sensor_offset_e3", "sensor_curvature_e3", "sensor_roll"),
    ],
}
