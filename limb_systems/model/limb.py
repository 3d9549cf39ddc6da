"""The whole limb, Fig. 3, as one Drake diagram."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import MatrixGain, Multiplexer

from limb_systems.model.layout import Layout
from limb_systems.model.manipulator import make_manipulator
from limb_systems.model.parameters import LimbParameters, ParameterError
from limb_systems.model.wire_blocks import VectorFunction, make_blocks
from limb_systems.model.wire_law import LinearLaw
from limb_systems.model.wires import num_wire_states


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
        heating, lag, torque_map = map(builder.AddSystem, make_blocks(parameters))
        joint_state = manipulator.get_state_output_port()
        wire_state = heating.get_output_port()
        layout = Layout(parameters)
        n, num_wires, num_bends = layout.num_joints, layout.num_wires, layout.num_bends
        bend = builder.AddNamedSystem(
            "bend_angle",
            VectorFunction(lambda state: layout.bend_angle(state[:n]), [2 * n], num_bends),
        )
        measurement = builder.AddSystem(Multiplexer([num_wires, num_bends]))

        builder.Connect(wire_state, torque_map.get_input_port(0))
        builder.Connect(wire_state, lag.get_input_port())
        if torque_map.num_input_ports() > 1:
            builder.Connect(joint_state, torque_map.get_input_port(1))
        builder.Connect(
            torque_map.get_output_port(), manipulator.get_applied_generalized_force_input_port()
        )
        builder.Connect(joint_state, bend.get_input_port())
        builder.Connect(lag.get_output_port(), measurement.get_input_port(0))
        builder.Connect(bend.get_output_port(), measurement.get_input_port(1))
        wire_temperature = wire_state
        if wire_state.size() > num_wires:
            first = builder.AddSystem(MatrixGain(np.eye(num_wires, wire_state.size())))
            builder.Connect(wire_state, first.get_input_port())
            wire_temperature = first.get_output_port()

        builder.ExportInput(heating.get_input_port(), "duty")
        builder.ExportOutput(lag.get_output_port(), "measured_temperature")
        builder.ExportOutput(bend.get_output_port(), "bend_angle")
        builder.ExportOutput(wire_temperature, "wire_temperature")
        builder.ExportOutput(joint_state, "joint_state")
        builder.ExportOutput(measurement.get_output_port(), "measurement")
        builder.BuildInto(self)
        self.set_name(name)


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
