"""Scenarios of stations and their drivers, like those of Drake's hardware_sim."""

import dataclasses
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed
from pydrake.manipulation import ZeroForceDriver
from pydrake.multibody.parsing import ModelDirective, ModelDirectives
from pydrake.multibody.plant import MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import DiagramBuilder, System

from limb_systems import LimbError, LimbParameters, add_limb_actuation
from limb_systems.contact import NEAR_RIGID_THRESHOLD, TIME_STEP
from limb_systems.files.input import read_text
from limb_systems.files.schema import refuse_repeated_fields

LIMB_PORTS = "measured_temperature", "bend_angle", "wire_temperature", "joint_state", "measurement"
GRAVITY_TOLERANCE = 0.5  # m/s², between gravity in a description and in the plant


class StationError(LimbError):
    """A scenario is wrong, a station cannot be made of it, or one of its inputs does not fit."""


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


@dataclasses.dataclass
class Scenario:
    """A scenario like those for Drake's hardware_sim, without LCM and cameras.

    - ``directives``: models and welds; ``package://soft_limb`` has the limb, ``package://scenario``
      is the scenario's folder.
    - ``model_drivers``: a driver for the model instances that have one, by name: `LimbDriver`, or
      Drake's ``ZeroForceDriver``.
    - ``plant_config``, ``simulator_config``: Drake's settings of the simulation. Without an
      ``integration_scheme`` it is explicit_euler if the plant is in steps, which leaves only heat
      to integrate, else radau3.
    """

    directives: list[ModelDirective] = dataclasses.field(default_factory=list)
    model_drivers: dict[str, LimbDriver | ZeroForceDriver] = dataclasses.field(default_factory=dict)
    plant_config: MultibodyPlantConfig = dataclasses.field(
        default_factory=lambda: MultibodyPlantConfig(
            time_step=TIME_STEP,
            discrete_contact_approximation="sap",
            sap_near_rigid_threshold=NEAR_RIGID_THRESHOLD,
        )
    )
    simulator_config: SimulatorConfig = dataclasses.field(
        default_factory=lambda: SimulatorConfig(integration_scheme="")
    )

    @classmethod
    def load(cls, path: str | Path) -> "Scenario":
        """Read a YAML file.

        Raises:
            StationError: if it is no scenario, or a field is unknown or of another type.
        """
        text = read_text(path, "scenario", StationError)
        if not text.strip():
            raise StationError(f"{path} is empty; a scenario has directives and model_drivers.")
        try:
            refuse_repeated_fields(text)
            return yaml_load_typed(schema=cls, data=text, defaults=cls())
        except (RuntimeError, TypeError, ValueError, yaml.YAMLError) as error:
            raise StationError(f"{path}: {' '.join(str(error).split())}.") from error

    def checked_directives(self) -> ModelDirectives:
        """Return Drake's directives; StationError unless each adds one thing: Drake would crash."""
        for index, directive in enumerate(self.directives):
            fields = [field.name for field in directive.__fields__]
            names = [name for name in fields if getattr(directive, name) is not None]
            if len(names) != 1:
                raise StationError(
                    f"directives[{index}] has {', '.join(names) or 'nothing'}; each element adds "
                    "one thing."
                )
        return ModelDirectives(directives=self.directives)
