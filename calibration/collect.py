"""Collecting the recordings that calibration wants.

Those of Sec. V are the sag, the ring-down and heated equilibria; what
`calibration.excitation` lists tells more about the wires in less time.
"""

import copy
import functools
import itertools
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.trajectories import PiecewisePolynomial
from threadpoolctl import threadpool_limits

from calibration.controller import BendAngleController, EquilibriumSchedule
from calibration.course import Course
from calibration.excitation import DutyUntilWarm, Excitation, LimitedDuty, excitations
from calibration.heat import ambient_temperature
from calibration.heat_bounds import check_first_contact, fit_heat_bounds, heat_remarks
from calibration.kinds import heated_kinds, heated_wires, only_segment
from calibration.prediction import LawFit, fit_law
from calibration.rest_angle import rest_angle
from hardware import LimbTwin, SerialLimb
from hardware.live.feed import LiveView, shown
from hardware.robot.journal import journaled
from limb_systems import (
    HystereticLaw,
    LimbError,
    LimbParameters,
    LimbSystem,
    Provenance,
    Recording,
)
from limb_systems.files.table_writer import is_unfinished
from limb_systems.model.limb_system import check_limb
from limb_systems.progress import Progress
from limb_systems.simulation import PERIOD, record

CO_CONTRACTION = 0.08  # duty of the wires where several are actuated
SAG_TRIALS, RING_DOWNS = 10, 3
GRAVITY = 9.81  # m/s²
SAG_RATE = HEATED_RATE = 20.0  # Hz
RING_DOWN_RATE = 100.0
PROTOCOLS = ("all", "excitation", "paper")
# Names of the recordings from which the board's bounds come.
FIRST_CONTACT, WARM_UP = "first_contact", "warm_up"
FIRST_DUTY = 0.3  # the largest sum of both duties while nothing is known of a limb
CONTACT_DUTY, CONTACT_TIME, CONTACT_END = 0.1, 30.0, 100.0  # s
CONTACT_RISE = 12.0  # °C of the readings, at which there is no duty
CONTACT_MARGIN = 0.5  # share by which its bounds are widened, as it is hardly warm
WARM_UP_DUTY, WARM_UP_TIME, WARM_UP_END = 0.15, 60.0, 100.0  # s
WARM_UP_RISE = 60.0  # °C; a wire that shows 60% of its rise then stays below 130 °C
WARM_UP_MARGIN = 0.25  # share by which its bounds are widened, as it is short and not hot


def collect_equilibria(
    limb: LimbSystem,
    actuated: str,
    *,
    num_angles: int = 8,
    largest_deg: float = 45.0,
    seed: int = 0,
    longest: float = 60.0,
    journal: str | Path | None = None,
    live: LiveView | None = None,
) -> Recording:
    """The datasets C^r, C^l and C^m of Sec. V-C: random equilibria, held by PI control.

    The angles are uniform between zero and the largest towards the actuated
    wire, or to both sides. Where several wires are, each has its own duty
    beside what the controller asks for.

    Args:
        limb: a `LimbTwin` or any other `LimbSystem`, of one segment; it
            cannot be used again.
        actuated: name of the wire, or "both" for all of them.
        num_angles: how many equilibria.
        largest_deg: bend angle, degrees.
        seed: of the random angles.
        longest: s that one of them is held.
        journal, live: file of the recording, and page, as for `hardware.replay`.

    Returns:
        A recording with the set points φ_eq as its ``reference``.

    Raises:
        LimbError: if an argument makes no sense.
    """
    check_limb(limb)
    heated = heated_wires(limb.parameters, actuated)
    if not num_angles >= 1 or not 0 < largest_deg < 90:
        raise LimbError(
            f"num_angles is {num_angles!r} and largest_deg {largest_deg!r}; there must be an angle "
            "at least, and the largest within 0° and 90°."
        )
    if seed < 0:
        raise LimbError(f"The seed of the random angles is {seed}; it must be zero or more.")
    wires = only_segment(limb.parameters).wires
    sides = np.sign([wires[index].direction for index in heated])
    low, high = min(0, *sides), max(0, *sides)
    random = np.random.default_rng(seed)
    angles = np.deg2rad(largest_deg) * random.uniform(low, high, num_angles)

    builder = DiagramBuilder()
    builder.AddSystem(limb)
    schedule = builder.AddSystem(EquilibriumSchedule(angles, longest, num_wires=len(wires)))
    controller = builder.AddSystem(
        BendAngleController(
            limb.parameters,
            actuated,
            co_contraction=CO_CONTRACTION if len(heated) > 1 else 0.0,
        )
    )
    for name in ("bend_angle", "measured_temperature"):
        for system in (schedule, controller):
            builder.Connect(limb.GetOutputPort(name), system.GetInputPort(name))
    builder.Connect(schedule.get_output_port(), controller.GetInputPort("set_point"))
    duty, reference = controller.get_output_port(), schedule.get_output_port()
    duration, made = num_angles * longest, Provenance.now(limb.parameters, seed)
    with (
        shown(builder, live, limb, duty, duration, reference=reference),
        journaled(builder, journal, limb, duty, HEATED_RATE, reference=reference, provenance=made),
    ):
        return record(
            builder,
            limb,
            duty,
            duration,
            reference=reference,
            until=lambda context: schedule.is_finished(schedule.GetMyContextFromRoot(context)),
            real_time=live is not None,
            sample_rate=HEATED_RATE,
            provenance=made,
        )


