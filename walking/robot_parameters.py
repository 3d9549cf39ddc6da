"""A robot of several limbs in one YAML file: a body, limbs on it, their feet and the ground."""

import copy
import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydrake.math import RollPitchYaw, RotationMatrix

from limb_systems.connected_limbs import ConnectedLimbs
from limb_systems.errors import reraise_as
from limb_systems.files.described import ParameterError, check_density, check_name
from limb_systems.files.output import free_path
from limb_systems.files.schema import Strict, quantity, validate
from limb_systems.layout import slices
from limb_systems.limb_parameters import (
    BoardIdentity,
    CalibrationRecord,
    EmulatedLimb,
    LimbParameters,
    NoBoard,
    SegmentParameters,
    SerialBoard,
)
from urdf.generate import CONTACT_STIFFNESS, RELAXATION_TIME

FORMAT_VERSION = 1  # of the YAML file
# The names of the numbers of the body's pose, by its mount, and the names of its angles.
POSE_NAMES: dict[str, tuple[str, ...]] = {
    "welded": (),
    "planar": ("x", "z", "pitch"),
    "free": ("x", "y", "z", "roll", "pitch", "yaw"),
}
ANGLES = ("roll", "pitch", "yaw")
MAX_LIMBS = 20
MAX_HIP_DISTANCE = 3.0  # of a hip, in lengths of body and limb
MAX_COSINE = 1e-6  # largest cosine between directions that are at right angles


@dataclasses.dataclass
class BodyParameters(Strict):
    """The rigid body that carries the limbs, a box about the origin of its frame.

    - ``mount``: "planar" if it moves in the vertical plane of x and z, "free" if in space,
      "welded" if it is fixed to the world.
    - ``length``, ``width``, ``height``: along x (forward), y and z (up), m.
    - ``mass``: kg; its centre is the box's.
    - ``inertia``: moments of inertia about x, y and z through the centre, kg·m², none of them
      larger than the sum of the other two, apart from rounding; a homogeneous box's if None.
    """

    mount: str = "planar"
    length: float = quantity(0.07, "m", 1e-3, 10.0)
    width: float = quantity(0.03, "m", 1e-3, 10.0)
    height: float = quantity(0.01, "m", 1e-3, 10.0)
    mass: float = quantity(0.020, "kg", 1e-6, 100.0)
    inertia: list[float] | None = dataclasses.field(
        default=None, metadata={"unit": "kg·m²", "range": (1e-12, 1e3)}
    )

    @property
    def size(self) -> float:
        """The longest side, m."""
        return max(self.length, self.width, self.height)

    @property
    def moments(self) -> np.ndarray:
        """Moments of inertia about x, y and z (3,), kg·m²."""
        if self.inertia is not None:
            moments = np.array(self.inertia)
            # Rounded moments of a plate may break the triangle inequality, for which Drake would
            # replace all of them.
            return np.minimum(moments, moments.sum() - moments)
        squares = np.square([self.length, self.width, self.height])
        return self.mass / 12 * (squares.sum() - squares)


@dataclasses.dataclass
class RobotLimb(Strict):
    """A limb of a robot, and where it is on the body.

    - ``name``: letters, digits and underscores; it names ports, joints and columns in files.
    - ``position``: place of the limb's base in the body's frame, m.
    - ``e1``, ``e2``: directions of the limb's axes E1 and E2 in the body's frame: where the
      straight limb points to, and where its wires on the +E2 side bend it to.
    - ``parameters``: the limb; its ``gravity`` and ``total_duty`` are the robot's here.
    """

    name: str
    position: list[float] = quantity((0.0, 0.0, 0.0), "m", -10.0, 10.0)
    e1: list[float] = quantity((0.0, 0.0, -1.0), "", -1.0, 1.0)
    e2: list[float] = quantity((1.0, 0.0, 0.0), "", -1.0, 1.0)
    parameters: LimbParameters = dataclasses.field(default_factory=LimbParameters)

    @property
    def axes(self) -> np.ndarray:
        """E1, E2 and E3 in the body's frame, side by side (3, 3)."""
        e1 = np.array(self.e1) / np.linalg.norm(self.e1)
        e2 = self.e2 - np.dot(e1, self.e2) * e1
        e2 = e2 / np.linalg.norm(e2)
        return np.column_stack([e1, e2, np.cross(e1, e2)])

    @property
    def straight_height(self) -> float:
        """Height of the straight limb's tip over the body's origin, m."""
        return self.position[2] + self.axes[2, 0] * self.parameters.length

    @property
    def rpy(self) -> np.ndarray:
        """Roll, pitch and yaw of the limb's base in the body's frame (3,), rad, as in URDF."""
        return RollPitchYaw(RotationMatrix(self.axes)).vector()


