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
    model = _add(sdf, "model", name=name)
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
        place = _add(model, "frame", name=frame.attrib["name"], attached_to=frame.attrib["link"])
        _add(place, "pose", _pose(frame))
    for group in robot.findall("drake:collision_filter_group"):
        element = _add(model, group.tag, name=group.attrib["name"])
        for part in group:
            _add(element, part.tag, part.get("link") or part.get("name"))
    return document(sdf)


def _add(parent, tag: str, text: str | None = None, **attributes: str):
    """Add an element with a text, and return it."""
    element = SubElement(parent, tag, attributes)
    element.text = text
    return element


def _add_link(model, link, joint, negligible_mass: float) -> None:
    """Add a link, in the frame of the joint that carries it, or of the model if joint is None."""
    element = _add(model, "link", name=link.get("name"))
    if joint is not None:
        _add(element, "pose", relative_to=joint.get("name"))
    # Add the inertia. A link without one gets the negligible mass, and no moments.
    inertial = link.find("inertial")
    sdf_inertial = _add(element, "inertial")
    mass = f"{negligible_mass:g}"
    moments: dict[str, str] = {}
    if inertial is not None:
        mass = inertial.find("mass").get("value")
        moments = inertial.find("inertia").attrib
        _add_pose(sdf_inertial, inertial)
    _add(sdf_inertial, "mass", mass)
    inertia = _add(sdf_inertial, "inertia")
    for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
        _add(inertia, name, moments.get(name, "0"))
    # Add the shapes, each with its colour or its contact.
    for shape in (*link.findall("visual"), *link.findall("collision")):
        sdf_shape = _add(element, shape.tag, name=shape.get("name"))
        _add_pose(sdf_shape, shape)
        (kind,) = shape.find("geometry")
        sizes = _add(_add(sdf_shape, "geometry"), kind.tag)
        for name, value in kind.attrib.items():
            _add(sizes, name, value)
        if (color := shape.find("material/color")) is not None:
            _add(_add(sdf_shape, "material"), "diffuse", color.get("rgba"))
        if (contact := shape.find("drake:proximity_properties")) is not None:
            properties = _add(sdf_shape, contact.tag)
            for contact_property in contact:
                _add(properties, contact_property.tag, contact_property.get("value"))


def _add_joint(model, joint, springs) -> None:
    """Add a joint; if it turns, with the next one of the springs."""
    turns = joint.get("type") != "fixed"
    kind = "revolute" if turns else "fixed"
    element = _add(model, "joint", name=joint.get("name"), type=kind)
    parent = joint.find("parent").get("link")
    _add(element, "pose", _pose(joint.find("origin")), relative_to=parent)
    _add(element, "parent", parent)
    _add(element, "child", joint.find("child").get("link"))
    if not turns:
        return
    # Add the axis, with damping and spring.
    stiffness, rest_angle = next(springs)
    axis = _add(element, "axis")
    _add(axis, "xyz", joint.find("axis").get("xyz"))
    dynamics = _add(axis, "dynamics")
    _add(dynamics, "damping", joint.find("dynamics").get("damping"))
    _add(dynamics, "spring_reference", repr(float(rest_angle)))
    _add(dynamics, "spring_stiffness", repr(float(stiffness)))


def _add_pose(element, parent) -> None:
    """Add the pose of a URDF element, if it has an origin."""
    if (origin := parent.find("origin")) is not None:
        _add(element, "pose", _pose(origin))


def _pose(origin) -> str:
    """Return the pose of an origin as SDFormat's text."""
    return " ".join(origin.get(name, "0 0 0") for name in ("xyz", "rpy"))
