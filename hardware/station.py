"""A station of limbs by a scenario, as Drake's hardware_sim has it: one diagram, named ports."""

import contextlib
import dataclasses
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories
from pydrake.common.yaml import yaml_load_typed
from pydrake.geometry import Meshcat
from pydrake.manipulation import ApplyDriverConfigs, ZeroForceDriver
from pydrake.multibody.parsing import (
    ModelDirective,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

import urdf
from hardware.emulation.twin import LimbTwin
from hardware.replaying import check_replayable
from hardware.robot.link import Closed
from hardware.robot.serial_limb import SerialLimb
from limb_systems import (
    LimbError,
    LimbParameters,
    Trajectory,
    WireColors,
    add_limb_actuation,
)
from limb_systems.input import read_text
from limb_systems.model.contact import NEAR_RIGID_THRESHOLD, TIME_STEP, ContactForces
from limb_systems.schema import shown
from limb_systems.simulation import (
    advance,
    build,
    check_duty,
    check_positive,
    config_of_steps,
    make_simulator,
)

SIMULATED, EMULATED, BOARD = KINDS = ("simulated", "emulated", "board")
OUTPUTS = "measured_temperature", "bend_angle", "wire_temperature", "joint_state", "measurement"
TILTED = 0.5  # m/s², by which gravity in a description may differ from that in the plant


class StationError(LimbError):
    """A scenario is wrong, or a station cannot be made of it."""


@dataclasses.dataclass
class LimbDriver:
    """Wires of a limb, as a driver of a scenario. Drake's `ApplyDriverConfigs` knows it, too.

    - ``limb``: YAML file of its `LimbParameters`, from the scenario's folder; the nominal limb if
      empty.
    - ``seed``: seed of the limb where it is emulated.
    - ``port``: serial port of its board.
    """

    limb: str = ""
    seed: int = 0
    port: str = ""

    @property
    def parameters(self) -> LimbParameters:
        """Description of the limb."""
        return LimbParameters.of(self.limb or None)


def _plant_config() -> MultibodyPlantConfig:
    """Contact as of robots."""
    return MultibodyPlantConfig(
        time_step=TIME_STEP,
        discrete_contact_approximation="sap",
        sap_near_rigid_threshold=NEAR_RIGID_THRESHOLD,
    )


@dataclasses.dataclass
class Scenario:
    """What there is, as in the scenarios of Drake's hardware_sim, without LCM and cameras.

    - ``directives``: models and welds; ``package://soft_limb`` has the limb, ``package://scenario``
      is the scenario's folder.
    - ``model_drivers``: a driver for the model instances that have one, by name: `LimbDriver`, or
      Drake's `ZeroForceDriver`.
    - ``plant_config``, ``simulator_config``: settings of the simulation.
    """

    directives: list[ModelDirective] = dataclasses.field(default_factory=list)
    model_drivers: Mapping[str, Union[LimbDriver, ZeroForceDriver]] = dataclasses.field(  # noqa: UP007 - Drake wants it so
        default_factory=dict
    )
    plant_config: MultibodyPlantConfig = dataclasses.field(default_factory=_plant_config)
    simulator_config: SimulatorConfig = dataclasses.field(default_factory=config_of_steps)

    @classmethod
    def load(cls, path: str | Path) -> "Scenario":
        """Reads a YAML file.

        Raises:
            StationError: if it is none, or has other fields.
        """
        text = read_text(path, "scenario", StationError)
        if not text.strip():
            raise StationError(f"{path} is empty; a scenario has directives and model_drivers.")
        try:
            return yaml_load_typed(schema=cls, data=text, defaults=cls())
        except Exception as error:  # Drake and PyYAML have many
            raise StationError(f"{path}: {' '.join(str(error).split())}.") from error


class Station(Diagram, Closed):
    """The limbs of a scenario, and with simulated limbs all else that is in it.

    For each limb, by its name:

    - input ``left_finger.duty``: D (W), in [0, 1]
    - outputs ``left_finger.measured_temperature``: V (W), °C; ``left_finger.bend_angle``: φ (F),
      rad; ``left_finger.measurement``: [V, φ]; and, unless it is on a board,
      ``left_finger.wire_temperature``: T (W), °C, and ``left_finger.joint_state``: [θ, θ̇] (2n)

    With simulated limbs also, for each limb, output ``left_finger.contact_force``: N, of whatever
    touches it, along x, y and z of the world (3); for each other model instance that moves,
    output ``wrist.state``: of the plant; for each that has actuators without a driver, inputs
    ``wrist.actuation``, which may be left unconnected, and ``wrist.desired_state``, which its
    actuators with gains hold if it is connected.

    - ``real_time``: whether it has boards, and so must run in real time and be closed at the end.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        scenario: Scenario | str | Path,
        limbs: str = SIMULATED,
        *,
        meshcat: Meshcat | None = None,
    ):
        """
        Args:
            scenario: what there is, or its YAML file.
            limbs: "simulated", "emulated" or "board". Emulated limbs, `LimbTwin`, and those on
                boards, `SerialLimb`, are there alone, without the plant.
            meshcat: where what is simulated is shown, with wires in the colour of their heat;
                nowhere if None.

        Raises:
            LimbError: one sentence, if a model, a description or a board does not fit.
        """
        super().__init__()
        folder = Path() if isinstance(scenario, Scenario) else Path(scenario).parent
        if not isinstance(scenario, Scenario):
            scenario = Scenario.load(scenario)
        if limbs not in KINDS:
            raise StationError(f"limbs is {limbs!r}; it must be one of {', '.join(KINDS)}.")
        drivers = {
            name: dataclasses.replace(driver, limb=driver.limb and str(folder / driver.limb))
            if isinstance(driver, LimbDriver)
            else driver
            for name, driver in scenario.model_drivers.items()
        }
        of_limbs = {name: d for name, d in drivers.items() if isinstance(d, LimbDriver)}
        self.real_time, self.scenario = limbs == BOARD, scenario
        self._is_simulated, self._names = limbs == SIMULATED, list(of_limbs)
        builder = DiagramBuilder()
        with contextlib.ExitStack() as opened:  # closed again if one does not answer
            if limbs == SIMULATED:
                _add_plant(builder, scenario, drivers, folder)
                if meshcat:
                    _show(builder, list(of_limbs), meshcat)
            for name, driver in of_limbs.items() if limbs != SIMULATED else ():
                limb = _limb_alone(name, driver, limbs)
                if limbs == BOARD:
                    opened.callback(limb.close)
                builder.AddNamedSystem(name, limb)
                _export(builder, limb, name)
            builder.BuildInto(self)
            opened.pop_all()
        self.set_name("station")

    # A reference to a part would keep the station alive, see limb_systems.model.ownership.

    @property
    def plant(self) -> MultibodyPlant | None:
        """The plant of what is simulated; None if limbs are emulated or on boards."""
        return self.GetSubsystemByName("plant") if self._is_simulated else None

    @property
    def limbs(self) -> dict[str, Any]:
        """The system of each limb by name: `LimbActuation`, `LimbTwin` or `SerialLimb`."""
        suffix = "_actuation" if self._is_simulated else ""
        return {name: self.GetSubsystemByName(f"{name}{suffix}") for name in self._names}

    def close(self) -> None:
        """Switches all wires off that are on boards, and closes their ports."""
        with contextlib.ExitStack() as every:  # whatever one of them raises
            for limb in self.limbs.values() if self.real_time else ():
                every.callback(limb.close)


def drive(
    station: Station,
    inputs: Mapping[str, Trajectory | trajectories.Trajectory | ArrayLike],
    duration: float,
    *,
    sample_rate: float = 20.0,
) -> dict[str, np.ndarray]:
    """Runs a station from time 0, on boards in real time, and closes it.

    Args:
        station: it becomes part of a diagram and cannot be run again.
        inputs: signals by the names of ports: a plan for ``NAME.duty``, a Drake trajectory with a
            row for each number, or constants. ``NAME.desired_state`` may have positions alone.
        duration: s.
        sample_rate: rate of what is returned, Hz.

    Returns:
        "time" (K,), s, and the samples (size, K) of all output ports by name.

    Raises:
        StationError: if the station has no such port, an input has another size, or a limb no duty,
            one that ends before the duration, or one beyond its ``total_duty``.
        ReplayError: if a plan must not be replayed on its limb, as `hardware.replaying` says.
        LimbError: if duty leaves [0, 1], or the simulation or a board fails.
    """
    with station:
        check_positive("duration", duration, " s")
        check_positive("sample_rate", sample_rate)
        builder = DiagramBuilder()
        builder.AddSystem(station)
        names = [station.get_input_port(i).get_name() for i in range(station.num_input_ports())]
        if unknown := [name for name in inputs if name not in names]:
            raise StationError(
                f"The station has no input {', '.join(unknown)}; it has {', '.join(names)}."
            )
        if missing := [n for n in names if n.endswith(".duty") and n not in inputs]:
            raise StationError(f"{', '.join(missing)} is missing; each limb needs its duty.")
        limbs = station.limbs
        for name, given in inputs.items():
            port = station.GetInputPort(name)
            signal = _signal(name, given, duration)
            with_rates = name.endswith(".desired_state") and 2 * signal.rows() == port.size()
            if not with_rates and signal.rows() != port.size():
                raise StationError(
                    f"The input {name} has {port.size()} numbers, and what it is given "
                    f"{signal.rows()}."
                )
            if name.endswith(".duty"):
                limb = limbs[name.removesuffix(".duty")]
                if isinstance(given, Trajectory):
                    check_replayable(given, limb)
                _check_duty(name, signal, duration, limb.parameters.total_duty)
            source = builder.AddSystem(TrajectorySource(signal, int(with_rates)))
            builder.Connect(source.get_output_port(), port)
        outputs = map(station.get_output_port, range(station.num_output_ports()))
        sinks = {
            port.get_name(): LogVectorOutput(port, builder, 1 / sample_rate) for port in outputs
        }
        simulator = _simulator(station, build(builder))
        advance(simulator, duration, real_time=station.real_time)
        logs = {name: sink.FindLog(simulator.get_context()) for name, sink in sinks.items()}
    times = next(iter(logs.values())).sample_times()
    return {"time": times} | {name: log.data() for name, log in logs.items()}


def _simulator(station: Station, diagram: Diagram) -> Simulator:
    """By the scenario's configuration, or by what limbs that are alone need."""
    if station.plant is not None:
        simulator = Simulator(diagram)
        ApplySimulatorConfig(station.scenario.simulator_config, simulator)
        return simulator
    accuracies = [limb.accuracy for limb in station.limbs.values()]
    return make_simulator(diagram, min(filter(None, accuracies), default=None))


def _signal(name: str, given: Any, duration: float) -> trajectories.Trajectory:
    """What an input is given, as a trajectory."""
    if isinstance(given, Trajectory):
        return given.since_start().duty_trajectory()
    if isinstance(given, trajectories.Trajectory):
        return given
    try:
        values = np.atleast_1d(np.asarray(given, float))
    except (TypeError, ValueError) as error:
        raise StationError(
            f"The input {name} is {shown(given)}; it must be a plan, a trajectory or numbers."
        ) from error
    held = np.column_stack([values, values])
    return trajectories.PiecewisePolynomial.ZeroOrderHold([0.0, duration], held)


def _check_duty(
    name: str, signal: trajectories.Trajectory, duration: float, total_duty: float
) -> None:
    """Raises LimbError if a limb must not have a duty; its last value would go on after its end."""
    if signal.end_time() < duration - 1e-6:
        raise StationError(
            f"The input {name} ends at {signal.end_time():g} s, before the {duration:g} s of the "
            "run; give a longer one, or run for less."
        )
    times = np.linspace(0.0, duration, 1000)
    check_duty(signal, times)
    if (most := signal.vector_values(times).sum(axis=0).max()) > total_duty + 1e-3:
        raise StationError(
            f"The duties of {name} add up to {most:.2f}, but the limb's total_duty is "
            f"{total_duty:g}; raise it if the supply and the limb are made for that."
        )


def ApplyDriverConfig(
    driver_config: LimbDriver | ZeroForceDriver,
    model_instance_name: str,
    sim_plant: MultibodyPlant,
    models_from_directives: Mapping[str, Any],
    lcms: Any,
    builder: DiagramBuilder,
) -> None:
    """Adds the wires of a limb to a simulation, and exports their ports with the limb's name.

    Args:
        driver_config: description of the limb.
        model_instance_name: name of the limb in the plant.
        sim_plant: finalized, with the limb.
        models_from_directives, lcms: not used.
        builder: builder of the diagram that has the plant.

    Raises:
        ParameterError: if the limb in the plant is not that of the description.
    """
    limb = sim_plant.GetModelInstanceByName(model_instance_name)
    wires = add_limb_actuation(builder, sim_plant, limb, driver_config.parameters)
    _warn_of_gravity(sim_plant, limb, wires.parameters)
    _export(builder, wires, model_instance_name)


def _add_plant(
    builder: DiagramBuilder, scenario: Scenario, drivers: Mapping[str, Any], folder: Path
) -> None:
    """Adds the plant of a scenario with its drivers, and exports the ports of all models."""
    try:
        plant, _ = AddMultibodyPlant(config=scenario.plant_config, builder=builder)
        parser = Parser(plant)
        parser.package_map().PopulateFromFolder(str(Path(urdf.__file__).parent))
        parser.package_map().Add("scenario", str(folder.resolve()))
        directives = ModelDirectives(directives=scenario.directives)
        models = ProcessModelDirectives(directives, plant, parser)
        plant.Finalize()
    except RuntimeError as error:
        raise StationError(f"The scenario: {' '.join(str(error).split())}") from error
    names = [model.model_name for model in models]
    if unknown := [name for name in drivers if name not in names]:
        raise StationError(
            f"model_drivers has {', '.join(unknown)}, but the directives add no model of that "
            f"name; they add {', '.join(names) or 'none'}."
        )
    limbs = [name for name, driver in drivers.items() if isinstance(driver, LimbDriver)]
    ApplyDriverConfigs(
        driver_configs=drivers,
        sim_plant=plant,
        models_from_directives=models,
        lcm_buses=None,
        builder=builder,
    )
    for name in limbs:
        bodies = plant.GetBodyIndices(plant.GetModelInstanceByName(name))
        contact = builder.AddNamedSystem(f"{name}_contact", ContactForces(plant, [bodies]))
        builder.Connect(plant.get_contact_results_output_port(), contact.get_input_port())
        builder.ExportOutput(contact.get_output_port(), f"{name}.contact_force")
    for name in names:
        model = plant.GetModelInstanceByName(name)
        if name not in limbs and plant.num_velocities(model):
            builder.ExportOutput(plant.get_state_output_port(model), f"{name}.state")
        if name not in drivers and plant.num_actuated_dofs(model):
            builder.ExportInput(plant.get_actuation_input_port(model), f"{name}.actuation")
            builder.ExportInput(plant.get_desired_state_input_port(model), f"{name}.desired_state")


def _show(builder: DiagramBuilder, limbs: list[str], meshcat: Meshcat) -> None:
    """Shows what is simulated, with wires in the colour of their heat."""
    ApplyVisualizationConfig(VisualizationConfig(), builder, meshcat=meshcat)
    for name in limbs:
        wires = builder.GetSubsystemByName(f"{name}_actuation")
        colors = builder.AddSystem(WireColors(wires.parameters, meshcat, name))
        builder.Connect(wires.GetOutputPort("wire_temperature"), colors.get_input_port())


def _warn_of_gravity(
    plant: MultibodyPlant, limb: ModelInstanceIndex, parameters: LimbParameters
) -> None:
    """Warns if plans of a limb would be for another direction of gravity than in the plant."""
    base = plant.GetFrameByName("base", limb).CalcPoseInWorld(plant.CreateDefaultContext())
    there = base.rotation().inverse() @ plant.gravity_field().gravity_vector()
    if np.linalg.norm(there - parameters.gravity) > TILTED:
        warnings.warn(
            f"Gravity is {np.round(there, 2).tolist()} m/s² in the base of the limb "
            f"{plant.GetModelInstanceName(limb)!r} and {list(parameters.gravity)} in its "
            "description, for which it is planned; give the description the same gravity.",
            stacklevel=2,
        )


def _limb_alone(name: str, driver: LimbDriver, kind: str) -> LimbTwin | SerialLimb:
    """An emulated limb, or one on a board."""
    if kind == EMULATED:
        return LimbTwin(driver.parameters, seed=driver.seed, truth=True)
    if not driver.port:
        raise StationError(f"The driver of {name} has no port; give its board's serial port.")
    return SerialLimb(driver.port, driver.parameters)


def _export(builder: DiagramBuilder, limb: System, name: str) -> None:
    """Exports the ports of a limb, with its name before theirs."""
    builder.ExportInput(limb.GetInputPort("duty"), f"{name}.duty")
    for output in filter(limb.HasOutputPort, OUTPUTS):
        builder.ExportOutput(limb.GetOutputPort(output), f"{name}.{output}")
