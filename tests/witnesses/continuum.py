"""An emulated limb of another physics: heat diffuses, wires have true minor loops, rubber ages.

It shares none of its laws with the model, nor with the emulated limb of lumped masses
(`ShapeMemoryWires`, `EmulatedRubber`). It is a witness: methods are judged on it, too. Importing
this module adds the physics "continuum" to `SPECIMENS` of `LimbTwin`. A seed
draws a `ContinuumSpecimen` by ranges that are listed below with their sources; "ours" marks
ranges without a published source. No range was fitted to make a calibration or a controller
look good or bad.

Sources, beside those of `specimen`:

- [Mayergoyz] Mayergoyz: Mathematical models of hysteresis and their applications, 2003: the
  Preisach operator, return-point memory and congruency of minor loops.
- [Ortin] Ortín: Preisach modeling of hysteresis for a pseudoelastic Cu-Zn-Al single crystal,
  1992; minor loops of shape-memory alloy by relays.
- [Flexinol] as there: wires of 70 and 90 °C with hysteresis of 15 to 30 °C, 7 to 14 MPa/°C,
  latent heat; resistance of austenite 10 to 20% below that of martensite.
- [Uchil] Uchil et al.: Electrical resistivity of NiTi with high transformation strain, 2002;
  R-phase loops of 2 to 5 °C hysteresis beside the main one.
- [Sylgard] Dow: Sylgard 184, and Smooth-On: Dragon Skin, data sheets: 0.16 to 0.27 W/(m K),
  1.1 to 1.5 kJ/(kg K), 1030 to 1100 kg/m³.
- [Incropera] Incropera, DeWitt: Fundamentals of heat and mass transfer: free convection of
  3 to 10 W/(m² K), with the fourth root of the temperature difference; radiation.
- [Yeoh] Yeoh: Some forms of the strain energy function for rubber, 1993: a modulus that falls,
  then rises with strain.
- [Ogden] Ogden, Roxburgh: A pseudo-elastic model for the Mullins effect in filled rubber, 1999.
- [Schapery] Schapery, Park: Methods of interconversion between linear viscoelastic functions,
  1999: power laws as Prony series of geometric times.
- [Dahl] Dahl: Solid friction damping of mechanical vibrations, 1976.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.trajectories import Trajectory
from scipy.linalg import eigh, expm
from scipy.special import ndtri

from hardware.emulation.lumped import CutOut
from hardware.emulation.sensors import (
    THERMOCOUPLE_NOISE,
    THERMOCOUPLE_PERIOD,
    THERMOCOUPLE_STEP,
)
from hardware.emulation.specimen import Specimen
from hardware.emulation.twin import SPECIMENS
from limb_systems import LimbError, LimbModel, symbolic_chain
from limb_systems.bend_sensor import roll_bends
from limb_systems.drake_python import declare_state_output, weak_method
from limb_systems.limb_mechanics import LimbMechanics
from limb_systems.limb_parameters import SegmentParameters
from limb_systems.simulation import PERIOD as SIMULATION_PERIOD
from limb_systems.smooth_function import SmoothFunction

JOINTS = 8  # of the chain for each axis, whatever the links of the description
SHELLS = 7  # of silicone around each wire
RELAYS = 1000  # of each wire
CREEP_TIMES = 0.2 * 8.0 ** np.arange(4)  # s, of the Prony series: 0.2 to 100 s
PERIOD = 0.02  # s, of heat and transformation
SUBSTEPS = 2  # of the beam in each of them
PWM_STEP = 1 / 1000  # of a timer of ten bits, nearly
BEND_STEP = 2 * np.pi / 4096 / 2  # of a magnetic encoder of twelve bits that reads α
GRIP, GRIP_TIME = 20.0, 0.05  # stiffness of a hand over that of the limb, and its damping, s
STEFAN_BOLTZMANN = 5.67e-8  # W/(m² K⁴)
ZERO_CELSIUS = 273.15  # K
GOLDEN = (np.sqrt(5) - 1) / 2  # multiples of it fill an interval evenly
WIRE_ARRAYS = (
    *("lead_share", "resistance_drop", "resistance_slope", "latent_heat", "stress_shift"),
    *("relief", "martensite_pull", "lag", "second_lag", "leak", "pick_up"),
)
STIFFEST = 2.0  # largest x² of `ContinuumBeam.stiffening`, 64° of bend, beyond which it is linear
# Share of the stiffness that is added to what is integrated exactly, and taken off the moments,
# because friction and stiff rubber would make steps with moments of the beginning unstable.
ADDED = 0.4
DEGREE = np.pi / 180  # rad


def drawn(low: float, high: float, factor: float = 1.0) -> float:
    """Return a field that a seed draws evenly from a range, in units of the factor."""
    return dataclasses.field(metadata={"range": (low, high), "factor": factor})


def draw(kind: type, uniform) -> Any:
    """Return an instance whose `drawn` fields have random values, in their order."""
    values = {}
    for field in dataclasses.fields(kind):
        if field.metadata:
            values[field.name] = field.metadata["factor"] * uniform(*field.metadata["range"])
    return kind(**values)


@dataclasses.dataclass(frozen=True)
class ContinuumWire:
    """One wire, its thermocouple and the silicone around it."""

    # Heat and resistance of the coil.
    heating: float = drawn(15.0, 25.0)  # °C/s at full duty, as martensite, without losses [records]
    contact_time: float = drawn(11.0, 19.0)  # s, to the silicone; of the first cooling [records]
    radius: float = drawn(0.6e-3, 0.9e-3)  # m; ours, coils of 1.2 to 1.8 mm
    heat_capacity: float = drawn(1.8e6, 2.8e6)  # J/(m³ K), between silicone and NiTi, 3 to 5e6
    lead_share: float = drawn(0.05, 0.2)  # of the resistance that is outside the coil; ours
    resistance_drop: float = drawn(0.08, 0.2)  # share that austenite lacks [Flexinol]
    resistance_slope: float = drawn(2e-4, 8e-4)  # 1/°C, relative [Uchil]
    latent_heat: float = drawn(8.0, 20.0)  # °C; below [Flexinol]'s 29 °C: filled coils share heat
    # Switching temperatures of the relays, °C: middle and, logarithmically, half the distance.
    middle: float = drawn(52.0, 62.0)  # [Flexinol], between wires of 70 and 90 °C
    middle_spread: float = drawn(6.5, 10.0)  # ours: stress and heat differ along a coil
    half_width: float = drawn(5.0, 9.0)  # [Flexinol]
    half_width_spread: float = drawn(0.2, 0.5)  # ours [Ortin]
    r_share: float = drawn(0.05, 0.15)  # of the relays, which make the R-phase's loop [Uchil]
    r_middle: float = drawn(38.0, 46.0)
    r_half_width: float = drawn(1.0, 2.5)
    # Pull.
    stress_shift: float = drawn(5.0, 12.0)  # °C; 70 to 170 MPa at 7 to 14 MPa/°C [Flexinol]
    bend: float = drawn(38.0, 62.0, DEGREE)  # where linear rubber would hold the full pull; ours
    relief: float = drawn(0.1, 0.3)  # share of austenite's pull lost per rad to its side; ours
    martensite_pull: float = drawn(0.1, 0.25)  # share of the full pull per rad of stretch; ours
    # Thermocouple.
    lag: float = drawn(0.5, 1.5)  # s [records]
    second_lag: float = drawn(0.15, 0.6)  # s [records]
    leak: float = drawn(0.0, 0.12)  # share of the reading from the innermost shell; ours
    pick_up: float = drawn(-0.5, 1.5)  # °C that full duty's current adds; ours
    misplaced: float = 0.0  # as of `WirePhysics`


@dataclasses.dataclass(frozen=True)
class ContinuumBeam:
    """The silicone of the limb, as beam and as conductor of heat, and its bend sensor.

    The moment of a joint is k θ (1 - a x² + b x⁴), where x is 1 at a bend of 45°.
    ``stiffness_ratio``, ``rest_offset_e3``, ``sensor_gain_e3``, ``sensor_offset_e3`` and
    ``sensor_roll`` are as of `SegmentPhysics`.
    """

    stiffness: float = drawn(0.85, 1.15)  # EI over the described one
    taper: float = drawn(-0.15, 0.3)  # share of EI more at the base, less at the tip; ours: glue
    damping_ratio: float = drawn(0.03, 0.09)  # viscous, of the first mode
    softening: float = drawn(0.0, 0.12)  # a [Yeoh]
    stiffening: float = drawn(0.02, 0.06)  # b [Yeoh]
    mullins: float = drawn(0.02, 0.10)  # share lost well below the largest bend so far [Ogden]
    creep: float = drawn(0.015, 0.05)  # share that relaxes per term of the Prony series [Schapery]
    friction: float = drawn(0.2, 0.8, DEGREE)  # bend that it can hold; ours [Dahl]
    friction_yield: float = drawn(2.0, 5.0, DEGREE)  # bend over which it turns; ours
    rest_offset: float = drawn(-4.0, 4.0, DEGREE)  # bend at rest, from the described one; ours
    anchor: float = drawn(0.1, 0.5)  # share of the pull missing at the last joint; ours
    # Heat.
    conductivity: float = drawn(0.16, 0.27)  # W/(m K) [Sylgard]
    heat_capacity: float = drawn(1.2e6, 1.6e6)  # J/(m³ K) [Sylgard]
    convection: float = drawn(4.0, 8.0)  # W/(m² K) at 10 °C above the room [Incropera]
    emissivity: float = drawn(0.8, 0.95)  # [Incropera]
    crossing: float = drawn(0.5, 1.5)  # conductance between wires, over a cube's two faces; ours
    # Bend sensor.
    sensor_gain: float = drawn(0.97, 1.03)
    sensor_offset: float = drawn(-0.5, 0.5, DEGREE)
    sensor_play: float = drawn(0.2, 1.0, DEGREE)  # width of its backlash; ours
    sensor_warming: float = drawn(-1e-3, 5e-4)  # 1/°C, of its gain, by the outermost shells; ours
    sensor_shift: float = drawn(-0.04, 0.04, DEGREE)  # rad/°C between the two sides; ours
    sensor_noise: float = drawn(0.1, 0.3, DEGREE)  # of a sample; ours
    sensor_walk: float = drawn(0.01, 0.05, DEGREE)  # rad/√s, 0.1 to 0.4° in a minute; ours
    missing: float = drawn(0.0, 0.01)  # share of samples that repeat the one before; ours
    cooling: float = 1.0  # factor of convection and radiation
    stiffness_ratio: float = 1.0
    rest_offset_e3: float = 0.0
    sensor_gain_e3: float = 1.0
    sensor_offset_e3: float = 0.0
    sensor_roll: float = 0.0


class ContinuumSpecimen(Specimen):
    """A particular limb of `ContinuumLimb`'s physics, and the state in which it was left.

    Geometry, mass, stiffness, sensors and limits are drawn around those of the description;
    what its wires do does not depend on the description's laws. A change of "cooling" is one of
    its surface alone.

    - ``wires``: `ContinuumWire` (W); left and right, if the limb bends in a plane.
    - ``segments``: one `ContinuumBeam`.
    """

    physics = "continuum"
    rest_period = 0.1
    effects: tuple[str, ...] = ()
    extra_effects: tuple[str, ...] = ()
    wires: list[ContinuumWire]
    segments: list[ContinuumBeam]

    def _draw(self, uniform, _):
        sides = [wire.lever[0] for wire in self.description.wires]
        is_planar = self.description.segments[0].axes == 1
        if (is_planar and sides != [-1, 1]) or len(self.description.segments) != 1:
            raise LimbError(
                "An emulated limb of the physics continuum has one segment with a left and a right "
                "wire, in this order, or one that bends about two axes; describe such a limb, or "
                "take the physics lumped."
            )
        self.segments = [draw(ContinuumBeam, uniform)]
        kind = draw(ContinuumWire, uniform)
        self.wires = [_draw_side(uniform, kind) for _ in sides]
        self.ambient = self.description.ambient_temperature + uniform(-3.0, 3.0)  # °C, ours

    def _draw_second_axis(self, uniform, segment: SegmentParameters) -> dict[str, float]:
        return {
            "stiffness_ratio": segment.stiffness_ratio * uniform(0.94, 1.06),  # ours
            "rest_offset_e3": np.deg2rad(uniform(-4.0, 4.0)),  # these as towards E2
            "sensor_gain_e3": uniform(0.97, 1.03),
            "sensor_offset_e3": np.deg2rad(uniform(-0.5, 0.5)),
            "sensor_roll": np.deg2rad(uniform(-5.0, 5.0)),  # ours
        }

    def _change(self, change: dict[str, float]) -> None:
        self.wires = [
            dataclasses.replace(wire, heating=wire.heating * change["supply"])
            for wire in self.wires
        ]
        (beam,) = self.segments
        changed = dataclasses.replace(
            beam,
            stiffness=beam.stiffness * change["stiffness"],
            # A torque on a spring is another angle at rest.
            rest_offset=beam.rest_offset + change["payload"] / change["stiffness"],
            rest_offset_e3=beam.rest_offset_e3 + change["payload_e3"] / change["stiffness"],
            cooling=beam.cooling * change["cooling"],
            sensor_noise=beam.sensor_noise * change["noise"],
        )
        # The wires pull as before, which their bend of a limb of this stiffness says otherwise.
        self.wires = [
            dataclasses.replace(wire, bend=wire.bend / change["stiffness"]) for wire in self.wires
        ]
        self.segments = [changed]

    def _move_state(self, warmer: float, bent: np.ndarray) -> None:
        if not self.state:
            return
        state, rows = self.state, bent.reshape(-1, JOINTS)
        segment, (beam,) = fine(self.description.segments[0]), self.segments
        bends = np.array([bend_gradient(segment, axis) @ row for axis, row in enumerate(rows)])
        moved = [[row, 0 * row, *[row] * len(CREEP_TIMES)] for row in rows]
        self.state = state | {
            "heat": state["heat"] + warmer,
            "thermocouples": state["thermocouples"] + warmer,
            "play": state["play"] + roll_bends(bends, beam.sensor_roll),
            "beam": state["beam"] + np.ravel(moved),
        }

    def rest_angles(self) -> np.ndarray:
        """Joint angles at rest (8 for each axis), rad."""
        (segment,), (beam,) = self.description.segments, self.segments
        towards_e2 = (segment.rest_angle + beam.rest_offset) * equal_joint_angles(segment)
        if segment.axes == 1:
            return towards_e2
        rest = segment.rest_angle_e3 + beam.rest_offset_e3
        return np.append(towards_e2, rest * equal_joint_angles(segment, 1))

    def build(
        self,
        builder: DiagramBuilder,
        *,
        hand: Trajectory | None,
        bend_rate: float,
        wire_period: float,
        truth: bool,
    ) -> None:
        """Add `ContinuumLimb` and its sensors to a builder, and export the ports of `LimbTwin`."""
        # The limb keeps its own period, except for fast samples and pauses.
        is_pause = wire_period > SIMULATION_PERIOD
        period = wire_period if is_pause else min(PERIOD, 1 / bend_rate)
        limb = builder.AddNamedSystem("shape_memory_wires", ContinuumLimb(self, period, hand))
        sensors = builder.AddNamedSystem("sensors", WalkingSensors(self, bend_rate))
        cut_out = builder.AddNamedSystem("heater_cut_out", CutOut(len(self.wires), wire_period))
        for name in ("thermocouples", "bend"):
            builder.Connect(limb.GetOutputPort(name), sensors.GetInputPort(name))
        builder.Connect(
            sensors.GetOutputPort("measured_temperature"),
            cut_out.GetInputPort("measured_temperature"),
        )
        builder.Connect(cut_out.GetOutputPort("duty"), limb.GetInputPort("duty"))
        builder.ExportInput(cut_out.GetInputPort("duty"), "duty")
        ports = {
            "measured_temperature": sensors,
            "bend_angle": sensors,
            "applied_duty": limb,
            "measurement": sensors,
            "cut_out": cut_out,
        }
        ports |= {"wire_temperature": limb, "joint_state": limb} if truth else {}
        for name, system in ports.items():
            builder.ExportOutput(system.GetOutputPort(name), name)


SPECIMENS[ContinuumSpecimen.physics] = ContinuumSpecimen


def fine(segment: SegmentParameters) -> SegmentParameters:
    """The chain of eight links that stands for a segment; in space it twists, and is centred."""
    in_space = segment.axes == 2
    return dataclasses.replace(segment, links=JOINTS, twists=in_space, centred_joints=in_space)


def equal_joint_angles(segment: SegmentParameters, axis: int = 0) -> np.ndarray:
    """Equal angles (8) of the chain's joints that an exact bend sensor shows as one radian."""
    return np.full(JOINTS, 1 / bend_gradient(fine(segment), axis).sum())


