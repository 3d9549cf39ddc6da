"""A plan, how a limb followed it, and how it learned to, each as one HTML page."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from controllers import Learner
from limb_systems import Recording, Trajectory
from limb_systems.summary import Summary
from limb_systems.views.panels import repetition_panels, tracking_panels
from planners.plan_check import far_from_reference
from soft_limb.reports import page
from soft_limb.runs.rollout import Rollout


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


def write_plan_report(
    trajectory: Trajectory,
    summary: Summary,
    path: str | Path,
    data: Mapping[str, str | Path],
) -> None:
    """Write one HTML page: verdict, chart, how the plan was found, its limits, and the limb.

    Args:
        trajectory: the plan; times are since its start.
        summary: its `plan_summary`, which the command prints, too.
        path: path of the page.
        data: files that the page links to, by what they are.
    """
    trajectory = trajectory.since_start()
    limits = trajectory.parameters.temperature_limits
    bounds = (
        f"Duty is from 0 to 1 (18). No wire is planned above T_max = {limits.maximum:g} °C (19), "
        f"and none below T_warm = {limits.warm:g} °C from {limits.warm_up_time:g} s on (20)."
    )
    parts: list[page.Part] = [
        page.verdict(plan_verdict(trajectory, summary)),
        page.chart(tracking_panels(trajectory), "Bend angle, temperatures and duty of the plan"),
        page.section("How it was found", page.facts(summary), page.paragraph(bounds)),
        page.section("Limb", page.limb(trajectory.parameters)),
    ]
    page.write_page(path, "Plan of a limb's motion", parts, trajectory.provenance, data)


def rollout_verdict(rollout: Rollout, summary: Summary) -> str:
    """What ended a run, how near the limb came to its reference, and what is to be doubted."""
    recording, near = rollout.recording, summary.texts()["reference"]
    said = []
    if recording.interrupted:
        said.append(
            f"Interrupted at {recording.time[-1]:.1f} s of {rollout.trajectory.duration:.1f} s: "
            f"{recording.interrupted.rstrip('.')}."
        )
    said.append(f"{near[0].upper()}{near[1:]}.")
    if far := far_from_reference(rollout.trajectory):
        said.append(far)
    if recording.doubt:
        said.append(f"Doubtful: {recording.doubt}; they do not count.")
    return " ".join(said)


def write_rollout_report(
    rollout: Rollout, summary: Summary, path: str | Path, data: Mapping[str, str | Path]
) -> None:
    """Write one HTML page: verdict, chart of plan and recording, facts and links to the data.

    Args:
        summary: statements that the command prints, such as `Rollout.summary`.
        path: path of the page.
        data: files that the page links to, by what they are.
    """
    panels = tracking_panels(rollout.trajectory, [rollout.recording])
    parts: list[page.Part] = [
        page.verdict(rollout_verdict(rollout, summary)),
        page.chart(panels, "Bend angle, temperatures and duty of the plan and the recording"),
        page.section("Facts", page.facts(summary)),
    ]
    page.write_page(path, "A plan, followed", parts, rollout.recording.provenance, data)


def learning_verdict(learner: Learner) -> str:
    """How far the distance from the reference fell, and why learning ended."""
    distances = np.rad2deg([repetition.reference_distance for repetition in learner.repetitions])
    said = [f"Mean distance from the reference: {distances[0]:.2f}° in the first repetition"]
    if len(distances) > 1:
        said[0] += f", {distances[-1]:.2f}° in the last of {len(distances)}"
    said[0] += "."
    if far := far_from_reference(learner.trajectory):
        said.append(far)
    if learner.finished:
        said.append(f"Learning is finished: {learner.finished.rstrip('.')}.")
    return " ".join(said)


def write_learning_report(
    learner: Learner, recordings: Mapping[int, Path], state: Path, picture: Path, path: Path
) -> None:
    """Save a picture of all repetitions and a page on them.

    Args:
        recordings: the files of repetitions by their numbers, one or more.
        state: file of the learner.
        picture: path of the picture.
        path: path of the page.
    """
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.plots import draw, save_figure

    numbers = sorted(recordings)
    first, last = (Recording.load(recordings[number]) for number in (numbers[0], numbers[-1]))
    distances = [repetition.reference_distance for repetition in learner.repetitions]
    errors = [repetition.mean_error for repetition in learner.repetitions]
    panels = repetition_panels(learner.trajectory, distances, errors, first, last)
    save_figure(draw(panels), picture)
    rows = [
        [
            str(number),
            f"{np.rad2deg(repetition.reference_distance):.2f}",
            f"{np.rad2deg(repetition.mean_error):.2f}",
            "; ".join(filter(None, [repetition.interrupted, repetition.remark])),
        ]
        for number, repetition in enumerate(learner.repetitions, 1)
    ]
    learned = page.chart(
        panels,
        "Mean distances of each repetition; bend angle in the first, in the last and in the plan",
    )
    tracked = page.chart(
        tracking_panels(learner.trajectory, [last]),
        "Bend angle, temperatures and duty of the plan and the last repetition",
    )
    data = {"what was learned": state}
    data |= {f"repetition {number}": recordings[number] for number in numbers}
    header = ["repetition", "mean |φ_REF − φ|, °", "mean |φ* − φ|, °", "remark"]
    parts: list[page.Part] = [
        page.verdict(learning_verdict(learner)),
        learned,
        page.section(f"Repetition {numbers[-1]}", tracked),
        page.section("Repetitions", page.table(header, rows)),
    ]
    page.write_page(path, "A plan, learned", parts, last.provenance, data)
