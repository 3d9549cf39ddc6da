"""Summaries of plans, learning, calibrations and validations, for terminals, JSON and pages."""

from typing import TYPE_CHECKING

import numpy as np

from limb_systems import Recording, Trajectory
from limb_systems.summary import Entry, Summary
from limb_systems.tracking import ReferenceDistances, reference_distances

if TYPE_CHECKING:
    from calibration import Calibration, Prediction, Validation
    from controllers import Learner


def plan_summary(trajectory: Trajectory, *, quick: bool = False) -> Summary:
    """Return the check of a plan, its distance from the reference, and its limits.

    If ``quick``, the best plan within the limits, which takes a second, is left out.
    """
    from planners.nearest import nearest_plan  # takes long to import
    from planners.plan_check import far_from_reference

    # Compute the distance of the best plan that the limits allow.
    best = None if quick else nearest_plan(trajectory)
    distances = reference_distances(trajectory, nearest=None if best is None else best[0])
    # Put it into words.
    nearest = _degrees(distances.nearest)
    text = ""
    if nearest is not None:
        if constraints := trajectory.check.added_constraints:
            text = f"; without {', '.join(constraints)}, the limits would leave {nearest:.2f}°"
            nearest = None  # the distance with the user's constraints is not known
        else:
            text = f"; the limits leave {nearest:.2f}°"
        text += " on average"
    details = [
        Entry("nearest_distance_deg", nearest, "", None),
        Entry("far_from_reference", far_from_reference(trajectory), "", None),
    ]
    return trajectory.statements(text) + Summary([], details)


def distances_summary(distances: ReferenceDistances) -> Summary:
    """Return the mean distances of limb, plan and best plan from the reference."""
    measured = _degrees(distances.measured)
    entries = _distance_entries("" if measured is None else f"{measured:.2f}°", distances)
    return Summary([*entries, Entry("reference_distance_deg", measured, "°", None)])


def _distance_entries(measured: str, distances: ReferenceDistances) -> list[Entry]:
    """Return the distances of a limb (as text, or empty), its plan and the best plan."""
    planned = _degrees(distances.planned)
    nearest = _degrees(distances.nearest)
    text = f"mean distance: measured {measured}, " if measured else "mean distance: "
    text += f"planned {planned:.2f}°"
    if nearest is not None:
        text += f", best possible within the limits {nearest:.2f}°"
    return [
        Entry("reference", sentence=text),
        Entry("planned_distance_deg", planned, "°", None),
        Entry("nearest_distance_deg", nearest, "°", None),
    ]


def _degrees(distance: float | None) -> float | None:
    return None if distance is None else float(np.rad2deg(distance))


def repetitions_summary(learner: "Learner", *, quick: bool = False) -> Summary:
    """Return each repetition's distance from reference and plan; see `plan_summary`."""
    # List the numbers of each repetition.
    values = []
    for repetition in learner.repetitions:
        values.append(
            {
                "reference_distance_deg": float(np.rad2deg(repetition.reference_distance)),
                "estimated_distance_deg": float(np.rad2deg(repetition.estimated_distance)),
                "mean_deg": float(np.rad2deg(repetition.mean_error)),
                "interrupted": repetition.interrupted,
                "remark": repetition.remark,
            }
        )

    def listed(name: str) -> str:
        return ", ".join(f"{value[name]:.2f}°" for value in values)

    # Put them into words.
    estimates = f"mean |φ_ref - φ| without the sensor's drift: {listed('estimated_distance_deg')}"
    text = f"mean |φ* - φ| {listed('mean_deg')}" if values else "none"
    if num_undone := sum(repetition.failed for repetition in learner.repetitions):
        text += f"; undone: {num_undone}"
    # Compare with the best plan.
    from planners import nearest_bend_angle  # takes long to import

    plan = learner.trajectory
    distances = reference_distances(plan, nearest=None if quick else nearest_bend_angle(plan))
    return Summary(
        [
            *_distance_entries(listed("reference_distance_deg"), distances),
            Entry("repetitions", values, sentence=None),
            Entry("estimated", sentence=estimates if values else None),
            Entry("errors", sentence=text),
            Entry("finished", learner.finished),
        ]
    )