def collect_sag(
    limb: LimbSystem, *, journal: str | Path | None = None, live: LiveView | None = None
) -> Recording:
    """Sec. V-A: the unheated limb, mounted so that gravity bends it, until it rests (15 s)."""
    return _collect_unheated(limb, 15.0, SAG_RATE, journal, live)


def collect_ring_down(
    limb: LimbSystem,
    sample_rate: float = RING_DOWN_RATE,
    *,
    journal: str | Path | None = None,
    live: LiveView | None = None,
) -> Recording:
    """Sec. V-B: a person holds the limb at 45° and releases it within the next 6 s."""
    return _collect_unheated(limb, 6.0, sample_rate, journal, live)


def collect_first_contact(
    limb: LimbSystem, *, journal: str | Path | None = None, live: LiveView | None = None
) -> Recording:
    """One wire after the other warmed by some degrees, of a limb of which nothing is known yet.

    `fit_heat_bounds` learns from it with what bounds the wires can be warmed up.
    """
    num_wires = len(limb.parameters.wires)
    pause = (CONTACT_END - num_wires * CONTACT_TIME) / num_wires
    times, levels = [0.0], []
    for wire in np.eye(num_wires):
        times += [times[-1] + CONTACT_TIME, times[-1] + CONTACT_TIME + pause]
        levels += [CONTACT_DUTY * wire, 0 * wire]
    return _collect_warm(limb, times, levels, CONTACT_RISE, journal, live)


def collect_warm_up(
    limb: LimbSystem, *, journal: str | Path | None = None, live: LiveView | None = None
) -> Recording:
    """All wires a little heated at once, for a minute, from which `fit_heat_bounds` learns."""
    all_wires = np.ones(len(limb.parameters.wires))
    levels = [WARM_UP_DUTY * all_wires, 0 * all_wires]
    return _collect_warm(
        limb, [0.0, WARM_UP_TIME, WARM_UP_END], levels, WARM_UP_RISE, journal, live
    )


def for_first_contact(described: LimbParameters) -> LimbParameters:
    """The limb as a board is told of it for `collect_first_contact`: any wire, little duty."""
    careful = copy.deepcopy(described)
    careful.total_duty = min(described.total_duty, FIRST_DUTY)
    for wire, bounds in zip(careful.wires, described.heat_bounds, strict=True):
        wire.heat_bounds = bounds.around_any()
    return careful


