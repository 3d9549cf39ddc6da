"""URDF of a limb or a robot; ``limb_5.urdf`` is the nominal limb."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element, SubElement

SILICONE_COLOR = "0.89 0.91 0.94 1"
CLEAR_SILICONE_COLOR = "0.80 0.85 0.92 0.3"
WIRE_COLOR = "0.45 0.45 0.5 1"
BRACKET_COLOR = "0.25 0.27 0.3 1"
BODY_COLOR = "0.36 0.42 0.50 1"
# Contact of the ground and of a robot's body.
CONTACT_STIFFNESS = 2e4  # N/m
RELAXATION_TIME = 0.01  # s
# Of the silicone's surface: friction on smooth things; Pa, hydroelastic modulus, of soft casting
# silicones, which have 0.1 to 0.6 MPa; s/m and s, of contact.
SILICONE = {
    "mu_dynamic": 0.8,
    "mu_static": 0.8,
    "compliant_hydroelastic": None,
    "hydroelastic_modulus": 2e5,
    "hunt_crossley_dissipation": 20.0,
    "relaxation_time": 0.01,
}
PAYLOAD_DENSITY = 33e3  # kg/m³, 4π/3 times the density of steel: a payload looks like a steel ball
Shape = tuple[str, dict[str, str]]  # an element of URDF, and its sizes, m
AXES = {"e2": "0 0 1", "e3": "0 -1 0", "twist": "1 0 0"}  # about which joints turn


def limb_urdf(segments: Sequence[Any], name: str = "limb", *, payload: float = 0.0) -> str:
    """Return the URDF text of a serial chain of box-shaped links.

    The base frame has E1 = +x, the axis of the straight limb, E2 = +y and E3 = +z.
    Joints ``joint_1``, ... are numbered from the base. A joint that bends towards +E2 turns about
    +z, towards +E3 about -y, and a twist about +x. Link ``link_i`` reaches from its
    last joint along its own +x; between joints of one link there are bodies ``cross_j`` without
    mass, and before centred joints ``root_s``, half a piece of segment s. Wires are
    visuals named ``wire_`` and their own name, such as ``wire_left`` (-E2 side)
    and ``wire_right`` (+E2 side): a wire that contracts bends the limb towards
    its own side. Links collide, as boxes of silicone, but not with each other. The frame
    ``tip`` is where the last link ends. URDF has no joint springs; `urdf.limb_sdf` has them.

    Args:
        segments: base first, such as `limb_systems.SegmentParameters`: number of ``links``;
            ``length``, ``mass``, ``width`` (E3) and ``thickness`` (E2) of the whole segment,
            m and kg; ``damping`` of each joint, N·m·s/rad; ``wires``, each with its ``name``
            and where it runs, ``e2`` and ``e3``, m; ``joints``, the kinds of each link's
            joints, their ``joint_ratios`` and ``centred_joints``.
        name: name of the model.
        payload: mass of a point at the tip, kg.
    """
    return document(limb_element(segments, name, payload))


def limb_element(segments: Sequence[Any], name: str, payload: float) -> Element:
    """Return the root of `limb_urdf`, with its arguments."""
    robot = _root(name)
    parent, origin = _add_chain(robot, segments, collides=True)
    if payload:
        _add_payload(robot, "", parent, origin, payload)
    # Links do not collide with each other.
    _filter_collisions(robot, [link.attrib["name"] for link in robot.findall("link[collision]")])
    place = {"xyz": _text(origin, 0.0, 0.0), "rpy": _text(0.0, 0.0, 0.0)}
    SubElement(robot, "frame", {"name": "tip", "link": parent, **place})
    return robot


def robot_urdf(robot: Any) -> str:
    """Return the URDF text of a robot: the link ``body`` and, fixed to it, the limbs with feet.

    Names of a limb's parts begin with its name, as in ``rear_base``, ``rear_joint_1``,
    ``rear_link_1`` and ``rear_foot``. The body and the feet collide with other objects, with the
    friction of the ground. The body's frame has x forward and z up.

    Args:
        robot: such as `limb_systems.RobotParameters`.
    """
    return document(robot_element(robot))


def robot_element(robot: Any) -> Element:
    """Return the root of `robot_urdf`, with its argument."""
    element = _root("robot")
    # Add the body.
    body = robot.body
    box = _box(body.length, body.width, body.height)
    link = SubElement(element, "link", name="body")
    _add_inertial(link, body.mass, body.moments)
    _add_visual(link, "body", BODY_COLOR, box)
    if robot.ground:
        _add_collision(link, box, _contact_properties(robot.ground))
    # Add the limbs with their feet.
    for limb in robot.limbs:
        prefix = f"{limb.name}_"
        parent, origin = _add_chain(element, limb.parameters.segments, prefix)
        mount = (f"{prefix}mount", "fixed", "body", f"{prefix}base")
        _add_joint(element, *mount, limb.position, limb.rpy)
        if limb.parameters.payload:
            _add_payload(element, prefix, parent, origin, limb.parameters.payload)
        ball = _sphere(robot.feet.radius)
        ankle = f"{prefix}ankle"
        foot = _add_point(element, f"{prefix}foot", ankle, parent, origin, robot.feet.mass)
        _add_visual(foot, "foot", BRACKET_COLOR, ball)
        if robot.ground:
            contact = _contact_properties(robot.ground)
            contact["point_contact_stiffness"] = robot.feet.stiffness
            contact["relaxation_time"] = robot.feet.damping / robot.feet.stiffness
            _add_collision(foot, ball, contact)
    # Body and feet do not collide with each other.
    if robot.ground:
        _filter_collisions(element, ["body", *(f"{limb.name}_foot" for limb in robot.limbs)])
    return element


def _root(name: str) -> Element:
    """Return an empty model."""
    return Element("robot", {"name": name, "xmlns:drake": "http://drake.mit.edu"})


def document(robot: Element) -> str:
    """Return the text of an XML document."""
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def _contact_properties(ground) -> dict[str, float]:
    """Return the contact properties of bodies that touch a robot's ground."""
    return {
        "mu_dynamic": ground.friction,
        "mu_static": ground.friction,
        "point_contact_stiffness": CONTACT_STIFFNESS,
        "relaxation_time": RELAXATION_TIME,
    }


