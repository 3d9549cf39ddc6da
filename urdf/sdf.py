"""SDFormat of a limb, which has the springs of its joints; ``limb_5.sdf`` is the nominal limb."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import SubElement

from urdf.generate import document, limb_element


def limb_sdf(
    segments: Sequence[Any],
    name: str = "limb",
    *,
    payload: float = 0.0,
    negligible_mass: float = 0.0,
) -> str:
    """Return the SDFormat text of the model of `urdf.limb_urdf`, with the springs of the joints.

    Each joint has an actuator without a limit, through which the wires' torque enters.

    Args:
        segments, name, payload: as for `urdf.limb_urdf`; segments also with ``stiffness``,
            N·m/rad, and ``joint_rest_angles`` by kind of joint, rad.
        negligible_mass: mass of the base and of each ``cross_j``, kg, for programs that divide by
            the mass of every body.
    """
    robot = limb_element(segments, name, payload)
    sdf = ElementTree.Element("sdf", {"version": "1.9", "xmlns:drake": "drake.mit.edu"})
    model = SubElement(sdf, "model", name=name)
    # Add the links, each in the frame of its joint.
    for link in robot.findall("link"):
        joint = robot.find(f"joint/child[@link='{link.get('name')}']/..")
        _add_link(model, link, joint, negligible_mass)
    # Add the joints, with their springs in the order of the joints.
    springs = []
    for segment in segments:
        for kinds in segment.joints:
            for kind in kinds:
                stiffness = segment.joint_ratios[kind] * segment.stiffness
                springs.append((stiffness, segment.joint_rest_angles[kind]))
    remaining_springs = iter(springs)
    for joint in robot.findall("joint"):
        _add_joint(model, joint, remaining_springs)
    # Add the frames and the filters of collisions.
    for frame in robot.findall("frame"):
        placed = {"name": frame.attrib["name"], "attached_to": frame.attrib["link"]}
        SubElement(SubElement(model, "frame", placed), "pose").text = _pose(frame)
    for group in robot.findall("drake:collision_filter_group"):
        element = SubElement(model, group.tag, name=group.attrib["name"])
        for part in group:
            SubElement(element, part.tag).text = part.get("link") or part.get("name")
    return document(sdf)


def _add_link(model, link, joint, negligible_mass: float) -> None:
    """Add a link, in the frame of the joint that carries it, or of the model if joint is None."""
    element = SubElement(model, "link", name=link.get("name"))
    if joint is not None:
        SubElement(element, "pose", relative_to=joint.get("name"))
    # Add the inertia. A link without one gets the negligible mass, and no moments.
    inertial = link.find("inertial")
    sdf_inertial = SubElement(element, "inertial")
    mass = f"{negligible_mass:g}"
    moments: dict[str, str] = {}
    if inertial is not None:
        mass = inertial.find("mass").get("value")
        moments = inertial.find("inertia").attrib
        _add_pose(sdf_inertial, inertial)
    SubElement(sdf_inertial, "mass").text = mass
    inertia = SubElement(sdf_inertial, "inertia")
    for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
        SubElement(inertia, name).text = moments.get(name, "0")
    # Add the shapes.
    for shape in (*link.findall("visual"), *link.findall("collision")):
        _add_shape(element, shape)


def _add_shape(link, shape) -> None:
    """Add a visual or a collision, with its colour or its contact."""
    element = SubElement(link, shape.tag, name=shape.get("name"))
    _add_pose(element, shape)
    (kind,) = shape.find("geometry")
    sizes = SubElement(SubElement(element, "geometry"), kind.tag)
    for name, value in kind.attrib.items():
        SubElement(sizes, name).text = value
    if (color := shape.find("material/color")) is not None:
        SubElement(SubElement(element, "material"), "diffuse").text = color.get("rgba")
    if (contact := shape.find("drake:proximity_properties")) is not None:
        properties = SubElement(element, contact.tag)
        for contact_property in contact:
            SubElement(properties, contact_property.tag).text = contact_property.get("value")


def _add_joint(model, joint, springs) -> None:
    """Add a joint; if it turns, with the next one of the springs."""
    turns = joint.get("type") != "fixed"
    kind = "revolute" if turns else "fixed"
    element = SubElement(model, "joint", name=joint.get("name"), type=kind)
    parent = _link(joint, "parent")
    child = _link(joint, "child")
    SubElement(element, "pose", relative_to=parent).text = _pose(joint.find("origin"))
    SubElement(element, "parent").text = parent
    SubElement(element, "child").text = child
    if not turns:
        return
    # Add the axis, with damping and spring.
    stiffness, rest_angle = next(springs)
    axis = SubElement(element, "axis")
    SubElement(axis, "xyz").text = joint.find("axis").get("xyz")
    dynamics = SubElement(axis, "dynamics")
    SubElement(dynamics, "damping").text = joint.find("dynamics").get("damping")
    SubElement(dynamics, "spring_reference").text = repr(float(rest_angle))
    SubElement(dynamics, "spring_stiffness").text = repr(float(stiffness))


def _add_pose(element, parent) -> None:
    """Add the pose of a URDF element, if it has an origin."""
    if (origin := parent.find("origin")) is not None:
        SubElement(element, "pose").text = _pose(origin)


def _pose(origin) -> str:
    """Return the pose of an origin as SDFormat's text."""
    return " ".join(origin.get(name, "0 0 0") for name in ("xyz", "rpy"))


def _link(joint, end: str) -> str:
    """Return the name of the link at an end of a joint, "parent" or "child"."""
    return joint.find(end).get("link")