@dataclasses.dataclass
class FootParameters(Strict):
    """The feet, spheres about the tips of the limbs.

    - ``radius``: m.
    - ``mass``: mass of each, kg.
    - ``stiffness``: force by which the ground presses a foot in, per depth, N/m. Along the ground
      feet are rigid.
    - ``damping``: the same force per speed, N·s/m.
    """

    radius: float = quantity(0.001, "m", 1e-4, 0.1)
    mass: float = quantity(0.0, "kg", 0.0, 10.0)
    stiffness: float = quantity(2e4, "N/m", 1.0, 1e6)
    damping: float = quantity(200.0, "N·s/m", 0.0, 1e5)


def soft_feet() -> FootParameters:
    """Pads of soft silicone, 6 mm wide, over which more than three limbs share a robot's weight."""
    return FootParameters(radius=0.003, stiffness=200.0, damping=2.0)


@dataclasses.dataclass
class GroundParameters(Strict):
    """The ground, a plane.

    - ``friction``: Coulomb's μ between it and all that touches it, at rest and sliding.
    - ``slope``: angle by which it rises along x, rad.
    """

    friction: float = quantity(0.3, "", 0.0, 10.0)
    slope: float = quantity(0.0, "rad", -1.5, 1.5)


def walking_limb() -> LimbParameters:
    """A limb of 6 cm that is stiff enough to stand on: k = 0.2077 N·m/rad, 15 g."""
    segment = SegmentParameters(length=0.06, mass=0.015, stiffness=0.2077)
    return LimbParameters(segments=[segment])


def walking_limb_in_space() -> LimbParameters:
    """A limb like `walking_limb` with a square section: three wires and links, two bending axes."""
    limb = LimbParameters.in_space(wires=3, links=3)
    segment = limb.segments[0]
    planar = walking_limb().segments[0]
    segment.length = planar.length
    segment.mass = planar.mass
    segment.stiffness = planar.stiffness
    return limb


def _limbs_in_space(limbs: int) -> list[RobotLimb]:
    """Return three limbs on a circle of 4 cm that bend outward, or four limbs at corners.

    The first wire bends each of three limbs outward, and each of four limbs forward.
    """
    robot_limbs = []
    if limbs == 3:
        angles = {"rear": np.pi, "left": np.pi / 3, "right": -np.pi / 3}
        for name, angle in angles.items():
            outward = np.array([np.cos(angle), np.sin(angle), 0.0]).round(9) + 0.0  # not -0.0
            position = (0.04 * outward).tolist()
            robot_limbs.append(RobotLimb(name, position=position, e2=outward.tolist()))
    else:
        for side, y in (("left", 0.015), ("right", -0.015)):
            for end, x in (("rear", -0.03), ("front", 0.03)):
                name = f"{end}_{side}"
                robot_limbs.append(RobotLimb(name, position=[x, y, 0.0], e2=[1.0, 0.0, 0.0]))
    for limb in robot_limbs:
        limb.parameters = walking_limb_in_space()
    return robot_limbs


def _rear_and_front_limbs() -> list[RobotLimb]:
    """Return the two limbs of the crawler."""
    return [
        RobotLimb("rear", position=[-0.03, 0.0, 0.0], parameters=walking_limb()),
        RobotLimb("front", position=[0.03, 0.0, 0.0], parameters=walking_limb()),
    ]


