"""A station of limbs by a scenario, as Drake's hardware_sim has it: one diagram, named ports."""

import contextlib
import dataclasses
import logging
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
from hardware.board.link import Closed
from hardware.board.serial_limb import SerialLimb
from hardware.board.several_boards import switch_off_together
from hardware.drivers import LimbDriver, export_limb
from hardware.emulation.twin import LimbTwin
from hardware.replaying import check_replayable
from hardware.scenario import Scenario, StationError
from limb_systems import (
    Trajectory,
    WireColors,
)
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

SIMULATED, EMULATED, BOARD = KINDS = ("simulated", "emulated", "board")


class Station(Diagram, Closed):
    """The limbs of a scenario, and with simulated limbs all else that is in it.

    For each limb, by its name:

    - input ``left_finger.duty``: D (W), in [0, 1]
    - outputs ``left_finger.measured_temperature``: V (W), °C; ``left_finger.bend_angle``: φ (F),
      rad; ``left_finger.measurement``: [V, φ]; and, unless it is on a board,
      ``left_finger.wire_temperature``: T (W), °C, and ``left_finger.joint_state``: [θ, θ̇] (2n)

    With simulated limbs also, for each limb, output ``left_finger.contact_force``: N, of whatever
    touches it, along x, y and z of the world (3), over the plant's step that begins with the state
    that there is; for each other model instance that moves,
    output ``wrist.state``: of the plant; for each that has actuators without a driver, inputs
    ``wrist.actuation``, which may be left unconnected, and ``wrist.desired_state``, which its
    actuators with gains hold if it is connected.

    Boards are switched off together as soon as one of them fails, by `switch_off_together`.

    - ``real_time``: whether it has boards, and so must run in real time and be closed at the end.
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
        if isinstance(scenario, Scenario):
            scenario.validate()
        else:
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
        if not of_limbs:
            raise StationError(
                "The scenario has no limb: model_drivers must have a !LimbDriver for each model "
                "that is one."
            )
        self.real_time, self.scenario = limbs == BOARD, scenario
        self._is_simulated, self._names = limbs == SIMULATED, list(of_limbs)
        builder = DiagramBuilder()
        links: list[Any] = []  # to boards
        with contextlib.ExitStack() as opened:  # closed again if one does not answer
            if limbs == SIMULATED:
                _add_plant(builder, scenario, drivers, folder)
                if meshcat:
                    _show(builder, list(of_limbs), meshcat)
            for name, driver in of_limbs.items() if limbs != SIMULATED else ():
                limb = _limb_alone(name, driver, limbs)
                if limbs == BOARD:
                    opened.callback(limb.close)
                    links.append(limb.link)
                builder.AddNamedSystem(name, limb)
                export_limb(builder, limb, name)
            switch_off_together(links)
            builder.BuildInto(self)
            opened.pop_all()

    # A reference to a part would keep the station alive, see limb_systems.drake_python.

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
        limbs, jumps = station.limbs, np.empty(0)
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
            jumps = np.append(jumps, jump_times(signal))
            source = builder.AddSystem(TrajectorySource(signal, int(with_rates)))
            builder.Connect(source.get_output_port(), port)
        outputs = map(station.get_output_port, range(station.num_output_ports()))
        sinks = {
            port.get_name(): LogVectorOutput(port, builder, 1 / sample_rate) for port in outputs
        }
        simulator = _simulator(station, build(builder))
        end = last_sample_time(duration, sample_rate)
        advance(simulator, end, real_time=station.real_time, jumps=np.unique(jumps))
        logs = {name: sink.FindLog(simulator.get_context()) for name, sink in sinks.items()}
    times = next(iter(logs.values())).sample_times().copy()
    return {"time": times} | {name: log.data().copy() for name, log in logs.items()}


def _simulator(station: Station, diagram: Diagram) -> Simulator:
    """By the scenario's configuration, or by what limbs that are alone need."""
    if station.plant is not None:
        simulator = Simulator(diagram)
        config = station.scenario.simulator_config
        time_step = station.scenario.plant_config.time_step
        ApplySimulatorConfig(config.to_drake(time_step), simulator)
        return simulator
    accuracies = [limb.accuracy for limb in station.limbs.values()]
    return make_simulator(diagram, min(filter(None, accuracies), default=None))


