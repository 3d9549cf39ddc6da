"""A plan as one HTML page."""

from collections.abc import Mapping
from pathlib import Path

from limb_systems import Trajectory
from limb_systems.summary import Summary
from limb_systems.views.panels import tracking_panels
from planners.checks import far_from_reference
from soft_limb.reports import page
from soft_limb.results.summaries import active_times, spans


def plan_verdict(trajectory: Trajectory, summary: Summary) -> str:
    """How far a plan is from its reference, whether it was checked, and why it is far."""
    check = trajectory.check
    said = [f"The reference is {summary.texts()['reference']}."]
    if failure := check.failure():
        said.append(f"Not to be used: {failure}")
    else:
        said.append(
            "Checked: simulated again, the limb stays within "
            f"{check.largest_difference_deg:.4f}° of the plan."
        )
    if far := far_from_reference(trajectory):
        said.append(far)
    return " ".join(said)


def write_report(
    trajectory: Trajectory,
    summary: Summary,
    path: str | Path,
    data: Mapping[str, str | Path],
) -> None:
    """Writes one HTML page: verdict, chart, limits, how the plan was found, and the limb.

    Args:
        trajectory: the plan; times are since its start.
        summary: its `plan_summary`, which the command prints, too.
        path: path of the page.
        data: files that the page links to, by what they are.
    """
    trajectory = trajectory.since_start()
    rows = [
        [bound, spans(times), f"{sum(end - start for start, end in times):.1f}"]
        for bound, times in active_times(trajectory).items()
    ]
    limits = trajectory.parameters.temperature_limits
    bounds = (
        f"Duty is from 0 to 1 (18). No wire is planned above T_max = {limits.maximum:g} °C (19), "
        f"and none below T_warm = {limits.warm:g} °C from {limits.warm_up_time:g} s on (20)."
    )
    found = Summary([entry for entry in summary.entries if entry.name != "limits"])
    parts: list[page.Part] = [
        page.verdict(plan_verdict(trajectory, summary)),
        page.chart(tracking_panels(trajectory), "Bend angle, temperatures and duty of the plan"),
        page.section(
            "Limits",
            page.paragraph(bounds),
            page.table(["the plan runs along", "at (s)", "in all (s)"], rows)
            if rows
            else page.paragraph("None is active."),
        ),
        page.section("How it was found", page.facts(found)),
        page.section("Limb", page.limb(trajectory.parameters)),
    ]
    page.write_page(path, "Plan of a limb's motion", parts, trajectory.provenance, data)