def bend_gradient(segment: SegmentParameters, axis: int = 0) -> np.ndarray:
    """Derivatives of a bend that an exact sensor shows by its joints, where all are straight."""
    step, chain = 1e-6, segment.chain
    joints = np.array(chain.kinds) == ("e2", "e3")[axis]
    angles = np.ascontiguousarray(step * np.eye(len(joints))[:, joints])
    return segment.bend_sensor.exact_bends(chain, angles)[axis] / step


def _weight_of_angles(mechanics: LimbMechanics, gravity: Sequence[float]) -> SmoothFunction:
    """The torques that hold a chain against gravity (3,), m/s², (n,), N·m, of θ (n,), rad."""
    n = mechanics.layout.num_joints
    angles, still = ca.SX.sym("q", n), ca.SX(n, 1)
    chain = symbolic_chain.Chain(mechanics, angles)
    return SmoothFunction(chain.inverse_dynamics(still, still, ca.DM(gravity)), angles)


class Preisach:
    """The Preisach operator: relays that switch up and down at temperatures of their own.

        r_i = 1 where T ≥ α_i,  r_i = 0 where T ≤ β_i,  else as before,   x = Σ r_i / n

    with α_i > β_i, so that x has return-point memory, and its minor loops between the same
    two temperatures are congruent [Mayergoyz].
    """

    def __init__(self, up: ArrayLike, down: ArrayLike):
        """
        Args:
            up, down: α and β, (n,) or (wires, n), °C.
        """
        self.up, self.down = np.asarray(up, float), np.asarray(down, float)

    @classmethod
    def of(cls, wires: list[ContinuumWire]) -> "Preisach":
        """Relays that fill the densities of wires evenly, (wires, `RELAYS`)."""
        return cls(*np.swapaxes([_relays(wire) for wire in wires], 0, 1))

    def after(self, relays: np.ndarray, temperature: np.ndarray) -> np.ndarray:
        """The relays, True where they are up, at the next temperature (..., 1), °C."""
        return (relays | (temperature >= self.up)) & (temperature > self.down)


