"""Reports on a plan, on a rollout of a plan, and on learning, each as one HTML page."""

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
    """Return the distance of a plan from its reference, the result of its check, and warnings."""
    check = trajectory.check
    sentences = [f"The reference is {summary.texts()['reference']}."]
    if failure := check.failure():
        sentences.append(f"Not to be used: {failure}")
    else:
        sentences.append(
            "Checked: simulated again, the limb stays within "
            f"{check.largest_difference_deg:.4f}° of the plan."
        )
    if warning := far_from_reference(trajectory):
        sentences.append(warning)
    return " ".join(sentences)


def write_plan_report(
    trajectory: Trajectory,
    summary: Summary,
    path: str | Path,
    data: Mapping[str, str | Path],
) -> None:
    """Write one HTML page of a plan and its `plan_summary`; ``data`` as for `page.write_page`."""
    trajectory = trajectory.since_start()
    # Put the limits of the program into words.
    limits = trajectory.parameters.temperature_limits
    bounds = (
        f"Limits: duty between 0 and 1 (18); wire temperature at most T_max = {limits.maximum:g} "
        f"°C (19), and at least T_warm = {limits.warm:g} °C from {limits.warm_up_time:g} s on (20)."
    )
    parts: list[page.Part] = [
        page.verdict(plan_verdict(trajectory, summary)),
        page.chart(tracking_panels(trajectory), "Bend angle, temperatures and duty of the plan"),
        page.section("Solution", page.facts(summary), page.paragraph(bounds)),
        page.section("Limb", page.limb(trajectory.parameters)),
    ]
    page.write_page(path, "Plan of a limb's motion", parts, trajectory.provenance, data)


def rollout_verdict(rollout: Rollout, summary: Summary) -> str:
    """Return an interruption, the distances from the reference, and doubts about readings."""
    recording = rollout.recording
    sentences = []
    if recording.interrupted:
        sentences.append(
            f"Interrupted at {recording.time[-1]:.1f} s of {rollout.trajectory.duration:.1f} s: "
            f"{recording.interrupted.rstrip('.')}."
        )
    # Tell how near the limb came, and what is in doubt.
    distances = summary.texts()["reference"]
    sentences.append(f"{distances[0].upper()}{distances[1:]}.")
    if warning := far_from_reference(rollout.trajectory):
        sentences.append(warning)
    if recording.doubt:
        sentences.append(f"Doubtful: {recording.doubt}; they do not count.")
    return " ".join(sentences)


def write_rollout_report(
    rollout: Rollout, summary: Summary, path: str | Path, data: Mapping[str, str | Path]
) -> None:
    """Write one HTML page of a rollout and its summary; ``data`` as for `page.write_page`."""
    panels = tracking_panels(rollout.trajectory, [rollout.recording])
    parts: list[page.Part] = [
        page.verdict(rollout_verdict(rollout, summary)),
        page.chart(panels, "Bend angle, temperatures and duty of the plan and the recording"),
        page.section("Facts", page.facts(summary)),
    ]
    page.write_page(path, "Rollout of a plan", parts, rollout.recording.provenance, data)


def learning_verdict(learner: Learner) -> str:
    """Return the distances of the first and the last repetition, and why learning ended."""
    # Compare the first repetition with the last.
    texts = []
    for repetition in learner.repetitions:
        read, estimated = np.rad2deg([repetition.reference_distance, repetition.estimated_distance])
        texts.append(f"{read:.2f}° as read, about {estimated:.2f}° without the sensor's drift")
    first = f"Mean distance from the reference: in the first repetition {texts[0]}"
    if len(texts) > 1:
        first += f"; in repetition {len(texts)}, the last, {texts[-1]}"
    sentences = [f"{first}."]
    if warning := far_from_reference(learner.trajectory):
        sentences.append(warning)
    if learner.finished:
        sentences.append(f"Learning is finished: {learner.finished.rstrip('.')}.")
    return " ".join(sentences)


def write_learning_report(
    learner: Learner, recordings: Mapping[int, Path], state: Path, path: Path
) -> None:
    """Write one HTML page of all repetitions.

    Args:
        recordings: one or more files of repetitions, by the numbers of the repetitions.
        state: file of the learner.
    """
    # List the errors of all repetitions.
    distances = [repetition.reference_distance for repetition in learner.repetitions]
    errors = [repetition.mean_error for repetition in learner.repetitions]
    rows = []
    for number, repetition in enumerate(learner.repetitions, 1):
        means = (
            repetition.reference_distance,
            repetition.estimated_distance,
            repetition.mean_error,
        )
        remark = "; ".join(filter(None, [repetition.interrupted, repetition.remark]))
        rows.append([str(number), *(f"{np.rad2deg(mean):.2f}" for mean in means), remark])
    # Draw them, and the first and the last recording.
    numbers = sorted(recordings)
    first = Recording.load(recordings[numbers[0]])
    last = Recording.load(recordings[numbers[-1]])
    learned = page.chart(
        repetition_panels(learner.trajectory, distances, errors, first, last),
        "Mean distances of each repetition; bend angle in the first, in the last and in the plan",
    )
    tracked = page.chart(
        tracking_panels(learner.trajectory, [last]),
        "Bend angle, temperatures and duty of the plan and the last repetition",
    )
    # Write the page, with links to all recordings.
    data = {"state of learning": state}
    for number in numbers:
        data[f"repetition {number}"] = recordings[number]
    header = [
        "repetition",
        "mean |φ_REF − φ| as read, °",
        "mean |φ_REF − φ| without drift, °",
        "mean |φ* − φ| as read, °",
        "remark",
    ]
    parts: list[page.Part] = [
        page.verdict(learning_verdict(learner)),
        learned,
        page.section(f"Repetition {numbers[-1]}", tracked),
        page.section("Repetitions", page.table(header, rows)),
    ]
    page.write_page(path, "Learning to follow a plan", parts, last.provenance, data)
