"""MJCF of a limb or a robot, with springs, heat and wires; ``limb_5.xml`` is the nominal limb."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from urdf.generate import document, limb_element, robot_element

# Share of a contact's damping in Drake with which feet land here as there; and N·s/m, damping times
# MuJoCo's impratio, by whose inverse a foot that sticks creeps for each newton: 0.4 mm/s, as much
# as in Drake's SAP with steps of 1 ms.
DAMPING_SHARE = 0.5
STICKING_DAMPING = 2500.0
IMPEDANCE = 0.9  # of a foot's contact, at any depth
# kg and kg·m², of a thermocouple: a hinge whose angle is a temperature, which has no inertia.
NEGLIGIBLE_INERTIA = 1e-9
NEGLIGIBLE_MASS = 1e-9  # kg, of a body without mass
LINEARITY = 1e-9  # relative, to which the heat and the torque of a law are linear


def limb_mjcf(
    parameters: Any,
    *,
    timestep: float = 0.002,
    callback: bool = False,
) -> str:
    """Return MJCF text of a limb that bends by the heat of its wires, clamped at its base.

    It has the bodies, joints and shapes of `urdf.limb_urdf`. Each wire is a tendon ``wire_left``
    and so on with an actuator of the same name, whose control is the duty in [0, 1] and whose
    activation, times -a2 / a1, is T - T0. A law of two masses has a second actuator,
    ``wire_left_2``, which gets the same control. The position of the joint
    ``thermocouple_left`` is V in °C.

    Args:
        parameters: such as `limb_systems.LimbParameters`.
        timestep: s; the bend is right to 0.001° at 1 ms, and to 0.01° at 10 ms.
        callback: whether wires of laws that MJCF cannot express are written for the C code of
            `limb_systems.wire_callback`. Their activations are [x, V], minus their cold values.

    Raises:
        ValueError: if MJCF cannot express the law of a wire, or the rubber's memory.
    """
    # Add the bodies of the URDF to a model, with springs in the joints.
    element = limb_element(parameters.segments, "limb", parameters.payload)
    options = {"timestep": timestep, "integrator": "implicitfast", "gravity": parameters.gravity}
    root, world = _root("limb", options)
    names = [f"joint_{number}" for number in range(1, parameters.num_joints + 1)]
    _add_bodies(world, element, "base", _springs(parameters, names))
    _add_stiffening(root, parameters, names)
    _add_wires(root, world, parameters, names, callback)
    return document(root)


def robot_mjcf(robot: Any, *, wires: bool = True, timestep: float = 0.002) -> str:
    """Return MJCF text of a robot, on its ground if it has one, with limbs as in `limb_mjcf`.

    Names begin with the limb's name, as in ``wire_rear_left``. Feet stick, slide and creep as
    in Drake's SAP contact with steps of 1 ms, and the sensor ``rear_foot`` is the force on a foot
    along the world's axes. The position of a body in a plane is x, z and θ, as in Drake.

    Args:
        robot: such as `limb_systems.RobotParameters`.
        wires: whether wires heat and pull; if not, apply the torque of any law at the joints.
        timestep: s.

    Raises:
        ValueError: if MJCF cannot express the law of a wire, or the rubber's memory.
        ImportError: without MuJoCo, if there is a ground: MuJoCo calculates the feet's inertia.
    """
    # Contact: what Drake's SAP does, see the constants.
    options = {"timestep": timestep, "integrator": "discrete", "gravity": robot.world_gravity}
    damping = DAMPING_SHARE * robot.contact_damping
    contact = {"cone": "elliptic", "impratio": STICKING_DAMPING / damping}
    root, world = _root("robot", options | contact)
    # Add the bodies of the URDF, with springs in the joints.
    all_limbs = robot.as_single_limb
    names = []
    for limb in robot.limbs:
        for number in range(1, limb.parameters.num_joints + 1):
            names.append(f"{limb.name}_joint_{number}")
    body = _add_bodies(world, robot_element(robot), "body", _springs(all_limbs, names))
    height = robot.standing_height if robot.ground else 0.0
    body.set("pos", _text(0.0, 0.0, height))
    _add_mount(body, robot.body.mount, height)
    # Add the ground.
    if robot.ground:
        friction = _text(robot.ground.friction)
        _add(world, "geom", name="ground", type="plane", size=(0, 0, 1), friction=friction)
        _add_feet(root, world, robot)
    # Add nonlinear rubber and wires.
    _add_stiffening(root, all_limbs, names)
    if wires:
        _add_wires(root, world, all_limbs, names)
    return document(root)


def _root(name: str, options: dict[str, Any]) -> tuple[Element, Element]:
    """Return an empty model and its world."""
    root = Element("mujoco", model=name)
    _add(root, "compiler", angle="radian", eulerseq="XYZ")  # roll, pitch and yaw, as in URDF
    _add(root, "option", **options)
    return root, SubElement(root, "worldbody")


def _add(parent: Element, tag: str, **attributes: Any) -> Element:
    """Add an element whose attributes are texts, numbers or sequences of numbers."""
    element = SubElement(parent, tag)
    for name, value in attributes.items():
        element.set(name, value if isinstance(value, str) else _text(*np.ravel(value)))
    return element


def _text(*numbers: float) -> str:
    """Return numbers as text, whole numbers without a decimal point."""
    return " ".join(f"{float(number)!r}".removesuffix(".0") for number in numbers)


def _joints_of_links(parameters: Any, names: Sequence[str]) -> list[tuple[Any, int, list[tuple]]]:
    """Return each link's segment, its segment's number, and the kinds and names of its joints."""
    links = []
    remaining_names = iter(names)
    for number, segment in enumerate(parameters.segments):
        for kinds in segment.joints:
            joints = [(kind, next(remaining_names)) for kind in kinds]
            links.append((segment, number, joints))
    return links


def _cubic(segment: Any) -> float:
    """Return the coefficient of θ³ in the torque of a joint that bends, N·m/rad³."""
    angle_at_45_deg = segment.chain.equal_angle * math.pi / 4
    return segment.stiffness * segment.stiffening / angle_at_45_deg**2


def _springs(parameters: Any, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the attributes of each joint's spring and damper."""
    springs = {}
    for segment, _, joints in _joints_of_links(parameters, names):
        for kind, name in joints:
            stiffness = [segment.joint_ratios[kind] * segment.stiffness]
            if segment.stiffening and kind != "twist":
                # With two axes the rest of the cubic term is in the tendons of `_add_stiffening`.
                share = 1.0 if segment.axes == 1 else 2 / 3
                stiffness += [0.0, share * _cubic(segment)]
            springs[name] = {
                "stiffness": stiffness,
                "springref": segment.joint_rest_angles[kind],
                "damping": segment.joint_ratios[kind] * segment.damping,
            }
    return springs


