"""One recording after the other: sag, ring-down, equilibria, warm-up and `excitations`."""

import copy
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypedDict, TypeVar, Unpack, cast

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from calibration.collecting.bend_control import BendAngleController, EquilibriumSchedule
from calibration.collecting.excitation import DutyUntilWarm, Excitation, LimitedDuty, held_levels
from calibration.recordings.kinds import heated_wires, only_segment
from hardware.board.journal import closing
from hardware.live_feed import LiveView
from hardware.replaying import record_with_journal
from limb_systems import LimbError, LimbParameters, LimbSystem, Recording
from limb_systems.limb_system import check_limb
from limb_systems.simulation import RecordOptions

MAX_EQUILIBRIUM_BEND = np.deg2rad(45.0)  # of equilibria
SAMPLE_RATE = 20.0  # Hz, but for ring-downs
RING_DOWN_RATE = 100.0
FIRST_TOTAL_DUTY = 0.3  # the largest sum of both duties while nothing is known of a limb
CONTACT_DUTY = 0.1
CONTACT_TIME = 30.0  # s with duty, of each wire
CONTACT_PAUSE = 20.0  # s without duty, after each wire
CONTACT_RISE = 12.0  # °C of the readings, at which there is no duty
WARM_UP_DUTY = 0.15
WARM_UP_TIME = 60.0  # s with duty
WARM_UP_END = 100.0  # s
WARM_UP_RISE = 60.0  # °C; a wire that shows 60% of its rise then stays below 130 °C

Collect = TypeVar("Collect", bound=Callable[..., Recording])


class Outputs(TypedDict, total=False):
    """Outputs of a recording, see `hardware.replaying`: its file, and a page with the limb."""

    journal: str | Path | None
    live: LiveView | None


def _closing(collect: Collect) -> Collect:
    """Have a function close its limb at the end, also if it fails before the recording starts."""

    @functools.wraps(collect)
    def closing_collect(limb: LimbSystem, *arguments: Any, **options: Any) -> Recording:
        with closing(check_limb(limb)):
            return collect(limb, *arguments, **options)

    return cast(Collect, closing_collect)


@_closing
def collect_equilibria(
    limb: LimbSystem,
    actuated: str,
    *,
    num_angles: int = 8,
    seed: int = 0,
    longest: float = 60.0,
    **outputs: Unpack[Outputs],
) -> Recording:
    """Return the datasets C^r, C^l and C^m of Sec. V-C: random equilibria, held by PI control.

    The angles are uniform between zero and 45° towards the actuated wire, or to
    both sides.

    Args:
        limb: a `LimbTwin` or any other `LimbSystem`, of one segment; it
            cannot be used again.
        actuated: name of the wire, or "both" for all of them.
        num_angles: number of equilibria.
        seed: seed of the random angles.
        longest: time for which each of them is held at most, s.
        outputs: see `Outputs`.

    Returns:
        A recording with the set points φ_eq as its ``reference``.

    Raises:
        LimbError: if an argument makes no sense.
    """
    heated = heated_wires(limb.parameters, actuated)
    if num_angles < 1 or seed < 0:
        raise LimbError(
            f"num_angles is {num_angles!r} and the seed of the random angles is {seed}; there "
            "must be an angle at least, and the seed must be zero or more."
        )
    # Draw random angles to the sides of the heated wires.
    wires = only_segment(limb.parameters).wires
    sides = np.sign([wires[index].lever[0] for index in heated])
    low = min(0, *sides)
    high = max(0, *sides)
    angles = MAX_EQUILIBRIUM_BEND * np.random.default_rng(seed).uniform(low, high, num_angles)
    # Hold them by PI control.
    schedule = EquilibriumSchedule(angles, longest, num_wires=len(wires))
    controller = BendAngleController(limb.parameters, actuated)
    duration = num_angles * longest
    return _record(limb, controller, duration, actuated, outputs, seed=seed, schedule=schedule)


