"""Drivers of models in a scenario, like Drake's hardware_sim: the wires of a limb."""

import dataclasses
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, System

from limb_systems import LimbParameters, add_limb_actuation

LIMB_PORTS = "measured_temperature", "bend_angle", "wire_temperature", "joint_state", "measurement"
GRAVITY_TOLERANCE = 0.5  # m/s², between gravity in a description and in the plant


@dataclasses.dataclass
class LimbDriver:
    """The wires of a limb as a driver in a scenario, also for Drake's `ApplyDriverConfigs`.

    - ``limb``: YAML file of its `LimbParameters`, from the scenario's folder; the nominal limb if
      empty.
    - ``seed``: seed of an emulated limb.
    - ``port``: serial port of its board.
    """

    limb: str = ""
    seed: int = 0
    port: str = ""

    @property
    def parameters(self) -> LimbParameters:
        """The description of the limb."""
        return LimbParameters.of(self.limb or None)


def ApplyDriverConfig(
    driver_config: LimbDriver,
    model_instance_name: str,
    sim_plant: MultibodyPlant,
    models_from_directives: Mapping[str, Any],
    lcms: Any,
    builder: DiagramBuilder,
) -> None:
    """Add the wires of a limb to a simulation, and export its ports with its name.

    Args:
        driver_config: the driver.
        model_instance_name: name of the model in the plant.
        sim_plant: the finalized plant with the model.
        models_from_directives, lcms: arguments that only Drake's drivers use.
        builder: builder of the diagram that has the plant.

    Raises:
        ParameterError: if the limb in the plant does not fit its description.
    """
    limb = sim_plant.GetModelInstanceByName(model_instance_name)
    wires = add_limb_actuation(builder, sim_plant, limb, driver_config.parameters)
    _warn_of_gravity(sim_plant, limb, wires.parameters)
    export_limb(builder, wires, model_instance_name)


def _warn_of_gravity(
    plant: MultibodyPlant, limb: ModelInstanceIndex, parameters: LimbParameters
) -> None:
    """Warn if the description of a limb, from which plans are made, has another gravity."""
    base = plant.GetFrameByName("base", limb).CalcPoseInWorld(plant.CreateDefaultContext())
    gravity = base.rotation().inverse() @ plant.gravity_field().gravity_vector()
    if np.linalg.norm(gravity - parameters.gravity) > GRAVITY_TOLERANCE:
        warnings.warn(
            f"Gravity is {np.round(gravity, 2).tolist()} m/s² in the base of the limb "
            f"{plant.GetModelInstanceName(limb)!r} and {list(parameters.gravity)} in its "
            "description, for which it is planned; give the description the same gravity.",
            stacklevel=2,
        )


def export_limb(builder: DiagramBuilder, limb: System, name: str) -> None:
    """Export the ports of a limb as NAME.PORT."""
    builder.ExportInput(limb.GetInputPort("duty"), f"{name}.duty")
    for output in filter(limb.HasOutputPort, LIMB_PORTS):
        builder.ExportOutput(limb.GetOutputPort(output), f"{name}.{output}")