def _add_stiffening(root: Element, parameters: Any, names: Sequence[str]) -> None:
    """Add, to each link that bends about two axes, cubic springs of the sum and the difference.

    The torque c (x² + y²) x is the sum of a spring 2 c / 3 of x, and of c / 6 of x + y and x - y.
    """
    for segment, _, joints in _joints_of_links(parameters, names):
        if not segment.stiffening or segment.axes == 1:
            continue
        names_of_kinds = dict(joints)
        names_of_kinds.pop("twist", None)
        (x_kind, x_name), (y_kind, y_name) = names_of_kinds.items()
        rest_angles = segment.joint_rest_angles
        for name, sign in (("sum", 1.0), ("difference", -1.0)):
            rest = rest_angles[x_kind] + sign * rest_angles[y_kind]
            direction = -1.0 if rest < 0 else 1.0  # MuJoCo takes no negative lengths
            spring = {"springlength": abs(rest), "stiffness": [0.0, 0.0, _cubic(segment) / 6]}
            tendons = _section(root, "tendon")
            tendon = _add(tendons, "fixed", name=f"{name}_{x_name}", **spring)
            _add(tendon, "joint", joint=x_name, coef=direction)
            _add(tendon, "joint", joint=y_name, coef=direction * sign)


def _section(root: Element, name: str) -> Element:
    """Return a section of a model, which is added if it is missing."""
    section = root.find(name)
    return SubElement(root, name) if section is None else section


