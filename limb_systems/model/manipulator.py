"""The rigid manipulator of eqns (1)-(2) as a MultibodyPlant, and its statics."""

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteSpring

from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters
from urdf import limb_urdf

# kg, far below the rounding error of a limb's mass. Drake 1.58 divides by the mass of each body
# when it evaluates a plant in symbols.
NEGLIGIBLE_MASS = 1e-20


def add_manipulator(plant: MultibodyPlant, parameters: LimbParameters) -> None:
    """Parses the limb's URDF into a plant, clamps its base and adds the springs.

    The plant is not finalized, so that you can add bodies to it. Joints
    are named ``joint_1`` ... from the base to the tip; by default they are at
    their rest angles, which torsional springs have as set points; and gravity
    is that of the parameters.
    The torques f(T) of eqn (2) enter at ``applied_generalized_force``.

    Args:
        plant: not finalized; registered with a SceneGraph if it is to be displayed.
        parameters: geometry, mass, stiffness and damping of the limb.
    """
    parameters.validate()
    text = limb_urdf(
        parameters.segments, payload=parameters.payload, negligible_mass=NEGLIGIBLE_MASS
    )
    Parser(plant).AddModelsFromString(text, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    rest_angles, stiffness = rest_joint_angles(parameters), Layout(parameters).stiffness
    for number, (rest_angle, k) in enumerate(zip(rest_angles, stiffness, strict=True), 1):
        joint = plant.GetJointByName(f"joint_{number}")
        joint.set_default_angle(rest_angle)
        plant.AddForceElement(RevoluteSpring(joint, rest_angle, k))
    plant.mutable_gravity_field().set_gravity_vector(parameters.gravity)


def make_manipulator(parameters: LimbParameters) -> MultibodyPlant:
    """The finalized continuous-time plant of eqns (1)-(2).

    State [θ (n), θ̇ (n)] in rad and rad/s; input ``applied_generalized_force``
    (n) in N·m.
    """
    plant = MultibodyPlant(time_step=0.0)
    add_manipulator(plant, parameters)
    plant.Finalize()
    plant.set_name("manipulator")
    return plant
