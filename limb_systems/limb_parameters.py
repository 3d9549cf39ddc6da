"""The limb in one YAML file: geometry, mechanics, wires, limits.

Every field of the dataclasses below carries its unit and the range that is
accepted, so that the documentation, the validation and the error messages
cannot drift apart.
"""

import dataclasses
import hashlib
import math

import numpy as np

from limb_systems.bend_sensor import BendSensor, TipTangentSensor
from limb_systems.errors import reraise_as
from limb_systems.files.described import Described, ParameterError, check_density, check_name
from limb_systems.files.provenance import Provenance
from limb_systems.files.schema import Strict, Tagged, quantity, rare, validate
from limb_systems.heat_bounds import BOUND_PAIRS, HeatBounds
from limb_systems.segment_chain import SegmentChain
from limb_systems.wire_laws import coupled, threshold, two_mass  # noqa: F401 - files name laws
from limb_systems.wire_laws.linear import LinearLaw
from limb_systems.wire_laws.wire_law import WireLaw

FORMAT = 2  # of the YAML file
MAX_SEGMENTS, MAX_JOINTS = 50, 500
# The least share of a wire's torque that bends the limb in its plane.
MIN_IN_PLANE_SHARE = 0.01
MAX_USUAL_DENSITY = 4.0  # relative to water; filled silicone has 2


@dataclasses.dataclass
class WireParameters(Strict):
    """One shape-memory-alloy wire: its name, where it runs, and its law.

    - ``name``: letters, digits and underscores; it names columns in files.
    - ``e2``, ``e3``: place in the cross-section, m from the axis. Its
      torque has the direction of this lever: a wire at e2 > 0, e3 = 0 bends
      towards +E2 with all of its law's torque, one at 45° with 1/√2 of it, and,
      if the segment has two axes, as much towards +E3.
    - ``law``: heat, torque and reading of the wire; `LinearLaw` is the paper's.
    - ``heat_bounds``: bounds within which a board expects the wire to heat and cool; None
      until it is calibrated, which means bounds around its law.
    """

    name: str = ""
    e2: float = quantity(0.0034, "m", -1.0, 1.0)
    e3: float = quantity(0.0, "m", -1.0, 1.0)
    law: LinearLaw | WireLaw = dataclasses.field(default_factory=LinearLaw)
    heat_bounds: HeatBounds | None = None

    @classmethod
    def at(cls, name: str, degrees: float, radius: float = 0.0034) -> "WireParameters":
        """Return a wire at an angle from +E2 towards +E3, and at a distance from the axis, m."""
        angle = np.deg2rad(degrees)
        # Rounding and adding zero avoid -0.0 and 1e-18, which files would show.
        e2 = float(radius * np.cos(angle).round(15)) + 0.0
        e3 = float(radius * np.sin(angle).round(15)) + 0.0
        return cls(name, e2=e2, e3=e3)

    @property
    def lever(self) -> np.ndarray:
        """The direction of the torque: shares (2,) that bend towards +E2 and +E3."""
        return np.array([self.e2, self.e3]) / np.hypot(self.e2, self.e3)

    @property
    def angle(self) -> float:
        """The angle of the wire from +E2 towards +E3, rad; setting it keeps the distance."""
        return float(np.arctan2(self.e3, self.e2))

    @angle.setter
    def angle(self, value: float) -> None:
        radius = np.hypot(self.e2, self.e3)
        self.e2 = float(radius * np.cos(value))
        self.e3 = float(radius * np.sin(value))


@dataclasses.dataclass
class RestMemory(Strict):
    """The angle at which the rubber rests remembers which wire was hot last.

    While a wire heats, the rest angle moves to its side: by the bend angle g
    that the wire's torque alone would hold, the share 1 - exp(-λ g) of the way.

    - ``shift``: Δ, deviation of the rest angle that a wire leads to in the end, rad.
    - ``rate``: λ, per bend angle, 1/rad.
    """

    shift: float = quantity(0.0305, "rad", 0.0, 0.5)
    rate: float = quantity(2.0, "1/rad", 0.0, 100.0)


def wires_around(count: int) -> list[WireParameters]:
    """Return wires ``wire_1``, ... at equal angles around the axis, the first at +E2."""
    degrees = 360.0 * np.arange(count) / count
    return [WireParameters.at(f"wire_{index + 1}", angle) for index, angle in enumerate(degrees)]