def _add_bodies(parent, robot, root_link: str, joint_attributes: dict) -> Element:
    """Add a link of a URDF and all links that hang on it to the MJCF, and return its body.

    Args:
        parent: element of the MJCF.
        robot: element of the URDF.
        root_link: name of the link.
        joint_attributes: MJCF attributes of the spring and damper of each joint, by its name.
    """

    def add(parent: Element, name: str, place: dict, turning_joints: list) -> Element:
        """Add the body of a link that turns about joints at its origin, and its children."""
        child_joints = robot.findall(f"joint/parent[@link='{name}']/..")
        link = robot.find(f"link[@name='{name}']")
        # A link without elements is between joints of one body, which get all of these joints.
        if not len(link):
            (joint,) = child_joints
            child = joint.find("child").get("link")
            return add(parent, child, place, [*turning_joints, joint])
        # Add the body with its joints, inertia and shapes.
        body = _add(parent, "body", name=name, **place)
        for joint in turning_joints:
            joint_name = joint.get("name")
            axis = joint.find("axis").get("xyz")
            _add(body, "joint", name=joint_name, axis=axis, **joint_attributes[joint_name])
        _add_inertia(body, link)
        for shape in (*link.findall("visual"), *link.findall("collision")):
            _add_shape(body, shape, name)
        # Add the children.
        for joint in child_joints:
            joints_of_child = [] if joint.get("type") == "fixed" else [joint]
            add(body, joint.find("child").get("link"), _place(joint), joints_of_child)
        return body

    body = add(parent, root_link, place={}, turning_joints=[])
    # Add the frames as sites.
    for frame in robot.findall("frame"):
        frame_body = parent.find(f".//body[@name='{frame.get('link')}']")
        _add(frame_body, "site", name=frame.get("name"), pos=frame.get("xyz"), size=1e-3)
    return body


def _place(element) -> dict[str, str]:
    """Return the position and angles of an element's origin, without zeros."""
    origin = element.find("origin")
    place = {"pos": origin.get("xyz"), "euler": origin.get("rpy", "0")}
    return {name: value for name, value in place.items() if any(map(float, value.split()))}


def _add_inertia(body: Element, link) -> None:
    """Add the inertia of a link.

    MuJoCo misplaces the frame of a body without inertia, and Drake takes no mass of zero.
    """
    inertial = link.find("inertial")
    if inertial is None or not float(inertial.find("mass").get("value")):
        moments = [NEGLIGIBLE_MASS * 1e-6] * 3
        _add(body, "inertial", pos=(0, 0, 0), mass=NEGLIGIBLE_MASS, diaginertia=moments)
        return
    origin = inertial.find("origin")
    moments = inertial.find("inertia")
    _add(
        body,
        "inertial",
        pos="0 0 0" if origin is None else origin.get("xyz"),
        mass=inertial.find("mass").get("value"),
        diaginertia=" ".join(moments.get(name) for name in ("ixx", "iyy", "izz")),
    )


def _add_shape(body: Element, shape, link: str) -> None:
    """Add a visual, or a shape that collides except with parts of the same limb or robot."""
    # MuJoCo takes half the lengths of a box and of a cylinder.
    (kind,) = shape.find("geometry")
    numbers = kind.get("size") or " ".join(filter(None, map(kind.get, ("radius", "length"))))
    sizes = np.array(numbers.split(), float)
    sizes[0 if kind.tag == "box" else 1 :] /= 2
    geometry = {"type": kind.tag, "size": sizes, **_place(shape), "mass": 0}
    if shape.tag == "visual":
        color = shape.find("material/color").get("rgba")
        _add(body, "geom", **geometry, contype="0", conaffinity="0", group="2", rgba=color)
        return
    properties = shape.find("drake:proximity_properties")
    friction = properties.find("drake:mu_dynamic").get("value")
    _add(body, "geom", name=link, **geometry, conaffinity="0", group="3", friction=friction)


