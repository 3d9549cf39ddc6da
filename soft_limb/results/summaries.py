"""Plans, calibrations and what was learned, each told once, for terminals, JSON and pages."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from limb_systems import Gait, Recording, Trajectory
from limb_systems.files.trajectory import AddedTerms
from limb_systems.summary import Entry, Summary
from limb_systems.tracking import ReferenceDistances, reference_distances

if TYPE_CHECKING:
    from calibration import Calibration, Prediction, Validation
    from controllers import Learner

# Of a `PlanCheck`, numbers and texts that JSON has under their own names.
_OF_CHECK = ["solver", "status", "iterations", "refinements", "cost", "guess_cost"]
_OF_CHECK += ["largest_defect", "largest_difference_deg", "tolerance_deg"]


def plan_summary(trajectory: Trajectory, *, quick: bool = False) -> Summary:
    """How a plan was found and checked, how far it is from its reference, and what limits it.

    Args:
        quick: whether to leave out what the limits leave, which takes a second.
    """
    check, parameters = trajectory.check, trajectory.parameters
    segments, knots = len(parameters.segments), len(trajectory.time)
    from planners import nearest_bend_angle  # takes long to import
    from planners.checks import far_from_reference

    best = None if quick else nearest_bend_angle(trajectory)
    distances = reference_distances(trajectory, nearest=best)
    missed, nearest = np.rad2deg(distances.planned), _degrees(distances.nearest)
    most = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference).max())
    texts = {
        "reference": f"missed by {missed:.2f}° on average, {most:.2f}° at most"
        + ("" if nearest is None else f"; the limits leave {nearest:.2f}° on average"),
        "limb": f"{segments} segment{'s' * (segments > 1)}, {parameters.num_joints} joints, "
        f"{len(parameters.wires)} wires",
        "plan": f"{trajectory.duration:g} s, {knots} knots, from request to checked plan in "
        f"{check.total_time:.2f} s",
        "solver": f"{check.solver}: {check.status} in {check.iterations} iterations, "
        f"{check.solve_time:.2f} s; cost {check.cost:.6g} (at the start {check.guess_cost:.6g})",
        "check": f"{'failed, ' * bool(check.failure())}simulated again: within "
        f"{check.largest_difference_deg:.4f}° of the plan (allowed {check.tolerance_deg:g}°); "
        f"largest defect {check.largest_defect:.1e}",
    }
    if check.is_missing:
        texts["solver"], texts["check"] = f"{check.solver or 'unknown'}: {check.status}", "none"
    if check.highest_readings:
        texts["band"] = (
            f"of limbs alike: φ is read within ±{check.bend_band_deg:.2f}° of the plan (95%), V up "
            f"to {max(check.highest_readings):.0f} °C (99.5%)"
        )
    stretches: dict[str, list[str]] = {}
    for active in check.active_constraints:
        stretches.setdefault(active.bound, []).append(f"{active.start:.1f}-{active.end:.1f}")
    at = {bound: f"at {', '.join(times)} s" for bound, times in stretches.items()}
    added = [_added(terms, at) for terms in check.added]
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
        "reference_missed_mean_deg": float(missed),
        "reference_missed_largest_deg": float(most),
        "nearest_distance_deg": nearest,
        "far_from_reference": far_from_reference(trajectory),
        "bend_band_deg": check.bend_band_deg if check.highest_readings else None,
        "highest_readings_c": check.highest_readings,
        "active_constraints": [
            {"bound": active.bound, "start_s": active.start, "end_s": active.end}
            for active in check.active_constraints
        ],
        "added": [dataclasses.asdict(terms) for terms in check.added],
    }
    return Summary.of(texts, values)


def _added(terms: AddedTerms, active: dict[str, str]) -> str:
    """Return a line on terms of one's own, and take what it says from the active constraints."""
    if terms.cost is None:
        times = active.pop(terms.name, None)
        kind, state = "constraint", f"active {times}" if times else "not active"
    else:
        kind, state = "cost", f"{terms.cost:.3g}"
    number = kind if terms.number == 1 else f"{terms.number} {kind}s"
    return f"{terms.name} ({number}): {state}"


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
    failure = None if check.is_missing else check.failure()
    return gait.summary() + Summary.of(
        {
            "phases": "\n".join(phases),
            "solver": found,
            "steadiness": "; ".join(steadiness) if np.isfinite(check.steadiness) else "",
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
    from planners.gait.check import fall_of, strides_of  # takes long to import

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


def distances_summary(distances: ReferenceDistances) -> Summary:
    """Mean distances from the reference: of the limb, of its plan and of the best plan."""
    done = _degrees(distances.done)
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
    for candidate in prediction.candidates:
        bend, used = float(np.rad2deg(candidate.bend_error)), candidate is prediction.best
        lines.append(
            f"{'*' if used else ' '} {candidate.name:<28} bend {bend:5.2f}°, "
            f"V {candidate.temperature_error:4.1f} °C on average"
        )
        values.append(
            {
                "law": candidate.name,
                "bend_angle_mean_deg": bend,
                "temperature_mean_c": candidate.temperature_error,
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
    return Summary.of(
        {
            "bend angle": f"|φ - φ_sim|: mean {mean:.2f}°, median {median:.2f}°, 90th percentile "
            f"{most:.2f}°",
            "temperature": f"|V - V_sim|: mean {validation.temperature_mean:.1f} °C"
            + (f"; until it was interrupted: {interrupted}" if interrupted else ""),
        },
        {
            "bend_angle_mean_deg": mean,
            "bend_angle_median_deg": median,
            "bend_angle_percentile_90_deg": most,
            "temperature_mean_c": validation.temperature_mean,
        },
    )
