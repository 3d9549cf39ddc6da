"""Scenarios of stations: their YAML, which is Drake's."""

import dataclasses
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_load_typed
from pydrake.manipulation import ZeroForceDriver
from pydrake.multibody.parsing import ModelDirective, ModelDirectives
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig

from hardware.drivers import LimbDriver
from limb_systems import LimbError
from limb_systems.contact import NEAR_RIGID_THRESHOLD, TIME_STEP
from limb_systems.files.input import read_text
from limb_systems.files.schema import refuse_repeated_fields


class StationError(LimbError):
    """A scenario is wrong, a station cannot be made of it, or one of its inputs does not fit."""


def _plant_config() -> MultibodyPlantConfig:
    """Return Drake's settings of the plant with the contact of a robot."""
    return MultibodyPlantConfig(
        time_step=TIME_STEP,
        discrete_contact_approximation="sap",
        sap_near_rigid_threshold=NEAR_RIGID_THRESHOLD,
    )


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
    plant_config: MultibodyPlantConfig = dataclasses.field(default_factory=_plant_config)
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