def _left_and_right() -> list[WireParameters]:
    return [WireParameters("left", e2=-0.0034), WireParameters("right", e2=0.0034)]


@dataclasses.dataclass
class SegmentParameters(Strict):
    """One segment: a silicone beam cut into equal rigid links, with its wires.

    It bends in the plane of E1 and E2, as the paper's, or about two axes.

    - ``links``: number of rigid links, each with a revolute joint at its base for each axis.
    - ``length``: length of the whole segment along E1, m.
    - ``mass``: mass of the whole segment, kg.
    - ``width``: cross-section along the bending axis (E3), m.
    - ``thickness``: cross-section in the bending plane (E2), m.
    - ``stiffness``: torsional spring constant k of each joint, N·m/rad (1).
    - ``damping``: damping constant σ of each joint, N·m·s/rad (1).
    - ``rest_angle``: bend angle φ towards +E2 at rest with cold wires, rad.
    - ``stiffening``: s, share that is added to k where the segment bends by 45°
      from its rest angle.
    - ``rest_memory``: change of the rest angle with use; None if there is none.
    - ``wires``: `WireParameters`; by default the paper's two, left and right.
      Heating the right one bends towards +E2.
    - ``bend_sensor``: sensor of the bend: `TipTangentSensor`, the paper's (8),
      `ChordSensor`, or another `BendSensor`.
    - ``axes``: 1 if joints turn about E3 alone, 2 if they turn about E2, too.
    - ``twists``: whether each link also has a joint that turns about E1.
    - ``centred_joints``: whether joints are in the middle of the pieces that the length is cut
      into, where a chain comes nearer to a beam, instead of at their bases.
    - ``stiffness_ratio``: stiffness against bends towards E3, as a share of k.
    - ``torsional_ratio``: stiffness against twist, as a share of k; a round section of rubber
      has GJ/EI = 2/3.
    - ``rest_angle_e3``: bend angle towards +E3 at rest with cold wires, rad.
    - ``name``: name in files and messages. If it is empty, segments of a limb with several
      segments are named by their numbers.
    """

    links: int = quantity(5, "links", 1, 100)
    length: float = quantity(0.10, "m", 1e-3, 10.0)
    mass: float = quantity(0.025, "kg", 1e-6, 100.0)
    width: float = quantity(0.020, "m", 1e-4, 1.0)
    thickness: float = quantity(0.010, "m", 1e-4, 1.0)
    stiffness: float = quantity(0.1246, "N·m/rad", 1e-6, 1e4)
    damping: float = quantity(1.0e-3, "N·m·s/rad", 0.0, 1e2)
    rest_angle: float = quantity(0.0, "rad", -1.5, 1.5)
    stiffening: float = quantity(0.0, "of k", 0.0, 10.0)
    rest_memory: RestMemory | None = None
    wires: list[WireParameters] = dataclasses.field(default_factory=_left_and_right)
    bend_sensor: TipTangentSensor | BendSensor = dataclasses.field(default_factory=TipTangentSensor)
    axes: int = quantity(1, "axes", 1, 2, rare=True)
    twists: bool = rare(False)
    centred_joints: bool = rare(False)
    stiffness_ratio: float = quantity(1.0, "of k", 0.01, 100.0, rare=True)
    torsional_ratio: float = quantity(2 / 3, "of k", 0.01, 100.0, rare=True)
    rest_angle_e3: float = quantity(0.0, "rad", -1.5, 1.5, rare=True)
    name: str = rare("")

    @property
    def joints(self) -> list[list[str]]:
        """The kinds of each link's joints, base first: "e2", "e3" and "twist".

        "e2" and "e3" bend towards +E2 and +E3. Each link begins with the kind that ends the link
        before, twists included: errors of the order in which joints turn then nearly cancel.
        """
        joints = ["e2", "e3"][: self.axes] + ["twist"] * self.twists
        return [joints if link % 2 == 0 else joints[::-1] for link in range(self.links)]

    @property
    def chain(self) -> SegmentChain:
        """The kinematics of the segment."""
        return SegmentChain(self.joints, self.centred_joints)

    @property
    def joint_ratios(self) -> dict[str, float]:
        """The stiffness and damping of each kind of joint, as shares of k and σ."""
        return {"e2": 1.0, "e3": self.stiffness_ratio, "twist": self.torsional_ratio}

    @property
    def joint_rest_angles(self) -> dict[str, float]:
        """The angle of each kind of joint at rest with wires that were never heated, rad, (11)."""
        angle_by_bend = self.chain.equal_angle
        return {
            "e2": angle_by_bend * self.rest_angle,
            "e3": angle_by_bend * self.rest_angle_e3,
            "twist": 0.0,
        }

    def wire(self, name: str) -> WireParameters:
        """Return the wire of a name.

        Raises:
            ParameterError: if there is none.
        """
        for wire in self.wires:
            if wire.name == name:
                return wire
        names = ", ".join(wire.name for wire in self.wires)
        raise ParameterError(f"This segment has no wire {name!r}; it has {names}.")


