"""All recordings that calibration wants, from an emulated limb or from a robot.

Those of Sec. V are the sag, the ring-down and heated equilibria; what
`calibration.collecting.excitation` lists tells more about the wires in less time.
"""

import copy
import functools
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from calibration.collecting.collect import (
    CONTACT_TIME,
    RING_DOWN_RATE,
    WARM_UP_TIME,
    collect_equilibria,
    collect_excitation,
    collect_first_contact,
    collect_ring_down,
    collect_sag,
    collect_warm_up,
    for_first_contact,
)
from calibration.collecting.excitation import Excitation, excitations, mountings
from calibration.collecting.knowledge import Knowledge
from calibration.heat_bounds import check_first_contact, fit_heat_bounds, heat_remarks
from calibration.recordings.kinds import FIRST_CONTACT, WARM_UP, heated_kinds, only_segment
from hardware import LimbTwin, SerialLimb
from hardware.live.feed import LiveView
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.files.table_writer import is_unfinished
from limb_systems.progress import Progress, part_of_work
from limb_systems.simulation import PERIOD

SAG_TRIALS, RING_DOWNS = 10, 3
SPEED = 70.0  # time for which wires of an emulated limb are heated, over that of collecting in all
GRAVITY = 9.81  # m/s²
HANGING, LEVEL = (0.0, -GRAVITY, 0.0), (0.0, 0.0, 0.0)  # gravity, m/s²
PROTOCOLS = ("all", "excitation", "paper")
CONTACT_MARGIN = 0.5  # share by which bounds of first contact are widened, as it is hardly warm
WARM_UP_MARGIN = 0.25  # share by which those of the warm-up are, as it is short and not hot


def hand_for_ring_down(axes: int = 1) -> PiecewisePolynomial:
    """A hand's course for `LimbTwin`: to 45° towards E2 within 1 s, released after 2 s, in rad."""
    course = np.zeros((axes, 3))
    course[0, 1:] = np.pi / 4
    return PiecewisePolynomial.FirstOrderHold([0.0, 1.0, 2.0], course)


def mounted(limb: LimbParameters, turned: float | None) -> LimbParameters:
    """A limb as it is mounted for an excitation: turned about E1 under gravity, or unbent by it.

    One that bends in space and is turned has another weight at its tip, as heavy as its segment,
    with which it sags four times as far: bend sensors drift by a quarter of its own sag.
    """
    limb = copy.deepcopy(limb)
    segment = only_segment(limb)
    limb.gravity = list(LEVEL)
    if turned is not None:
        angle = np.deg2rad(turned)
        limb.gravity = [0.0, -GRAVITY * float(np.cos(angle)), GRAVITY * float(np.sin(angle))]
        limb.payload += segment.mass if segment.axes > 1 else 0.0
    elif segment.axes > 1:
        limb.gravity = [GRAVITY, 0.0, 0.0]  # it hangs
    return limb


def program(limb: LimbParameters, seed: int, protocol: str) -> list[Excitation]:
    """The excitations of a protocol, motions last.

    Where a limb bends in space, the stairs of `mountings` take the place of pulses and ramps.
    """
    every = excitations(len(limb.wires), seed)
    if only_segment(limb).axes == 1 or protocol == "excitation":
        return every
    heated = [each for each in every if each.name in ("conditioning", "random")]
    motions = [each for each in every if each.kind == "motion"]
    return [*heated, *mountings(len(limb.wires)), *motions]


def heated_times(
    limb: LimbParameters,
    protocol: str,
    *,
    seed: int,
    num_angles: int,
    longest: float,
    sag_trials: int,
    ring_downs: int,
    emulated: bool,
) -> dict[str, float]:
    """How long each recording of a protocol heats wires at most, s, by name, in their order.

    Args:
        limb: description of the limb, of one segment.
        emulated: whether the limb is, which needs no first contact.
        protocol, seed, num_angles, longest, sag_trials, ring_downs: as for `collect_from_twin`.
    """
    planar = only_segment(limb).axes == 1
    unheated = [f"sag_{number}" for number in range(1, sag_trials + 1)] if planar else []
    unheated += [f"ring_down_{number}" for number in range(1, ring_downs + 1)]
    kinds = heated_kinds(limb) if planar and protocol != "excitation" else ()
    held = dict.fromkeys(kinds, num_angles * longest)
    warm = {WARM_UP: WARM_UP_TIME}
    if emulated:
        heated = held if protocol == "paper" else held | warm
    else:
        heated = {FIRST_CONTACT: CONTACT_TIME * len(limb.wires)} | warm | held
    if protocol != "paper":
        heated |= {each.name: each.heated_time for each in program(limb, seed, protocol)}
    return dict.fromkeys(unheated, 0.0) | heated