def _collect_warm(
    limb: LimbSystem,
    times: list[float],
    levels: list[np.ndarray],
    rise: float,
    journal: str | Path | None,
    live: LiveView | None,
) -> Recording:
    """With a duty of each level until the next time, while no reading rose by more."""
    check_limb(limb)
    builder = DiagramBuilder()
    course = PiecewisePolynomial.ZeroOrderHold(times, np.array([*levels, levels[-1]]).T)
    source = builder.AddSystem(DutyUntilWarm(course, rise))
    builder.AddSystem(limb)
    builder.Connect(limb.GetOutputPort("measured_temperature"), source.get_input_port())
    made = Provenance.now(limb.parameters)
    duty = source.get_output_port()
    return _record(builder, limb, duty, times[-1], HEATED_RATE, journal, live, made)


def collect_excitation(
    limb: LimbSystem,
    excitation: Excitation,
    known: LimbParameters,
    *,
    journal: str | Path | None = None,
    live: LiveView | None = None,
) -> Recording:
    """One of `excitations`, with duty that is limited by what is known of the limb so far.

    Args:
        known: the limb as it is calibrated so far.
        limb, journal, live: as for `collect_equilibria`.
    """
    check_limb(limb)
    builder = DiagramBuilder()
    source = builder.AddSystem(LimitedDuty(known, excitation.course))
    builder.AddSystem(limb)
    builder.Connect(limb.GetOutputPort("measured_temperature"), source.get_input_port())
    duty, duration = source.get_output_port(), excitation.course.end_time()
    made = Provenance.now(limb.parameters, excitation.seed)
    return _record(builder, limb, duty, duration, HEATED_RATE, journal, live, made)


class Knowledge:
    """What the recordings so far tell of a limb, and how well they predict the next one.

    Args:
        described: the limb as it was described.
        recordings: made before: of ring-downs, for the angle at rest, and with heat.
    """

    LAW = HystereticLaw  # which has the other laws' shapes

    def __init__(self, described: LimbParameters, recordings: Iterable[Recording] = ()):
        self._described, self._recordings = copy.deepcopy(described), list(recordings)
        self._fit: LawFit | None = None
        self._judges: list[Recording] = []

    @property
    def limb(self) -> LimbParameters:
        """The limb as it is calibrated so far."""
        if self._fit is None:
            self._learn()
        assert self._fit is not None
        return self._fit.calibrated(self._described)

    def add(self, recording: Recording, kind: str) -> str:
        """Takes in a recording; says how well it was predicted before."""
        if self._fit is None:
            self._learn()
        assert self._fit is not None
        with threadpool_limits(1, "blas"):
            (predicted,) = self._fit.predict([Course.of(recording)])
        if kind == "motion":
            self._judges.append(recording)
        else:
            self._recordings.append(recording)
            self._fit = None
        told = (
            f"predicted to {np.rad2deg(predicted.bend_error):.1f}° and "
            f"{predicted.temperature_error:.1f} °C on average before it was fitted"
        )
        if len(self._judges) > 1:
            floor = np.mean(
                [
                    np.abs(a.bend_angle[0, :length] - b.bend_angle[0, :length]).mean()
                    for a, b in itertools.combinations(self._judges, 2)
                    for length in [min(a.bend_angle.shape[1], b.bend_angle.shape[1])]
                ]
            )
            told += f"; motions differ by {np.rad2deg(floor):.1f}° from each other"
        return told

    def _learn(self) -> None:
        described, recordings = self._described, self._recordings
        ambient = ambient_temperature(recordings).value
        segment = copy.deepcopy(only_segment(described))
        segment.rest_angle = rest_angle(recordings, ambient).value
        courses = [Course.of(recording) for recording in recordings if recording.duty.any()]
        with threadpool_limits(1, "blas"):
            self._fit = fit_law(self.LAW, courses, segment, ambient)


def _collect_unheated(
    limb: LimbSystem,
    duration: float,
    sample_rate: float,
    journal: str | Path | None,
    live: LiveView | None,
) -> Recording:
    off = ConstantVectorSource(np.zeros(len(limb.parameters.wires)))
    return _collect(limb, off, duration, sample_rate, journal, live)