def _add_chain(
    robot, segments: Sequence[Any], prefix: str = "", collides: bool = False
) -> tuple[str, float]:
    """Add the base and the links of a limb.

    Returns:
        The last link, and the distance along it at which the limb ends, m.
    """
    # Add the base.
    base = SubElement(robot, "link", name=f"{prefix}base")
    thickness = segments[0].thickness
    width = segments[0].width
    bracket = (0.6 * thickness, 1.6 * thickness, 1.2 * width)
    _add_visual(base, "bracket", BRACKET_COLOR, _box(*bracket), (-0.5 * bracket[0], 0.0, 0.0))

    # The next joint is on this link, at this distance along it, m.
    parent = f"{prefix}base"
    origin = 0.0
    link_number = 0
    joint_number = 0
    for segment_number, segment in enumerate(segments, 1):
        piece_length = segment.length / segment.links
        # Add the half piece before centred joints.
        root_share = 0.5 if segment.centred_joints else 0.0
        if root_share:
            root = f"{prefix}root_{segment_number}"
            _add_link(robot, root, segment, root_share, collides)
            mount = (f"{prefix}mount_{segment_number}", "fixed", parent, root)
            _add_joint(robot, *mount, (origin, 0.0, 0.0))
            parent = root
            origin = root_share * piece_length
        # Add the joints of each link, with bodies between them, and the link.
        for index, kinds in enumerate(segment.joints):
            link_number += 1
            share = 1.0 - root_share if index == segment.links - 1 else 1.0
            for kind in kinds:
                joint_number += 1
                if kind == kinds[-1]:
                    child = f"{prefix}link_{link_number}"
                    _add_link(robot, child, segment, share, collides)
                else:
                    child = f"{prefix}cross_{joint_number}"
                    SubElement(robot, "link", name=child)
                name = f"{prefix}joint_{joint_number}"
                joint = _add_joint(robot, name, "continuous", parent, child, (origin, 0.0, 0.0))
                SubElement(joint, "axis", xyz=AXES[kind])
                damping = segment.joint_ratios[kind] * segment.damping
                SubElement(joint, "dynamics", damping=_text(damping))
                parent = child
                origin = 0.0
            origin = share * piece_length
    return parent, origin


def _add_link(robot, name: str, segment, share: float, collides: bool) -> None:
    """Add a link that is a share of a piece of its segment: a homogeneous box."""
    link = SubElement(robot, "link", name=name)
    length = share * (segment.length / segment.links)
    mass = share * (segment.mass / segment.links)
    middle = (0.5 * length, 0.0, 0.0)
    x2 = length**2
    y2 = segment.thickness**2
    z2 = segment.width**2
    moments = (mass * (y2 + z2) / 12, mass * (x2 + z2) / 12, mass * (x2 + y2) / 12)
    _add_inertial(link, mass, moments, middle)
    _add_link_visuals(link, length, segment)
    if collides:
        _add_collision(link, _box(length, segment.thickness, segment.width), SILICONE, middle)


def _add_payload(robot, prefix: str, parent: str, origin: float, mass: float) -> None:
    """Add a payload of some mass, kg, at a distance along its parent, m."""
    load = _add_point(robot, f"{prefix}payload", f"{prefix}load", parent, origin, mass)
    _add_visual(load, "load", BRACKET_COLOR, _sphere((mass / PAYLOAD_DENSITY) ** (1 / 3)))


def _add_point(robot, name: str, joint: str, parent: str, origin: float, mass: float) -> Element:
    """Add a link that is a point of some mass, kg, at a distance along its parent, m."""
    link = SubElement(robot, "link", name=name)
    _add_inertial(link, mass)
    _add_joint(robot, joint, "fixed", parent, name, (origin, 0.0, 0.0))
    return link