def _numbered(name: str, names: Iterable[str]) -> str:
    """A recording, and which of how many it is."""
    names = list(names)
    return f"{name}, {names.index(name) + 1} of {len(names)}"


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
        twin: an emulated limb of one segment; `again` is called on it.
        seed, num_angles, longest: as for `collect_equilibria`.
        cooling_time: time without heat before each recording of equilibria, s.
        sag_trials, ring_downs: numbers of recordings.
        protocol: "paper" for the recordings of Sec. V, "excitation" for `excitations` in
            place of equilibria, or "all".
        tell: is called with about how long it takes, and after each excitation, with how well
            it was predicted.
        live: page on which the limb is shown, in real time: for an hour.

    Returns:
        recordings by kind, as `calibrate` takes them.

    Raises:
        LimbError: if there is no such protocol.
    """
    _check_protocol(protocol, twin.parameters)
    say = live.say if live else lambda _: None
    described = twin.parameters
    axes, level = only_segment(described).axes, mounted(described, None).gravity
    heated = heated_times(
        described,
        protocol,
        seed=seed,
        num_angles=num_angles,
        longest=longest,
        sag_trials=sag_trials,
        ring_downs=ring_downs,
        emulated=True,
    )
    seconds = sum(heated.values()) / SPEED
    tell(f"{len(heated)} recordings of an emulated limb, which take about {seconds:.2g} s")

    def made(name: str, collect: Callable[..., Recording], *arguments: Any) -> Recording:
        say(what := _numbered(name, heated))
        with part_of_work(what):
            return collect(*arguments, live=live)

    recordings: dict[str, list[Recording]] = {"sag": [], "ring_down": []}
    for number in range(1, sag_trials + 1) if axes == 1 else ():
        twin = twin.again(gravity=HANGING)
        recordings["sag"].append(made(f"sag_{number}", collect_sag, twin))
    for number in range(1, ring_downs + 1):
        twin = twin.again(gravity=level, hand=hand_for_ring_down(axes), bend_rate=RING_DOWN_RATE)
        recordings["ring_down"].append(made(f"ring_down_{number}", collect_ring_down, twin))
    kinds = heated_kinds(twin.parameters) if protocol != "excitation" else ()
    for number, kind in enumerate(kinds if axes == 1 else ()):
        twin = twin.again(cooling_time, gravity=LEVEL)
        held = functools.partial(
            collect_equilibria,
            actuated=kind,
            num_angles=num_angles,
            seed=seed + number,
            longest=longest,
        )
        recordings[kind] = [made(kind, held, twin)]
    if protocol == "paper":
        return recordings
    twin = twin.again(cooling_time, gravity=level)
    recordings |= {"heated": [made(WARM_UP, collect_warm_up, twin)], "motion": []}
    knowledge = Knowledge(twin.parameters, recordings["ring_down"] + recordings["heated"])
    for number, excitation in enumerate(program(described, seed, protocol)):
        limb = mounted(described, excitation.turned)
        pause = excitation.pause if number else cooling_time
        twin = twin.again(pause, gravity=limb.gravity, payload=limb.payload)
        say(f"{excitation.name}: calibrating with what was recorded so far")
        recording = made(excitation.name, collect_excitation, twin, excitation, knowledge.limb)
        recordings[excitation.kind].append(recording)
        tell(f"{excitation.name}: {knowledge.add(recording, excitation.kind)}")
    return recordings


def _check_protocol(protocol: str, limb: LimbParameters) -> None:
    if protocol not in PROTOCOLS:
        raise LimbError(f"protocol is {protocol!r}; it must be one of {', '.join(PROTOCOLS)}.")
    if protocol == "paper" and only_segment(limb).axes > 1:
        raise LimbError(
            "The paper's protocol is one for limbs that bend in a plane; collect with protocol all."
        )


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
        folder: folder of the recordings, named after their kinds.
        ask: shows an instruction to the operator, and returns when it is done.
        seed, num_angles, longest: as for `collect_equilibria`.
        protocol: as for `collect_from_twin`.
        tell: is called with how long wires are heated in all, and as by `collect_from_twin`.
        live: page on which the limb is shown, and what is done.

    Raises:
        LimbError: if there is no such protocol, or if a thermocouple shows no heat.
        HardwareError: if the robot fails on the way; it is off then.
        OutputError: as for `hardware.replay`.
    """
    _check_protocol(protocol, parameters)
    folder = Path(folder)
    say = live.say if live else lambda _: None
    planar = only_segment(parameters).axes == 1
    sagging, level = mounted(parameters, 0.0), mounted(parameters, None)
    heated = heated_times(
        parameters,
        protocol,
        seed=seed,
        num_angles=num_angles,
        longest=longest,
        sag_trials=SAG_TRIALS,
        ring_downs=RING_DOWNS,
        emulated=False,
    )
    left = [heated[name] for name in heated if not (folder / f"{name}.csv").exists()]
    tell(
        f"{len(left)} of {len(heated)} recordings are left, in which wires are heated for at most "
        f"{sum(left) / 60:.2g} min in all"
    )

    def made(
        name: str, limb: LimbParameters, collect: Callable[..., Recording], instruction: str
    ) -> Recording | None:
        """A new recording, with its file; None if there is one already."""
        path = folder / f"{name}.csv"
        if path.exists():
            return None
        for left in filter(is_unfinished, sorted(folder.glob(f"{name}.*"))):
            warnings.warn(
                f"{left} was interrupted; it is kept, calibration ignores it, and {name} is "
                "recorded again.",
                stacklevel=3,
            )
        if instruction:
            ask(f"{name}{instruction}")
        say(what := _numbered(name, heated))
        with part_of_work(what), connect(limb) as robot:
            return collect(robot, journal=path, live=live)

    wires = sorted(only_segment(parameters).wires, key=lambda wire: wire.lever[0])
    side = "towards" if wires[0].lever[0] < 0 else "away from"
    hang = (
        f": Mount the limb so that gravity bends it {side} its {wires[0].name} wire, and let it "
        "hang still."
    )
    place = "level" if planar else "so that it hangs straight down"
    swing = f": Mount the limb {place}. Bend it to 45° by hand, and release it 2 s after Enter."
    where = "level" if planar else "as it hangs"
    cool = f": Leave the limb {where} and alone until its wires are cold."
    for number in range(1, SAG_TRIALS + 1) if planar else ():
        made(f"sag_{number}", sagging, collect_sag, hang)
    ring_down = functools.partial(collect_ring_down, sample_rate=1 / PERIOD)
    for number in range(1, RING_DOWNS + 1):
        made(f"ring_down_{number}", level, ring_down, swing)

    def tell_of(name: str, recording: Recording | None) -> None:
        for remark in heat_remarks([recording], parameters) if recording else ():
            tell(f"{name}: {remark}")

    if not (folder / f"{WARM_UP}.csv").exists():
        contact = made(FIRST_CONTACT, for_first_contact(level), collect_first_contact, cool)
        if contact:
            check_first_contact(contact, parameters, folder / f"{FIRST_CONTACT}.csv")
        tell_of(FIRST_CONTACT, contact)
    _set_heat_bounds(level, parameters, folder)
    tell_of(WARM_UP, made(WARM_UP, level, collect_warm_up, cool))
    _set_heat_bounds(level, parameters, folder)
    kinds = heated_kinds(parameters) if planar and protocol != "excitation" else ()
    for number, kind in enumerate(kinds):
        held = functools.partial(
            collect_equilibria,
            actuated=kind,
            num_angles=num_angles,
            seed=seed + number,
            longest=longest,
        )
        made(kind, level, held, cool)
    if protocol == "paper":
        return
    before = [*sorted(folder.glob("ring_down_?.csv")), folder / f"{WARM_UP}.csv"]
    knowledge = Knowledge(level, map(Recording.load, before))
    first, turned = True, None
    for excitation in program(parameters, seed, protocol):
        name, path = excitation.name, folder / f"{excitation.name}.csv"
        if path.exists():
            knowledge.add(Recording.load(path), excitation.kind)
            continue
        if not first:
            say(f"resting before {name} for {excitation.pause:g} s")
            _wait(excitation.pause, f"resting before {name}")
        say(f"{name}: calibrating with what was recorded so far")
        # It takes seconds, in which no robot should wait.
        collect = functools.partial(collect_excitation, excitation=excitation, known=knowledge.limb)
        follows = f" and what follows{cool[:-1]}, and for 20 minutes after Enter." * first
        if excitation.turned != turned:
            turned = excitation.turned
            follows = (
                f": {how_mounted(parameters, turned)} Leave it alone until its wires are cold."
            )
        limb = mounted(level, turned)
        recording = made(name, limb, collect, follows)
        assert recording is not None  # there was no file
        tell(f"{name}: {knowledge.add(recording, excitation.kind)}")
        first = False


