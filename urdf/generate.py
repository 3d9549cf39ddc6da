"""Writes the URDF of a limb or a robot; ``limb_5.urdf`` is that of the nominal limb."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from typing import Any

SILICONE_COLOR, CLEAR_SILICONE_COLOR = "0.89 0.91 0.94 1", "0.80 0.85 0.92 0.3"
WIRE_COLOR = "0.45 0.45 0.5 1"
BRACKET_COLOR, BODY_COLOR = "0.25 0.27 0.3 1", "0.36 0.42 0.50 1"
# N/m and s, of contact: a foot that carries 0.25 N sinks in by 25 µm.
CONTACT_STIFFNESS, RELAXATION_TIME = 2e4, 0.01
# Of the silicone's surface: friction on smooth things; Pa, hydroelastic modulus, of soft casting
# silicones, which have 0.1 to 0.6 MPa; m, the edges of its mesh; s/m and s, of contact.
SILICONE = {
    "mu_dynamic": 0.8,
    "mu_static": 0.8,
    "compliant_hydroelastic": None,
    "hydroelastic_modulus": 2e5,
    "mesh_resolution_hint": 0.01,
    "hunt_crossley_dissipation": 20.0,
    "relaxation_time": 0.01,
}
STEEL = 33e3  # kg/m³, 4π/3 times that of steel: a payload is drawn as a ball of it
PI_2 = 1.5707963267948966


AXES = {"e2": "0 0 1", "e3": "0 -1 0", "twist": "1 0 0"}  # about which joints turn


def limb_urdf(
    segments: Sequence[Any],
    name: str = "limb",
    *,
    payload: float = 0.0,
    negligible_mass: float = 0.0,
) -> str:
    """URDF text of a serial chain of box-shaped links.

    The base frame has E1 = +x, the axis of the straight limb, E2 = +y and E3 = +z.
    Joints ``joint_1``, ... are numbered from the base. One that bends towards +E2 turns about
    +z, towards +E3 about -y, and one that twists about +x. Link ``link_i`` reaches from its
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
        negligible_mass: mass of the base and of each ``cross_j``, kg, for programs that divide by
            the mass of every body.
    """
    return document(limb_element(segments, name, payload, negligible_mass))


def limb_element(
    segments: Sequence[Any], name: str, payload: float, negligible_mass: float
) -> ElementTree.Element:
    """The root of `limb_urdf`, with its arguments."""
    robot = _root(name)
    parent, origin = _add_chain(robot, segments, collides=True)
    if negligible_mass:
        for link in robot.findall("link"):
            if link.find("inertial") is None:
                _add_mass(link, negligible_mass)
    if payload:
        _add_payload(robot, "", parent, origin, payload)
    of_links = [link for link in robot.findall("link") if link.find("collision") is not None]
    _filter_collisions(robot, [link.attrib["name"] for link in of_links])
    place = {"xyz": _text(origin, 0.0, 0.0), "rpy": _text(0.0, 0.0, 0.0)}
    ElementTree.SubElement(robot, "frame", {"name": "tip", "link": parent, **place})
    return robot


def robot_urdf(robot: Any) -> str:
    """URDF text of a robot: the link ``body`` and, fixed to it, the limbs with their feet.

    What belongs to a limb begins with its name, as in ``rear_base``, ``rear_joint_1``,
    ``rear_link_1`` and ``rear_foot``. The body and the feet collide with what there is, with the
    friction of the ground. The body's frame has x forward and z up.

    Args:
        robot: such as `limb_systems.RobotParameters`.
    """
    element = _root("robot")
    parts, size = robot.body, (robot.body.length, robot.body.width, robot.body.height)
    body = ElementTree.SubElement(element, "link", name="body")
    inertial = ElementTree.SubElement(body, "inertial")
    ElementTree.SubElement(inertial, "mass", value=_text(parts.mass))
    _inertia(inertial, *parts.moments)
    _box(body, "body", size, (0.0, 0.0), BODY_COLOR)
    if robot.ground:
        _collision(body, "box", _of_ground(robot.ground), size=_text(*size))
    for limb in robot.limbs:
        parent, origin = _add_chain(element, limb.parameters.segments, f"{limb.name}_")
        mount = ElementTree.SubElement(element, "joint", name=f"{limb.name}_mount", type="fixed")
        ElementTree.SubElement(mount, "parent", link="body")
        ElementTree.SubElement(mount, "child", link=f"{limb.name}_base")
        place = {"xyz": _text(*limb.position), "rpy": _text(*limb.rpy)}
        ElementTree.SubElement(mount, "origin", place)
        end = parent, origin
        if limb.parameters.payload:
            _add_payload(element, f"{limb.name}_", *end, limb.parameters.payload)
        names = f"{limb.name}_foot", f"{limb.name}_ankle"
        foot = _add_point(element, *names, *end, robot.feet.mass)
        _sphere(foot, "foot", robot.feet.radius, BRACKET_COLOR)
        if robot.ground:
            radius = _text(robot.feet.radius)
            _collision(foot, "sphere", _of_ground(robot.ground), radius=radius)
    if robot.ground:
        _filter_collisions(element, ["body", *(f"{limb.name}_foot" for limb in robot.limbs)])
    return document(element)


def _root(name: str) -> ElementTree.Element:
    return ElementTree.Element("robot", {"name": name, "xmlns:drake": "http://drake.mit.edu"})


def document(robot: ElementTree.Element) -> str:
    """Text of an XML document."""
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def _of_ground(ground) -> dict[str, float | None]:
    """Contact of what touches a robot's ground."""
    return {
        "mu_dynamic": ground.friction,
        "mu_static": ground.friction,
        "point_contact_stiffness": CONTACT_STIFFNESS,
        "relaxation_time": RELAXATION_TIME,
    }