def _add_mount(body: Element, mount: str, height: float) -> None:
    """Add the joints by which a robot's body moves."""
    joints: dict[str, list[dict[str, Any]]] = {
        "planar": [
            {"name": "body_x", "type": "slide", "axis": (1, 0, 0)},
            {"name": "body_z", "type": "slide", "axis": (0, 0, 1), "ref": height},
            {"name": "body_pitch", "type": "hinge", "axis": (0, -1, 0)},  # turns +x to +z
        ],
        "free": [{"name": "body", "type": "free"}],
        "welded": [],
    }
    for joint in joints[mount]:
        _add(body, "joint", **joint)


def _add_feet(root: Element, world, robot: Any) -> None:
    """Give feet the stiffness and the damping of their contact, and sensors of its force.

    MuJoCo takes both as multiples of (1 - impedance) / m, with the inertia m of a foot in the
    straight robot.
    """
    import mujoco  # only robots need it

    model = mujoco.MjModel.from_xml_string(document(root))
    stiffness = robot.contact_stiffness
    damping = DAMPING_SHARE * robot.contact_damping
    for limb in robot.limbs:
        name = f"{limb.name}_foot"
        scale = (1 - IMPEDANCE) * model.body(name).invweight0[0]
        foot = world.find(f".//geom[@name='{name}']")
        foot.set("priority", "1")  # over the ground's
        foot.set("solref", _text(-stiffness * scale, -damping * scale))
        foot.set("solimp", _text(IMPEDANCE, IMPEDANCE, 1.0, 0.5, 1.0))
        sensor = {"geom1": "ground", "geom2": name, "data": "force", "reduce": "netforce"}
        _add(_section(root, "sensor"), "contact", name=name, **sensor)


def _add_wires(
    root: Element, world: Element, parameters: Any, names: Sequence[str], callback: bool = False
) -> None:
    """Add a tendon and actuators for each wire, and the hinge of its thermocouple."""
    links = _joints_of_links(parameters, names)
    wires = []
    for number, segment in enumerate(parameters.segments):
        wires += [(number, wire) for wire in segment.wires]
        if segment.rest_memory:
            raise ValueError(
                f"segments[{number}] has rest_memory, which MJCF cannot express; leave it out of a "
                "copy of the description."
            )
    for index, ((segment_number, wire), name) in enumerate(
        zip(wires, parameters.wire_names, strict=True)
    ):
        linear_wire = _LinearWire.of(wire.law)
        if linear_wire is None and not callback:
            raise ValueError(
                f"The wire {name} has the law {type(wire.law).__name__}, which MJCF cannot "
                "express; write its C code as well (--callback FILE.c), or fit the limb with "
                "--method paper, whose law MJCF can express."
            )
        # Add the tendon, whose length is the sum of the joints' angles times the wire's lever.
        tendon = _add(_section(root, "tendon"), "fixed", name=f"wire_{name}")
        radius = math.hypot(wire.e2, wire.e3)
        levers = {"e2": wire.e2 / radius, "e3": wire.e3 / radius, "twist": 0.0}
        for _, link_segment, joints in links:
            if link_segment != segment_number:
                continue
            for kind, joint in joints:
                if levers[kind]:
                    _add(tendon, "joint", joint=joint, coef=levers[kind])
        # Add the actuators: one for the C code, or a filter for each pole of the heat.
        actuators = _section(root, "actuator")
        actuator = {"tendon": f"wire_{name}", "ctrlrange": (0, 1)}
        if linear_wire is None:
            num_activations = len(wire.law.states) + 1
            dynamics = {"dyntype": "user", "dynprm": index, "actdim": str(num_activations)}
            force = {"gainprm": 0, "biastype": "user"}
            _add(actuators, "general", name=f"wire_{name}", **actuator, **dynamics, **force)
            continue
        poles = zip(linear_wire.rates, linear_wire.warmths, strict=True)
        for number, (rate, warmth) in enumerate(poles, 1):
            suffix = f"_{number}" if number > 1 else ""
            dynamics = {"dyntype": "filterexact", "dynprm": -1 / rate}
            force = {"gainprm": linear_wire.beta * warmth}
            _add(actuators, "general", name=f"wire_{name}{suffix}", **actuator, **dynamics, **force)
        _add_thermocouple(world, tendon, name, linear_wire, parameters.ambient_temperature)