@_closing
def collect_sag(limb: LimbSystem, **outputs: Unpack[Outputs]) -> Recording:
    """Record the unheated limb while gravity bends it, for 15 s (Sec. V-A)."""
    return _record(limb, _zero_duty(limb), 15.0, "sag", outputs)


@_closing
def collect_ring_down(
    limb: LimbSystem, sample_rate: float = RING_DOWN_RATE, **outputs: Unpack[Outputs]
) -> Recording:
    """Record for 6 s a limb that a person holds at 45° and then releases (Sec. V-B)."""
    return _record(limb, _zero_duty(limb), 6.0, "ring_down", outputs, sample_rate=sample_rate)


@_closing
def collect_first_contact(limb: LimbSystem, **outputs: Unpack[Outputs]) -> Recording:
    """Warm one wire after the other by some degrees, of a limb that was never recorded before.

    `fit_heat_bounds` learns from it with what bounds the wires can be warmed up.
    """
    parts = []
    for wire in np.eye(len(limb.parameters.wires)):
        parts += [(CONTACT_TIME, CONTACT_DUTY * wire), (CONTACT_PAUSE, 0 * wire)]
    duty = held_levels(parts)
    source = DutyUntilWarm(duty, CONTACT_RISE)
    return _record(limb, source, duty.end_time(), "heated", outputs)


@_closing
def collect_warm_up(limb: LimbSystem, **outputs: Unpack[Outputs]) -> Recording:
    """Heat all wires a little at once for a minute, as `fit_heat_bounds` needs it."""
    wires = np.ones(len(limb.parameters.wires))
    parts = [(WARM_UP_TIME, WARM_UP_DUTY * wires), (WARM_UP_END - WARM_UP_TIME, 0 * wires)]
    source = DutyUntilWarm(held_levels(parts), WARM_UP_RISE)
    return _record(limb, source, WARM_UP_END, "heated", outputs)


def limb_for_first_contact(described: LimbParameters) -> LimbParameters:
    """Return the limb with little duty and bounds for any wire, for `collect_first_contact`."""
    careful_limb = copy.deepcopy(described)
    careful_limb.total_duty = min(described.total_duty, FIRST_TOTAL_DUTY)
    for wire, bounds in zip(careful_limb.wires, described.heat_bounds, strict=True):
        wire.heat_bounds = bounds.widened_to_any_wire()
    return careful_limb


@_closing
def collect_excitation(
    limb: LimbSystem,
    excitation: Excitation,
    known: LimbParameters,
    **outputs: Unpack[Outputs],
) -> Recording:
    """Return one of `excitations`, with duty that is limited by the limb as calibrated so far."""
    source = LimitedDuty(known, excitation.duty)
    duration = excitation.duty.end_time()
    return _record(limb, source, duration, excitation.kind, outputs, seed=excitation.seed)


def _zero_duty(limb: LimbSystem) -> LeafSystem:
    return ConstantVectorSource(np.zeros(len(limb.parameters.wires)))


def _record(
    limb: LimbSystem,
    source: LeafSystem,
    duration: float,
    kind: str,
    outputs: Outputs,
    *,
    sample_rate: float = SAMPLE_RATE,
    seed: int | None = None,
    schedule: EquilibriumSchedule | None = None,
) -> Recording:
    """Record a limb under the duty of a source, which sees its outputs, until a schedule ends."""
    # Connect limb, source and schedule.
    builder = DiagramBuilder()
    builder.AddSystem(limb)
    for system in filter(None, (schedule, source)):
        builder.AddSystem(system)
        for name in ("bend_angle", "measured_temperature"):
            if system.HasInputPort(name):
                builder.Connect(limb.GetOutputPort(name), system.GetInputPort(name))
    reference = until = None
    if schedule:
        reference = schedule.get_output_port()
        builder.Connect(reference, source.GetInputPort("set_point"))

        def until(context):
            return schedule.is_finished(schedule.GetMyContextFromRoot(context))

    options = RecordOptions(reference=reference, until=until, sample_rate=sample_rate)
    duty = source.get_output_port()
    return record_with_journal(
        builder, limb, duty, duration, options=options, kind=kind, seed=seed, **outputs
    )
