"""Reports on a calibration and on its validation."""

import dataclasses
import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from markupsafe import Markup

from calibration.calibrate import Calibration
from calibration.paper_method.mechanics import DampingFit
from calibration.paper_method.wire_fits import HeatFit
from calibration.prediction.law_fit import Predicted
from calibration.prediction.selection import Prediction
from calibration.validation import Validation
from limb_systems import LimbParameters
from limb_systems.monte_carlo import parameter_owner
from limb_systems.views.colors import (
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.panels import SIGNALS, Curve, Panel
from soft_limb.reports import page
from soft_limb.results.summaries import ranked_remarks, validation_summary

# Name, times (K,) in s, φ (F, K) in rad, and V (W, K) in °C.
Samples = tuple[str, np.ndarray, np.ndarray, np.ndarray]


def write_report(
    calibration: Calibration, path: str | Path, data: Mapping[str, str | Path] | None = None
) -> None:
    """Write one HTML page: verdict, validation, parameters, and the laws over their recordings.

    Args:
        data: files that the page links to, by their descriptions.
    """
    # Begin with the verdict and the next steps.
    parts: list[page.Part] = [page.verdict(calibration.verdict)]
    next_steps = ranked_remarks(calibration)
    if calibration.next_recording:
        next_steps.append(f"next recording: {calibration.next_recording}")
    if next_steps:
        parts.append(page.section("Next steps", page.items(next_steps)))
    # Add the validation.
    if validation := calibration.validation:
        judged = calibration.prediction.parts if calibration.prediction else []
        text = "The duty of a recording that was not used in any fit, simulated open loop"
        if len(judged) > 1:
            text = (
                f"The duties of {len(judged)} recordings, simulated open loop and drawn one after "
                "the other; each was left out of the fit that predicts it"
            )
        text += f". {validation_summary(validation).line()}."
        title = "Validation, Sec. V-D and Fig. 4"
        parts.append(_section(title, text, validation_panels(validation)))
    # Add the parameters, and the names of those that were not fitted.
    sources = sorted(set(itertools.chain(*calibration.sources.values())))
    parameters = [
        page.paragraph(f"From recordings of: {', '.join(sources)}."),
        parameter_table(calibration),
    ]
    if not_fitted := calibration.as_described:
        parameters.append(page.paragraph(f"As described: {', '.join(not_fitted)}."))
    parts.append(page.section("Parameters", *parameters))
    # Add the laws as fitted, and the fits of Sec. V in words.
    if calibration.prediction:
        parts += _prediction(calibration.prediction, calibration.parameters)
    sentences = []
    if stiffness := calibration.stiffness:
        factor = stiffness.factor_in_words
        sentences.append(f"Sag (Sec. V-A): the correction factor of (9) is {factor}.")
    if damping := calibration.damping:
        sentences.append(_compare_decay(damping))
    sentences += map(_heat_in_words, calibration.heat)
    if sentences:
        parts.append(page.section("Fits of Sec. V", page.items(sentences)))
    # Write the page.
    record = calibration.parameters.calibration
    made = record.provenance if record else None
    page.write_page(path, "Calibration of a limb", parts, made, data)


def write_validation_report(
    validation: Validation, path: str | Path, data: Mapping[str, str | Path]
) -> None:
    """Write one HTML page that compares a simulation with a recording; see `write_report`."""
    parts: list[page.Part] = [
        page.verdict(validation.verdict),
        page.paragraph(f"{validation_summary(validation).line()}."),
        page.chart(validation_panels(validation), "Limb and model for the same duty"),
    ]
    made = validation.simulation.provenance
    page.write_page(path, "Validation of a calibrated limb", parts, made, data)


def _prediction(prediction: Prediction, limb: LimbParameters) -> list[page.Part]:
    """Return a table of the compared laws, and a section for each recording that was fitted."""
    # List the errors of each law.
    rows = []
    for candidate in prediction.candidates:
        mark = " *" if candidate is prediction.best else ""
        bend = f"{np.rad2deg(candidate.bend_error):.2f}"
        heat = f"{candidate.temperature_error:.1f}" if prediction.fit.measures_heat else ""
        rows.append([f"{candidate.name}{mark}", bend, heat])
    table = page.table(
        ["law", "bend, °", "reading V, °C"],
        rows,
        f"Mean errors of open-loop predictions, judged by {prediction.judges}. {prediction.choice}",
    )
    # Draw each recording with the prediction of the chosen law.
    parts: list[page.Part] = [page.section("Laws of the wires", table)]
    for number, predicted in enumerate(prediction.fit.predicted, 1):
        title = f"Recording {number} of {len(prediction.fit.predicted)} as fitted"
        bend = f"{np.rad2deg(predicted.bend_error):.2f}°"
        text = f"{predicted.run.source}: mean error of the bend {bend}"
        if predicted.run.is_read:
            text += f", of V {predicted.temperature_error:.1f} °C"
        parts.append(_section(title, f"{text}.", predicted_panels(predicted, limb)))
    return parts


def parameter_table(calibration: Calibration) -> Markup:
    """Return a table of the calibrated parameters with their standard errors."""
    rows = []
    for name, estimate in calibration.estimates.items():
        owner, field_name = parameter_owner(calibration.parameters, name)
        fields = {field.name: field for field in dataclasses.fields(owner)}
        metadata = fields[field_name].metadata if field_name in fields else {}
        rows.append([name, str(estimate), metadata.get("meaning", "")])
    return page.table(["parameter", "value ± standard error", "meaning"], rows)


def _compare_decay(fit: DampingFit) -> str:
    """Return frequency and damping ratio of limb and model, in words."""
    limb = fit.measured[0]
    model = fit.simulated[0]
    return (
        f"Ring-down (Sec. V-B): the limb at {limb.frequency:.2f} Hz with "
        f"ζ = {limb.damping_ratio:.3f}, the model with this damping constant at "
        f"{model.frequency:.2f} Hz with ζ = {model.damping_ratio:.3f}."
    )


def _heat_in_words(fit: HeatFit) -> str:
    """Return the parameters of heat transfer and their errors, in words."""
    delay = f", delay {fit.delay}" if fit.delay else ""
    return (
        f"The {fit.wire} wire (Sec. V-C): a1 = {fit.a1}, a2 = {fit.a2}, "
        f"a3 = {fit.a3}{delay}; V within "
        f"{fit.temperature_residual:.1f} °C and φ within {np.rad2deg(fit.angle_residual):.1f}° "
        "(root mean square)."
    )


def _section(title: str, text: str, panels: list[Panel]) -> page.Section:
    return page.section(title, page.paragraph(text), page.chart(panels, title))


def validation_panels(validation: Validation) -> list[Panel]:
    """Return Fig. 4: the calibrated model and the limb, for the same duty."""
    # Draw the readings of limb and model.
    recording = validation.recording
    names = recording.parameters.wire_names
    runs = []
    for name, run in (("limb", recording), ("model", validation.simulation)):
        runs.append((name, run.time, run.bend_angle, run.measured_temperature))
    reference = None if recording.reference is None else np.rad2deg(recording.reference)
    panels = _model_panels(runs, recording.parameters, reference)
    # Draw the duty below.
    duties = []
    for name, duty, color in zip(names, recording.duty, wire_colors(len(names)), strict=True):
        duties.append(Curve(name, recording.time, duty, color, width=1.0))
    return [*panels, SIGNALS["duty"].panel(duties)]


def predicted_panels(predicted: Predicted, limb: LimbParameters) -> list[Panel]:
    """Return panels of a recording and its open-loop simulation by the fitted law."""
    run = predicted.run
    runs = [
        ("limb", run.times, run.bend.T, run.temperature.T),
        ("law", run.times, predicted.bend.T, predicted.temperature.T),
    ]
    return _model_panels(runs, limb)


def _model_panels(
    runs: list[Samples], limb: LimbParameters, reference: np.ndarray | None = None
) -> list[Panel]:
    """Return panels of bends and readings: the limb solid, its model dashed; set points in °."""
    styles = ((ROLLOUT_COLOR, "solid", 1.0), (PLAN_COLOR, "dashed", 1.75))
    # Draw a panel for each bend.
    panels = []
    for bend, suffix in enumerate(limb.bend_suffixes):
        curves = []
        if reference is not None:
            times = runs[0][1]
            curves.append(Curve("set point", times, reference[bend], REFERENCE_COLOR, width=1.0))
        for (run, time, angles, _), style in zip(runs, styles, strict=True):
            curves.append(Curve(run, time, np.rad2deg(angles[bend]), *style))
        panels.append(SIGNALS["bend_angle"].panel(curves, suffix))
    # Draw the readings of all wires in one panel.
    readings = []
    colors = wire_colors(len(limb.wires))
    for (run, time, _, wire_readings), (_, dash, width) in zip(runs, styles, strict=True):
        for wire, color, reading in zip(limb.wire_names, colors, wire_readings, strict=True):
            readings.append(Curve(f"{wire}, V {run}", time, reading, color, dash, width))
    return [*panels, SIGNALS["measured_temperature"].panel(readings)]