@dataclasses.dataclass
class RobotParameters(ConnectedLimbs):
    """A robot: a body, limbs on it, their feet, and the ground that they are on.

    ``RobotParameters()`` is a crawler of 50 g with two limbs that hang down from its body.
    The world has x along the ground and z normal to it. The body's frame is x forward, z up.

    - ``format``: version of the file's format.
    - ``body``: `BodyParameters`.
    - ``limbs``: one or more `RobotLimb`; wires, bends and joints are in their order.
    - ``feet``: `FootParameters`.
    - ``ground``: `GroundParameters`; None if there is none.
    - ``gravity``: acceleration along x, y and z of a level world, m/s².
    - ``total_duty``: largest sum of the duties of all wires at one time, for which the supply is
      made.
    """

    format: int = quantity(FORMAT_VERSION, "", FORMAT_VERSION, FORMAT_VERSION)
    body: BodyParameters = dataclasses.field(default_factory=BodyParameters)
    limbs: list[RobotLimb] = dataclasses.field(default_factory=_rear_and_front_limbs)
    feet: FootParameters = dataclasses.field(default_factory=FootParameters)
    ground: GroundParameters | None = dataclasses.field(default_factory=GroundParameters)
    gravity: list[float] = quantity((0.0, 0.0, -9.81), "m/s²", -100.0, 100.0)
    total_duty: float = quantity(1.5, "of full duty", 0.01, 100.0)

    @classmethod
    def in_space(cls, limbs: int = 4) -> "RobotParameters":
        """A robot of three or four limbs that bend about two axes, on a body that moves in space.

        Four limbs have `soft_feet`: on hard ones, micrometres decide which of them carry the robot.

        Raises:
            ParameterError: for another number of limbs.
        """
        if limbs not in (3, 4):
            raise ParameterError(
                f"limbs is {limbs}; a robot in space has three or four by default, and any number "
                "in a description of yours."
            )
        robot = cls(body=BodyParameters(mount="free"), limbs=_limbs_in_space(limbs), total_duty=3.0)
        if limbs == 3:
            robot.body.length = robot.body.width = 0.09
        else:
            robot.feet = soft_feet()
        return robot

    @classmethod
    def of_limb(cls, limb: LimbParameters) -> "RobotParameters":
        """Return a robot of one limb on a welded body, with the limb's axes along the world's."""
        return cls(
            body=BodyParameters(mount="welded"),
            limbs=[RobotLimb("limb", e1=[1.0, 0.0, 0.0], e2=[0.0, 1.0, 0.0], parameters=limb)],
            ground=None,
            gravity=list(limb.gravity),
            total_duty=limb.total_duty,
        )

    @classmethod
    def of(cls, robot: "RobotParameters | LimbParameters | str | Path | None") -> "RobotParameters":
        """Return a robot from parameters or a file, see `LimbParameters.of`.

        A limb becomes a robot `of_limb`.
        """
        return super().of(cls.of_limb(robot) if isinstance(robot, LimbParameters) else robot)

    @classmethod
    def from_yaml(cls, text: str) -> "RobotParameters":
        """Parse YAML text of a robot, or of a limb, which becomes a robot `of_limb`."""
        if re.search(r"^segments:", text, re.MULTILINE):
            return cls.of_limb(LimbParameters.from_yaml(text))
        return super().from_yaml(text)

    def plausibility_warnings(self, where: str = "") -> list[str]:
        """Return sentences on implausible values of the limbs, see `Described`."""
        sentences = []
        for index, limb in enumerate(self.limbs):
            path = where if self.is_limb else f"{where}limbs[{index}].parameters."
            sentences += limb.parameters.plausibility_warnings(path)
        return sentences

    def without_provenance(self) -> "RobotParameters":
        """Return these parameters without the provenance of the limbs."""
        limbs = [
            dataclasses.replace(limb, parameters=limb.parameters.without_provenance())
            for limb in self.limbs
        ]
        return dataclasses.replace(self, limbs=limbs)

    def validate(self) -> None:
        """Raise ParameterError for the first field that is out of its range."""
        with reraise_as(ParameterError):
            validate(self)
        self._validate_body()
        self._validate_gravity()
        self._validate_limbs()
        self._validate_sizes()

    def _validate_body(self) -> None:
        """Raise ParameterError if the body's mount, mass or inertia is impossible."""
        body = self.body
        if body.mount not in POSE_NAMES:
            raise ParameterError(
                f"body.mount is {body.mount!r}; it must be one of {', '.join(POSE_NAMES)}."
            )
        if body.inertia is not None and (
            len(body.inertia) != 3 or 2 * max(body.inertia) > sum(body.inertia) * (1 + 1e-9)
        ):
            raise ParameterError(
                f"body.inertia is {body.inertia}; it must be three moments about x, y and z, none "
                "of them larger than the other two together."
            )
        sizes = {"length": body.length, "width": body.width, "height": body.height}
        check_density(body.mass, sizes, "body")
        largest = body.mass * body.size**2
        if body.moments.max() > largest:
            raise ParameterError(
                f"body.inertia is {body.inertia} kg·m², but a mass of {body.mass:g} kg at the far "
                f"end of the body would have {largest:.2g} kg·m²; is it in other units?"
            )

    def _validate_limbs(self) -> None:
        """Raise ParameterError if a limb is invalid, or if the limbs do not go together."""
        if not 1 <= len(self.limbs) <= MAX_LIMBS:
            raise ParameterError(
                f"limbs has {len(self.limbs)} elements; a robot has 1 to {MAX_LIMBS}."
            )
        names = self.limb_names
        for index, limb in enumerate(self.limbs):
            where = f"limbs[{index}]"
            check_name(names, index, where, "limb", taken="body")
            with reraise_as(ParameterError, f"{where}.parameters."):
                limb.parameters.validate()
            self._validate_place(limb, where)
            first = self.limbs[0].parameters
            for field in ("ambient_temperature", "temperature_limits"):
                if getattr(limb.parameters, field) != getattr(first, field):
                    raise ParameterError(
                        f"{where}.parameters.{field} differs from the value of limb {names[0]}; "
                        "the limbs of a robot share the air and the temperature limits, so make "
                        "them equal."
                    )

        wires = self.as_single_limb.wire_names
        if len(set(wires)) < len(wires):
            raise ParameterError(
                f"The names of limbs make the names of wires {', '.join(wires)}, of which some "
                "are the same; give the limbs other names."
            )

    def _validate_sizes(self) -> None:
        """Raise ParameterError if hips or feet look as if they were in other units."""
        # Compare places of limbs and the size of feet with body and limbs.
        size = self.body.size
        for index, limb in enumerate(self.limbs):
            length = limb.parameters.length
            distance = np.abs(limb.position).max()
            if distance > MAX_HIP_DISTANCE * (size + length):
                raise ParameterError(
                    f"limbs[{index}].position is {limb.position} m, {distance:g} m from the middle "
                    f"of a body of {size:g} m; is it in other units?"
                )
            if self.feet.radius > length / 2:
                raise ParameterError(
                    f"feet.radius is {self.feet.radius:g} m, more than half of a limb's length; is "
                    "it in mm?"
                )
        carried_mass = self.body.mass + sum(s.mass for s in self.as_single_limb.segments)
        if self.feet.mass > carried_mass:
            raise ParameterError(
                f"feet.mass is {self.feet.mass:g} kg, more than all the rest of the robot, which "
                f"is {carried_mass:g} kg; is it in grams?"
            )

        # Compare the depth to which the weight presses the feet in with their thickness.
        load = carried_mass * float(np.linalg.norm(self.gravity)) / len(self.limbs)
        depth = load / self.feet.stiffness
        if self.ground and self.pose_size and depth > 2 * self.feet.radius:
            raise ParameterError(
                f"feet.stiffness is {self.feet.stiffness:g} N/m, so that the robot's weight "
                f"presses its feet in by {1e3 * depth:.3g} mm, more than the "
                f"{2e3 * self.feet.radius:g} mm that they are thick; is it in N/mm?"
            )

    def _validate_gravity(self) -> None:
        """Raise ParameterError if gravity does not press the robot on its ground, in its plane."""
        _validate_vector(self.gravity, "gravity")
        if self.ground and self.world_gravity[2] >= 0:
            raise ParameterError(
                f"gravity is {self.gravity} m/s², which does not press the robot on its ground; "
                "its third number must be negative."
            )
        if self.body.mount == "planar" and self.gravity[1]:
            raise ParameterError(
                f"gravity is {self.gravity} m/s², out of the plane of x and z in which the body "
                "moves; its second number must be 0."
            )

    def _validate_place(self, limb: RobotLimb, where: str) -> None:
        """Raise ParameterError if a limb's place or axes are impossible on this body."""
        for name in ("position", "e1", "e2"):
            _validate_vector(getattr(limb, name), f"{where}.{name}")
        lengths = np.linalg.norm([limb.e1, limb.e2], axis=1)
        if min(lengths) < MAX_COSINE or abs(np.dot(limb.e1, limb.e2)) > MAX_COSINE * np.prod(
            lengths
        ):
            raise ParameterError(
                f"{where} has e1 = {limb.e1} and e2 = {limb.e2}; both must have a direction, at "
                "right angles to each other."
            )
        if self.body.mount != "planar":
            return
        if any(segment.axes == 2 for segment in limb.parameters.segments):
            raise ParameterError(
                f"{where} bends in space, but the body moves in a plane; set body.mount to free, "
                "or the axes of the limb's segments to 1."
            )
        if max(abs(limb.e1[1]), abs(limb.e2[1])) > MAX_COSINE:
            raise ParameterError(
                f"{where} has e1 = {limb.e1} and e2 = {limb.e2}, out of the plane of x and z in "
                "which the body moves; their second numbers must be 0."
            )

    def limb(self, name: str) -> LimbParameters:
        """The parameters of a limb.

        Raises:
            ParameterError: if no limb has that name.
        """
        for limb in self.limbs:
            if limb.name == name:
                return limb.parameters
        names = ", ".join(self.limb_names)
        raise ParameterError(f"This robot has no limb {name!r}; it has {names}.")

    def limb_alone(self, name: str) -> LimbParameters:
        """The parameters of a limb without the robot; it carries its foot as payload.

        Raises:
            ParameterError: if no limb has that name.
        """
        limb = copy.deepcopy(self.limb(name))
        limb.payload += self.feet.mass
        return limb

    def with_limbs(self, limbs: Mapping[str, LimbParameters]) -> "RobotParameters":
        """Return this robot with limbs that were calibrated alone, see `limb_alone`.

        The robot's ambient temperature is the mean of the limbs'. Its temperature limits stay.

        Args:
            limbs: calibrated limbs by name.

        Raises:
            ParameterError: if no limb has such a name, or a limb does not fit the robot.
        """
        robot = copy.deepcopy(self)
        ambient = float(np.mean([limb.ambient_temperature for limb in limbs.values()]))
        for name in limbs:
            robot.limb(name)  # raises ParameterError for an unknown name
        for limb in robot.limbs:
            if limb.name in limbs:
                limb.parameters = copy.deepcopy(limbs[limb.name])
                limb.parameters.payload = max(0.0, limb.parameters.payload - self.feet.mass)
                limb.parameters.temperature_limits = copy.deepcopy(
                    self.limb(limb.name).temperature_limits
                )
            limb.parameters.ambient_temperature = ambient
        robot.validate()
        return robot

    @property
    def limb_names(self) -> list[str]:
        """Names of the limbs (L,)."""
        return [limb.name for limb in self.limbs]

    @property
    def hips(self) -> np.ndarray:
        """Places of the limbs' bases in the body's frame (L, 3), m."""
        return np.array([limb.position for limb in self.limbs])

    @property
    def longest_limb(self) -> float:
        """Length of the longest limb, m."""
        return max(limb.parameters.length for limb in self.limbs)

    @property
    def is_limb(self) -> bool:
        """True for one limb on a welded body, which `as_single_limb` describes completely."""
        return len(self.limbs) == 1 and self.body.mount == "welded"

    @property
    def as_single_limb(self) -> LimbParameters:
        """All limbs as a single limb: their segments in order, with the limbs' names.

        `LimbModel`, recordings, supervisors and boards use it for wires, joints and bends. It does
        not have the places of the limbs. Its ``board`` has the serial numbers of all limbs' boards
        if each limb was calibrated on a board; it is the emulated robot if all limbs are parts of
        it.
        """
        if self.is_limb:
            limb = copy.deepcopy(self.limbs[0].parameters)
            limb.gravity = (self.limbs[0].axes.T @ self.world_gravity + 0.0).tolist()
            return limb
        segments = []
        for robot_limb in self.limbs:
            limb_segments = robot_limb.parameters.segments
            for number, segment in enumerate(limb_segments, 1):
                is_single = len(limb_segments) == 1
                name = robot_limb.name if is_single else f"{robot_limb.name}_{number}"
                segments.append(dataclasses.replace(segment, name=name))
        first = self.limbs[0].parameters
        # Boards refuse all limbs if the heat of any was not measured.
        record = None
        if not all(limb.parameters.heat_is_measured for limb in self.limbs):
            record = CalibrationRecord([], [], [], [], heat_measured=False)
        return LimbParameters(
            segments=segments,
            board=self._board,
            calibration=record,
            ambient_temperature=first.ambient_temperature,
            temperature_limits=first.temperature_limits,
            total_duty=self.total_duty,
        )

    @property
    def _board(self) -> BoardIdentity:
        """The identity of the emulated robot, or of all limbs' boards."""
        boards = [limb.parameters.board for limb in self.limbs]
        first = boards[0]
        if isinstance(first, EmulatedLimb):
            robot_boards = [dataclasses.replace(first, limb=limb.name) for limb in self.limbs]
            if boards == robot_boards:
                return dataclasses.replace(first, limb="")
        numbers = [getattr(board, "serial_number", "") for board in boards]
        return SerialBoard(", ".join(dict.fromkeys(numbers))) if all(numbers) else NoBoard()

    @property
    def world_gravity(self) -> np.ndarray:
        """Gravity (3,) in the world, whose x is along the sloping ground, m/s²."""
        slope = self.ground.slope if self.ground else 0.0
        cosine = np.cos(slope)
        sine = np.sin(slope)
        return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]) @ self.gravity

    @property
    def contact_stiffness(self) -> float:
        """Stiffness of a foot and the ground in series, N/m."""
        return self.feet.stiffness * CONTACT_STIFFNESS / (self.feet.stiffness + CONTACT_STIFFNESS)

    @property
    def contact_damping(self) -> float:
        """Damping of a foot on the ground, whose relaxation times add up, N·s/m."""
        relaxation_time = self.feet.damping / self.feet.stiffness + RELAXATION_TIME
        return self.contact_stiffness * relaxation_time

    @property
    def standing_height(self) -> float:
        """Height of the body's origin, m, with the lowest foot of straight limbs on the ground."""
        return self.feet.radius - min(limb.straight_height for limb in self.limbs)

    @property
    def pose_size(self) -> int:
        """Numbers of the body's pose: 3 if planar, 6 if free, 0 if welded."""
        return len(POSE_NAMES[self.body.mount])

    @property
    def force_size(self) -> int:
        """Numbers of a foot's contact force: x and z if the body is planar, else x, y and z."""
        return 2 if self.body.mount == "planar" else 3

    def signal_columns(self) -> dict[str, list[str]]:
        """Return the columns of ``body_pose`` and ``contact_force``, if the robot has them."""
        columns: dict[str, list[str]] = {}
        for name in POSE_NAMES[self.body.mount]:
            unit = "deg" if name in ANGLES else "m"
            columns.setdefault("body_pose", []).append(f"body_{name}_{unit}")
        if self.ground:
            axes = "xz" if self.force_size == 2 else "xyz"
            columns["contact_force"] = [
                f"contact_force_{limb.name}_{axis}_n" for limb in self.limbs for axis in axes
            ]
        return columns

    def pose_rows(self) -> list[tuple[str, str, float]]:
        """Return name, unit and scale from SI of each row of the body's pose."""
        rows = []
        for name in POSE_NAMES[self.body.mount]:
            rows.append((name, "°", np.rad2deg(1.0)) if name in ANGLES else (name, "mm", 1e3))
        return rows

    def surroundings(self) -> str:
        """Return the ground in words."""
        if self.ground is None:
            return "no ground"
        slope = np.rad2deg(self.ground.slope)
        rises = f", rises by {slope:g}°" if slope else ""
        return f"ground: a mark each 10 mm, μ = {self.ground.friction:g}{rises}"

    def commands_after_fit(self, path: Path) -> list[list[str]]:
        """Return the words of the command that plans gaits, if the robot walks."""
        if self.body.mount == "welded" or not self.ground:
            return []
        if self.body.mount == "free":
            return [["gait", str(path), "--set", "-o", str(free_path(Path("gaits")))]]
        return [["gait", str(path), "-o", str(free_path(Path("gait.csv")))]]

    @property
    def joints_of(self) -> list[slice]:
        """Indices of each limb's joints among all limbs\'."""
        return slices([limb.parameters.num_joints for limb in self.limbs])

    @property
    def wires_of(self) -> list[slice]:
        """Indices of each limb's wires among all limbs\'."""
        return slices([len(limb.parameters.wires) for limb in self.limbs])

    @property
    def bends_of(self) -> list[slice]:
        """Indices of each limb's bends among all limbs\'."""
        return slices([sum(s.axes for s in limb.parameters.segments) for limb in self.limbs])


def _validate_vector(value: list[float], name: str) -> None:
    if len(value) != 3:
        raise ParameterError(f"{name} is {value}; it must be three numbers, along x, y and z.")