@dataclasses.dataclass
class TemperatureLimits(Strict):
    """Bounds on the wire temperature T, eqns (19)-(20), and on its reading V.

    - ``maximum``: T_max, °C, never exceeded (19).
    - ``warm``: T_warm, °C, kept after the warm-up (20).
    - ``warm_up_time``: k_warm, s, from the start of a plan (20).
    - ``measured_maximum``: °C, reading at which the board's firmware cuts out; plans stay below.

    None of them is above 200 °C, which silicone rubber stands for long; wires of nickel-titanium
    lose their trained shape from there on.
    """

    maximum: float = quantity(100.0, "°C", -50.0, 200.0)
    warm: float = quantity(45.0, "°C", -50.0, 200.0)
    warm_up_time: float = quantity(20.0, "s", 0.0, 3600.0)
    measured_maximum: float = quantity(110.0, "°C", -50.0, 200.0)


class BoardIdentity(Tagged):
    """The identity of the limb that the parameters belong to: `NoBoard`, or another subclass."""

    @property
    def identity(self) -> str:
        """A text that differs between any two boards; empty if there is none."""
        return ""


@dataclasses.dataclass
class NoBoard(BoardIdentity):
    """No particular limb, but a kind of limbs."""


@dataclasses.dataclass
class SerialBoard(BoardIdentity):
    """The limb on a board with this serial number."""

    serial_number: str

    @property
    def identity(self) -> str:
        """The serial number."""
        return self.serial_number


@dataclasses.dataclass
class EmulatedLimb(BoardIdentity):
    """An emulated limb.

    - ``seed``: seed of the random numbers that it was drawn with.
    - ``description``: YAML text of the `LimbParameters` that it was drawn
      around; empty for the nominal limb.
    - ``absent``: effects that were taken out of it.
    - ``extra``: effects that only this emulated limb has.
    - ``disturbances``: later changes, each a name and a number.
    - ``physics``: name of its physics, "lumped" or the name that a module of yours defines.
    - ``limb``: name of the limb, if it is one of an emulated robot; empty for a limb alone and for
      a whole robot. The other fields then describe the robot, and ``description`` is the YAML
      text of its `RobotParameters`.
    """

    seed: int
    description: str = dataclasses.field(default="", metadata={"lines": True})
    absent: list[str] = dataclasses.field(default_factory=list)
    extra: list[str] = dataclasses.field(default_factory=list)
    disturbances: list[str] = dataclasses.field(default_factory=list)
    physics: str = "lumped"
    limb: str = ""

    @property
    def identity(self) -> str:
        """A text of the fields, by which limbs differ.

        A field after ``extra`` has its name, and is left out at its default value. If a later
        version adds a field, all other limbs keep their numbers.
        """
        counted: list[object] = [self.seed, self.description, self.absent, self.extra]
        for field in dataclasses.fields(self)[len(counted) :]:
            value = getattr(self, field.name)
            if value and value != field.default:
                counted.append((field.name, value))
        return repr(tuple(counted))

    @property
    def serial_number(self) -> str:
        """The serial number of the emulated board of the limb: eight letters and digits."""
        if self == EmulatedLimb(self.seed) and self.seed < 10_000:
            return f"twin{self.seed:04d}"
        return f"t{hashlib.sha256(self.identity.encode()).hexdigest()[:7]}"