def _relays(wire: ContinuumWire) -> tuple[np.ndarray, np.ndarray]:
    """Switching temperatures up and down (`RELAYS`), °C."""
    parts = []
    in_r = round(wire.r_share * RELAYS)
    for count, middle, spread, half_width, half_spread in (
        (RELAYS - in_r, wire.middle, wire.middle_spread, wire.half_width, wire.half_width_spread),
        (in_r, wire.r_middle, wire.middle_spread / 3, wire.r_half_width, 0.2),
    ):
        # A lattice of the quantiles, without the last 1% at either end.
        first = 0.01 + 0.98 * (np.arange(count) + 0.5) / count
        second = 0.01 + 0.98 * ((np.arange(count) * GOLDEN) % 1.0)
        middles = middle + spread * ndtri(first)
        halves = half_width * np.exp(half_spread * ndtri(second))
        parts.append((middles + halves, middles - halves))
    up, down = np.concatenate(parts, axis=1)
    return up, down


class RadialShells:
    """Heat of wires and of the silicone around each, in finite volumes per metre of limb.

    Each wire is surrounded by `SHELLS` cylindrical shells, whose radii grow by one factor up to
    that of its share of the limb's cross-section. Heat flows from the wire over a contact
    resistance into the first, on to the next by conduction, and from the last to the room by free
    convection and radiation, and to the last shells of the wires beside it:

        C_0 Ṫ_0 = P - g (T_0 - T_1)
        C_i Ṫ_i = g_(i-1) (T_(i-1) - T_i) - g_i (T_i - T_(i+1)),   g_i = 2π λ / ln(r_(i+1) / r_i)

    with r_i at the volumes' middles by their logarithms. Integrated by Euler's method.

    - ``capacities``: C (W, 1 + `SHELLS`), J/(m K).
    - ``conductances``: g (W, `SHELLS`), W/(m K), from each to the next.
    """

    def __init__(self, specimen: ContinuumSpecimen):
        (segment,), (beam,) = specimen.description.segments, specimen.segments
        count = len(specimen.wires)
        outside = np.sqrt(segment.width * segment.thickness / count / np.pi)
        self.capacities = np.empty((count, 1 + SHELLS))
        self.conductances = np.empty((count, SHELLS))
        self._last = np.empty(count)  # from the last shell's middle to the surface
        for index, wire in enumerate(specimen.wires):
            radii = np.geomspace(wire.radius, max(outside, 2 * wire.radius), SHELLS + 1)
            own = wire.heat_capacity * np.pi * wire.radius**2
            shells = beam.heat_capacity * np.pi * np.diff(radii**2)
            one = 2 * np.pi * beam.conductivity / np.log(radii[1] / radii[0])
            contact = 1 / (wire.contact_time / own + 0.5 / one)
            self.capacities[index] = own, *shells
            self.conductances[index] = contact, *np.full(SHELLS - 1, one)
            self._last[index] = 2 * one
        self._power = np.array([wire.heating for wire in specimen.wires]) * self.capacities[:, 0]
        self._room, self._beam = specimen.ambient, beam
        self._surface = 2 * (segment.width + segment.thickness) / count  # m² per m, each wire's
        around = np.argsort([np.arctan2(wire.e3, wire.e2) for wire in segment.wires]).tolist()
        self._beside = np.zeros((count, count))  # differences between each and those beside it
        for one, other in {tuple(sorted(p)) for p in zip(around, np.roll(around, 1), strict=True)}:
            pair = np.eye(count)[one] - np.eye(count)[other]
            self._beside += np.outer(pair, pair)
        self._crossing = beam.crossing * beam.conductivity

    def power(self, heating: np.ndarray) -> np.ndarray:
        """Heat into the wires (W), W/m, at a share of the full power of each."""
        return self._power * heating

    def after(self, temperatures: np.ndarray, power: np.ndarray, step: float) -> np.ndarray:
        """Temperatures (W, 1 + `SHELLS`) after a step, °C, with heat into the wires (W), W/m."""
        flows = self.conductances * (temperatures[:, :-1] - temperatures[:, 1:])
        net = np.empty_like(temperatures)
        net[:, 0] = power
        net[:, 1:] = flows
        net[:, :-1] -= flows
        last = temperatures[:, -1]
        net[:, -1] -= self.loss(last)
        net[:, -1] -= self._crossing * (self._beside @ last)
        return temperatures + step * net / self.capacities

    def loss(self, last: np.ndarray) -> np.ndarray:
        """Heat from the last shells, at temperatures (W), °C, to the room (W), W/m."""
        rise = last - self._room
        convection = self._beam.convection * ((np.abs(rise) + 0.1) / 10) ** 0.25
        mean = (last + self._room) / 2 + ZERO_CELSIUS
        radiation = 4 * self._beam.emissivity * STEFAN_BOLTZMANN * mean**3
        surface = self._beam.cooling * self._surface * (convection + radiation)
        return rise * surface * self._last / (surface + self._last)