def calibration_summary(calibration: "Calibration") -> Summary:
    """Return the verdict on a calibration, the next steps, and the calibrated parameters."""
    estimates = calibration.estimates
    stiffness = calibration.stiffness
    values = {}
    lines = []
    for name, estimate in estimates.items():
        numbers = {"value": estimate.value, "standard_error": estimate.standard_error}
        values[name] = numbers | {"unit": estimate.unit}
        lines.append(Entry(name, sentence=str(estimate)))
    remarks = [remark.sentence for remark in calibration.remarks]
    # Begin with the verdict and the next steps, then the estimates.
    entries = [
        Entry("verdict", calibration.verdict),
        Entry("remarks", remarks, sentence="\n".join(ranked_remarks(calibration)) or None),
        Entry("next", calibration.next_recording, sentence=calibration.next_recording or None),
        Entry("estimates", values, sentence=None),
        *lines,
        _law_entry(calibration.prediction),
    ]
    # Add what was not calibrated, and the factor of (9).
    not_fitted = calibration.as_described
    entries.append(Entry("as_described", not_fitted, sentence=", ".join(not_fitted) or None))
    factor = stiffness.correction_factor if stiffness else None
    text = stiffness.factor_in_words if stiffness else None
    entries.append(Entry("correction_factor", factor, sentence=text))
    # Add the errors to expect.
    if miss := calibration.plan_miss:
        low_deg, expected_deg, high_deg = np.rad2deg([miss.low, miss.expected, miss.high]).tolist()
        numbers = {"low_deg": low_deg, "expected_deg": expected_deg, "high_deg": high_deg}
        entries.append(Entry("plan_miss", numbers, sentence=None))
    if calibration.validation:
        summary = validation_summary(calibration.validation)
        validated = Entry("validation", summary.to_json(), sentence=summary.line())
    else:
        validated = Entry("validation")
    return Summary([*entries, validated])


def ranked_remarks(calibration: "Calibration") -> list[str]:
    """Return the remarks on a calibration as texts, each after its severity."""
    return [f"{remark.severity.name.lower()}: {remark}" for remark in calibration.remarks]


def _law_entry(prediction: "Prediction | None") -> Entry:
    """Return the compared laws, each with its errors on recordings left out of its fit."""
    if prediction is None:
        return Entry("laws")
    values = []
    lines = [f"judged by {prediction.judges}"]
    measured = prediction.fit.measures_heat
    # Put the errors of each law into a line, with a star for the chosen law.
    for candidate in prediction.candidates:
        bend = float(np.rad2deg(candidate.bend_error))
        used = candidate is prediction.best
        lines.append(
            f"{'*' if used else ' '} {candidate.name:<28} bend {bend:5.2f}°"
            f"{f', V {candidate.temperature_error:4.1f} °C' * measured} on average"
        )
        values.append(
            {
                "law": candidate.name,
                "bend_angle_mean_deg": bend,
                "temperature_mean_c": candidate.temperature_error if measured else None,
                "used": used,
            }
        )
    # End with the reason for the choice.
    lines.append(prediction.choice)
    return Entry("laws", values, sentence="\n".join(lines))


def validation_summary(validation: "Validation") -> Summary:
    """Return the errors of a validation."""
    errors = [validation.mean, validation.median, validation.percentile_90]
    mean, median, percentile_90 = np.rad2deg(errors).tolist()
    bend = f"mean {mean:.2f}°, median {median:.2f}°, 90th percentile {percentile_90:.2f}°"
    # A limb without thermocouples has no error of V.
    heat: float | None = validation.temperature_mean
    heat_text = f"|V - V_sim|: mean {heat:.1f} °C"
    if np.isnan(validation.temperature_mean):
        heat = None
        heat_text = "not measured"
    # Tell if the recording ended early.
    interrupted = validation.recording.interrupted.rstrip(".")
    if interrupted:
        heat_text += f"; until it was interrupted: {interrupted}"
    return Summary.of(
        {"bend angle": f"|φ - φ_sim|: {bend}", "temperature": heat_text},
        {
            "bend_angle_mean_deg": mean,
            "bend_angle_median_deg": median,
            "bend_angle_percentile_90_deg": percentile_90,
            "temperature_mean_c": heat,
        },
    )


def troubles(recording: Recording) -> Summary:
    """Return the reasons why a recording was interrupted, and why it is doubtful."""
    return Summary([Entry("interrupted", recording.interrupted), Entry("doubt", recording.doubt)])