@dataclasses.dataclass
class CalibrationRecord(Strict):
    """The accuracy of calibrated parameters, and the recordings that they were fitted to.

    - ``names``: names of the P parameters, such as "right.a1".
    - ``values``, ``standard_errors``: estimates and their errors (P), in their units.
    - ``covariance``: (P, P), in the products of their units. The diagonal has the squared
      standard errors. Off the diagonal are the covariances of a1, a2 and a3 of each wire, and
      of the β of all wires with k, of which each β is a multiple; all others were not
      estimated and are zero.
    - ``recordings``: a line on each kind of recording: their number and their limb.
    - ``validation``: a line on the prediction error of a recording that was not
      used in any fit; empty if there was none.
    - ``bend_error``, ``temperature_error``: mean errors of open-loop predictions
      of such recordings, of the bend, rad, and of the readings, °C; 0 if unknown.
    - ``heat_measured``: whether thermocouples were read. If not, temperatures are estimated from
      the duty by a2 as described, and `TemperatureLimits.maximum` limits the estimate.
    - ``provenance``: stamp of the program and command that made it; None if unknown.
      Comparisons of records leave it out.
    """

    names: list[str]
    values: list[float]
    standard_errors: list[float]
    covariance: list[list[float]]
    recordings: list[str] = dataclasses.field(default_factory=list)
    validation: str = ""
    bend_error: float = quantity(0.0, "rad", 0.0, 3.2)
    temperature_error: float = quantity(0.0, "°C", 0.0, 500.0)
    heat_measured: bool = rare(True)
    provenance: Provenance | None = dataclasses.field(default=None, compare=False)