def _add_inertial(link, mass: float, moments=(0.0, 0.0, 0.0), center=None) -> None:
    """Add mass, kg, moments of inertia (3), kg·m², and their centre, m, or the link's origin."""
    inertial = SubElement(link, "inertial")
    if center:
        SubElement(inertial, "origin", xyz=_text(*center))
    SubElement(inertial, "mass", value=_text(mass))
    values = dict(zip(("ixx", "iyy", "izz"), map(_text, moments), strict=True))
    SubElement(inertial, "inertia", {**values, "ixy": "0", "ixz": "0", "iyz": "0"})


def _add_joint(
    robot, name: str, kind: str, parent: str, child: str, position: Sequence[float], rpy=None
) -> Element:
    """Add a joint of a kind of URDF, at a position in its parent, m, and turned there, rad."""
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    place = {"xyz": _text(*position)}
    if rpy is not None:
        place["rpy"] = _text(*rpy)
    SubElement(joint, "origin", place)
    return joint


def _add_link_visuals(link, length: float, segment) -> None:
    """Add the silicone, the shape that fills its gap to the link before, and the wires.

    A segment that bends in a plane is a box with discs. Its wires are half sunk along the
    top, where a view from above shows them however it bends; wires below the axis
    (e3 < 0) are along the bottom. A segment that bends in space is of clear silicone, a
    cylinder with balls if its section is a square, and its wires are where they run. They
    overlap from link to link.
    """
    thickness = segment.thickness
    width = segment.width
    middle = 0.5 * length
    along = math.pi / 2  # pitch of a cylinder along the link
    # Draw the silicone.
    in_space = "e3" in segment.joints[0]
    color = CLEAR_SILICONE_COLOR if in_space else SILICONE_COLOR
    if in_space and thickness == width:
        silicone = _cylinder(0.5 * width, length)
        _add_visual(link, "silicone", color, silicone, (middle, 0.0, 0.0), along)
    else:
        silicone = _box(length, thickness, width)
        _add_visual(link, "silicone", color, silicone, (middle, 0.0, 0.0))
    # Close the gap that opens between bent links.
    if in_space:
        joint = _sphere(0.495 * min(thickness, width))
    else:
        joint = _cylinder(0.495 * thickness, 0.99 * width)
    _add_visual(link, "joint", color, joint)
    # Draw the wires.
    radius = 0.12 * thickness
    shape = _cylinder(radius, length + 1.5 * radius)
    for wire in segment.wires:
        top_or_bottom = -0.5 * width if wire.e3 < 0 else 0.5 * width
        center = (middle, wire.e2, wire.e3 if in_space else top_or_bottom)
        _add_visual(link, f"wire_{wire.name}", WIRE_COLOR, shape, center, along)


def _box(*size: float) -> Shape:
    """Return a box of sizes along x, y and z, m."""
    return "box", {"size": _text(*size)}


def _cylinder(radius: float, length: float) -> Shape:
    """Return a cylinder along z, m."""
    return "cylinder", {"radius": _text(radius), "length": _text(length)}


def _sphere(radius: float) -> Shape:
    """Return a sphere, m."""
    return "sphere", {"radius": _text(radius)}


def _add_visual(
    link, name: str, color: str, shape: Shape, center=(0.0, 0.0, 0.0), pitch: float = 0.0
) -> None:
    """Add a shape that is drawn, at a centre, m, and a pitch, rad."""
    visual = SubElement(link, "visual", name=name)
    _add_shape(visual, shape, center, pitch)
    kind = f"clear_{name}" if color == CLEAR_SILICONE_COLOR else name
    SubElement(SubElement(visual, "material", name=kind), "color", rgba=color)


def _add_collision(link, shape: Shape, contact: dict, center=(0.0, 0.0, 0.0)) -> None:
    """Add a shape that collides, with the properties of its contact."""
    collision = SubElement(link, "collision", name=shape[0])
    _add_shape(collision, shape, center, 0.0)
    properties = SubElement(collision, "drake:proximity_properties")
    for name, value in contact.items():
        attributes = {} if value is None else {"value": _text(value)}
        SubElement(properties, f"drake:{name}", attributes)


def _add_shape(owner, shape: Shape, center: Sequence[float], pitch: float) -> None:
    """Add the shape of a visual or a collision, and its place: m, and rad about y."""
    SubElement(owner, "origin", xyz=_text(*center), rpy=_text(0.0, pitch, 0.0))
    SubElement(SubElement(owner, "geometry"), *shape)


def _filter_collisions(robot, links: Sequence[str]) -> None:
    """Exclude collisions between some links."""
    group = SubElement(robot, "drake:collision_filter_group", name="own_links")
    for link in links:
        SubElement(group, "drake:member", link=link)
    SubElement(group, "drake:ignored_collision_filter_group", name="own_links")


def _text(*numbers: float) -> str:
    """Return numbers as text, exactly."""
    return " ".join(repr(float(number)) for number in numbers)