def _add_chain(
    robot, segments: Sequence[Any], prefix: str = "", collides: bool = False
) -> tuple[str, float]:
    """The base and the links of a limb; the last link, and how far along it the limb ends, m."""
    base = ElementTree.SubElement(robot, "link", name=f"{prefix}base")
    first = segments[0]
    bracket = (0.6 * first.thickness, 1.6 * first.thickness, 1.2 * first.width)
    _box(base, "bracket", bracket, (-0.5 * bracket[0], 0.0), BRACKET_COLOR)

    parent, origin = f"{prefix}base", 0.0
    number = joint_number = 0
    for segment_number, segment in enumerate(segments, 1):
        piece, first = segment.length / segment.links, 0.5 if segment.centred_joints else 0.0
        if first:
            root = f"{prefix}root_{segment_number}"
            _add_link(robot, root, segment, first, collides)
            _add_joint(robot, f"{prefix}mount_{segment_number}", "fixed", parent, root, origin)
            parent, origin = root, first * piece
        for index, kinds in enumerate(segment.joints):
            number += 1
            for kind in kinds:
                joint_number += 1
                name = f"link_{number}" if kind == kinds[-1] else f"cross_{joint_number}"
                child = f"{prefix}{name}"
                if kind != kinds[-1]:
                    ElementTree.SubElement(robot, "link", name=child)
                else:
                    last = index == segment.links - 1
                    _add_link(robot, child, segment, 1.0 - first if last else 1.0, collides)
                name = f"{prefix}joint_{joint_number}"
                joint = _add_joint(robot, name, "continuous", parent, child, origin)
                ElementTree.SubElement(joint, "axis", xyz=AXES[kind])
                damping = segment.joint_ratios[kind] * segment.damping
                ElementTree.SubElement(joint, "dynamics", damping=_text(damping))
                parent, origin = child, 0.0
            origin = (1.0 - first if index == segment.links - 1 else 1.0) * piece
    return parent, origin


def _add_payload(robot, prefix: str, parent: str, origin: float, mass: float) -> None:
    load = _add_point(robot, f"{prefix}payload", f"{prefix}load", parent, origin, mass)
    _sphere(load, "load", (mass / STEEL) ** (1 / 3), BRACKET_COLOR)


def _add_point(robot, name: str, joint: str, parent: str, origin: float, mass: float):
    """A link that is a point of some mass, kg, at a distance along its parent, m."""
    link = ElementTree.SubElement(robot, "link", name=name)
    _add_mass(link, mass)
    _add_joint(robot, joint, "fixed", parent, name, origin)
    return link


def _add_mass(link, mass: float) -> None:
    """A point's mass, kg, at the link's origin."""
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", value=_text(mass))
    _inertia(inertial, 0.0, 0.0, 0.0)


def _collision(link, shape: str, contact: dict[str, float | None], x: float = 0.0, **size: str):
    """A shape of a link that collides, at x, m, with the properties of its contact."""
    collision = ElementTree.SubElement(link, "collision", name=shape)
    ElementTree.SubElement(collision, "origin", xyz=_text(x, 0.0, 0.0), rpy=_text(0.0, 0.0, 0.0))
    ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), shape, size)
    properties = ElementTree.SubElement(collision, "drake:proximity_properties")
    for name, value in contact.items():
        given = {} if value is None else {"value": _text(value)}
        ElementTree.SubElement(properties, f"drake:{name}", given)


