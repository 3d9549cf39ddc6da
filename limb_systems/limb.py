"""The limb of Fig. 3 as one Drake diagram or as part of any plant, and its manipulator, (1)-(2)."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    ForceElementIndex,
    Frame,
    ModelInstanceIndex,
    RevoluteJoint,
    RevoluteSpring,
)
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import PassThrough

from limb_systems.limb_model import LimbModel, split_state
from limb_systems.limb_parameters import LimbParameters, ParameterError
from limb_systems.wire_blocks import add_wire_blocks
from limb_systems.wire_laws.linear import LinearLaw
from urdf import limb_sdf

# kg, far below the rounding error of a limb's mass. Drake 1.58 divides by the mass of each body
# when it evaluates a plant in symbols.
NEGLIGIBLE_MASS = 1e-20
LIMB_BODY_NAME = re.compile(r"base|payload|(link|cross|root)_[0-9]+")


class Limb(Diagram):
    """The model of Fig. 3: duty in, measured temperature and bend angle out.

    As a diagram::

                ┌──────────────┐    ┌───────────┐    ┌─────────────┐
        duty ──▶│ JouleHeating ├─┬─▶│ TorqueMap ├───▶│ manipulator ├─┬──▶ joint_state
                │     (6)      │ │  │    (4)    │    │   (1)-(2)   │ │
                └──────────────┘ │  └───────────┘    └─────────────┘ │  ┌───────────┐
                                 ├──▶ wire_temperature               └─▶│ φ = atan2 ├──▶ bend_angle
                                 │  ┌─────────────────┐                 └───────────┘
                                 └─▶│ ThermocoupleLag ├──▶ measured_temperature
                                    │       (7)       │
                                    └─────────────────┘

    For a limb of F bends, n joints in all and W wires with N states:

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C
    - output 1 ``bend_angle``: φ (F), rad
    - output 2 ``wire_temperature``: T (W), °C
    - output 3 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - output 4 ``measurement``: [V (W), φ (F)], °C and rad
    - state, all continuous: [θ (n), θ̇ (n), x (N), V (W)], in rad, rad/s, the
      wires' units and °C; by default at rest, at the rest angle, at ambient temperature

    With the paper's law, the wires' states x are T (W), °C; the states that
    other laws have besides T follow. Duty is not clipped: duty outside [0, 1]
    is an error of the plan or controller, and robots refuse it. The diagram
    converts to AutoDiffXd and symbolic::Expression, but Drake's plant cannot
    evaluate accelerations of more than one link symbolically.
    """

    __slots__ = ()  # see limb_systems.drake_python

    is_model = True

    def __init__(self, parameters: LimbParameters | str | Path | None = None, *, name: str = ""):
        """
        Args:
            parameters: description of the limb, or its YAML file; the nominal limb if
                None. The limb keeps a copy, its attribute ``parameters``.
            name: name of the system; Drake gives it one in a diagram if empty.

        Raises:
            ParameterError: if a parameter is out of its range.
        """
        super().__init__()
        self.parameters = parameters = LimbParameters.of(parameters)
        self.source = "model"
        builder = DiagramBuilder()
        # Connect the manipulator to the wires' blocks.
        manipulator = builder.AddNamedSystem("manipulator", make_manipulator(parameters))
        ports, duty = add_wire_blocks(builder, parameters, manipulator.get_state_output_port())
        builder.Connect(ports["torque"], manipulator.get_applied_generalized_force_input_port())
        builder.ExportInput(duty, "duty")
        builder.BuildInto(self)
        self.set_name(name)


class LimbActuation(Diagram):
    """The wires of a limb that is part of any plant: heat (6), lag (7) and torque (4).

    These are the blocks of `Limb` about its manipulator. For F bends, n joints and W wires with N
    states:

    - input 0 ``duty``: D (W), in [0, 1]
    - input 1 ``joint_state``: [θ, θ̇] (2n), rad and rad/s, the plant's state of the limb's instance
    - outputs 0 to 4: the outputs of `Limb`
    - output 5 ``torque``: torque of wires and rubber on each joint (n), N·m
    - state, continuous: x (N), V (W); by default of cold wires
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters | str | Path | None = None, *, name: str = ""):
        """
        Args:
            parameters: description of the limb, or its YAML file; the nominal limb if None.
            name: name of the system; Drake gives it one in a diagram if empty.

        Raises:
            ParameterError: if a parameter is out of its range.
        """
        super().__init__()
        self.parameters = parameters = LimbParameters.of(parameters)
        builder = DiagramBuilder()
        state = builder.AddNamedSystem("state", PassThrough(2 * parameters.num_joints))
        ports, duty = add_wire_blocks(builder, parameters, state.get_output_port())
        builder.ExportInput(duty, "duty")
        builder.ExportInput(state.get_input_port(), "joint_state")
        builder.ExportOutput(ports["torque"], "torque")
        builder.BuildInto(self)
        self.set_name(name)