def _collect(
    limb: LimbSystem,
    source: LeafSystem,
    duration: float,
    sample_rate: float,
    journal: str | Path | None,
    live: LiveView | None,
) -> Recording:
    check_limb(limb)
    builder = DiagramBuilder()
    builder.AddSystem(source)
    builder.AddSystem(limb)
    duty = source.get_output_port()
    made = Provenance.now(limb.parameters)
    return _record(builder, limb, duty, duration, sample_rate, journal, live, made)


def _record(
    builder: DiagramBuilder,
    limb: LimbSystem,
    duty: OutputPort,
    duration: float,
    sample_rate: float,
    journal: str | Path | None,
    live: LiveView | None,
    made: Provenance,
) -> Recording:
    with (
        shown(builder, live, limb, duty, duration),
        journaled(builder, journal, limb, duty, sample_rate, provenance=made),
    ):
        return record(
            builder,
            limb,
            duty,
            duration,
            real_time=live is not None,
            sample_rate=sample_rate,
            provenance=made,
        )


def hand_for_ring_down() -> PiecewisePolynomial:
    """A hand's course for `LimbTwin`: to 45° within 1 s, released after 2 s, in rad."""
    return PiecewisePolynomial.FirstOrderHold([0.0, 1.0, 2.0], [[0.0, np.pi / 4, np.pi / 4]])


def collect_from_twin(
    twin: LimbTwin,
    *,
    seed: int = 0,
    num_angles: int = 8,
    longest: float = 60.0,
    cooling_time: float = 300.0,
    sag_trials: int = SAG_TRIALS,
    ring_downs: int = RING_DOWNS,
    protocol: str = "all",
    tell: Callable[[str], object] = lambda what: None,
    live: LiveView | None = None,
) -> dict[str, list[Recording]]:
    """All recordings that calibration wants, from an emulated limb, one after the other.

    Trials of the sag, ring-downs, then equilibria with one wire after the other, and
    with all of them, as in Sec. V; then a warm-up and `excitations`.

    Args:
        twin: of one segment; `again` is called on it.
        seed, num_angles, longest: as for `collect_equilibria`.
        cooling_time: s without heat before each recording of equilibria.
        sag_trials, ring_downs: how many of them.
        protocol: "paper" for those of Sec. V, "excitation" for `excitations` in place
            of equilibria, or "all".
        tell: is called after each excitation, with how well it was predicted.
        live: page on which the limb is shown, in real time: for an hour.

    Returns:
        recordings by kind, as `calibrate` takes them.

    Raises:
        LimbError: if there is no such protocol.
    """
    check_protocol(protocol)
    kinds = heated_kinds(twin.parameters)
    say = live.say if live else lambda _: None
    sags, swings, heated = [], [], {}
    for number in range(1, sag_trials + 1):
        say(f"sag {number} of {sag_trials}")
        twin = twin.again(gravity=(0.0, -GRAVITY, 0.0))
        sags.append(collect_sag(twin, live=live))
    for number in range(1, ring_downs + 1):
        say(f"ring-down {number} of {ring_downs}")
        twin = twin.again(
            gravity=(0.0, 0.0, 0.0), hand=hand_for_ring_down(), bend_rate=RING_DOWN_RATE
        )
        swings.append(collect_ring_down(twin, live=live))
    for number, actuated in enumerate(kinds if protocol != "excitation" else ()):
        say(f"equilibria: {actuated}")
        twin = twin.again(cooling_time, gravity=(0.0, 0.0, 0.0))
        heated[actuated] = [
            collect_equilibria(
                twin,
                actuated,
                num_angles=num_angles,
                seed=seed + number,
                longest=longest,
                live=live,
            )
        ]
    recordings = {"sag": sags, "ring_down": swings, **heated}
    if protocol == "paper":
        return recordings
    twin = twin.again(cooling_time, gravity=(0.0, 0.0, 0.0))
    say("warm-up")
    recordings["heated"] = [collect_warm_up(twin, live=live)]
    knowledge = Knowledge(twin.parameters, swings + recordings["heated"])
    recordings["motion"] = []
    for number, excitation in enumerate(excitations(len(twin.parameters.wires), seed)):
        twin = twin.again(excitation.pause if number else cooling_time)
        say(f"{excitation.name}: calibrating with what was recorded so far")
        known = knowledge.limb
        say(excitation.name)
        recording = collect_excitation(twin, excitation, known, live=live)
        recordings[excitation.kind].append(recording)
        tell(f"{excitation.name}: {knowledge.add(recording, excitation.kind)}")
    return recordings


