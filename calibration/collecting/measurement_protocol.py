"""Collect all recordings that calibration wants, from an emulated limb or from a robot.

Section V asks for the sag, the ring-down and heated equilibria. The excitations of
`calibration.collecting.excitation` tell more about the wires in less time.
"""

import copy
import dataclasses
import functools
import itertools
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from pydrake.trajectories import PiecewisePolynomial
from threadpoolctl import threadpool_limits

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
    limb_for_first_contact,
)
from calibration.collecting.excitation import excitations, mountings
from calibration.heat_bounds_fit import check_first_contact, fit_heat_bounds, heat_remarks
from calibration.paper_method.mechanics import GRAVITY, sag_payload
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import LawFit, fit_law
from calibration.recordings.at_rest import ambient_temperature, rest_angles
from calibration.recordings.kinds import (
    FIRST_CONTACT,
    WARM_UP,
    gravity_bends,
    heated_kinds,
    only_segment,
)
from hardware import LimbTwin, SerialLimb
from hardware.live_feed import LiveView
from limb_systems import HystereticLaw, LimbError, LimbParameters, Recording
from limb_systems.files.table_writer import is_unfinished
from limb_systems.law_functions import check_affine
from limb_systems.progress import Progress, TimeLeft, progress_prefix
from limb_systems.simulation import PERIOD

NUM_SAG_TRIALS = 10
NUM_RING_DOWNS = 3
# Computing time of an emulated limb's recordings, as s of a heated one that takes as long: of any
# recording, and of the calibration after each excitation.
RECORDING_WORK = 15.0
CALIBRATION_WORK = 150.0
SAG_PAUSE = 20.0  # s, after which rubber has forgotten the sag to the other side
PROTOCOLS = ("all", "excitation", "paper")
UPPER_SIDES: dict[float, str] = {0: "+E2", 90: "-E3", 180: "-E2", 270: "+E3"}  # side up, by turn
CONTACT_MARGIN = 0.5  # share by which bounds of first contact are widened: the wires stay cool
WARM_UP_MARGIN = 0.25  # share by which bounds of the warm-up are widened: it is short and not hot


class Knowledge:
    """A calibration that grows with the recordings, and predicts each of them before it is fitted.

    Args:
        described: the limb as it was described.
        recordings: recordings made before: ring-downs, for the angle at rest, and heated ones.
    """

    LAW = HystereticLaw  # which has the other laws' shapes

    def __init__(self, described: LimbParameters, recordings: Iterable[Recording] = ()):
        self._described = copy.deepcopy(described)
        self._recordings = list(recordings)
        self._fit_so_far: LawFit | None = None
        self._motions: list[np.ndarray] = []

    @property
    def limb(self) -> LimbParameters:
        """The limb as it is calibrated so far."""
        return self._fit().calibrated(self._described)

    def add(self, recording: Recording, kind: str) -> str:
        """Add a recording; return in words how well it was predicted before."""
        with threadpool_limits(1, "blas"):
            (predicted,) = self._fit().predict([HeatedRun.of(recording)])
        sentence = (
            f"predicted to {np.rad2deg(predicted.bend_error):.1f}° and "
            f"{predicted.temperature_error:.1f} °C on average before it was fitted"
        )
        if kind != "motion":
            if not gravity_bends(recording.parameters):  # others tell little more of the heat
                self._recordings.append(recording)
                self._fit_so_far = None
            return sentence
        # Compare the motion with its repetitions.
        self._motions.append(recording.bend_angle)
        differences = []
        for motion, other_motion in itertools.combinations(self._motions, 2):
            length = min(motion.shape[1], other_motion.shape[1])
            difference = motion[:, :length] - other_motion[:, :length]
            differences.append(np.linalg.norm(difference, axis=0).mean())
        if differences:
            mean_deg = np.rad2deg(np.mean(differences))
            sentence += f"; motions differ by {mean_deg:.1f}° from each other"
        return sentence

    def _fit(self) -> LawFit:
        if self._fit_so_far is None:
            ambient = ambient_temperature(self._recordings).value
            segment = copy.deepcopy(only_segment(self._described))
            segment.rest_angle = rest_angles(self._recordings, ambient)[0].value
            runs = [HeatedRun.of(each) for each in self._recordings if each.duty.any()]
            with threadpool_limits(1, "blas"):
                self._fit_so_far = fit_law(self.LAW, runs, segment, ambient)
        return self._fit_so_far


