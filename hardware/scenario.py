"""Scenarios of stations: their YAML, its checks, and Drake's settings for it."""

import dataclasses
from pathlib import Path
from typing import Any, ClassVar

from pydrake.common.yaml import yaml_load_typed
from pydrake.multibody.parsing import ModelDirectives
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig

from hardware.drivers import LimbDriver, ZeroForceDriver
from limb_systems import LimbError
from limb_systems.contact import NEAR_RIGID_THRESHOLD, TIME_STEP
from limb_systems.errors import reraise_as
from limb_systems.files.input import read_text
from limb_systems.files.schema import (
    SchemaError,
    Strict,
    Tagged,
    did_you_mean,
    dump_typed,
    load_typed,
    quantity,
    validate,
)
from limb_systems.simulation import MAX_STEP_SIZE

# Integration schemes of Drake, and reasons against two of them.
FIXED_STEP_SCHEMES = "explicit_euler", "runge_kutta2", "semi_explicit_euler"
ERROR_CONTROLLED_SCHEMES = (
    "bogacki_shampine3",
    "implicit_euler",
    "radau1",
    "radau3",
    "runge_kutta3",
    "runge_kutta5",
    "velocity_implicit_euler",
)
CENIC_REASON = "it adds energy to light springs on Drake 1.58, and fails on 1.51"
TAMSI_REASON = "Drake 1.58 reads it and does not have it any more"


class StationError(LimbError):
    """A scenario is wrong, a station cannot be made of it, or one of its inputs does not fit."""


def _three_numbers(low: float, high: float, unit: str) -> Any:
    """Return a field of three numbers, all 0 by default."""
    metadata = {"unit": unit, "range": (low, high)}
    return dataclasses.field(default=(0.0, 0.0, 0.0), metadata=metadata)


@dataclasses.dataclass
class Rpy(Tagged):
    """A rotation by roll, pitch and yaw, ``deg``."""

    deg: tuple[float, float, float] = _three_numbers(-1e3, 1e3, "°")


@dataclasses.dataclass
class AngleAxis(Tagged):
    """A rotation by an angle, ``angle_deg``, about an ``axis``."""

    axis: tuple[float, float, float] = _three_numbers(-1.0, 1.0, "")
    angle_deg: float = quantity(0.0, "°", -1e3, 1e3)


@dataclasses.dataclass
class Transform(Strict):
    """A pose: ``translation``, m, and ``rotation`` in ``base_frame``, the world or the parent."""

    base_frame: str | None = None
    translation: tuple[float, float, float] = _three_numbers(-1e4, 1e4, "m")
    rotation: Rpy | AngleAxis | None = None


@dataclasses.dataclass
class AddModel(Strict):
    """The model of a file, with its joints' positions and its bodies' poses by default."""

    name: str
    file: str
    default_joint_positions: dict[str, list[float]] = dataclasses.field(
        default_factory=dict, metadata={"unit": "rad or m", "range": (-1e4, 1e4)}
    )
    default_free_body_pose: dict[str, Transform] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass
class AddModelInstance(Strict):
    """An empty model instance."""

    name: str


@dataclasses.dataclass
class AddFrame(Strict):
    """A frame at a pose, whose ``base_frame`` must be given."""

    name: str
    X_PF: Transform


@dataclasses.dataclass
class AddWeld(Strict):
    """A weld of the child's frame to the parent's."""

    parent: str
    child: str
    X_PC: Transform | None = None


@dataclasses.dataclass
class AddCollisionFilterGroup(Strict):
    """A group of bodies, and groups that it does not collide with."""

    name: str
    members: list[str] = dataclasses.field(default_factory=list)
    ignored_collision_filter_groups: list[str] = dataclasses.field(default_factory=list)
    model_namespace: str | None = None


@dataclasses.dataclass
class AddDirectives(Strict):
    """The directives of a file of Drake's, by Drake's own YAML."""

    file: str
    model_namespace: str | None = None


@dataclasses.dataclass
class Directive(Strict):
    """One of Drake's model directives."""

    add_model: AddModel | None = None
    add_model_instance: AddModelInstance | None = None
    add_frame: AddFrame | None = None
    add_weld: AddWeld | None = None
    add_collision_filter_group: AddCollisionFilterGroup | None = None
    add_directives: AddDirectives | None = None