def check_protocol(protocol: str) -> None:
    """Raises LimbError if there is no protocol of that name."""
    if protocol not in PROTOCOLS:
        raise LimbError(f"protocol is {protocol!r}; it must be one of {', '.join(PROTOCOLS)}.")


def collect_from_robot(
    connect: Callable[[LimbParameters], SerialLimb],
    parameters: LimbParameters,
    folder: str | Path,
    ask: Callable[[str], object],
    *,
    seed: int = 0,
    num_angles: int = 8,
    longest: float = 60.0,
    protocol: str = "all",
    tell: Callable[[str], object] = lambda what: None,
    live: LiveView | None = None,
) -> None:
    """All recordings that calibration wants, from a robot, one file after the other.

    Before the heated ones the wires are warmed by some degrees, with a little duty and
    bounds so wide that the board takes in any limb, and then warmed up, to tell the board
    what to expect of these wires. What a wire or thermocouple shows that is unlike the others
    or the description is told.

    Each sample goes to a file when it arrives, which gets its name when the
    recording is complete. Recordings that are complete are kept, so that it can be
    interrupted. One that was interrupted is made again; what there is of it is
    kept under its name of an unfinished file, with a warning.

    Args:
        connect: makes a `SerialLimb` with the given description.
        parameters: the limb's description, of one segment.
        folder: for the recordings, named after their kinds.
        ask: shows an instruction to the operator, and returns when it is done.
        seed, num_angles, longest: as for `collect_equilibria`.
        protocol, tell: as for `collect_from_twin`.
        live: page on which the limb is shown, and what is done.

    Raises:
        LimbError: if there is no such protocol, or if a thermocouple shows no heat.
        HardwareError: if the robot fails on the way; it is off then.
        OutputError: as for `hardware.replay`.
    """
    check_protocol(protocol)
    kinds = heated_kinds(parameters)
    say = live.say if live else lambda _: None
    mounted, level = copy.deepcopy(parameters), copy.deepcopy(parameters)
    mounted.gravity, level.gravity = [0.0, -GRAVITY, 0.0], [0.0, 0.0, 0.0]
    wires = sorted(only_segment(parameters).wires, key=lambda wire: wire.direction)
    side = "towards" if wires[0].direction < 0 else "away from"
    sag = (
        f"Mount the limb so that gravity bends it {side} its {wires[0].name} wire, and let it hang "
        "still."
    )
    ring = "Mount the limb level. Bend it to 45° by hand, and release it 2 s after Enter."
    cool = "Leave the limb level and alone until its wires are cold."
    rate = 1 / PERIOD
    tasks: list[tuple[str, LimbParameters, str, Callable[..., Recording]]]
    tasks = [(f"sag_{n}", mounted, sag, collect_sag) for n in range(1, SAG_TRIALS + 1)]
    tasks += [
        (f"ring_down_{n}", level, ring, functools.partial(collect_ring_down, sample_rate=rate))
        for n in range(1, RING_DOWNS + 1)
    ]
    careful = for_first_contact(level)
    if not (Path(folder) / f"{WARM_UP}.csv").exists():
        tasks.append((FIRST_CONTACT, careful, cool, collect_first_contact))
    tasks.append((WARM_UP, level, cool, collect_warm_up))
    for number, actuated in enumerate(kinds if protocol != "excitation" else ()):
        collect_held = functools.partial(
            collect_equilibria,
            actuated=actuated,
            num_angles=num_angles,
            seed=seed + number,
            longest=longest,
        )
        tasks.append((actuated, level, cool, collect_held))
    for name, description, instruction, collect in tasks:
        path = Path(folder) / f"{name}.csv"
        if name in (WARM_UP, *kinds):
            _set_heat_bounds(description, parameters, Path(folder))
        if not path.exists():
            _warn_of_unfinished(path)
            ask(f"{name}: {instruction}")
            say(f"{name}: recording")
            with connect(description) as limb:
                recording = collect(limb, journal=path, live=live)
            if name == FIRST_CONTACT:
                check_first_contact(recording, parameters, path)
            if name in (FIRST_CONTACT, WARM_UP):
                for remark in heat_remarks([recording], parameters):
                    tell(f"{name}: {remark}")
    if protocol != "paper":
        _set_heat_bounds(level, parameters, Path(folder))
        _excite_robot(connect, level, Path(folder), ask, seed, tell, live)