@dataclasses.dataclass(frozen=True)
class PlannedRecording:
    """A recording of a protocol.

    - ``name``, ``kind``: name of its file, and its kind.
    - ``collect``: makes it, as ``collect(limb, journal=..., live=...)``; an excitation also
      takes the limb as ``known`` so far.
    - ``heated_time``: the longest time with duty, s.
    - ``pause``: time without heat before it, s; None if the wires must be cold.
    - ``turned``: mounting of the limb, as for `mounted_limb`.
    - ``excites``: whether it is one of `excitations`.
    """

    name: str
    kind: str
    collect: Callable[..., Recording]
    heated_time: float = 0.0
    pause: float | None = 0.0
    turned: float | None = None
    excites: bool = False


class ProtocolOptions(TypedDict, total=False):
    """Options of a protocol.

    - ``protocol``: "paper" for the recordings of Sec. V, "excitation" for `excitations` in
      place of equilibria, or "all", the default.
    - ``seed``, ``num_angles``, ``longest``: as for `collect_equilibria`.
    - ``sag_trials``, ``ring_downs``: numbers of recordings, 10 and 3 if left out.
    """

    protocol: str
    seed: int
    num_angles: int
    longest: float
    sag_trials: int
    ring_downs: int


def planned_recordings(
    limb: LimbParameters,
    emulated: bool,
    *,
    protocol: str = "all",
    seed: int = 0,
    num_angles: int = 8,
    longest: float = 60.0,
    sag_trials: int | None = None,
    ring_downs: int | None = None,
) -> list[PlannedRecording]:
    """Return the recordings of a protocol in their order; emulated limbs need no first contact.

    The options are as in `ProtocolOptions`.

    Raises:
        LimbError: if there is no such protocol for the limb, or the rates of a wire's law are not
            affine in the duty.
    """
    check_affine(limb)
    planar = only_segment(limb).axes == 1
    if protocol not in PROTOCOLS:
        raise LimbError(f"protocol is {protocol!r}; it must be one of {', '.join(PROTOCOLS)}.")
    if protocol == "paper" and not planar:
        raise LimbError(
            "The paper's protocol is one for limbs that bend in a plane; collect with protocol all."
        )
    rate = RING_DOWN_RATE if emulated else 1 / PERIOD
    ring_down = functools.partial(collect_ring_down, sample_rate=rate)
    has_weight = planar and sag_payload(limb) > 0
    plans = []
    if sag_trials is None:
        sag_trials = NUM_SAG_TRIALS
    for number in range(1, sag_trials + 1) if planar else ():
        pause = SAG_PAUSE * has_weight
        turned = 180.0 * (has_weight and number % 2 == 0)
        plans.append(PlannedRecording(f"sag_{number}", "sag", collect_sag, 0.0, pause, turned))
    # Ring-downs, by hand.
    if ring_downs is None:
        ring_downs = NUM_RING_DOWNS
    for number in range(1, ring_downs + 1):
        plans.append(PlannedRecording(f"ring_down_{number}", "ring_down", ring_down))
    # Equilibria of each wire and of all.
    equilibria = []
    hold = functools.partial(collect_equilibria, num_angles=num_angles, longest=longest)
    kinds = heated_kinds(limb) if planar and protocol != "excitation" else ()
    for number, kind in enumerate(kinds, seed):
        collect = functools.partial(hold, actuated=kind, seed=number)
        equilibria.append(PlannedRecording(kind, kind, collect, num_angles * longest, None))
    # First contact of each wire, and the warm-up of all.
    contact_time = CONTACT_TIME * len(limb.wires)
    contact = PlannedRecording(FIRST_CONTACT, "heated", collect_first_contact, contact_time, None)
    warm_up = PlannedRecording(WARM_UP, "heated", collect_warm_up, WARM_UP_TIME, None)
    plans += [*equilibria, warm_up] if emulated else [contact, warm_up, *equilibria]
    if protocol == "paper":
        return plans[:-1] if emulated else plans
    return plans + _planned_excitations(limb, seed, with_mountings=not planar and protocol == "all")