def _add_thermocouple(
    world: Element, tendon: Element, name: str, wire: "_LinearWire", ambient: float
) -> None:
    """Add the hinge whose position is the reading of a wire's thermocouple, °C."""
    joint = f"thermocouple_{name}"
    body = _add(world, "body", name=joint)
    lag = {"stiffness": wire.beta, "damping": wire.beta / wire.lag}
    rest = {"axis": (0, 0, 1), "ref": ambient, "springref": ambient}
    _add(body, "joint", name=joint, **rest, **lag)
    inertia = {"mass": NEGLIGIBLE_INERTIA, "diaginertia": [NEGLIGIBLE_INERTIA] * 3}
    _add(body, "inertial", pos=(0, 0, 0), **inertia)
    _add(tendon, "joint", joint=joint, coef=1)


@dataclasses.dataclass
class _LinearWire:
    """A wire whose warmth, to which its torque is proportional, is a sum of filters of the duty.

    - ``rates``: poles of the filters, 1/s, negative.
    - ``warmths``: T - T0 of each filter in steady state at full duty, °C.
    - ``beta``: torque per degree, N·m/°C.
    - ``lag``: rate of the reading, 1/s, positive.
    """

    rates: np.ndarray
    warmths: np.ndarray
    beta: float
    lag: float

    @classmethod
    def of(cls, law: Any) -> "_LinearWire | None":
        """Return the filters of a law, or None if its heat, torque or reading is not linear."""
        size = len(law.states)

        def evaluate(warmth: np.ndarray, duty: float, reading: float, angle: float) -> np.ndarray:
            """Return the rates of the states, the torque and the rate of the reading."""
            rates = law.rates(warmth, duty, 0.0)
            torque = law.torque(warmth, 0.0, angle)
            return np.array([*rates, torque, law.reading_rate(reading, warmth)], float)

        # Compare a warm wire with the prediction by the slopes at a cold wire.
        points = np.eye(size + 3)
        slopes = np.array([evaluate(point[:size], *point[size:]) for point in points]).T
        warm = np.concatenate([np.linspace(80.0, 30.0, size), [0.7, 60.0, 0.4]])
        expected = slopes @ warm
        exact = evaluate(warm[:size], *warm[size:])
        # Find the poles, and their shares of T.
        by_heat = slopes[:size, :size]
        by_duty = slopes[:size, size]
        torque, reading = slopes[size : size + 2]
        rates, modes = np.linalg.eig(by_heat)
        scale = LINEARITY * (np.abs(exact) + np.abs(slopes) @ np.abs(warm))
        is_native = (
            (np.abs(exact - expected) <= scale).all()
            and not torque[1:].any()  # by T alone
            and not reading[1 : size + 1].any()
            and np.isclose(reading[0], -reading[size + 1])  # V' = a3 (V - T)
            and (np.isreal(rates) & (rates.real < 0)).all()
        )
        if not is_native:
            return None
        shares = modes[0].real * np.linalg.solve(modes, by_duty).real
        return cls(rates.real, -shares / rates.real, float(torque[0]), float(reading[0]))