class Chain:
    """The beam, bent about one axis, as a chain of eight joints, whose stiffness varies along it.

        M θ̈ + C θ̇ + K ((1 + s) (θ - θ_0) + v Σ_j (θ - q_j)) = moments,   q̇_j = (θ - q_j) / τ_j

    with the inertia of the straight chain and creep in a Prony series. This, what is linear, is
    integrated exactly, with moments that are constant over each step, to which K s (θ - θ_0)
    is to be added, see `ADDED`.

    - ``stiffness``: k (8), N·m/rad.
    - ``gradient``: derivatives (8) of the bend by the joint angles.
    """

    def __init__(self, specimen: ContinuumSpecimen, axis: int = 0):
        """
        Args:
            specimen: the limb.
            axis: 0 for bends towards E2, 1 towards E3.
        """
        (segment,), (beam,) = specimen.description.segments, specimen.segments
        self.gradient = bend_gradient(fine(segment), axis)
        self.rest = specimen.rest_angles()[axis * JOINTS :][:JOINTS]
        along = (np.arange(JOINTS) + 0.5) / JOINTS
        mean = segment.stiffness * beam.stiffness * JOINTS / segment.links
        mean *= (1.0, beam.stiffness_ratio)[axis]
        self.stiffness = mean * (1 + beam.taper * (1 - 2 * along))
        link, link_mass = segment.length / JOINTS, segment.mass / JOINTS
        turned = np.tril(np.ones((JOINTS, JOINTS)))  # directions of the links by joint angles
        lateral = link * (np.tril(np.ones((JOINTS, JOINTS)), -1) + 0.5 * np.eye(JOINTS))
        across = (segment.thickness, segment.width)[axis]
        own = (link**2 + across**2) / 12  # of a box, over its mass
        inertia = lateral.T @ lateral + own * np.eye(JOINTS)
        inertia += specimen.description.payload / link_mass * link**2  # at the tip
        self._inertia = link_mass * turned.T @ inertia @ turned
        squares = eigh(np.diag(self.stiffness), self._inertia, eigvals_only=True)
        self._creep = beam.creep
        self._damping = 2 * beam.damping_ratio / np.sqrt(squares[0]) * np.diag(self.stiffness)

    def propagator(self, step: float, held: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """The chain's state after a step, s, with or without a hand.

        Returns:
            Φ (48, 48) and Γ (48, 8) of the state [θ - θ_0, θ̇, q_1 - θ_0, ...] and the moments.
        """
        count, size = len(CREEP_TIMES), (2 + len(CREEP_TIMES)) * JOINTS
        springs, damping = np.diag(self.stiffness), self._damping
        creep = self._creep * springs
        stiffness = (1 + ADDED) * springs + count * creep
        if held:
            hand = self.hand * np.outer(self.gradient, self.gradient)
            stiffness, damping = stiffness + hand, damping + GRIP_TIME * hand
        inverse = np.linalg.inv(self._inertia)
        blocks = [-stiffness, -damping, *[creep] * count, np.eye(JOINTS)]
        system = np.zeros((size + JOINTS, size + JOINTS))
        system[:JOINTS, JOINTS : 2 * JOINTS] = np.eye(JOINTS)
        system[JOINTS : 2 * JOINTS] = inverse @ np.hstack(blocks)
        rates = np.repeat(1 / CREEP_TIMES, JOINTS)
        system[2 * JOINTS : size, :JOINTS] = np.tile(np.eye(JOINTS), (count, 1)) * rates[:, None]
        system[2 * JOINTS : size, 2 * JOINTS : size] = np.diag(-rates)
        after = expm(step * system)[:size]
        return after[:, :size].copy(), after[:, size:].copy()

    @property
    def hand(self) -> float:
        """Stiffness of a hand's grip against the bend, N·m/rad."""
        return GRIP / (self.gradient**2 / self.stiffness).sum()

    def resampled(self, segment: SegmentParameters, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """The chain of a described segment of this shape, which shows the same bend.

        Returns:
            matrix (links, 8) from these angles to its angles, and equal angles of it (links,)
            that an exact bend sensor shows as one radian.
        """
        joints = segment.links
        ends, wanted = np.linspace(0.0, 1.0, JOINTS + 1), np.linspace(0.0, 1.0, joints + 1)
        turned = np.vstack([np.zeros(JOINTS), np.tril(np.ones((JOINTS, JOINTS)))])
        tangent = np.array([np.interp(wanted, ends, column) for column in turned.T]).T
        angles, gradient = np.diff(tangent, axis=0), bend_gradient(segment, axis)
        one = np.full(joints, 1 / gradient.sum())
        return angles + np.outer(one, self.gradient - gradient @ angles), one


class ContinuumLimb(LeafSystem):
    """Wires and beam of a `ContinuumSpecimen`, and what its sensors would show but for noise.

    The wires' pull is

        p = x (1 - r b) - (1 - x) s tanh(b / b_0)

    with the share of austenite x, a `Preisach` operator of T - Δ p, and the bend b to the wire's
    own side, along its lever. Heat is that of `RadialShells`, the latent heat taken from the
    wire. Power falls with the resistance, which depends on phase and temperature. The beam is a
    `Chain`, each of whose joints has the moment

        k θ η(x) (1 - a x² + b x⁴) + k v Σ_j (θ - q_j) + F z

    softer below its largest bend so far by η, as Mullins saw, with creep by a power law in q_j,
    and dry friction z by Dahl. In space there is one for each axis, x² is the sum of both, weight
    is that of the bent chain, and twist is what its springs hold at rest under the weight.

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``thermocouples``: V (W), °C, before noise and steps
    - output 1 ``bend``: φ (F), rad, before noise, walk and steps
    - output 2 ``wire_temperature``: T (W), °C
    - output 3 ``joint_state``: [θ, θ̇] (2n), rad and rad/s, of a chain as described that shows
      the same bend
    - output 4 ``applied_duty``: D (W) in the steps of the PWM
    - state, discrete: what `_unused` lists
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        specimen: ContinuumSpecimen,
        period: float = PERIOD,
        hand: Trajectory | None = None,
    ):
        """
        Args:
            specimen: the limb, with the state after its last use, which this keeps up to date.
            period: s, of the steps of heat; those of the beam are half as long.
            hand: bend angles (F) over time, rad, to which a hand bends the limb until its end.
        """
        super().__init__()
        self._specimen, self._period, self._hand = specimen, period, hand
        (beam,), wires, (segment,) = (
            specimen.segments,
            specimen.wires,
            specimen.description.segments,
        )
        self._beam, self._room, num_wires = beam, specimen.ambient, len(wires)
        self._heat, self._preisach = RadialShells(specimen), Preisach.of(wires)
        self._chains = [Chain(specimen, axis) for axis in range(segment.axes)]
        self._described = LimbModel.of(specimen.description).mechanics
        limb = dataclasses.replace(specimen.description, segments=[fine(segment)])
        self._mechanics = LimbModel.of(limb).mechanics
        self._sensor = segment.bend_sensor
        self._weighs = bool(np.cross(limb.gravity, self._mechanics.axes).any())
        self._weight = _weight_of_angles(self._mechanics, limb.gravity)
        self._twists = np.flatnonzero(~self._mechanics.shape.any(axis=1))
        self._torsional = segment.torsional_ratio * self._chains[0].stiffness[: len(self._twists)]
        step = period / SUBSTEPS
        self._free = [chain.propagator(step) for chain in self._chains]
        self._held = [chain.propagator(step, held=True) for chain in self._chains]
        for name in WIRE_ARRAYS:
            setattr(self, f"_{name}", np.array([getattr(wire, name) for wire in wires]))
        self._first_share = 1 - np.exp(-period / self._lag)
        self._second_share = 1 - np.exp(-period / self._second_lag)
        # A moment along the beam, less at the last joint, that would bend it as drawn.
        profile = np.ones(JOINTS)
        profile[-1] -= beam.anchor
        one = self._chains[0].gradient @ (profile / self._chains[0].stiffness)
        places = specimen.places()
        self._levers = (places / np.hypot(*places.T)[:, None])[:, : segment.axes]
        self._moments = [
            profile[:, None] * lever * [wire.bend / one for wire in wires]
            for lever in self._levers.T
        ]
        equal = [equal_joint_angles(segment, axis) for axis in range(segment.axes)]
        self._at_45 = np.pi / 4 * np.array(equal)
        self._friction = beam.friction * np.array(equal) * [c.stiffness for c in self._chains]
        self._friction_yield = beam.friction_yield * np.array(equal)
        self._shown = [chain.resampled(segment, a) for a, chain in enumerate(self._chains)]
        # The beam's state counts angles from where it rests.
        self._rest = np.array(
            [[c.rest, 0 * c.rest, *[c.rest] * len(CREEP_TIMES)] for c in self._chains]
        ).reshape(segment.axes, -1)
        joints = self._described.layout.num_joints

        unused = self._unused()
        ends = np.cumsum([len(part) for part in unused.values()]).tolist()
        self._parts = {
            name: slice(end - len(part), end)
            for (name, part), end in zip(unused.items(), ends, strict=True)
        }
        first = np.concatenate([specimen.state.get(name, part) for name, part in unused.items()])
        state = self.DeclareDiscreteState(first)
        duty = self.DeclareVectorInputPort("duty", num_wires)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weak_method(self._update))
        tickets = {self.discrete_state_ticket(state)}
        for name, size, calc in (
            ("thermocouples", num_wires, self._calc_thermocouples),
            ("bend", segment.axes, self._calc_bend),
            ("wire_temperature", num_wires, self._calc_temperature),
            ("joint_state", 2 * joints, self._calc_joints),
        ):
            self.DeclareVectorOutputPort(name, size, weak_method(calc), tickets)
        self.DeclareVectorOutputPort(
            "applied_duty",
            num_wires,
            weak_method(self._calc_duty),
            {self.input_port_ticket(duty.get_index())},
        )

    def _unused(self) -> dict[str, np.ndarray]:
        """The state of a limb that was never used, by the names of its parts."""
        num_wires, twist = len(self._levers), np.zeros(len(self._twists))
        rest = self._exact_bend(self._rest[:, :JOINTS], twist)
        return {
            "heat": np.full(num_wires * (1 + SHELLS), self._room),
            "relays": np.zeros(num_wires * RELAYS),
            "share": np.zeros(num_wires),
            "beam": self._rest.ravel(),
            "twist": twist,
            "friction": np.zeros(JOINTS * len(self._chains)),
            "largest": np.zeros(JOINTS),
            "thermocouples": np.full(2 * num_wires, self._room),  # after the first lag, after both
            "pulls": np.zeros(num_wires),
            "play": roll_bends(rest, self._beam.sensor_roll),
            "duty": np.zeros(num_wires),
        }

    def _all_angles(self, angles: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Angles of all joints, of those of each axis (axes, 8) and the twists."""
        result = np.zeros(self._mechanics.layout.num_joints)
        result[self._twists] = twist
        for joints, of_axis in zip(self._mechanics.layout.bend_joints, angles, strict=True):
            result[joints] = of_axis
        return result

    def _exact_bend(self, angles: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """What an exact bend sensor shows (F), rad, of joint angles as of `_all_angles`."""
        return self._sensor.exact_bends(self._mechanics.chains[0], self._all_angles(angles, twist))

    def _part(self, context: Context, name: str) -> np.ndarray:
        return context.get_discrete_state_vector().value()[self._parts[name]]

    def _applied_duty(self, context: Context) -> np.ndarray:
        return PWM_STEP * np.rint(self.get_input_port(0).Eval(context) / PWM_STEP)

    def _update(self, context, discrete_state):
        values = context.get_discrete_state_vector().value().copy()
        state = {name: values[part] for name, part in self._parts.items()}  # views of the values
        state["duty"][:] = self._applied_duty(context)
        self._after_heat(state)
        now, hand, wanted = context.get_time(), self._hand, None
        if hand is not None and now < hand.end_time():
            wanted = hand.value(now).ravel()
        for _ in range(SUBSTEPS):
            self._after_beam(state, wanted)
        angles = state["beam"].reshape(len(self._chains), -1)[:, :JOINTS]
        bend = roll_bends(self._exact_bend(angles, state["twist"]), self._beam.sensor_roll)
        half = self._beam.sensor_play / 2
        state["play"][:] = np.minimum(np.maximum(state["play"], bend - half), bend + half)
        self._specimen.state = self._specimen.state | state
        discrete_state.set_value(values)

    def _after_heat(self, state: dict[str, np.ndarray]) -> None:
        """Advances the wires and thermocouples."""
        share, num_wires = state["share"], len(state["share"])
        temperatures = state["heat"].reshape(num_wires, -1)
        warm = 1 + self._resistance_slope * (temperatures[:, 0] - 25.0)
        coil = (1 - self._resistance_drop * share) * warm
        resistance = self._lead_share + (1 - self._lead_share) * coil
        power = self._heat.power(state["duty"] / resistance)
        after = self._heat.after(temperatures, power, self._period)
        shifted = after[:, :1] - (self._stress_shift * state["pulls"])[:, None]
        relays = self._preisach.after(state["relays"].reshape(num_wires, -1) > 0.5, shifted)
        changed = np.array([np.count_nonzero(row) for row in relays]) / RELAYS
        after[:, 0] -= self._latent_heat * (changed - share)
        share[:] = changed
        state["heat"][:] = after.ravel()
        state["relays"][:] = relays.ravel()
        first, second = state["thermocouples"].reshape(2, num_wires)
        bonded = after[:, 0] + self._leak * (after[:, 1] - after[:, 0])
        second += self._second_share * (first - second)
        first += self._first_share * (bonded - first)

    def _after_beam(self, state: dict[str, np.ndarray], wanted: np.ndarray | None) -> None:
        """Advances the beam by a step of its own, with or without a hand."""
        chains, beam, share = self._chains, self._beam, state["share"]
        absolute = state["beam"].reshape(len(chains), -1)
        relative = absolute - self._rest
        bent = relative[:, :JOINTS]
        bend = np.array(
            [c.gradient @ row[:JOINTS] for c, row in zip(chains, absolute, strict=True)]
        )
        own_bend = self._levers @ bend
        yielding = MARTENSITE_YIELD * np.tanh(own_bend / MARTENSITE_YIELD)
        pulls = share * (1 - self._relief * own_bend)
        pulls -= (1 - share) * self._martensite_pull * yielding
        squares = ((bent / self._at_45) ** 2).sum(axis=0)
        largest = np.maximum(state["largest"], squares)
        healthy = 1 - beam.mullins * np.tanh((largest - squares) / MULLINS_RANGE)
        capped = np.minimum(squares, STIFFEST)
        shape = healthy * (1 - (beam.softening - beam.stiffening * capped) * capped)
        weights = self._weights(absolute[:, :JOINTS], state["twist"])
        for axis, friction in enumerate(state["friction"].reshape(len(chains), -1)):
            chain = chains[axis]
            moments = self._moments[axis] @ pulls
            moments -= chain.stiffness * (shape - 1 - ADDED) * bent[axis]
            moments += weights[axis] - self._friction[axis] * friction
            free, forced = (self._free if wanted is None else self._held)[axis]
            if wanted is not None:
                to_hand = wanted[axis] - chain.gradient @ chain.rest
                moments += chain.hand * chain.gradient * to_hand
            after = free @ relative[axis] + forced @ moments
            turned = after[:JOINTS] - bent[axis]
            side = np.sign(turned)
            slip = np.exp(-np.abs(turned) / self._friction_yield[axis])
            friction[:] = side + (friction - side) * slip
            absolute[axis] = after + self._rest[axis]
        state["largest"][:], state["pulls"][:] = largest, pulls

    def _weights(self, angles: np.ndarray, twist: np.ndarray) -> list[np.ndarray | float]:
        """Moments of gravity on the joints of each axis, N·m, under which the twists settle."""
        if not self._weighs:
            return [0.0] * len(self._chains)
        moments = -self._weight.values(self._all_angles(angles, twist))
        twist[:] = moments[self._twists] / self._torsional
        return [moments[joints] for joints in self._mechanics.layout.bend_joints]

    def _calc_thermocouples(self, context, output):
        _, read = np.split(self._part(context, "thermocouples"), 2)
        output.SetFromVector(read + self._pick_up * self._part(context, "duty"))

    def _calc_bend(self, context, output):
        beam, axes = self._beam, len(self._chains)
        last = self._part(context, "heat").reshape(len(self._levers), -1)[:, -1]
        gain = np.array([beam.sensor_gain, beam.sensor_gain_e3])[:axes]
        offset = np.array([beam.sensor_offset, beam.sensor_offset_e3])[:axes]
        gain = gain + beam.sensor_warming * (last.mean() - self._room)
        shift = beam.sensor_shift * (self._levers.T @ last) + offset
        output.SetFromVector(gain * self._part(context, "play") + shift)

    def _calc_temperature(self, context, output):
        output.SetFromVector(self._part(context, "heat").reshape(len(self._levers), -1)[:, 0])

    def _calc_joints(self, context, output):
        beam = self._part(context, "beam").reshape(len(self._chains), -1)
        angles, rates = beam[:, :JOINTS], beam[:, JOINTS : 2 * JOINTS]
        shown = np.zeros((2, self._described.layout.num_joints))
        for axis, joints in enumerate(self._described.layout.bend_joints):
            shown[:, joints] = [self._shown[axis][0] @ row[axis] for row in (angles, rates)]
        # Exact already for a sensor that adds up angles; one that sees the chord is curved.
        bend = self._exact_bend(angles, self._part(context, "twist"))
        for _ in self._chains:
            error = bend - self._sensor.exact_bends(self._described.chains[0], shown[0])
            for axis, joints in enumerate(self._described.layout.bend_joints):
                shown[0, joints] += self._shown[axis][1] * error[axis]
        output.SetFromVector(shown.ravel())

    def _calc_duty(self, context, output):
        output.SetFromVector(self._applied_duty(context))


class WalkingSensors(LeafSystem):
    """Samples thermocouples and bend, with noise, steps, a random walk and missing samples.

    - input 0 ``thermocouples``: V (W), °C
    - input 1 ``bend``: φ (F), rad
    - output 0 ``measured_temperature``: V (W), °C
    - output 1 ``bend_angle``: φ (F), rad
    - output 2 ``measurement``: [V (W), φ (F)]
    - state, discrete: the same; the walk, rad; how many numbers of the noise were used
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, specimen: ContinuumSpecimen, bend_rate: float):
        """
        Args:
            specimen: the limb, whose state counts the numbers of the noise.
            bend_rate: rate at which the bend sensor is read, Hz.
        """
        super().__init__()
        self._specimen, (self._beam,) = specimen, specimen.segments
        (self._draws,) = specimen.state.get("draws", np.zeros(1))
        self._walk_step = self._beam.sensor_walk / np.sqrt(bend_rate)
        self._missing_below = ndtri(self._beam.missing)
        self._num_wires = num_wires = len(specimen.wires)
        self._num_bends = num_bends = specimen.description.segments[0].axes
        readings = self.DeclareDiscreteState(num_wires + num_bends)
        self.DeclareDiscreteState(num_bends)
        self.DeclareDiscreteState([self._draws])
        self.DeclareVectorInputPort("thermocouples", num_wires)
        self.DeclareVectorInputPort("bend", num_bends)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._start))
        for period, sample in (
            (THERMOCOUPLE_PERIOD, self._sample_temperature),
            (1 / bend_rate, self._sample_bend),
        ):
            self.DeclarePeriodicDiscreteUpdateEvent(period, period, weak_method(sample))
        declare_state_output(self, "measured_temperature", readings, slice(0, num_wires))
        declare_state_output(self, "bend_angle", readings, slice(num_wires, num_wires + num_bends))
        self.DeclareStateOutputPort("measurement", readings)

    def _draw(self, state, count: int) -> np.ndarray:
        draws = state.get_mutable_value(2)
        start = int(draws[0])
        draws[0] = start + count
        self._specimen.state = self._specimen.state | {"draws": np.array([draws[0]])}
        return self._specimen.noise.read(start, count)

    def _start(self, context, state):
        state.get_mutable_value(1)[:] = 0.0
        self._read_temperature(context, state)
        self._read_bend(context, state, 0.0)

    def _sample_temperature(self, context, state):
        if self._draw(state, 1)[0] > self._missing_below:
            self._read_temperature(context, state)

    def _sample_bend(self, context, state):
        missing, *walk = self._draw(state, 1 + self._num_bends)
        state.get_mutable_value(1)[:] += self._walk_step * np.array(walk)
        if missing > self._missing_below:
            self._read_bend(context, state, state.get_mutable_value(1))

    def _read_temperature(self, context, state):
        noise = THERMOCOUPLE_NOISE * self._draw(state, self._num_wires)
        read = np.rint((self.get_input_port(0).Eval(context) + noise) / THERMOCOUPLE_STEP)
        state.get_mutable_value(0)[: self._num_wires] = THERMOCOUPLE_STEP * read

    def _read_bend(self, context, state, walk: ArrayLike):
        read = self.get_input_port(1).Eval(context) + walk
        read = read + self._beam.sensor_noise * self._draw(state, self._num_bends)
        state.get_mutable_value(0)[self._num_wires :] = BEND_STEP * np.rint(read / BEND_STEP)


MARTENSITE_YIELD = 0.25  # rad of stretch, at which detwinning martensite yields; ours
MULLINS_RANGE = 0.3  # of x², over which rubber stiffens to its virgin curve; ours


def _draw_side(uniform, kind: ContinuumWire) -> ContinuumWire:
    """One of a limb's wires, which are of one spool, but coiled and bonded by hand."""
    shares = {  # by which the sides may differ from their kind, ours
        **dict.fromkeys(("heating", "bend"), 0.08),  # length of the coil, its place in the limb
        **dict.fromkeys(("radius", "latent_heat", "resistance_drop"), 0.05),
        **dict.fromkeys(("contact_time", "relief", "lag", "second_lag"), 0.15),  # glue
    }
    changes = {
        name: getattr(kind, name) * uniform(1 - share, 1 + share) for name, share in shares.items()
    }
    changes["middle"] = kind.middle + uniform(-1.5, 1.5)  # °C, by the stress at rest
    return dataclasses.replace(kind, **changes, leak=uniform(0.0, 0.12), pick_up=uniform(-0.5, 1.5))