def _planned_excitations(
    limb: LimbParameters, seed: int, *, with_mountings: bool
) -> list[PlannedRecording]:
    """Return the excitations; mountings take the place of pulses and ramps."""
    chosen = excitations(len(limb.wires), seed)
    if with_mountings:
        heated = [each for each in chosen if each.name in ("conditioning", "random")]
        motions = [each for each in chosen if each.kind == "motion"]
        chosen = [*heated, *mountings(len(limb.wires)), *motions]
    plans: list[PlannedRecording] = []
    for each in chosen:
        collect = functools.partial(collect_excitation, excitation=each)
        pause = each.pause if plans else None  # the first begins cold
        plan = PlannedRecording(
            each.name, each.kind, collect, each.heated_time, pause, each.turned, excites=True
        )
        plans.append(plan)
    return plans


def mounted_limb(limb: LimbParameters, turned: float | None) -> LimbParameters:
    """Copy a limb as it is mounted: turned about E1 under gravity, or unbent by gravity.

    A limb that is turned has a weight at its tip, as bend sensors drift by a good part of its own
    sag. In space the weight is as heavy as the segment, with which it sags four times as far. A
    planar limb has the weight of `sag_payload`, which is zero if its own sag is large enough.

    Args:
        turned: angle about E1, degrees; None if gravity does not bend the limb.
    """
    limb = copy.deepcopy(limb)
    segment = only_segment(limb)
    limb.gravity = [0.0, 0.0, 0.0]
    if turned is not None:
        angle = np.deg2rad(turned)
        limb.gravity = [0.0, -GRAVITY * float(np.cos(angle)), GRAVITY * float(np.sin(angle))]
        limb.payload += segment.mass if segment.axes > 1 else sag_payload(limb)
    elif segment.axes > 1:
        limb.gravity = [GRAVITY, 0.0, 0.0]  # it hangs
    return limb


def hand_for_ring_down(axes: int = 1) -> PiecewisePolynomial:
    """Return a hand's bend, rad, for `LimbTwin`: 45° towards E2 within 1 s, released at 2 s."""
    course = np.zeros((axes, 3))
    course[0, 1:] = np.pi / 4
    return PiecewisePolynomial.FirstOrderHold([0.0, 1.0, 2.0], course)


def collect_from_twin(
    twin: LimbTwin,
    *,
    cooling_time: float = 300.0,
    tell: Callable[[str], object] = lambda name: None,
    live: LiveView | None = None,
    **options: Unpack[ProtocolOptions],
) -> dict[str, list[Recording]]:
    """Return all recordings that calibration wants, from an emulated limb, one after the other.

    Trials of the sag and ring-downs come first: if the limb's own sag is small, under a weight at
    its tip and to both sides in turn. Then follow equilibria with one wire after
    the other and with all of them, as in Sec. V, a warm-up and `excitations`.

    Args:
        twin: an emulated limb of one segment; `after_rest` is called on it.
        cooling_time: time without heat before each recording that begins cold, s.
        tell: is called with how many recordings there are, after the first of them with about
            how long the others take, and after each excitation with how well it was predicted.
        live: page on which the limb is shown, in real time: for an hour.
        options: see `ProtocolOptions`.

    Returns:
        recordings by kind, as `calibrate` takes them.

    Raises:
        LimbError: if there is no such protocol.
    """
    described = copy.deepcopy(twin.parameters)
    # Plan the recordings, and estimate the work of each.
    plans = planned_recordings(described, True, **options)
    tell(f"{len(plans)} recordings of an emulated limb")
    work = {}
    for plan in plans:
        is_fitted = plan.excites and plan.kind != "motion"
        work[plan.name] = RECORDING_WORK + plan.heated_time + CALIBRATION_WORK * is_fitted
    time_left = TimeLeft(sum(work.values()), tell)
    say = live.say if live else lambda _: None
    recordings: dict[str, list[Recording]] = {"sag": [], "ring_down": []}
    knowledge = None
    for plan in plans:
        # Let the emulated limb rest in the next mounting.
        limb = mounted_limb(described, plan.turned)
        swing: dict[str, Any] = {}
        if plan.kind == "ring_down":
            swing["hand"] = hand_for_ring_down(only_segment(described).axes)
            swing["bend_rate"] = RING_DOWN_RATE
        pause = cooling_time if plan.pause is None else plan.pause
        twin = twin.after_rest(pause, gravity=limb.gravity, payload=limb.payload, **swing)
        # Calibrate with what was recorded so far, which limits the duty.
        known = {}
        if plan.excites:
            if knowledge is None:
                knowledge = Knowledge(limb, recordings["ring_down"] + recordings["heated"])
            say(f"{plan.name}: calibrating with what was recorded so far")
            known = {"known": knowledge.limb}
        say(name := _numbered_name(plan, plans))
        with progress_prefix(name):
            recording = plan.collect(twin, live=live, **known)
        recordings.setdefault(plan.kind, []).append(recording)
        if knowledge:
            tell(f"{plan.name}: {knowledge.add(recording, plan.kind)}")
        time_left.add(work[plan.name])
    return recordings


