"""A summary of a plan, in words, in numbers and as one HTML page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from limb_systems import Trajectory
from limb_systems.views import page
from planners.distance import far_from_reference
from planners.distance import missed as missed_by


def plan_summary(trajectory: Trajectory) -> str:
    """A few lines on how a plan was found, how it was checked and what limits it."""
    check = trajectory.check
    joints, segments = trajectory.parameters.num_joints, len(trajectory.parameters.segments)
    missed = missed_by(trajectory)
    lines = [
        f"limb        {segments} segment{'s' * (segments > 1)}, {joints} joints, "
        f"{len(trajectory.parameters.wires)} wires",
        f"plan        {trajectory.duration:g} s, {len(trajectory.time)} knots, "
        f"from request to checked plan in {check.total_time:.2f} s",
        f"solver      {check.solver}: {check.status} in {check.iterations} iterations, "
        f"{check.solve_time:.2f} s; cost {check.cost:.6g} (at the start {check.guess_cost:.6g})",
        f"check       simulated again: within {check.largest_difference_deg:.4f}° of the plan "
        f"(allowed {check.tolerance_deg:g}°); largest defect {check.largest_defect:.1e}",
        f"reference   missed by {missed.mean():.2f}° on average, {missed.max():.2f}° at most",
        "limits      " + ("the plan runs along" if check.active_constraints else "none is active"),
    ]
    if check.highest_readings:
        lines.insert(
            -1,
            f"band        of limbs alike: φ is read within ±{check.bend_band_deg:.2f}° of the plan "
            f"(95%), V up to {max(check.highest_readings):.0f} °C (99.5%)",
        )
    stretches = active_times(trajectory)
    width = max((len(bound) for bound in stretches), default=0)
    lines += [
        f"            {bound.ljust(width)}  at {_spans(times)} s"
        for bound, times in stretches.items()
    ]
    return "\n".join(lines)


def plan_facts(trajectory: Trajectory) -> dict[str, Any]:
    """The content of `plan_summary` for programs: numbers, with the unit in the name."""
    check = trajectory.check
    missed = missed_by(trajectory)
    return {
        "duration_s": trajectory.duration,
        "knots": len(trajectory.time),
        "solver": check.solver,
        "status": check.status,
        "iterations": check.iterations,
        "refinements": check.refinements,
        "solve_time_s": check.solve_time,
        "total_time_s": check.total_time,
        "cost": check.cost,
        "guess_cost": check.guess_cost,
        "largest_defect": check.largest_defect,
        "largest_difference_deg": check.largest_difference_deg,
        "tolerance_deg": check.tolerance_deg,
        "reference_missed_mean_deg": float(missed.mean()),
        "reference_missed_largest_deg": float(missed.max()),
        "far_from_reference": far_from_reference(trajectory),
        "bend_band_deg": check.bend_band_deg if check.highest_readings else None,
        "highest_readings_c": check.highest_readings,
        "active_constraints": [
            {"bound": active.bound, "start_s": active.start, "end_s": active.end}
            for active in check.active_constraints
        ],
    }


def plan_verdict(trajectory: Trajectory) -> str:
    """Whether a plan was checked, how far it is from its reference, and what holds it there."""
    check, missed = trajectory.check, missed_by(trajectory)
    said = (
        f"Not to be used: {failure}"
        if (failure := check.failure())
        else "Checked: simulated again, the limb stays within "
        f"{check.largest_difference_deg:.4f}° of the plan."
    )
    said += f" The reference is missed by {missed.mean():.2f}° on average, {missed.max():.2f}° at"
    said += " most"
    if far := far_from_reference(trajectory):
        return f"{said}. {far}"
    times = active_times(trajectory)
    if not times:
        return f"{said}, and no limit is active."
    longest = sorted(times, key=lambda bound: -sum(end - start for start, end in times[bound]))[:3]
    named = [
        f"{bound} for {sum(end - start for start, end in times[bound]):.1f} s" for bound in longest
    ]
    return f"{said}; it runs along limits: {', '.join(named)}."


def active_times(trajectory: Trajectory) -> dict[str, list[tuple[float, float]]]:
    """From when to when a plan runs along each bound, s."""
    times: dict[str, list[tuple[float, float]]] = {}
    for active in trajectory.check.active_constraints:
        times.setdefault(active.bound, []).append((active.start, active.end))
    return times


def write_report(
    trajectory: Trajectory, path: str | Path, data: Mapping[str, str | Path] | None = None
) -> None:
    """Writes one HTML page: verdict, chart, limits, how the plan was found, and the limb.

    Args:
        trajectory: the plan; times are since its start.
        path: of the page.
        data: files that the page links to, by what they are.
    """
    # Bokeh takes as long to import as all the rest.
    from limb_systems.views.charts import tracking_chart

    trajectory = trajectory.since_start()
    rows = [
        [
            bound,
            _spans(times),
            f"{sum(end - start for start, end in times):.1f}",
        ]
        for bound, times in active_times(trajectory).items()
    ]
    limits = trajectory.parameters.temperature_limits
    bounds = (
        f"Duty is from 0 to 1 (18). No wire is planned above T_max = {limits.maximum:g} °C (19), "
        f"and none below T_warm = {limits.warm:g} °C from {limits.warm_up_time:g} s on (20)."
    )
    found = [
        line
        for line in plan_summary(trajectory).splitlines()
        if not line.startswith(("limits", " "))  # they have a section of their own
    ]
    parts = [
        page.verdict(plan_verdict(trajectory)),
        page.chart(tracking_chart(trajectory), "Bend angle, temperatures and duty of the plan"),
        page.section(
            "Limits",
            page.paragraph(bounds),
            page.table(["the plan runs along", "at (s)", "in all (s)"], rows)
            if rows
            else page.paragraph("None is active."),
        ),
        page.section("How it was found", page.facts(found)),
        page.section("Limb", page.preformatted(trajectory.parameters.to_yaml())),
    ]
    if data:
        parts.append(page.section("Data", page.links(path, data)))
    page.write_page(path, "Plan of a limb's motion", parts, trajectory.provenance)


def _spans(times: list[tuple[float, float]]) -> str:
    return ", ".join(f"{start:.1f}-{end:.1f}" for start, end in times)