def add_limb(
    plant: MultibodyPlant,
    parameters: LimbParameters | str | Path | None = None,
    name: str = "limb",
    *,
    parent_frame: Frame | None = None,
    X_PF: RigidTransform | None = None,
) -> ModelInstanceIndex:
    """Add a limb to a plant and weld its base; a plant may have several limbs.

    The plant is not finalized, so that you can add to it. In the limb's instance, the frames
    ``base`` and ``tip`` have E1 along x, E2 along y and E3 along z of the first and the last link.
    Joints are named ``joint_1`` ... from the base to the tip. They have springs, which are at rest
    by default, and actuators, through which torque enters: see `add_limb_actuation`. Gravity is
    the plant's. Give the parameters the same gravity in the frame ``base``: plans and calibrations
    use only the gravity of the parameters.

    Args:
        plant: not finalized; registered with a SceneGraph if the limb is to be shown or to collide.
        parameters: description of the limb, or its YAML file; the nominal limb if None.
        name: name of the model instance.
        parent_frame: frame that the base is welded to; the world if None.
        X_PF: pose of the base in the parent frame; the identity if None.

    Raises:
        ParameterError: if a parameter is out of its range.
    """
    parameters = LimbParameters.of(parameters)
    text = limb_sdf(
        parameters.segments, name, payload=parameters.payload, negligible_mass=NEGLIGIBLE_MASS
    )
    # Add the bodies with springs and actuators, and weld the base.
    (limb,) = Parser(plant).AddModelsFromString(text, "sdf")
    base = plant.GetFrameByName("base", limb)
    plant.WeldFrames(parent_frame or plant.world_frame(), base, X_PF or RigidTransform())
    # Start at rest.
    rest_angles = LimbModel.of(parameters).mechanics.rest_angles
    for joint, angle in zip(_joints(plant, limb), rest_angles, strict=True):
        joint.set_default_angle(angle)
    return limb


def add_limb_actuation(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    limb: ModelInstanceIndex,
    parameters: LimbParameters | str | Path | None = None,
) -> LimbActuation:
    """Add the wires of a limb to a diagram, and connect them to its joints in the plant.

    Args:
        builder: builder of the diagram that has the plant.
        plant: finalized, with the limb.
        limb: model instance of the limb, from `add_limb` or from its SDFormat.
        parameters: description of the limb, or its YAML file; the nominal limb if None.

    Returns:
        The wires, named after the limb, whose ``duty`` is not connected.

    Raises:
        ParameterError: if the limb in the plant differs from its description, or is too stiff for
            the steps of a discrete plant.
    """
    actuation = LimbActuation(parameters, name=f"{plant.GetModelInstanceName(limb)}_actuation")
    # Check the limb in the plant against its description.
    joints = _check_model(plant, limb, actuation.parameters)
    if plant.time_step():
        check_time_step(plant, joints, actuation.parameters)
    # Connect the wires to the joints.
    builder.AddSystem(actuation)
    builder.Connect(plant.get_state_output_port(limb), actuation.GetInputPort("joint_state"))
    builder.Connect(actuation.GetOutputPort("torque"), plant.get_actuation_input_port(limb))
    return actuation


def add_joint_springs(
    plant: MultibodyPlant, joints: Sequence[RevoluteJoint], parameters: LimbParameters
) -> None:
    """Add the spring of each joint (n) to a plant; by default the joints are at rest."""
    mechanics = LimbModel.of(parameters).mechanics
    springs = zip(joints, mechanics.rest_angles, mechanics.stiffness, strict=True)
    for joint, rest_angle, stiffness in springs:
        joint.set_default_angle(rest_angle)
        plant.AddForceElement(RevoluteSpring(joint, rest_angle, stiffness))


def _joints(plant: MultibodyPlant, limb: ModelInstanceIndex) -> list[RevoluteJoint]:
    """Return the revolute joints of a limb (n), from the base to the tip."""
    joints = []
    for index in plant.GetJointIndices(limb):
        joint = plant.get_joint(index)
        if isinstance(joint, RevoluteJoint):
            joints.append(joint)
    return joints