def _filter_collisions(robot, links: Sequence[str]) -> None:
    """Links that go through each other."""
    group = ElementTree.SubElement(robot, "drake:collision_filter_group", name="own_links")
    for link in links:
        ElementTree.SubElement(group, "drake:member", link=link)
    ElementTree.SubElement(group, "drake:ignored_collision_filter_group", name="own_links")


def _add_link(robot, name: str, segment, share: float, collides: bool) -> None:
    """A link that is a share of a piece of its segment."""
    link = ElementTree.SubElement(robot, "link", name=name)
    length = share * (segment.length / segment.links)
    _inertial(link, share * (segment.mass / segment.links), length, segment)
    _link_visuals(link, length, segment)
    if collides:
        size = _text(length, segment.thickness, segment.width)
        _collision(link, "box", SILICONE, 0.5 * length, size=size)


def _add_joint(robot, name: str, kind: str, parent: str, child: str, origin: float):
    """A joint of a kind of URDF, at a distance along its parent, m."""
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_text(origin, 0.0, 0.0))
    return joint


def _inertial(link, mass: float, length: float, segment) -> None:
    """A homogeneous box: its mass, centre and moments of inertia."""
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_text(0.5 * length, 0.0, 0.0))
    ElementTree.SubElement(inertial, "mass", value=_text(mass))
    x2, y2, z2 = length**2, segment.thickness**2, segment.width**2
    _inertia(inertial, mass * (y2 + z2) / 12, mass * (x2 + z2) / 12, mass * (x2 + y2) / 12)


def _inertia(inertial, ixx: float, iyy: float, izz: float) -> None:
    moments = {"ixx": _text(ixx), "iyy": _text(iyy), "izz": _text(izz)}
    products = {"ixy": "0", "ixz": "0", "iyz": "0"}
    ElementTree.SubElement(inertial, "inertia", {**moments, **products})


def _link_visuals(link, length: float, segment) -> None:
    """The silicone, what closes its gap to the link before when bent, and the wires.

    A segment that bends in a plane is a box with discs, with its wires half sunk along the
    top, where a view from above shows them however it bends; those below the axis
    (e3 < 0) along the bottom. One that bends in space is of clear silicone, a cylinder
    with balls if its section is a square, and its wires are where they run. They
    overlap from link to link.
    """
    thickness, width = segment.thickness, segment.width
    in_space, middle = "e3" in segment.joints[0], (0.5 * length, 0.0)
    color = CLEAR_SILICONE_COLOR if in_space else SILICONE_COLOR
    if in_space and thickness == width:
        _cylinder(link, "silicone", (0.5 * width, length), (*middle, 0.0), PI_2, color)
    else:
        _box(link, "silicone", (length, thickness, width), middle, color)
    if in_space:
        _sphere(link, "joint", 0.495 * min(thickness, width), color)
    else:
        disc = (0.495 * thickness, 0.99 * width)
        _cylinder(link, "joint", disc, (0.0, 0.0, 0.0), 0.0, color)
    radius = 0.12 * thickness
    for wire in segment.wires:
        top_or_bottom = -0.5 * width if wire.e3 < 0 else 0.5 * width
        center = (0.5 * length, wire.e2, wire.e3 if in_space else top_or_bottom)
        size = (radius, length + 1.5 * radius)
        _cylinder(link, f"wire_{wire.name}", size, center, PI_2, WIRE_COLOR)


def _box(link, name: str, size, center, color: str) -> None:
    visual = _visual(link, name, (*center, 0.0), 0.0, color)
    ElementTree.SubElement(visual.find("geometry"), "box", size=_text(*size))


def _cylinder(link, name: str, size, center, pitch: float, color: str) -> None:
    radius, length = map(_text, size)
    visual = _visual(link, name, center, pitch, color)
    ElementTree.SubElement(visual.find("geometry"), "cylinder", radius=radius, length=length)


def _sphere(link, name: str, radius: float, color: str) -> None:
    visual = _visual(link, name, (0.0, 0.0, 0.0), 0.0, color)
    ElementTree.SubElement(visual.find("geometry"), "sphere", radius=_text(radius))


def _visual(link, name: str, center, pitch: float, color: str):
    visual = ElementTree.SubElement(link, "visual", name=name)
    ElementTree.SubElement(visual, "origin", xyz=_text(*center), rpy=_text(0.0, pitch, 0.0))
    ElementTree.SubElement(visual, "geometry")
    kind = f"clear_{name}" if color == CLEAR_SILICONE_COLOR else name
    material = ElementTree.SubElement(visual, "material", name=kind)
    ElementTree.SubElement(material, "color", rgba=color)
    return visual


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