@dataclasses.dataclass
class PlantConfig(Strict):
    """Settings of the plant, see Drake's `MultibodyPlantConfig`; contact is by default a robot's.

    - ``time_step``: s; 0 for a continuous plant.
    - ``contact_model``: point, hydroelastic or hydroelastic_with_fallback.
    - ``discrete_contact_approximation``: sap, similar or lagged; sap by default.
    - ``sap_near_rigid_threshold``: 0 by default.
    - ``stiction_tolerance``: m/s, for similar, for lagged, and for a continuous plant.
    - ``contact_surface_representation``: polygon or triangle, of hydroelastic contact.
    - ``adjacent_bodies_collision_filters``: whether bodies that share a joint do not collide.
    - ``use_sampled_output_ports``: whether ports of forces and accelerations show their values in
      the last step, and nothing before the first, instead of values by the present state.
    """

    REFUSED: ClassVar[dict[str, str]] = {
        "penetration_allowance": (
            "it has no effect, as each shape has a point stiffness, by default 1e6 N/m; give "
            "drake:point_contact_stiffness in the model"
        ),
    }

    time_step: float = quantity(TIME_STEP, "s", 0.0, 0.1)
    contact_model: str = "hydroelastic_with_fallback"
    discrete_contact_approximation: str | None = None
    sap_near_rigid_threshold: float | None = quantity(None, "", 0.0, 1e3)
    stiction_tolerance: float | None = quantity(None, "m/s", 1e-9, 1.0)
    contact_surface_representation: str | None = None
    adjacent_bodies_collision_filters: bool = True
    use_sampled_output_ports: bool = False

    def check(self) -> None:
        """Raise SchemaError for a setting that Drake does not have, or that has no effect."""
        # Names must be Drake's.
        approximation = self.discrete_contact_approximation
        models = "point", "hydroelastic", "hydroelastic_with_fallback"
        _check_choice("contact_model", self.contact_model, models)
        if approximation is not None:
            approximations = "sap", "similar", "lagged"
            refused = {"tamsi": TAMSI_REASON}
            _check_choice("discrete_contact_approximation", approximation, approximations, refused)
        surfaces = self.contact_surface_representation
        if surfaces is not None:
            _check_choice("contact_surface_representation", surfaces, ("polygon", "triangle"))
        # Settings must have an effect.
        if not self.time_step:
            for name in (
                "discrete_contact_approximation",
                "sap_near_rigid_threshold",
                "use_sampled_output_ports",
            ):
                if getattr(self, name) not in (None, False):
                    _refuse(name, "it has no effect where time_step is 0; leave it out")
        elif approximation in (None, "sap") and self.stiction_tolerance is not None:
            reason = "sap does not use it; leave it out, or choose similar or lagged"
            _refuse("stiction_tolerance", reason)
        if self.contact_model == "point" and surfaces is not None:
            _refuse("contact_surface_representation", "points of contact have no surface")

    def to_drake(self) -> MultibodyPlantConfig:
        """Return Drake's settings."""
        defaults = {
            "discrete_contact_approximation": "sap",
            "sap_near_rigid_threshold": NEAR_RIGID_THRESHOLD,
        }
        return MultibodyPlantConfig(**defaults | _without_none(dataclasses.asdict(self)))