def _check_model(
    plant: MultibodyPlant, limb: ModelInstanceIndex, parameters: LimbParameters
) -> list[RevoluteJoint]:
    """Return the revolute joints of a limb (n), from the base to the tip.

    Raises:
        ParameterError: if the limb in the plant is not as described.
    """
    name = plant.GetModelInstanceName(limb)
    # The instance has the bodies and joints of a limb, and no others.
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(limb)]
    foreign = [body.name() for body in bodies if not LIMB_BODY_NAME.fullmatch(body.name())]
    if foreign:
        raise ParameterError(
            f"The model instance of the limb {name!r} has other bodies, too: "
            f"{', '.join(foreign)}; give them a model instance of their own, by "
            "plant.AddModelInstance."
        )
    joints = _joints(plant, limb)
    if len(joints) != parameters.num_joints:
        raise ParameterError(
            f"The limb {name!r} has {len(joints)} joints in the plant and "
            f"{parameters.num_joints} in its description; give the description from which the "
            "model was written."
        )
    # Each joint has a spring and an actuator, and the base is welded.
    springs = {}
    for index in range(plant.num_force_elements()):
        element = plant.get_force_element(ForceElementIndex(index))
        if isinstance(element, RevoluteSpring):
            springs[element.joint().index()] = element
    has_springs = all(joint.index() in springs for joint in joints)
    if plant.num_actuated_dofs(limb) != len(joints) or not has_springs:
        raise ParameterError(
            f"The limb {name!r} has no springs or no actuators, as URDF has none; parse its "
            "SDFormat."
        )
    if plant.num_velocities(limb) != len(joints):
        raise ParameterError(
            f"The base of the limb {name!r} is free; weld the frame base to what holds it, such as "
            "the world, before the plant is finalized."
        )
    # Mass and stiffness are as described.
    mechanics = LimbModel.of(parameters).mechanics
    mass = sum(body.default_mass() for body in bodies)
    checks = [("mass", "kg", mass, mechanics.body_masses.sum())]
    for joint, described in zip(joints, mechanics.stiffness, strict=True):
        stiffness = springs[joint.index()].default_stiffness()
        checks.append((f"stiffness of {joint.name()}", "N·m/rad", stiffness, described))
    for property_name, unit, in_plant, described in checks:
        if not np.isclose(in_plant, described, rtol=1e-6):
            raise ParameterError(
                f"The {property_name} of the limb {name!r} is {in_plant:.6g} {unit} in the plant "
                f"and {described:.6g} {unit} in its description; write its model again by "
                "urdf.limb_sdf of this description."
            )
    return joints


def check_time_step(
    plant: MultibodyPlant, joints: Sequence[RevoluteJoint], parameters: LimbParameters
) -> None:
    """Raise ParameterError if explicit spring forces are unstable at the plant's time step.

    Drake takes the springs' forces at the beginning of a step and the damping at its end. A mode
    of mass m, stiffness k and damping σ is then stable at steps h if 4 m + 2 h σ > h² k.

    Args:
        plant: finalized and discrete.
        joints: the joints (n) that the parameters describe.
        parameters: description of the limb.
    """
    import scipy.linalg  # takes long to import

    step = plant.time_step()
    mechanics = LimbModel.of(parameters).mechanics
    excess = np.zeros(plant.num_velocities())
    velocities = [joint.velocity_start() for joint in joints]
    excess[velocities] = step * (step * mechanics.stiffness - 2 * mechanics.damping)
    mass = 4 * plant.CalcMassMatrix(plant.CreateDefaultContext())
    # The largest ratio of h² k - 2 h σ to 4 m of all modes.
    highest = scipy.linalg.eigh(np.diag(excess), mass, eigvals_only=True)[-1]
    if highest >= 1.0:
        raise ParameterError(
            f"The limbs are too stiff for their mass and damping to be simulated in steps of "
            f"{1e3 * step:g} ms: their fastest mode is {highest:.2f} times as stiff as it may be; "
            f"give the plant a smaller time_step, or the segments a damping of "
            f"{0.6 * step * mechanics.stiffness.max():.2g} N·m·s/rad, if that is possible."
        )


def make_manipulator(parameters: LimbParameters) -> MultibodyPlant:
    """Return the finalized continuous-time plant of eqns (1)-(2).

    State [θ (n), θ̇ (n)] in rad and rad/s; input ``applied_generalized_force``
    (n) in N·m. The plant has the gravity of the parameters.
    """
    plant = MultibodyPlant(time_step=0.0)
    add_limb(plant, parameters)
    plant.mutable_gravity_field().set_gravity_vector(parameters.gravity)
    plant.Finalize()
    return plant


def to_paper_state(parameters: LimbParameters, state: ArrayLike) -> np.ndarray:
    """Return the paper's x = [θ, V, θ̇, V̇], eqn (14), from a state of `Limb`.

    Args:
        parameters: description of a limb whose wires have the paper's law.
        state: [θ, θ̇, T, V], (2n + 2W,) or (2n + 2W, K).

    Returns:
        same shape, in rad, °C, rad/s and °C/s.
    """
    angles, rates, wire, measured = split_state(parameters, state)
    measured_rate = _a3(parameters, measured) * (measured - wire)
    return np.concatenate([angles, measured, rates, measured_rate])


def from_paper_state(parameters: LimbParameters, paper_state: ArrayLike) -> np.ndarray:
    """Invert `to_paper_state`: T = V - V̇/a3, eqn (7) rearranged."""
    num_joints = parameters.num_joints
    ends = np.cumsum([num_joints, len(parameters.wires), num_joints])
    parts = np.split(np.asarray(paper_state, float), ends)
    angles, measured, rates, measured_rate = parts
    wire = measured - measured_rate / _a3(parameters, measured)
    return np.concatenate([angles, rates, wire, measured])


def _a3(parameters: LimbParameters, readings: np.ndarray) -> np.ndarray:
    """Return a3 of the wires (W, ...), 1/s, with as many axes as readings (W, ...)."""
    a3 = []
    for wire in parameters.wires:
        if not isinstance(wire.law, LinearLaw):
            raise ParameterError(
                "Only wires with the paper's LinearLaw have the paper's state (14)."
            )
        a3.append(wire.law.a3)
    return np.reshape(a3, (-1, *[1] * (readings.ndim - 1)))