def how_mounted(limb: LimbParameters, turned: float | None) -> str:
    """What the operator is to do for an excitation of a limb in space."""
    if turned is None:
        return "Take the weight off its tip, and mount the limb so that it hangs straight down."
    up = ("+E2", "-E3", "-E2", "+E3")[round(turned / 90) % 4]
    return (
        f"Hang {1000 * only_segment(limb).mass:.0f} g to the limb's tip, and mount it "
        f"horizontally, turned about its axis so that its {up} side is up."
    )


def _wait(duration: float, label: str) -> None:
    with Progress(label, duration, "s") as progress:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0:
            progress.update(duration - left)
            time.sleep(min(0.5, left))


def _set_heat_bounds(limb: LimbParameters, described: LimbParameters, folder: Path) -> None:
    """Gives wires that have no bounds of their own those that first contact and warm-up show."""
    paths = [folder / f"{name}.csv" for name in (FIRST_CONTACT, WARM_UP)]
    margin = WARM_UP_MARGIN if paths[-1].exists() else CONTACT_MARGIN
    recordings = [Recording.load(path) for path in paths if path.exists()]
    fitted = fit_heat_bounds(recordings, described, margin)
    for wire, given, bounds in zip(limb.wires, described.wires, fitted, strict=True):
        wire.heat_bounds = given.heat_bounds or bounds
