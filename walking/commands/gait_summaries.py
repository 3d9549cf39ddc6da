"""Gaits and walks, each told once, for terminals, JSON and pages."""

import dataclasses

import numpy as np

from limb_systems.files.recording import Recording
from limb_systems.summary import Entry, Summary
from walking.gait import Gait
from walking.gait_check import fall_of, strides_of


def gait_summary(gait: Gait) -> Summary:
    """How far and fast a gait goes, what its feet do, how it was found, and how it was checked."""
    check = gait.check
    phases = [
        f"{phase.start:5.1f} s  "
        + ", ".join(
            f"{limb.name} {contact.replace('_', ' ')}"
            for limb, contact in zip(gait.robot.limbs, phase.contacts, strict=True)
        )
        for phase in gait.phases
    ]
    how = (
        f"{check.solver}: {check.status} in {check.iterations} iterations, {check.solve_time:.2f} s"
    )
    found = how if check.solver else ""
    strides = [share for variation in check.spread for share in variation.strides]
    fallen = [variation.what for variation in check.spread if variation.fall]
    spread = []
    if strides:
        spread.append(f"strides {min(strides):.0%} to {max(strides):.0%} of the planned one")
    if fallen:
        spread.append(f"falls with {', '.join(fallen)}")
    steadiness = [
        f"{check.steadiness:.3g} x weight x limb length against pitch",
        "gaits of less are faster and tip over sooner",
        *([check.remark.rstrip(".")] if check.remark else []),
    ]
    announced = ""
    if check.made != 1.0:
        announced = f"the stride of the simulation, {check.made:.1%} of the program's"
    failure = None if check.is_missing else check.failure()
    return gait.summary() + Summary.of(
        {
            "phases": "\n".join(phases),
            "solver": found,
            "steadiness": "; ".join(steadiness) if np.isfinite(check.steadiness) else "",
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


def walk_summary(gait: Gait, recording: Recording, cycles: int, start: float) -> Summary:
    """The travel in each planned period beside the planned stride, the heat, and whether it fell.

    Feedback may take longer for a cycle, of which a period then has a part.

    Args:
        cycles: number of cycles that it was to have.
        start: time at which the first of them begins, s.
    """
    summary = recording.summary()
    if recording.body_pose is None:
        return summary
    fall, end = fall_of(recording, gait, start)
    cycles = max(0, min(cycles, int((end - start) / gait.period + 1e-6)))
    planned, unit = (np.rad2deg(gait.turn), "°") if gait.on_the_spot else (1e3 * gait.stride, " mm")
    shares = strides_of(recording, gait, cycles, start)[0]
    strides = shares * (gait.turn if gait.on_the_spot else gait.stride)
    shown = ", ".join(f"{share * planned:.1f}" for share in shares)
    said = f"{shown}{unit}" if len(strides) else "none is whole"
    said += f" in periods of {gait.period:.1f} s, {planned:.1f}{unit} planned"
    if fall:
        places = recording.body_pose[: 2 if gait.in_space else 1]
        moved = [np.diff(np.interp([start, end], recording.time, row))[0] for row in places]
        fall += f", having travelled {1e3 * np.linalg.norm(moved):.1f} mm"
    return summary + Summary(
        [
            Entry("strides", strides.tolist(), "rad" if gait.on_the_spot else "m", said),
            Entry("fall", fall),
        ]
    )