def _numbered_name(plan: PlannedRecording, plans: list[PlannedRecording]) -> str:
    """Return the name of a recording, and which of how many it is."""
    return f"{plan.name}, {plans.index(plan) + 1} of {len(plans)}"


def collect_from_robot(
    connect: Callable[[LimbParameters], SerialLimb],
    parameters: LimbParameters,
    folder: str | Path,
    ask: Callable[[str], object],
    *,
    tell: Callable[[str], object] = lambda numbered_name: None,
    live: LiveView | None = None,
    **options: Unpack[ProtocolOptions],
) -> None:
    """Record all that calibration wants from a robot, one file after the other.

    Before the other heated recordings, the first contact warms the wires by some degrees, with a
    little duty and bounds so wide that the board accepts any limb. Then the warm-up heats them, so
    that the board gets the bounds of these wires. ``tell`` gets a remark on each wire or
    thermocouple that differs from the others or from the description.

    Each sample goes to a file when it arrives, which gets its name when the recording is
    complete. Complete recordings are kept when collecting is started again. A recording that
    was interrupted is made again; its samples stay in the unfinished file, with a warning.

    Args:
        connect: makes a `SerialLimb` with the given description.
        parameters: the limb's description, of one segment.
        folder: folder of the recordings, named after their kinds.
        ask: shows an instruction to the operator, and returns when it is done.
        tell: is called with how long wires are heated in all, and as by `collect_from_twin`.
        live: page on which the limb is shown, and what is done.
        options: see `ProtocolOptions`.

    Raises:
        LimbError: if there is no such protocol, or if a thermocouple shows no heat.
        HardwareError: if the robot fails on the way; it is off then.
        OutputError: as for `hardware.replaying`.
    """
    # Plan the recordings, and say how many are left.
    plans = planned_recordings(parameters, False, **options)
    paths = {plan.name: Path(folder) / f"{plan.name}.csv" for plan in plans}
    say = live.say if live else lambda _: None
    remaining_times = [plan.heated_time for plan in plans if not paths[plan.name].exists()]
    tell(
        f"{len(remaining_times)} of {len(plans)} recordings are left, in which wires are heated "
        f"for at most {sum(remaining_times) / 60:.2g} min in all"
    )
    described = copy.deepcopy(parameters)  # gets bounds of heat after the first recordings
    knowledge = None
    was_excited = False
    turned = None
    for plan in plans:
        path = paths[plan.name]
        limb = mounted_limb(described, plan.turned)
        # First contact is not needed after a warm-up.
        if plan.name == FIRST_CONTACT:
            if paths[WARM_UP].exists():
                continue
            limb = limb_for_first_contact(limb)
        if plan.excites and knowledge is None:
            names = [each.name for each in plans if each.kind == "ring_down"]
            knowledge = Knowledge(limb, [Recording.load(paths[n]) for n in (*names, WARM_UP)])
        # Take a recording that is complete already.
        if path.exists():
            if knowledge:
                knowledge.add(Recording.load(path), plan.kind)
        else:
            _warn_of_unfinished(path)
            if was_excited:
                say(f"resting before {plan.name} for {plan.pause:g} s")
                _wait_with_progress(plan.pause or 0.0, f"resting before {plan.name}")
            known = {}
            if knowledge:
                say(f"{plan.name}: calibrating with what was recorded so far")
                # Calibrate before the robot is connected: it takes seconds.
                known = {"known": knowledge.limb}
            # Let the operator mount the limb.
            if not was_excited or plan.turned != turned:
                ask(f"{plan.name}{_instruction(parameters, plan, plan.turned != turned)}")
            if plan.excites:
                was_excited = True
                turned = plan.turned
            say(numbered_name := _numbered_name(plan, plans))
            with progress_prefix(numbered_name), connect(limb) as robot:
                recording = plan.collect(robot, journal=path, live=live, **known)
            # Compare the thermocouples after the first heat.
            if plan.name == FIRST_CONTACT:
                check_first_contact(recording, parameters, path)
            if plan.name in (FIRST_CONTACT, WARM_UP):
                for remark in heat_remarks([recording], parameters):
                    tell(f"{plan.name}: {remark}")
            if knowledge:
                tell(f"{plan.name}: {knowledge.add(recording, plan.kind)}")
        if plan.name in (FIRST_CONTACT, WARM_UP):
            _set_heat_bounds(described, parameters, paths)


