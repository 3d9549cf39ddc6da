"""A station of limbs by a scenario, as Drake's hardware_sim has it: one diagram, named ports."""

import contextlib
import copy
import dataclasses
import logging.handlers
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories
from pydrake.geometry import Meshcat
from pydrake.manipulation import ApplyDriverConfigs
from pydrake.multibody.parsing import Parser, ProcessModelDirectives
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

import urdf
from hardware.board.link import Closeable
from hardware.board.serial_limb import SerialLimb
from hardware.board.several_boards import switch_off_together
from hardware.emulation.twin import LimbTwin
from hardware.replaying import check_replayable
from hardware.scenario import LimbDriver, Scenario, StationError, export_limb
from limb_systems import Trajectory, WireColors
from limb_systems.contact import ContactForces
from limb_systems.files.schema import short_repr
from limb_systems.simulation import (
    advance,
    build,
    check_duty,
    check_positive,
    jump_times,
    last_sample_time,
    make_simulator,
)

SIMULATED = "simulated"
EMULATED = "emulated"
BOARD = "board"
KINDS = SIMULATED, EMULATED, BOARD


class Station(Diagram, Closeable):
    """The limbs of a scenario, and with simulated limbs also its other models.

    For each limb, by its name:

    - input ``left_finger.duty``: D (W), in [0, 1]
    - outputs ``left_finger.measured_temperature``: V (W), °C; ``left_finger.bend_angle``: φ (F),
      rad; ``left_finger.measurement``: [V, φ]; and, unless it is on a board,
      ``left_finger.wire_temperature``: T (W), °C, and ``left_finger.joint_state``: [θ, θ̇] (2n)

    With simulated limbs there are also:

    - for each limb, output ``left_finger.contact_force``: force on it, N, along x, y and z of the
      world (3), over the plant's step that begins with the present state
    - for each other model instance that moves, output ``wrist.state`` of the plant
    - for each model instance that has actuators without a driver, inputs ``wrist.actuation``, which
      may be left unconnected, and ``wrist.desired_state``, which actuators with gains track

    Boards are switched off together as soon as one of them fails, see `switch_off_together`.

    - ``real_time``: whether it has boards. It then must run in real time and be closed at the end.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        scenario: Scenario | str | Path,
        limbs: str = SIMULATED,
        *,
        meshcat: Meshcat | None = None,
    ):
        """
        Args:
            scenario: the scenario, or its YAML file.
            limbs: "simulated", "emulated" or "board". Emulated limbs, `LimbTwin`, and limbs on
                boards, `SerialLimb`, are alone, without the plant.
            meshcat: view of the simulated models, with wires in the colour of their heat; or None.

        Raises:
            LimbError: one sentence, if a model, a description or a board does not fit.
        """
        super().__init__()
        # Load the scenario, whose folder the paths of its limbs start from.
        folder = Path() if isinstance(scenario, Scenario) else Path(scenario).parent
        if not isinstance(scenario, Scenario):
            scenario = Scenario.load(scenario)
        if limbs not in KINDS:
            raise StationError(f"limbs is {limbs!r}; it must be one of {', '.join(KINDS)}.")
        drivers: dict[str, Any] = dict(scenario.model_drivers)
        limb_drivers: dict[str, LimbDriver] = {}
        for name, driver in scenario.model_drivers.items():
            if isinstance(driver, LimbDriver):
                path = str(folder / driver.limb) if driver.limb else ""
                drivers[name] = limb_drivers[name] = dataclasses.replace(driver, limb=path)
        if not limb_drivers:
            raise StationError(
                "The scenario has no limb: model_drivers must have a !LimbDriver for each model "
                "that is one."
            )
        self.real_time = limbs == BOARD
        self.scenario = scenario
        self._is_simulated = limbs == SIMULATED
        self._names = list(limb_drivers)
        # Add the plant, or each limb alone; boards are closed again if one does not answer.
        builder = DiagramBuilder()
        links: list[Any] = []  # to boards
        with contextlib.ExitStack() as opened:
            if limbs == SIMULATED:
                _add_plant(builder, scenario, drivers, folder)
                if meshcat:
                    # Show the models, with wires in the colour of their heat.
                    ApplyVisualizationConfig(VisualizationConfig(), builder, meshcat=meshcat)
                    for name in limb_drivers:
                        wires = builder.GetSubsystemByName(f"{name}_actuation")
                        colors = builder.AddSystem(WireColors(wires.parameters, meshcat, name))
                        temperature = wires.GetOutputPort("wire_temperature")
                        builder.Connect(temperature, colors.get_input_port())
            for name, driver in limb_drivers.items() if limbs != SIMULATED else ():
                if limbs == EMULATED:
                    limb = LimbTwin(driver.parameters, seed=driver.seed, truth=True)
                elif driver.port:
                    limb = SerialLimb(driver.port, driver.parameters)
                    opened.callback(limb.close)
                    links.append(limb.link)
                else:
                    raise StationError(
                        f"The driver of {name} has no port; give its board's serial port."
                    )
                builder.AddNamedSystem(name, limb)
                export_limb(builder, limb, name)
            switch_off_together(links)
            builder.BuildInto(self)
            opened.pop_all()

    # A reference to a part would keep the station alive, see limb_systems.drake_python.

    @property
    def plant(self) -> MultibodyPlant | None:
        """The plant of a simulation; None if limbs are emulated or on boards."""
        return self.GetSubsystemByName("plant") if self._is_simulated else None

    @property
    def limbs(self) -> dict[str, Any]:
        """The system of each limb by name: `LimbActuation`, `LimbTwin` or `SerialLimb`."""
        suffix = "_actuation" if self._is_simulated else ""
        return {name: self.GetSubsystemByName(f"{name}{suffix}") for name in self._names}

    def close(self) -> None:
        """Switch all wires off that are on boards, and close their ports."""
        with contextlib.ExitStack() as opened:  # closes all, also if one raises
            for limb in self.limbs.values() if self.real_time else ():
                opened.callback(limb.close)


def drive(
    station: Station,
    inputs: Mapping[str, Trajectory | trajectories.Trajectory | ArrayLike],
    duration: float,
    *,
    sample_rate: float = 20.0,
) -> dict[str, np.ndarray]:
    """Run a station from time 0, on boards in real time, and close it.

    Args:
        station: the station, which becomes part of a diagram and cannot be run again.
        inputs: signals by the names of ports: a plan for ``NAME.duty``, a Drake trajectory with a
            row for each number, or constants. ``NAME.desired_state`` may be positions only.
        duration: s.
        sample_rate: rate of the returned samples, Hz.

    Returns:
        "time" (K,), s, and the samples (size, K) of all output ports by name.

    Raises:
        StationError: if the station has no such port, an input has another size, or a limb has no
            duty, a duty that ends before the duration, or a duty beyond its ``total_duty``.
        ReplayError: if a plan must not be replayed on its limb, see `check_replayable`.
        LimbError: if duty leaves [0, 1], or the simulation or a board fails.
    """
    with station:
        # Each input must be known, and each limb have its duty.
        check_positive("duration", duration, " s")
        check_positive("sample_rate", sample_rate)
        builder = DiagramBuilder()
        builder.AddSystem(station)
        ports = map(station.get_input_port, range(station.num_input_ports()))
        names = [port.get_name() for port in ports]
        if unknown := [name for name in inputs if name not in names]:
            raise StationError(
                f"The station has no input {', '.join(unknown)}; it has {', '.join(names)}."
            )
        if missing := [name for name in names if name.endswith(".duty") and name not in inputs]:
            raise StationError(f"{', '.join(missing)} is missing; each limb needs its duty.")
        # Connect a source to each input. Integration stops at its jumps.
        limbs = station.limbs
        jumps = np.empty(0)
        for name, value in inputs.items():
            port = station.GetInputPort(name)
            signal = _as_trajectory(name, value, duration)
            with_rates = name.endswith(".desired_state") and 2 * signal.rows() == port.size()
            if not with_rates and signal.rows() != port.size():
                raise StationError(
                    f"The input {name} has {port.size()} numbers, but its signal {signal.rows()}."
                )
            if name.endswith(".duty"):
                limb = limbs[name.removesuffix(".duty")]
                if isinstance(value, Trajectory):
                    check_replayable(value, limb)
                _check_duty(name, signal, duration, limb.parameters.total_duty)
            jumps = np.append(jumps, jump_times(signal))
            source = builder.AddSystem(TrajectorySource(signal, int(with_rates)))
            builder.Connect(source.get_output_port(), port)
        # Log all outputs, and simulate.
        sinks = {}
        for index in range(station.num_output_ports()):
            port = station.get_output_port(index)
            sinks[port.get_name()] = LogVectorOutput(port, builder, 1 / sample_rate)
        simulator = _simulator(station, build(builder))
        end = last_sample_time(duration, sample_rate)
        advance(simulator, end, real_time=station.real_time, jumps=np.unique(jumps))
        logs = {name: sink.FindLog(simulator.get_context()) for name, sink in sinks.items()}
    times = next(iter(logs.values())).sample_times().copy()
    return {"time": times} | {name: log.data().copy() for name, log in logs.items()}


def _simulator(station: Station, diagram: Diagram) -> Simulator:
    """Return a simulator by the scenario's configuration, or by the accuracy of limbs alone."""
    if station.plant is not None:
        simulator = Simulator(diagram)
        config = copy.copy(station.scenario.simulator_config)
        if not config.integration_scheme:
            config.integration_scheme = "explicit_euler" if station.plant.time_step() else "radau3"
        ApplySimulatorConfig(config, simulator)
        return simulator
    accuracies = [limb.accuracy for limb in station.limbs.values()]
    return make_simulator(diagram, min(filter(None, accuracies), default=None))


