"""Plans, calibrations and what was learned, each told once, for terminals, JSON and pages."""

from typing import TYPE_CHECKING

import numpy as np

from limb_systems import Recording, Trajectory
from limb_systems.files.plan_statements import plan_statements
from limb_systems.summary import Entry, Summary
from limb_systems.tracking import ReferenceDistances, reference_distances

if TYPE_CHECKING:
    from calibration import Calibration, Prediction, Validation
    from controllers import Learner


def plan_summary(trajectory: Trajectory, *, quick: bool = False) -> Summary:
    """Return how a plan was found and checked, how far it is from its reference, and its limits.

    Args:
        quick: whether to leave out what the limits leave, which takes a second.
    """
    from planners.nearest import nearest_plan  # takes long to import
    from planners.plan_check import far_from_reference

    found = None if quick else nearest_plan(trajectory)
    distances = reference_distances(trajectory, nearest=None if found is None else found[0])
    nearest, said = _degrees(distances.nearest), ""
    if nearest is not None:
        if constraints := trajectory.check.added_constraints:
            said = f"; without {', '.join(constraints)}, the limits would leave {nearest:.2f}°"
            nearest = None  # what all of them leave is not known
        else:
            said = f"; the limits leave {nearest:.2f}°"
        said += " on average"
    more = [
        Entry("nearest_distance_deg", nearest, "", None),
        Entry("far_from_reference", far_from_reference(trajectory), "", None),
    ]
    return plan_statements(trajectory, said) + Summary([], more)


def distances_summary(distances: ReferenceDistances) -> Summary:
    """Mean distances from the reference: of the limb, of its plan and of the best plan."""
    done = _degrees(distances.measured)
    of_plan = _beside("" if done is None else f"{done:.2f}°", distances)
    return Summary([*of_plan, Entry("reference_distance_deg", done, "°", None)])


def _beside(done: str, distances: ReferenceDistances) -> list[Entry]:
    """What was done, in words, beside the distances of the plan and of the best plan."""
    planned, nearest = _degrees(distances.planned), _degrees(distances.nearest)
    said = f"mean distance: measured {done}, " if done else "mean distance: "
    said += f"planned {planned:.2f}°"
    said += "" if nearest is None else f", best possible within the limits {nearest:.2f}°"
    return [
        Entry("reference", sentence=said),
        Entry("planned_distance_deg", planned, "°", None),
        Entry("nearest_distance_deg", nearest, "°", None),
    ]


def _degrees(distance: float | None) -> float | None:
    return None if distance is None else float(np.rad2deg(distance))


def repetitions_summary(learner: "Learner", *, quick: bool = False) -> Summary:
    """How near each repetition came to the reference and to the plan, and why learning ended.

    Args:
        quick: as for `plan_summary`.
    """
    values = [
        {
            "reference_distance_deg": float(np.rad2deg(repetition.reference_distance)),
            "mean_deg": float(np.rad2deg(repetition.mean_error)),
            "interrupted": repetition.interrupted,
            "remark": repetition.remark,
        }
        for repetition in learner.repetitions
    ]
    done, errors = (
        ", ".join(f"{value[name]:.2f}°" for value in values)
        for name in ("reference_distance_deg", "mean_deg")
    )
    undone = sum(repetition.failed for repetition in learner.repetitions)
    said = f"mean |φ* - φ| {errors}{f'; undone: {undone}' * bool(undone)}" if values else "none"
    plan = learner.trajectory
    from planners import nearest_bend_angle  # takes long to import

    distances = reference_distances(plan, nearest=None if quick else nearest_bend_angle(plan))
    return Summary(
        [
            *_beside(done, distances),
            Entry("repetitions", values, sentence=None),
            Entry("errors", sentence=said),
            Entry("finished", learner.finished),
        ]
    )


def calibration_summary(calibration: "Calibration") -> Summary:
    """Whether to plan with a calibration, what to do next, and what was calibrated."""
    estimates, stiffness = calibration.estimates, calibration.stiffness
    values = {
        name: {"value": e.value, "standard_error": e.standard_error, "unit": e.unit}
        for name, e in estimates.items()
    }
    remarks = [remark.sentence for remark in calibration.remarks]
    entries = [
        Entry("verdict", calibration.verdict),
        Entry("remarks", remarks, sentence="\n".join(ranked(calibration)) or None),
        Entry("next", calibration.next_recording, sentence=calibration.next_recording or None),
        Entry("estimates", values, sentence=None),
        *(Entry(name, sentence=str(estimate)) for name, estimate in estimates.items()),
        _laws(calibration.prediction),
    ]
    kept = calibration.as_described
    entries.append(Entry("as_described", kept, sentence=", ".join(kept) or None))
    factor = stiffness.correction_factor if stiffness else None
    said = stiffness.factor_in_words if stiffness else None
    entries.append(Entry("correction_factor", factor, sentence=said))
    if miss := calibration.plan_miss:
        range_deg = np.rad2deg([miss.low, miss.expected, miss.high]).tolist()
        values = dict(zip(("low_deg", "expected_deg", "high_deg"), range_deg, strict=True))
        entries.append(Entry("plan_miss", values, sentence=None))
    if calibration.validation:
        summary = validation_summary(calibration.validation)
        validated = Entry("validation", summary.to_json(), sentence=summary.line())
    else:
        validated = Entry("validation")
    return Summary([*entries, validated])


def ranked(calibration: "Calibration") -> list[str]:
    """The remarks on a calibration, each after its severity."""
    return [f"{remark.severity.name.lower()}: {remark}" for remark in calibration.remarks]


def _laws(prediction: "Prediction | None") -> Entry:
    """The laws that were compared, and how well each predicts what it was not fitted to."""
    if prediction is None:
        return Entry("laws")
    values, lines = [], [f"judged by {prediction.judges}"]
    measured = prediction.fit.measures_heat
    for candidate in prediction.candidates:
        bend, used = float(np.rad2deg(candidate.bend_error)), candidate is prediction.best
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
    lines.append(prediction.choice)
    return Entry("laws", values, sentence="\n".join(lines))


def validation_summary(validation: "Validation") -> Summary:
    """The errors of a validation."""
    degrees = [validation.mean, validation.median, validation.percentile_90]
    mean, median, most = np.rad2deg(degrees).tolist()
    interrupted = validation.recording.interrupted.rstrip(".")
    heat: float | None = validation.temperature_mean
    said = f"|V - V_sim|: mean {heat:.1f} °C"
    if np.isnan(validation.temperature_mean):
        heat = None
        said = "not measured"
    return Summary.of(
        {
            "bend angle": f"|φ - φ_sim|: mean {mean:.2f}°, median {median:.2f}°, 90th percentile "
            f"{most:.2f}°",
            "temperature": said
            + (f"; until it was interrupted: {interrupted}" if interrupted else ""),
        },
        {
            "bend_angle_mean_deg": mean,
            "bend_angle_median_deg": median,
            "bend_angle_percentile_90_deg": most,
            "temperature_mean_c": heat,
        },
    )


def troubles(recording: Recording) -> Summary:
    """Return why a recording was interrupted, and why it is to be doubted."""
    return Summary([Entry("interrupted", recording.interrupted), Entry("doubt", recording.doubt)])