@dataclasses.dataclass
class SimulationConfig(Strict):
    """Settings of the simulator, see Drake's `SimulatorConfig`.

    - ``integration_scheme``: by default explicit_euler if the plant is in steps, which leaves only
      heat to integrate, else radau3.
    - ``max_step_size``: s.
    - ``use_error_control``: whether the accuracy controls the steps; by default if the scheme can.
    - ``accuracy``: absolute, of the states in K, rad, rad/s and m.
    - ``target_realtime_rate``: largest speed over real time; 0 for no limit.
    """

    REFUSED: ClassVar[dict[str, str]] = {
        "publish_every_time_step": "nothing in a station publishes at each step, and Drake 1.58 "
        "does not have it; drive has a sample_rate",
        "start_time": "a run begins at 0 s",
    }

    integration_scheme: str | None = None
    max_step_size: float = quantity(MAX_STEP_SIZE, "s", 1e-7, 100.0)
    use_error_control: bool | None = None
    accuracy: float | None = quantity(None, "", 1e-10, 0.1)
    target_realtime_rate: float = quantity(0.0, "", 0.0, 1e3)

    def scheme(self, time_step: float) -> str:
        """Return the integration scheme for a time step of the plant, s."""
        return self.integration_scheme or ("explicit_euler" if time_step else "radau3")

    def check(self, time_step: float) -> None:
        """Raise SchemaError for a setting that Drake does not have, or that has no effect."""
        scheme = self.scheme(time_step)
        schemes = FIXED_STEP_SCHEMES + ERROR_CONTROLLED_SCHEMES
        _check_choice("integration_scheme", scheme, schemes, {"cenic": CENIC_REASON})
        if self.use_error_control and scheme in FIXED_STEP_SCHEMES:
            _refuse("use_error_control", f"{scheme} has no error control; choose another scheme")
        if self.accuracy is None:
            return
        if scheme in FIXED_STEP_SCHEMES:
            _refuse("accuracy", f"it has no effect on {scheme}, which has fixed steps")
        if self.use_error_control is False:
            _refuse("accuracy", "it has no effect where use_error_control is false")

    def to_drake(self, time_step: float) -> SimulatorConfig:
        """Return Drake's settings for a time step of the plant, s."""
        settings = dataclasses.asdict(self) | {"integration_scheme": self.scheme(time_step)}
        return SimulatorConfig(**_without_none(settings))


@dataclasses.dataclass
class Directives(Strict):
    """The directives of a scenario."""

    directives: list[Directive] = dataclasses.field(default_factory=list)

    def to_drake(self) -> ModelDirectives:
        """Return Drake's directives, through YAML with numbers in Drake's notation."""
        return yaml_load_typed(schema=ModelDirectives, data=dump_typed(Directives(self.directives)))


@dataclasses.dataclass
class Scenario(Directives):
    """A scenario like those for Drake's hardware_sim, without LCM and cameras.

    - ``directives``: models and welds; ``package://soft_limb`` has the limb, ``package://scenario``
      is the scenario's folder.
    - ``model_drivers``: a driver for the model instances that have one, by name: `LimbDriver`, or
      `ZeroForceDriver`.
    - ``plant_config``, ``simulator_config``: settings of the simulation. Settings without effect
      are refused.
    """

    model_drivers: dict[str, LimbDriver | ZeroForceDriver] = dataclasses.field(default_factory=dict)
    plant_config: PlantConfig = dataclasses.field(default_factory=PlantConfig)
    simulator_config: SimulationConfig = dataclasses.field(default_factory=SimulationConfig)

    @classmethod
    def load(cls, path: str | Path) -> "Scenario":
        """Read a YAML file.

        Raises:
            StationError: if it is no scenario, or a field is unknown, out of range or without
                effect.
        """
        text = read_text(path, "scenario", StationError)
        if not text.strip():
            raise StationError(f"{path} is empty; a scenario has directives and model_drivers.")
        with reraise_as(StationError, f"{path}: "):
            scenario = load_typed(cls, text)
            scenario.validate()
        return scenario

    def validate(self) -> None:
        """Raise StationError for the first field that is wrong, or has no effect."""
        with reraise_as(StationError):
            validate(self)
            for index, directive in enumerate(self.directives):
                names = list(_without_none(vars(directive)))
                if len(names) != 1:
                    raise SchemaError(
                        f"directives[{index}] has {', '.join(names) or 'nothing'}; each element "
                        "adds one thing."
                    )
        with reraise_as(StationError, "plant_config."):
            self.plant_config.check()
        with reraise_as(StationError, "simulator_config."):
            self.simulator_config.check(self.plant_config.time_step)


def _check_choice(
    name: str, value: str, choices: tuple[str, ...], refused: dict[str, str] | None = None
) -> None:
    """Raise SchemaError if a text is not among the choices, with the reason if there is one."""
    if reason := (refused or {}).get(value):
        _refuse(name, f"{value} is not for stations: {reason}")
    if value not in choices:
        raise SchemaError(
            f"{name} is {value!r}{did_you_mean(value, choices)}; it must be one of "
            f"{', '.join(choices)}."
        )


def _refuse(name: str, reason: str) -> None:
    raise SchemaError(f"{name} is refused: {reason}.")


def _without_none(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values that are not None."""
    return {name: value for name, value in values.items() if value is not None}