def _as_trajectory(name: str, value: Any, duration: float) -> trajectories.Trajectory:
    """Return the value of an input as a trajectory with one column, from time 0.

    Raises:
        StationError: if it is no plan, trajectory or list of numbers.
    """
    if isinstance(value, Trajectory):
        return value.since_start().duty_trajectory()
    # A Drake trajectory must be a column, and begin with the run.
    if isinstance(value, trajectories.Trajectory):
        try:
            rows = value.rows()
            columns = value.cols()
        except RuntimeError:  # it is empty
            rows = columns = 0
        if rows == 0 or columns != 1:
            raise StationError(
                f"The input {name} is a trajectory of {rows} x {columns} numbers; it must "
                "have a row for each number of the input, and one column."
            )
        if value.start_time() > 1e-6:
            raise StationError(
                f"The input {name} starts at {value.start_time():g} s, but a run begins at 0 s; "
                "shift it, or begin it at 0 s."
            )
        return value
    # Constants hold for the whole run.
    try:
        values = np.atleast_1d(np.asarray(value, float))
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.ndim != 1 or not values.size or not np.isfinite(values).all():
        raise StationError(
            f"The input {name} is {short_repr(value)}; it must be a plan, a trajectory or a list "
            "of finite numbers."
        )
    samples = np.column_stack([values, values])
    return trajectories.PiecewisePolynomial.ZeroOrderHold([0.0, duration], samples)


