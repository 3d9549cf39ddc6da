"""Drivers of models in a scenario, as Drake's hardware_sim has them: the wires of a limb."""

import dataclasses
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake import manipulation
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, System

from limb_systems import LimbParameters, add_limb_actuation
from limb_systems.files.schema import Tagged, quantity

LIMB_OUTPUTS = (
    "measured_temperature",
    "bend_angle",
    "wire_temperature",
    "joint_state",
    "measurement",
)
GRAVITY_TOLERANCE = 0.5  # m/s², by which gravity in a description may differ from that in the plant


@dataclasses.dataclass
class LimbDriver(Tagged):
    """Wires of a limb, as a driver of a scenario. Drake's `ApplyDriverConfigs` knows it, too.

    - ``limb``: YAML file of its `LimbParameters`, from the scenario's folder; the nominal limb if
      empty.
    - ``seed``: seed of the limb where it is emulated.
    - ``port``: serial port of its board.
    """

    limb: str = ""
    seed: int = quantity(0, "", 0, 2**63)
    port: str = ""

    @property
    def parameters(self) -> LimbParameters:
        """Description of the limb."""
        return LimbParameters.of(self.limb or None)


@dataclasses.dataclass
class ZeroForceDriver(Tagged):
    """No force on the actuators of a model."""


def ApplyDriverConfig(
    driver_config: LimbDriver | ZeroForceDriver,
    model_instance_name: str,
    sim_plant: MultibodyPlant,
    models_from_directives: Mapping[str, Any],
    lcms: Any,
    builder: DiagramBuilder,
) -> None:
    """Add what drives a model to a simulation; export the ports of a limb with its name.

    Args:
        driver_config: what drives the model.
        model_instance_name: name of the model in the plant.
        sim_plant: finalized, with the model.
        models_from_directives, lcms: used by Drake's drivers alone.
        builder: builder of the diagram that has the plant.

    Raises:
        ParameterError: if the limb in the plant is not that of the description.
    """
    if isinstance(driver_config, ZeroForceDriver):
        manipulation.ApplyDriverConfig(
            manipulation.ZeroForceDriver(),
            model_instance_name,
            sim_plant,
            models_from_directives,
            lcms,
            builder,
        )
        return
    limb = sim_plant.GetModelInstanceByName(model_instance_name)
    wires = add_limb_actuation(builder, sim_plant, limb, driver_config.parameters)
    _warn_of_gravity(sim_plant, limb, wires.parameters)
    export_limb(builder, wires, model_instance_name)


def _warn_of_gravity(
    plant: MultibodyPlant, limb: ModelInstanceIndex, parameters: LimbParameters
) -> None:
    """Warns if plans of a limb would be for another direction of gravity than in the plant."""
    base = plant.GetFrameByName("base", limb).CalcPoseInWorld(plant.CreateDefaultContext())
    there = base.rotation().inverse() @ plant.gravity_field().gravity_vector()
    if np.linalg.norm(there - parameters.gravity) > GRAVITY_TOLERANCE:
        warnings.warn(
            f"Gravity is {np.round(there, 2).tolist()} m/s² in the base of the limb "
            f"{plant.GetModelInstanceName(limb)!r} and {list(parameters.gravity)} in its "
            "description, for which it is planned; give the description the same gravity.",
            stacklevel=2,
        )


def export_limb(builder: DiagramBuilder, limb: System, name: str) -> None:
    """Exports the ports of a limb, with its name before theirs."""
    builder.ExportInput(limb.GetInputPort("duty"), f"{name}.duty")
    for output in filter(limb.HasOutputPort, LIMB_OUTPUTS):
        builder.ExportOutput(limb.GetOutputPort(output), f"{name}.{output}")
