"""The whole limb, Fig. 3, as one Drake diagram, and its manipulator, eqns (1)-(2), as a plant."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, RevoluteSpring
from pydrake.systems.framework import Diagram, DiagramBuilder

from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters, ParameterError
from limb_systems.model.wire_blocks import add_wires
from limb_systems.model.wire_law import LinearLaw
from limb_systems.model.wires import num_wire_states
from urdf import limb_urdf

# kg, far below the rounding error of a limb's mass. Drake 1.58 divides by the mass of each body
# when it evaluates a plant in symbols.
NEGLIGIBLE_MASS = 1e-20


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

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self, parameters: LimbParameters | str | Path | None = None, *, name: str = "limb"
    ):
        """
        Args:
            parameters: description of the limb, or its YAML file; the nominal limb if
                None. The limb keeps a copy, its attribute ``parameters``.
            name: name of the system; limbs in one diagram need different names.

        Raises:
            ParameterError: if a parameter is out of its range.
        """
        super().__init__()
        self.parameters = parameters = LimbParameters.of(parameters)
        self.source = "model"
        builder = DiagramBuilder()
        manipulator = builder.AddSystem(make_manipulator(parameters))
        _, duty = add_wires(
            builder,
            parameters,
            manipulator.get_state_output_port(),
            manipulator.get_applied_generalized_force_input_port(),
        )
        builder.ExportInput(duty, "duty")
        builder.BuildInto(self)
        self.set_name(name)


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
    numbers = range(1, parameters.num_joints + 1)
    add_springs(plant, [plant.GetJointByName(f"joint_{n}") for n in numbers], parameters)
    plant.mutable_gravity_field().set_gravity_vector(parameters.gravity)


def add_springs(
    plant: MultibodyPlant, joints: Sequence[RevoluteJoint], parameters: LimbParameters
) -> None:
    """Adds the spring of each joint (n) to a plant, and puts the joints to rest by default."""
    rest_angles, stiffness = rest_joint_angles(parameters), Layout(parameters).stiffness
    for joint, rest_angle, k in zip(joints, rest_angles, stiffness, strict=True):
        joint.set_default_angle(rest_angle)
        plant.AddForceElement(RevoluteSpring(joint, rest_angle, k))


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


def to_paper_state(parameters: LimbParameters, state: ArrayLike) -> np.ndarray:
    """The paper's x = [θ, V, θ̇, V̇], eqn (14), from a state of `Limb`.

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
    """The inverse of `to_paper_state`: T = V - V̇/a3, eqn (7) rearranged."""
    n, num_wires = parameters.num_joints, len(parameters.wires)
    angles, measured, rates, measured_rate = np.split(
        np.asarray(paper_state, float), np.cumsum([n, num_wires, n])
    )
    wire = measured - measured_rate / _a3(parameters, measured)
    return np.concatenate([angles, rates, wire, measured])


def split_state(
    parameters: LimbParameters, state: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """θ (n), θ̇ (n), x (N) and V (W) of a state of `Limb`, each (.., K); x begins with T (W)."""
    n, num_states = parameters.num_joints, num_wire_states(parameters)
    angles, rates, wire, measured = np.split(
        np.asarray(state, float), np.cumsum([n, n, num_states])
    )
    return angles, rates, wire, measured


def _a3(parameters: LimbParameters, like: np.ndarray) -> np.ndarray:
    laws = [wire.law for wire in parameters.wires if isinstance(wire.law, LinearLaw)]
    if len(laws) < len(parameters.wires):
        raise ParameterError("Only wires with the paper's LinearLaw have the paper's state (14).")
    return np.array([law.a3 for law in laws]).reshape(-1, *[1] * (like.ndim - 1))