def _signal(name: str, given: Any, duration: float) -> trajectories.Trajectory:
    """Return what an input is given as a trajectory of a column, from time 0.

    Raises:
        StationError: if it is none.
    """
    if isinstance(given, Trajectory):
        return given.since_start().duty_trajectory()
    if isinstance(given, trajectories.Trajectory):
        try:
            shape = given.rows(), given.cols()
        except RuntimeError:  # it is empty
            shape = 0, 0
        if shape[0] == 0 or shape[1] != 1:
            raise StationError(
                f"The input {name} is a trajectory of {shape[0]} x {shape[1]} numbers; it must "
                "have a row for each number of the input, and one column."
            )
        if given.start_time() > 1e-6:
            raise StationError(
                f"The input {name} starts at {given.start_time():g} s, but a run begins at 0 s; "
                "shift it, or say what is before."
            )
        return given
    try:
        values = np.atleast_1d(np.asarray(given, float))
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.ndim != 1 or not values.size or not np.isfinite(values).all():
        raise StationError(
            f"The input {name} is {short_repr(given)}; it must be a plan, a trajectory or a list "
            "of finite numbers."
        )
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


def _add_plant(
    builder: DiagramBuilder, scenario: Scenario, drivers: Mapping[str, Any], folder: Path
) -> None:
    """Adds the plant of a scenario with its drivers, and exports the ports of all models."""
    try:
        config = scenario.plant_config.to_drake()
        plant, _ = AddMultibodyPlant(config=config, builder=builder)
        parser = Parser(plant)
        parser.package_map().PopulateFromFolder(str(Path(urdf.__file__).parent))
        parser.package_map().Add("scenario", str(folder.resolve()))
        with _refusing_replaced_inertia():
            models = ProcessModelDirectives(scenario.to_drake(), plant, parser)
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


@contextlib.contextmanager
def _refusing_replaced_inertia() -> Iterator[None]:
    """Raise StationError if Drake's parser puts the inertia of a ball of water in a body's place.

    It does so where moments break the triangle inequality, and says so in its log alone.
    """
    records: list[logging.LogRecord] = []

    class Keeper(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            records.append(record)

    log, keeper = logging.getLogger("drake"), Keeper()
    log.addHandler(keeper)
    try:
        yield
    finally:
        log.removeHandler(keeper)
    for record in records:
        place, found, reason = record.getMessage().partition(" warning: While parsing inertia")
        if found:
            moments = reason.partition("principal moments of inertia:")[2].split("do not")[0]
            raise StationError(
                f"{place} the moments of inertia {', '.join(moments.split())} kg·m² are those of "
                "no body, and Drake would take those of a ball of water; give moments of which "
                "none is larger than the other two together."
            )


def _show(builder: DiagramBuilder, limbs: list[str], meshcat: Meshcat) -> None:
    """Shows what is simulated, with wires in the colour of their heat."""
    ApplyVisualizationConfig(VisualizationConfig(), builder, meshcat=meshcat)
    for name in limbs:
        wires = builder.GetSubsystemByName(f"{name}_actuation")
        colors = builder.AddSystem(WireColors(wires.parameters, meshcat, name))
        builder.Connect(wires.GetOutputPort("wire_temperature"), colors.get_input_port())


def _limb_alone(name: str, driver: LimbDriver, kind: str) -> LimbTwin | SerialLimb:
    """An emulated limb, or one on a board."""
    if kind == EMULATED:
        return LimbTwin(driver.parameters, seed=driver.seed, truth=True)
    if not driver.port:
        raise StationError(f"The driver of {name} has no port; give its board's serial port.")
    return SerialLimb(driver.port, driver.parameters)