@dataclasses.dataclass
class LimbParameters(Described):
    """A limb: segments in series from the base to the tip, and where it is.

    ``LimbParameters()`` is the nominal limb, one segment of five links with
    the paper's 10° sag under gravity.

    - ``format``: version of the file's format.
    - ``segments``: one or more `SegmentParameters`, base first.
    - ``ambient_temperature``: T0, °C (4), (6).
    - ``gravity``: acceleration in the frame (E1, E2, E3), m/s². Zero, the
      default, is the paper's mounting, with the bending axis vertical and
      stiff against gravity; (0, -9.81, 0) is the cantilever of Sec. V-A.
    - ``temperature_limits``: eqns (19)-(20).
    - ``total_duty``: the largest sum of the duties of all wires at one time that supply and limb
      are made for.
    - ``payload``: mass of a point at the tip, kg.
    - ``supply_voltage``: voltage of the wires' supply, as it was measured when the limb was
      calibrated, V; 0 if nobody measured it.
    - ``board``: the particular limb that these parameters were calibrated on,
      `SerialBoard` or `EmulatedLimb`; `NoBoard` if none.
    - ``calibration``: accuracy of the parameters, `CalibrationRecord`; None if
      they were not calibrated.

    Wires are in the order of their segments, base first; joints are from the
    base to the tip.
    """

    format: int = quantity(FORMAT, "", FORMAT, FORMAT)
    segments: list[SegmentParameters] = dataclasses.field(
        default_factory=lambda: [SegmentParameters()]
    )
    ambient_temperature: float = quantity(25.0, "°C", -50.0, 100.0)
    gravity: list[float] = quantity((0.0, 0.0, 0.0), "m/s²", -100.0, 100.0)
    temperature_limits: TemperatureLimits = dataclasses.field(default_factory=TemperatureLimits)
    total_duty: float = quantity(1.5, "of full duty", 0.01, 100.0)
    board: NoBoard | BoardIdentity = dataclasses.field(default_factory=NoBoard)
    calibration: CalibrationRecord | None = None
    payload: float = quantity(0.0, "kg", 0.0, 100.0, rare=True)
    supply_voltage: float = quantity(0.0, "V", 0.0, 1000.0, rare=True)

    @classmethod
    def in_space(cls, wires: int = 3, links: int = 5) -> "LimbParameters":
        """Return the nominal limb with a square section, two axes, and wires around the axis."""
        segment = SegmentParameters(links, axes=2, width=0.0125, thickness=0.0125)
        segment.mass = 0.02
        segment.wires = wires_around(wires)
        return cls(segments=[segment])

    def plausibility_warnings(self, where: str = "") -> list[str]:
        """Return warnings about the segments; see `Described.plausibility_warnings`."""
        warnings: list[str] = []
        for index, segment in enumerate(self.segments):
            warnings += _plausibility_warnings(segment, f"{where}segments[{index}]")
        return warnings

    def without_provenance(self) -> "LimbParameters":
        """Return these parameters without the provenance of their calibration."""
        if self.calibration is None:
            return self
        record = dataclasses.replace(self.calibration, provenance=None)
        return dataclasses.replace(self, calibration=record)

    def validate(self) -> None:
        """Raise ParameterError for the first field that is out of its range."""
        # Check lists whose lengths are limited.
        if not isinstance(self.segments, list) or not self.segments:
            raise ParameterError("segments is empty; a limb has at least one segment.")
        if len(self.segments) > MAX_SEGMENTS:
            raise ParameterError(
                f"segments has {len(self.segments)} elements; a limb has at most {MAX_SEGMENTS}."
            )
        if not isinstance(self.gravity, list) or len(self.gravity) != 3:
            raise ParameterError(
                f"gravity is {self.gravity!r}; it must be a list of three numbers from -100 to "
                "100 m/s², along E1, E2 and E3."
            )
        # Check each field against its range.
        with reraise_as(ParameterError):
            validate(self)
        # Check fields against each other.
        if self.num_joints > MAX_JOINTS:
            raise ParameterError(
                f"the limb has {self.num_joints} joints in all; at most {MAX_JOINTS} can be "
                "computed with, so describe its segments with fewer links."
            )
        for index, segment in enumerate(self.segments):
            _validate_wires(segment, f"segments[{index}].wires")
            check_density(segment.mass, _sizes(segment), f"segments[{index}]")
            if segment.twists and segment.axes == 1:
                raise ParameterError(
                    f"segments[{index}].twists is true, but the segment bends in a plane, where "
                    "nothing twists it; set its axes to 2, or leave twists out."
                )
        # Check that the limits are in order.
        limits = self.temperature_limits
        if limits.maximum <= self.ambient_temperature:
            raise ParameterError(
                f"temperature_limits.maximum is {limits.maximum:g} °C; it must be above "
                f"ambient_temperature, which is {self.ambient_temperature:g} °C."
            )
        if limits.warm >= limits.maximum:
            raise ParameterError(
                f"temperature_limits.warm is {limits.warm:g} °C; it must be below "
                f"temperature_limits.maximum, which is {limits.maximum:g} °C."
            )

    @property
    def length(self) -> float:
        """The length of all segments, m."""
        return sum(segment.length for segment in self.segments)

    @property
    def num_joints(self) -> int:
        """The number of joints of all segments."""
        return sum(segment.links * len(segment.joints[0]) for segment in self.segments)

    @property
    def wires(self) -> list[WireParameters]:
        """All wires, base first."""
        wires: list[WireParameters] = []
        for segment in self.segments:
            wires += segment.wires
        return wires

    @property
    def wire_names(self) -> list[str]:
        """The names of all wires, unique in the limb.

        The name of the segment is before the wire's name. Wires of segments without a name have the
        segment's number after their names, if there are several segments.
        """
        names: list[str] = []
        for number, segment in enumerate(self.segments, 1):
            prefix = f"{segment.name}_" if segment.name else ""
            suffix = f"_{number}" if len(self.segments) > 1 and not segment.name else ""
            names += [f"{prefix}{wire.name}{suffix}" for wire in segment.wires]
        return names

    @property
    def segment_suffixes(self) -> list[str]:
        """The suffix of each segment in names of signals, such as ``_2`` or ``_rear``.

        It is empty for a limb of one segment without a name.
        """
        suffixes: list[str] = []
        for number, segment in enumerate(self.segments, 1):
            has_suffix = segment.name or len(self.segments) > 1
            suffixes.append(f"_{segment.name or number}" if has_suffix else "")
        return suffixes

    @property
    def bend_suffixes(self) -> list[str]:
        """The suffix of each bend, such as ``_2_e3``; a segment with one bend has no axis in it."""
        suffixes: list[str] = []
        for segment, suffix in zip(self.segments, self.segment_suffixes, strict=True):
            suffixes += [suffix] if segment.axes == 1 else [f"{suffix}_e2", f"{suffix}_e3"]
        return suffixes

    @property
    def heat_is_measured(self) -> bool:
        """True if boards may heat the limb; False if a calibration had no thermocouples."""
        return self.calibration is None or self.calibration.heat_measured

    @property
    def heat_bounds(self) -> list[HeatBounds]:
        """The heat bounds of all wires (W): calibrated bounds, or else bounds around their laws.

        A law that was fitted without bounds serves plans and does not bound the heat, so
        that its wire has the bounds of the nominal wire.

        Raises:
            LimbError: if a law has no `WireLaw.typical_rates`, or its rates are
                beyond the range that a board accepts.
        """
        bounds = []
        for wire in self.wires:
            law = LinearLaw() if self.calibration else wire.law
            bounds.append(wire.heat_bounds or HeatBounds.around(law))
        return bounds