def _warn_of_unfinished(path: Path) -> None:
    for left in filter(is_unfinished, sorted(path.parent.glob(f"{path.stem}.*"))):
        warnings.warn(
            f"{left} was interrupted; it is kept, calibration ignores it, and {path.stem} is "
            "recorded again.",
            stacklevel=3,
        )


def _instruction(limb: LimbParameters, plan: PlannedRecording, remount: bool) -> str:
    """Return what the operator is to do for a recording, after its name."""
    segment = only_segment(limb)
    planar = segment.axes == 1
    load = sag_payload(limb) if planar else 0.0
    if plan.kind == "sag":
        first = min(segment.wires, key=lambda wire: wire.lever[0])
        side = "towards" if (first.lever[0] < 0) != bool(plan.turned) else "away from"
        hang = f"Hang {1000 * load:.3g} g to its tip, and let" if load else "Let"
        return (
            f": Mount the limb so that gravity bends it {side} its {first.name} wire. {hang} it "
            "hang still."
        )
    if plan.kind == "ring_down":
        take = "Take the weight off the limb's tip. " if load else ""
        place = "level" if planar else "so that it hangs straight down"
        return (
            f": {take}Mount the limb {place}. Bend it to 45° by hand, and release it 2 s after "
            "Enter."
        )
    if plan.excites and remount:
        mount = (
            "Take the weight off its tip, and mount the limb so that it hangs straight down."
            if plan.turned is None
            else f"Hang {1000 * segment.mass:.0f} g to the limb's tip, and mount it horizontally, "
            f"turned about its axis so that its {UPPER_SIDES[plan.turned]} side is up."
        )
        return f": {mount} Leave it alone until its wires are cold."
    cool = f": Leave the limb {'level' if planar else 'as it hangs'} and alone until its wires are"
    if plan.excites:
        return f" and what follows{cool} cold, and for 20 minutes after Enter."
    return f"{cool} cold."


def _wait_with_progress(duration: float, label: str) -> None:
    with Progress(label, duration, "s") as progress:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0:
            progress.update(duration - left)
            time.sleep(min(0.5, left))


def _set_heat_bounds(
    limb: LimbParameters, described: LimbParameters, paths: dict[str, Path]
) -> None:
    """Give wires without described bounds the bounds that first contact and warm-up show."""
    recorded = [paths[name] for name in (FIRST_CONTACT, WARM_UP) if paths[name].exists()]
    margin = WARM_UP_MARGIN if paths[WARM_UP].exists() else CONTACT_MARGIN
    fitted = fit_heat_bounds(map(Recording.load, recorded), described, margin)
    for wire, given, bounds in zip(limb.wires, described.wires, fitted, strict=True):
        wire.heat_bounds = given.heat_bounds or bounds
