"""What a plan says of itself: how it was found and checked, its distances, and what limits it."""

import dataclasses
from typing import Any

import numpy as np

from limb_systems.limb_model import LimbModel
from limb_systems.summary import Summary

RATE = 20.0  # Hz, at which the distance from the reference is looked at
# Of a `PlanCheck`, numbers and texts that JSON has under their own names.
_OF_CHECK = ["solver", "status", "iterations", "refinements", "cost", "guess_cost"]
_OF_CHECK += ["largest_defect", "largest_difference_deg", "tolerance_deg"]


def plan_statements(trajectory: Any, nearest: str = "") -> Summary:
    """Return the statements about a plan.

    Args:
        trajectory: `Trajectory`.
        nearest: what its limits leave of its distance from the reference, in words, if known.
    """
    check, parameters = trajectory.check, trajectory.parameters
    segments, knots = len(parameters.segments), len(trajectory.time)
    plan = trajectory.since_start()
    times = np.linspace(0.0, plan.duration, int(np.ceil(plan.duration * RATE)) + 1)
    missed = plan.interpolated(plan.reference, times) - plan.bend_angle_at(times)
    missed_mean_deg = np.rad2deg(LimbModel.of(parameters).layout.distances(missed).mean())
    most = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference).max())
    texts = {
        "reference": f"missed by {missed_mean_deg:.2f}° on average, {most:.2f}° at most{nearest}",
        "limb": f"{segments} segment{'s' * (segments > 1)}, {parameters.num_joints} joints, "
        f"{len(parameters.wires)} wires",
        "plan": f"{trajectory.duration:g} s, {knots} knots, from request to checked plan in "
        f"{check.total_time:.2f} s",
        "solver": f"{check.solver}: {check.status} in {check.iterations} iterations, "
        f"{check.solve_time:.2f} s; cost {check.cost:.6g} (at the start {check.guess_cost:.6g})",
        "check": f"{'failed' if check.failure() else 'passed'}, simulated again: within "
        f"{check.largest_difference_deg:.4f}° of the plan (allowed {check.tolerance_deg:g}°); "
        f"largest defect {check.largest_defect:.1e}",
    }
    if check.is_missing:
        texts["solver"] = f"{check.solver or 'unknown'}: {check.status}"
        texts["check"] = "none"
    if check.highest_readings:
        texts["band"] = (
            f"of limbs alike: φ is read within ±{check.bend_band_deg:.2f}° of the plan (95%), V up "
            f"to {max(check.highest_readings):.0f} °C (99.5%)"
        )
    stretches: dict[str, list[str]] = {}
    for active in check.active_constraints:
        stretches.setdefault(active.bound, []).append(_time_range(active.start, active.end))
    at = {bound: f"at {', '.join(times)} s" for bound, times in stretches.items()}
    added = [_added_terms_line(terms, at) for terms in check.added]
    width = max(map(len, at), default=0)
    lines = [f"{bound:<{width}}  {times}" for bound, times in at.items()]
    texts["limits"] = "\n".join(["the plan runs along", *lines]) if lines else "none is active"
    texts["added"] = "\n".join(added)
    values = {
        "duration_s": trajectory.duration,
        "knots": knots,
        **{name: getattr(check, name) for name in _OF_CHECK},
        "solve_time_s": check.solve_time,
        "total_time_s": check.total_time,
        "reference_missed_mean_deg": float(missed_mean_deg),
        "reference_missed_largest_deg": float(most),
        "bend_band_deg": check.bend_band_deg if check.highest_readings else None,
        "highest_readings_c": check.highest_readings,
        "active_constraints": [
            {"bound": active.bound, "start_s": active.start, "end_s": active.end}
            for active in check.active_constraints
        ],
        "added": [dataclasses.asdict(terms) for terms in check.added],
    }
    return Summary.of(texts, values)


def _time_range(start: float, end: float) -> str:
    """Return a stretch of time, s, or the time of a single knot."""
    first, last = f"{start:.1f}", f"{end:.1f}"
    return first if first == last else f"{first}-{last}"


def _added_terms_line(terms: Any, active: dict[str, str]) -> str:
    """Return a line on terms of one's own, and take what it says from the active constraints."""
    if terms.cost is None:
        times = active.pop(terms.name, None)
        kind, state = "constraint", f"active {times}" if times else "not active"
    else:
        kind, state = "cost", f"{terms.cost:.3g}"
    number = kind if terms.number == 1 else f"{terms.number} {kind}s"
    return f"{terms.name} ({number}): {state}"
