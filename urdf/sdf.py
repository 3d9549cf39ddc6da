"""Writes the SDFormat of a limb, which has the springs of its joints; ``limb_5.sdf`` is nominal."""

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
    """SDFormat text of the model of `urdf.limb_urdf`, and with the springs of the joints.

    Each joint has an actuator without a limit, through which the wires' torque enters.

    Args:
        segments, name, payload, negligible_mass: as for `urdf.limb_urdf`; segments also with
            ``stiffness``, N·m/rad, and ``joint_rest_angles`` by kind of joint, rad.
    """
    robot = limb_element(segments, name, payload, negligible_mass)
    sdf = ElementTree.Element("sdf", {"version": "1.9", "xmlns:drake": "drake.mit.edu"})
    model = SubElement(sdf, "model", name=name)
    joints = robot.findall("joint")
    hangs_on = {_link(joint, "child"): joint.attrib["name"] for joint in joints}
    for link in robot.findall("link"):
        _add_link(model, link, hangs_on.get(link.attrib["name"]))
    springs = (
        (segment.joint_ratios[kind] * segment.stiffness, segment.joint_rest_angles[kind])
        for segment in segments
        for kinds in segment.joints
        for kind in kinds
    )
    for joint in joints:
        _add_joint(model, joint, springs)
    for frame in robot.findall("frame"):
        placed = {"name": frame.attrib["name"], "attached_to": frame.attrib["link"]}
        SubElement(SubElement(model, "frame", placed), "pose").text = _pose(frame)
    for group in robot.findall("drake:collision_filter_group"):
        element = SubElement(model, group.tag, name=group.attrib["name"])
        for part in group:
            SubElement(element, part.tag).text = part.get("link") or part.get("name")
    return document(sdf)


def _add_link(model, link, joint: str | None) -> None:
    """A link, in the frame of the joint that it is the child of."""
    element = SubElement(model, "link", name=link.get("name"))
    if joint:
        SubElement(element, "pose", relative_to=joint)
    inertial = link.find("inertial")
    mass, moments = SubElement(element, "inertial"), {}
    if inertial is not None:
        moments = inertial.find("inertia").attrib
        _add_pose(mass, inertial)
    value = "0" if inertial is None else inertial.find("mass").get("value")
    SubElement(mass, "mass").text = value
    inertia = SubElement(mass, "inertia")
    for moment in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
        SubElement(inertia, moment).text = moments.get(moment, "0")
    for shape in (*link.findall("visual"), *link.findall("collision")):
        _add_shape(element, shape)


def _add_shape(link, shape) -> None:
    """A visual or a collision, with its colour or its contact."""
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
        for one in contact:
            SubElement(properties, one.tag).text = one.get("value")


def _add_joint(model, joint, springs) -> None:
    """A joint, with the next of the springs if it turns."""
    turns = joint.get("type") != "fixed"
    kind = "revolute" if turns else "fixed"
    element = SubElement(model, "joint", name=joint.get("name"), type=kind)
    parent, child = _link(joint, "parent"), _link(joint, "child")
    SubElement(element, "pose", relative_to=parent).text = _pose(joint.find("origin"))
    SubElement(element, "parent").text = parent
    SubElement(element, "child").text = child
    if not turns:
        return
    axis, (stiffness, rest) = SubElement(element, "axis"), next(springs)
    SubElement(axis, "xyz").text = joint.find("axis").get("xyz")
    dynamics = SubElement(axis, "dynamics")
    SubElement(dynamics, "damping").text = joint.find("dynamics").get("damping")
    SubElement(dynamics, "spring_reference").text = repr(float(rest))
    SubElement(dynamics, "spring_stiffness").text = repr(float(stiffness))


def _add_pose(element, parent) -> None:
    if (origin := parent.find("origin")) is not None:
        SubElement(element, "pose").text = _pose(origin)


def _pose(origin) -> str:
    return " ".join(origin.get(name, "0 0 0") for name in ("xyz", "rpy"))


def _link(joint, end: str) -> str:
    return joint.find(end).get("link")