def _excite_robot(
    connect, level: LimbParameters, folder: Path, ask, seed: int, tell, live: LiveView | None
) -> None:
    """`excitations`, which run one after the other without the operator."""
    say = live.say if live else lambda _: None
    todo = excitations(len(level.wires), seed)
    before = [*sorted(folder.glob("ring_down_?.csv")), folder / f"{WARM_UP}.csv"]
    knowledge = Knowledge(level, map(Recording.load, before))
    asked = False
    for excitation in todo:
        path = folder / f"{excitation.name}.csv"
        if path.exists():
            knowledge.add(Recording.load(path), excitation.kind)
            continue
        _warn_of_unfinished(path)
        if not asked:
            ask(
                f"{excitation.name} and what follows: Leave the limb level and alone until its "
                "wires are cold, and for 20 minutes after Enter."
            )
            asked = True
        else:
            resting = f"resting before {excitation.name}"
            say(f"{resting} for {excitation.pause:g} s")
            _wait(excitation.pause, resting)
        say(f"{excitation.name}: calibrating with what was recorded so far")
        known = knowledge.limb  # takes seconds, in which no robot should wait
        say(f"{excitation.name}: recording")
        with connect(level) as limb:
            recording = collect_excitation(limb, excitation, known, journal=path, live=live)
        tell(f"{excitation.name}: {knowledge.add(recording, excitation.kind)}")


def _wait(duration: float, label: str) -> None:
    with Progress(label, duration, "s") as progress:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0:
            progress.update(duration - left)
            time.sleep(min(0.5, left))


def _warn_of_unfinished(path: Path) -> None:
    for left in filter(is_unfinished, sorted(path.parent.glob(f"{path.stem}.*"))):
        warnings.warn(
            f"{left} was interrupted; it is kept, calibration ignores it, and {path.stem} is "
            "recorded again.",
            stacklevel=3,
        )


def _set_heat_bounds(limb: LimbParameters, described: LimbParameters, folder: Path) -> None:
    """Gives wires that have no bounds of their own those that first contact and warm-up show."""
    paths = [folder / f"{name}.csv" for name in (FIRST_CONTACT, WARM_UP)]
    margin = WARM_UP_MARGIN if paths[-1].exists() else CONTACT_MARGIN
    recordings = [Recording.load(path) for path in paths if path.exists()]
    fitted = fit_heat_bounds(recordings, described, margin)
    for wire, given, bounds in zip(limb.wires, described.wires, fitted, strict=True):
        wire.heat_bounds = given.heat_bounds or bounds


def save_recordings(recordings: dict[str, list[Recording]], folder: str | Path) -> list[Path]:
    """Writes recordings to files named after their kinds; returns their paths."""
    paths = []
    for kind, group in recordings.items():
        for number, recording in enumerate(group, 1):
            name = kind if len(group) == 1 else f"{kind}_{number}"
            paths.append(Path(folder) / f"{name}.csv")
            recording.save(paths[-1])
    return paths