def _check_duty(
    name: str, signal: trajectories.Trajectory, duration: float, total_duty: float
) -> None:
    """Raise LimbError for a duty that ends early, leaves [0, 1] or exceeds the total duty."""
    if signal.end_time() < duration - 1e-6:
        raise StationError(
            f"The input {name} ends at {signal.end_time():g} s, before the {duration:g} s of the "
            "run; give a longer one, or run for less."
        )
    times = np.linspace(0.0, duration, 1000)
    check_duty(signal, times)
    largest_sum = signal.vector_values(times).sum(axis=0).max()
    if largest_sum > total_duty + 1e-3:
        raise StationError(
            f"The duties of {name} add up to {largest_sum:.2f}, but the limb's total_duty is "
            f"{total_duty:g}; raise it if the supply and the limb are made for that."
        )


def _add_plant(
    builder: DiagramBuilder, scenario: Scenario, drivers: Mapping[str, Any], folder: Path
) -> None:
    """Add the plant of a scenario with its drivers, and export the ports of all models."""
    # Load the models.
    try:
        plant, _ = AddMultibodyPlant(config=scenario.plant_config, builder=builder)
        parser = Parser(plant)
        parser.package_map().PopulateFromFolder(str(Path(urdf.__file__).parent))
        parser.package_map().Add("scenario", str(folder.resolve()))
        with _refuse_replaced_inertia():
            models = ProcessModelDirectives(scenario.checked_directives(), plant, parser)
        plant.Finalize()
    except RuntimeError as error:
        raise StationError(f"The scenario: {' '.join(str(error).split())}") from error
    # Add their drivers.
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
    # Export contact forces of limbs, and ports of other models.
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


@contextlib.contextmanager
def _refuse_replaced_inertia() -> Iterator[None]:
    """Raise StationError if Drake's parser replaces a body's inertia by a ball of water's.

    It does so where moments break the triangle inequality, with only a message in its log.
    """
    # Keep what Drake logs of inertia while models are loaded.
    log = logging.getLogger("drake")
    keeper = logging.handlers.BufferingHandler(capacity=10_000)
    keeper.addFilter(lambda record: "While parsing inertia" in record.getMessage())
    log.addHandler(keeper)
    try:
        yield
    finally:
        log.removeHandler(keeper)
    # Find a message about a body's moments of inertia.
    for record in keeper.buffer:
        place, warning, reason = record.getMessage().partition(" warning: While parsing inertia")
        if warning:
            moments = reason.partition("principal moments of inertia:")[2].split("do not")[0]
            raise StationError(
                f"{place} the moments of inertia {', '.join(moments.split())} kg·m² fit no "
                "body, and Drake would replace them by a ball of water's; give moments of which "
                "none is larger than the other two together."
            )