def _plausibility_warnings(segment: SegmentParameters, where: str) -> list[str]:
    """Return warnings about a segment, for `LimbParameters.plausibility_warnings`."""
    warnings = []
    # Compare the density with rubber.
    density = segment.mass / (1000.0 * math.prod(_sizes(segment).values()))  # relative to water
    if not 1 / MAX_USUAL_DENSITY < density < MAX_USUAL_DENSITY:
        warnings.append(
            f"{where}.mass is {segment.mass:g} kg, {density:.2g} times the water that its "
            "length, width and thickness hold; are all of them right?"
        )
    # Find wires that run outside the segment.
    for index, wire in enumerate(segment.wires):
        extents = ("e2", wire.e2, segment.thickness), ("e3", wire.e3, segment.width)
        for name, value, extent in extents:
            if abs(value) > extent / 2:
                warnings.append(
                    f"{where}.wires[{index}].{name} is {value:g} m, outside the segment, which is "
                    f"{extent:g} m across."
                )
    # Find directions in which no wire pulls.
    if segment.axes == 2:
        angles = np.sort([wire.angle for wire in segment.wires])
        gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
        if gaps.max() > np.pi - 1e-9:
            middle = np.rad2deg(angles[gaps.argmax()] + gaps.max() / 2)
            warnings.append(
                f"the wires of {where} do not surround its axis, so that none can bend it towards "
                f"{180 - (180 - middle) % 360:.0f}° from +E2; is a sign missing?"
            )
        return warnings
    signs = np.unique(np.sign([wire.e2 for wire in segment.wires]))
    if len(segment.wires) > 1 and len(signs) == 1:
        warnings.append(
            f"all wires of {where} run on the same side (e2 {'>' if signs[0] > 0 else '<'} 0), so "
            "that none can bend it back; is a sign missing?"
        )
    return warnings


def _sizes(segment: SegmentParameters) -> dict[str, float]:
    """Return the length, width and thickness of a segment by their names, m."""
    return {"length": segment.length, "width": segment.width, "thickness": segment.thickness}


def _validate_wires(segment: SegmentParameters, where: str) -> None:
    """Raise ParameterError for the first wire whose name, bounds or place is invalid."""
    wires = segment.wires
    if not wires:
        raise ParameterError(f"{where} is empty; a segment has at least one wire.")
    names = [wire.name for wire in wires]
    for index, wire in enumerate(wires):
        # Check the name and the heat bounds.
        check_name(names, index, f"{where}[{index}]", "wire of the segment")
        for low_name, high_name in BOUND_PAIRS if wire.heat_bounds else ():
            low = getattr(wire.heat_bounds, low_name)
            high = getattr(wire.heat_bounds, high_name)
            if low > high:
                raise ParameterError(
                    f"{where}[{index}].heat_bounds.{low_name} is {low:g}; it must not "
                    f"be above {high_name}, which is {high:g}."
                )
        # Check that the wire can bend the segment.
        if segment.axes == 2 and wire.e2 == wire.e3 == 0:
            raise ParameterError(
                f"{where}[{index}] is at e2 = e3 = 0 m, on the axis, where it cannot bend the "
                "limb; give the place at which it runs beside the axis, or leave the wire out."
            )
        smallest_e2 = MIN_IN_PLANE_SHARE * np.hypot(wire.e2, wire.e3)
        if segment.axes == 1 and abs(wire.e2) <= smallest_e2:
            raise ParameterError(
                f"{where}[{index}] is at e2 = {wire.e2:g} m and e3 = {wire.e3:g} m, where it "
                "cannot bend the limb sideways; give the e2 at which it runs beside the axis, or "
                "leave the wire out."
            )
