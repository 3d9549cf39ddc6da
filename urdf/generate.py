"""Writes the URDF of a planar limb; ``limb_5.urdf`` is that of the nominal one."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from typing import Any

SILICONE_COLOR = "0.89 0.91 0.94 1"
WIRE_COLOR = "0.45 0.45 0.5 1"
BRACKET_COLOR = "0.25 0.27 0.3 1"
PI_2 = 1.5707963267948966


def limb_urdf(segments: Sequence[Any], name: str = "limb") -> str:
    """URDF text of a serial chain of box-shaped links in the plane E1-E2.

    The base frame has E1 = +x, the axis of the straight limb, and E2 = +y.
    Joint ``joint_i`` turns about +z, so that positive angles bend towards
    +E2. Link ``link_i`` reaches from its joint along its own +x. Wires are
    visuals named ``wire_`` and their own name, such as ``wire_left`` (-E2 side)
    and ``wire_right`` (+E2 side): a wire that contracts bends the limb towards
    its own side. URDF has no
    joint springs; the manipulator adds them.

    Args:
        segments: base first, such as `limb_systems.SegmentParameters`: number of ``links``;
            ``length``, ``mass``, ``width`` (E3) and ``thickness`` (E2) of the whole segment,
            m and kg; ``damping`` of each joint, N·m·s/rad; ``wires``, each with its ``name``
            and where it runs, ``e2`` and ``e3``, m.
        name: name of the model.
    """
    robot = ElementTree.Element("robot", name=name)
    base = ElementTree.SubElement(robot, "link", name="base")
    first = segments[0]
    bracket = (0.6 * first.thickness, 1.6 * first.thickness, 1.2 * first.width)
    _box(base, "bracket", bracket, (-0.5 * bracket[0], 0.0), BRACKET_COLOR)

    parent, origin = "base", 0.0
    number = 0
    for segment in segments:
        link_length = segment.length / segment.links
        for _ in range(segment.links):
            number += 1
            link = ElementTree.SubElement(robot, "link", name=f"link_{number}")
            _inertial(link, segment.mass / segment.links, link_length, segment)
            _link_visuals(link, link_length, segment)
            joint = ElementTree.SubElement(
                robot, "joint", name=f"joint_{number}", type="continuous"
            )
            ElementTree.SubElement(joint, "parent", link=parent)
            ElementTree.SubElement(joint, "child", link=f"link_{number}")
            ElementTree.SubElement(joint, "origin", xyz=_text(origin, 0.0, 0.0))
            ElementTree.SubElement(joint, "axis", xyz="0 0 1")
            ElementTree.SubElement(joint, "dynamics", damping=_text(segment.damping))
            parent, origin = f"link_{number}", link_length
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def _inertial(link, mass: float, length: float, segment) -> None:
    """A homogeneous box: its mass, centre and moments of inertia."""
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_text(0.5 * length, 0.0, 0.0))
    ElementTree.SubElement(inertial, "mass", value=_text(mass))
    x2, y2, z2 = length**2, segment.thickness**2, segment.width**2
    ElementTree.SubElement(
        inertial,
        "inertia",
        ixx=_text(mass * (y2 + z2) / 12),
        iyy=_text(mass * (x2 + z2) / 12),
        izz=_text(mass * (x2 + y2) / 12),
        ixy="0",
        ixz="0",
        iyz="0",
    )


def _link_visuals(link, length: float, segment) -> None:
    """A box, a disc that closes the gap to the link before when bent, and the wires.

    Wires are drawn half sunk along the top, where a view from above shows them
    however the limb bends; those below the axis (e3 < 0) along the bottom. They
    overlap from link to link.
    """
    thickness, width = segment.thickness, segment.width
    _box(link, "silicone", (length, thickness, width), (0.5 * length, 0.0), SILICONE_COLOR)
    disc = (0.495 * thickness, 0.99 * width)
    _cylinder(link, "joint", disc, (0.0, 0.0, 0.0), 0.0, SILICONE_COLOR)
    radius = 0.12 * thickness
    for wire in segment.wires:
        center = (0.5 * length, wire.e2, -0.5 * width if wire.e3 < 0 else 0.5 * width)
        size = (radius, length + 1.5 * radius)
        _cylinder(link, f"wire_{wire.name}", size, center, PI_2, WIRE_COLOR)


def _box(link, name: str, size, center, color: str) -> None:
    visual = _visual(link, name, (*center, 0.0), 0.0, color)
    ElementTree.SubElement(visual.find("geometry"), "box", size=_text(*size))


def _cylinder(link, name: str, size, center, pitch: float, color: str) -> None:
    radius, length = map(_text, size)
    visual = _visual(link, name, center, pitch, color)
    ElementTree.SubElement(visual.find("geometry"), "cylinder", radius=radius, length=length)


def _visual(link, name: str, center, pitch: float, color: str):
    visual = ElementTree.SubElement(link, "visual", name=name)
    ElementTree.SubElement(visual, "origin", xyz=_text(*center), rpy=_text(0.0, pitch, 0.0))
    ElementTree.SubElement(visual, "geometry")
    material = ElementTree.SubElement(visual, "material", name=name)
    ElementTree.SubElement(material, "color", rgba=color)
    return visual


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
