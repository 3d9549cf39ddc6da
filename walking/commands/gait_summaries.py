"""Summaries of gaits and walks, for terminals, JSON and pages."""

import dataclasses

import numpy as np

from limb_systems.files.recording import Recording
from limb_systems.summary import Entry, Summary
from walking.gait import Gait
from walking.gait_check import find_fall, measure_strides

FIRST_STRIDE_REMARK = "from the second on, as the first begins from straight limbs"


def gait_summary(gait: Gait) -> Summary:
    """Summarize a gait: its motion, the contacts of its feet, its solver and its check."""
    check = gait.check
    phases = []
    for phase in gait.phases:
        contacts = []
        for limb, contact in zip(gait.robot.limbs, phase.contacts, strict=True):
            contacts.append(f"{limb.name} {contact.replace('_', ' ')}")
        phases.append(f"{phase.start:5.1f} s  {', '.join(contacts)}")
    solver = ""
    if check.solver:
        effort = f"in {check.iterations} iterations, {check.solve_time:.2f} s"
        solver = f"{check.solver}: {check.status} {effort}"
    strides = []
    fallen = []
    for variation in check.spread:
        strides += variation.strides
        if variation.fall:
            fallen.append(variation.what)
    spread = []
    if strides:
        spread.append(f"strides {min(strides):.0%} to {max(strides):.0%} of the planned one")
    if fallen:
        spread.append(f"falls with {', '.join(fallen)}")
    if hot := overheating_remark(gait):
        spread.append(hot)
    # The remark is on what makes a gait safer: steadiness in a plane, friction to spare in space.
    steadiness = [
        f"{check.steadiness:.3g} x weight x limb length against pitch",
        "gaits of less are faster and tip over sooner",
    ]
    friction = [f"feet that stick use at most {check.sticking_share:.3g} of μ"]
    if check.remark:
        (friction if gait.in_space else steadiness).append(check.remark.rstrip("."))
    announced = FIRST_STRIDE_REMARK
    if check.made != 1.0:
        announced += f"; strides of the simulation, {check.made:.1%} of the program's"
    failure = None if check.is_missing else check.failure()
    return gait.summary() + Summary.of(
        {
            "phases": "\n".join(phases),
            "solver": solver,
            "steadiness": "; ".join(steadiness) if np.isfinite(check.steadiness) else "",
            "friction": "; ".join(friction) if np.isfinite(check.sticking_share) else "",
            "checked by": check.checked_by,
            "announced": announced,
            "failure": failure or "",
            "spread": "; ".join(spread),
        },
        {
            "phases": [dataclasses.asdict(phase) for phase in gait.phases],
            "knots": len(gait.time),
            **dataclasses.asdict(check),
        },
    )


def overheating_remark(gait: Gait) -> str:
    """Say on which varied robots a wire gets hotter than its limit; "" if on none."""
    limit = gait.parameters.temperature_limits.maximum
    hottest = 0.0
    changes = []
    for variation in gait.check.spread:
        if variation.highest_temperature > limit:
            hottest = max(hottest, variation.highest_temperature)
            changes.append(variation.what)
    if not changes:
        return ""
    return (
        f"open loop, a wire reaches {hottest:.0f} °C, above its limit of {limit:g} °C, with "
        f"{', '.join(changes)}; walk with feedback, which holds wires below their limit"
    )


def walk_summary(gait: Gait, recording: Recording, starts: np.ndarray) -> Summary:
    """Summarize a walk: the travel and duration of its cycles, its heat, and its fall, if any.

    Args:
        starts: times at which the cycles begin, and the last one ends (C + 1,), s.
    """
    summary = recording.summary()
    if recording.body_pose is None:
        return summary

    # Measure the cycles that ended before a fall.
    fall, end = find_fall(recording, gait, starts[0])
    num_completed = max(1, np.searchsorted(starts, end + 1e-6, "right"))
    completed = starts[:num_completed]
    planned = gait.turn if gait.on_the_spot else gait.stride
    scale, unit = (np.rad2deg(1.0), "°") if gait.on_the_spot else (1e3, " mm")
    strides = measure_strides(recording, gait, completed)[0] * planned
    durations = np.diff(completed)

    # Put them into words.
    sentence = "none is whole"
    if len(strides):
        sentence = ", ".join(map("{:.1f}".format, scale * strides)) + unit
        sentence += f" in {', '.join(map('{:.1f}'.format, durations))} s"
    sentence += f"; {scale * planned:.1f}{unit} in {gait.period:.1f} s planned"
    sentence += f" {FIRST_STRIDE_REMARK}"
    if fall:
        places = recording.body_pose[: 2 if gait.in_space else 1]
        moved = np.diff(recording.interpolated(places, np.array([starts[0], end])))
        fall += f", having travelled {1e3 * np.linalg.norm(moved):.1f} mm"
    entries = [
        Entry("strides", strides.tolist(), "rad" if gait.on_the_spot else "m", sentence),
        Entry("stride_durations", durations.tolist(), "s", sentence=None),
        Entry("fall", fall),
    ]
    return summary + Summary(entries)
