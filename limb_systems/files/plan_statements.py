"""The statements about a plan: its check, its distance from the reference, its active limits."""

import dataclasses
from typing import Any

import numpy as np

from limb_systems.limb_model import LimbModel
from limb_systems.summary import Summary

DISTANCE_RATE = 20.0  # Hz, of the samples for the distance from the reference
# Fields of a `PlanCheck` that JSON has under the same names.
_CHECK_FIELDS = ["solver", "status", "iterations", "refinements", "cost", "guess_cost"]
_CHECK_FIELDS += ["largest_defect", "largest_difference_deg", "tolerance_deg"]


def plan_statements(trajectory: Any, nearest: str = "") -> Summary:
    """Return the statements about a plan.

    Args:
        trajectory: `Trajectory`.
        nearest: the distance of the best plan within the limits, in words, if known.
    """
    check = trajectory.check
    parameters = trajectory.parameters
    num_segments = len(parameters.segments)
    num_knots = len(trajectory.time)
    # Measure the distance from the reference.
    plan = trajectory.since_start()
    times = np.linspace(0.0, plan.duration, int(np.ceil(plan.duration * DISTANCE_RATE)) + 1)
    differences = plan.interpolated(plan.reference, times) - plan.bend_angle_at(times)
    distances = LimbModel.of(parameters).layout.distances(differences)
    mean_distance_deg = np.rad2deg(distances.mean())
    difference_at_knots = np.abs(trajectory.bend_angle - trajectory.reference)
    largest_distance_deg = np.rad2deg(difference_at_knots.max())
    # Write the texts for people.
    texts = {
        "reference": f"missed by {mean_distance_deg:.2f}° on average, "
        f"{largest_distance_deg:.2f}° at most{nearest}",
        "limb": f"{num_segments} segment{'s' * (num_segments > 1)}, {parameters.num_joints} "
        f"joints, {len(parameters.wires)} wires",
        "plan": f"{trajectory.duration:g} s, {num_knots} knots, from request to checked plan in "
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
    # List the times of each active bound; added constraints have lines of their own.
    ranges: dict[str, list[str]] = {}
    for active in check.active_constraints:
        ranges.setdefault(active.bound, []).append(_time_range(active.start, active.end))
    active_times = {bound: f"at {', '.join(times)} s" for bound, times in ranges.items()}
    added_lines = [_added_terms_line(terms, active_times) for terms in check.added]
    width = max(map(len, active_times), default=0)
    lines = [f"{bound:<{width}}  {times}" for bound, times in active_times.items()]
    texts["limits"] = "\n".join(["the plan runs along", *lines]) if lines else "none is active"
    texts["added"] = "\n".join(added_lines)
    # Collect the values for JSON.
    values = {
        "duration_s": trajectory.duration,
        "knots": num_knots,
        **{name: getattr(check, name) for name in _CHECK_FIELDS},
        "solve_time_s": check.solve_time,
        "total_time_s": check.total_time,
        "reference_missed_mean_deg": float(mean_distance_deg),
        "reference_missed_largest_deg": float(largest_distance_deg),
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
    """Return a range of time, s, or the time of a single knot."""
    first = f"{start:.1f}"
    last = f"{end:.1f}"
    return first if first == last else f"{first}-{last}"


def _added_terms_line(terms: Any, active_times: dict[str, str]) -> str:
    """Return a line on terms that the task added, and remove them from the active constraints."""
    if terms.cost is None:
        kind = "constraint"
        times = active_times.pop(terms.name, None)
        state = f"active {times}" if times else "not active"
    else:
        kind = "cost"
        state = f"{terms.cost:.3g}"
    number = kind if terms.number == 1 else f"{terms.number} {kind}s"
    return f"{terms.name} ({number}): {state}"
