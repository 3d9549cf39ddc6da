"""Reports on a calibration and on its validation, with every fit plotted over its data."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from calibration.calibrate import Calibration
from calibration.paper_method.mechanics import DampingFit, StiffnessFit
from calibration.paper_method.wire_fits import ForceFit, HeatFit
from calibration.prediction.law_fit import Predicted
from calibration.prediction.selection import Prediction
from calibration.validation import Validation
from limb_systems.views.colors import (
    NEUTRAL_COLOR,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.panels import SIGNALS, Curve, Panel
from soft_limb.reports import page
from soft_limb.results.summaries import ranked_remarks, validation_summary

_PARAMETER_MEANINGS = {
    "ambient_temperature": "T0",
    "stiffness": "k, Sec. V-A",
    "damping": "σ, Sec. V-B",
    "a1": "cooling (6)",
    "a2": "heating (6)",
    "a3": "thermocouple's lag (7)",
    "beta": "torque per degree (4)",
    "silicone_warming": "kS, silicone warmed by the wire",
    "silicone_cooling": "kA, silicone cooled by the room",
    "knee": "temperature about which torque sets in",
    "width": "width of the knee, or of the curves of transformation",
    "full_torque": "torque of the transformed wire",
    "middle": "half is transformed",
    "heating_middle": "half is transformed, on heating",
    "cooling_middle": "half is transformed, on cooling",
    "outer_warming": "kR, outer silicone warmed by the inner",
    "outer_cooling": "kO, outer silicone cooled by the room",
    "direct_cooling": "h0, wire cooled by the room",
    "convection": "h1, more of that per degree",
    "silicone_share": "μ, of the silicone in the reading",
    "heating_drop": "ρ, share of heating lost by transformation",
    "latent_heat": "L, as degrees of the wire",
    "backlash": "b, turned without transformation",
    "play_share": "m, of memory that closes minor loops",
    "stress_shift": "σ, transformation shifted by full pull",
    "creep_share": "c, share of the bend that comes late",
    "creep_rate": "kC, at which it comes",
    "rest_angle": "bend angle at rest, cold",
    "rest_angle_e3": "the same towards E3",
    "angle": "wire's place around the axis, from E2 towards E3",
    "roll": "angle by which the bend sensor is turned about the axis",
    "stiffness_ratio": "stiffness against bends towards E3, as a share of k",
    "stiffening": "share added to k at 45°",
    "shift": "Δ of the rest angle's memory",
    "rate": "λ of the rest angle's memory",
}


# Name, times (K,) in s, φ (F, K) in rad, and V (W, K) in °C.
Samples = tuple[str, np.ndarray, np.ndarray, np.ndarray]


def write_report(
    calibration: Calibration, path: str | Path, data: Mapping[str, str | Path] | None = None
) -> None:
    """Write one HTML page: verdict, next steps, parameters, and every fit over its data.

    Args:
        path: path of the page.
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
    # Add every fit.
    if calibration.prediction:
        parts += _prediction(calibration.prediction, calibration.parameters.wire_names)
    if stiffness := calibration.stiffness:
        text = f"The correction factor of (9) is {stiffness.factor_in_words}."
        parts.append(_section("Spring constant, Sec. V-A", text, stiffness_panels(stiffness)))
    if damping := calibration.damping:
        title = "Damping, Sec. V-B and Algorithm 1"
        parts.append(_section(title, _compare_decay(damping), damping_panels(damping)))
    colors = wire_colors(len(calibration.heat))
    for heat, force, color in zip(calibration.heat, calibration.force, colors, strict=True):
        title = f"The {heat.wire} wire, Sec. V-C"
        parts.append(_section(title, _heat_in_words(heat), wire_panels(heat, force, color)))
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


def _prediction(prediction: Prediction, wire_names: list[str]) -> list[page.Part]:
    """Return a table of the compared laws, and a section for each recording as fitted."""
    # List the errors of each law.
    rows = []
    for candidate in prediction.candidates:
        mark = " *" if candidate is prediction.best else ""
        bend = f"{np.rad2deg(candidate.bend_error):.2f}"
        heat = f"{candidate.temperature_error:.1f}" if prediction.fit.measures_heat else ""
        rows.append([f"{candidate.name}{mark}", bend, heat])
    table = page.table(
        ["law", "bend, °", "V, °C"],
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
        parts.append(_section(title, f"{text}.", predicted_panels(predicted, wire_names)))
    return parts


def parameter_table(calibration: Calibration) -> Markup:
    """Return a table of the calibrated parameters with their standard errors."""
    rows = [
        [name, str(estimate), _PARAMETER_MEANINGS.get(name.split(".")[-1], "")]
        for name, estimate in calibration.estimates.items()
    ]
    return page.table(["parameter", "value ± standard error", "meaning"], rows)


def _compare_decay(fit: DampingFit) -> str:
    """Return frequency and damping ratio of limb and model, in words."""
    limb = fit.measured[0]
    model = fit.simulated[0]
    return (
        "Damped sinusoids fitted to the limb and to its model. The damping constant gives the "
        f"model the decay of the limb: the limb at {limb.frequency:.2f} Hz with "
        f"ζ = {limb.damping_ratio:.3f}, the model at {model.frequency:.2f} Hz with "
        f"ζ = {model.damping_ratio:.3f}."
    )


def _heat_in_words(fit: HeatFit) -> str:
    """Return the parameters of heat transfer and their errors, in words."""
    delay = f", delay {fit.delay}" if fit.delay else ""
    return (
        f"a1 = {fit.a1}, a2 = {fit.a2}, a3 = {fit.a3}{delay}; V within "
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
    panels = _model_panels(runs, names, reference)
    # Draw the duty below.
    duties = []
    for name, duty, color in zip(names, recording.duty, wire_colors(len(names)), strict=True):
        duties.append(Curve(name, recording.time, duty, color, width=1.0))
    return [*panels, SIGNALS["duty"].panel(duties)]


def predicted_panels(predicted: Predicted, wire_names: Sequence[str]) -> list[Panel]:
    """Return panels of a recording and its open-loop simulation by the fitted law."""
    run = predicted.run
    runs = [
        ("limb", run.times, run.bend.T, run.temperature.T),
        ("law", run.times, predicted.bend.T, predicted.temperature.T),
    ]
    return _model_panels(runs, wire_names)


def _model_panels(
    runs: list[Samples], wire_names: Sequence[str], reference: np.ndarray | None = None
) -> list[Panel]:
    """Return panels of bends and readings: the limb solid, and its model dashed.

    Args:
        runs: samples of the limb and of its model.
        reference: set points of the bends (F, K), degrees; None if there are none.
    """
    styles = ((ROLLOUT_COLOR, "solid", 1.0), (PLAN_COLOR, "dashed", 1.75))
    # Draw a panel for each bend.
    panels = []
    for bend, suffix in enumerate(["_e2", "_e3"] if len(runs[0][2]) == 2 else [""]):
        curves = []
        if reference is not None:
            times = runs[0][1]
            curves.append(Curve("set point", times, reference[bend], REFERENCE_COLOR, width=1.0))
        for (run, time, angles, _), style in zip(runs, styles, strict=True):
            curves.append(Curve(run, time, np.rad2deg(angles[bend]), *style))
        panels.append(SIGNALS["bend_angle"].panel(curves, suffix))
    # Draw the readings of all wires in one panel.
    readings = []
    colors = wire_colors(len(wire_names))
    for (run, time, _, wire_readings), (_, dash, width) in zip(runs, styles, strict=True):
        for wire, color, reading in zip(wire_names, colors, wire_readings, strict=True):
            readings.append(Curve(f"{wire}, V {run}", time, reading, color, dash, width))
    return [*panels, SIGNALS["measured_temperature"].panel(readings)]


def stiffness_panels(fit: StiffnessFit) -> list[Panel]:
    """Return a panel of the sag in each trial, of the limb and of the fitted model."""
    sags = np.rad2deg(np.abs(fit.sags))
    trials = np.arange(1, len(sags) + 1)
    model = np.rad2deg(np.abs(fit.simulated_sags))
    curves = [
        Curve("limb, each trial", trials, sags, ROLLOUT_COLOR, marks=True),
        Curve(f"model, k = {fit.by_sag}", trials, model, PLAN_COLOR, "dashed"),
    ]
    ticks = {int(trial): str(trial) for trial in trials}
    return [Panel("sag (°)", curves, x_label="trial", from_zero=True, x_ticks=ticks)]


def damping_panels(fit: DampingFit) -> list[Panel]:
    """Return a panel of the first ring-down, its fitted sinusoid, and the model's decay."""
    measured = fit.measured[0]
    simulated = fit.simulated[0]
    times = measured.start + np.linspace(0, min(2.0, fit.time[-1] - measured.start), 400)
    # The model is released otherwise: draw its decay with the amplitude and offset of the limb.
    model = np.exp(-simulated.damping_ratio * simulated.natural_frequency * (times - times[0]))
    decay = np.rad2deg(measured.offset + measured.amplitude * model)
    drawn = (fit.time >= measured.start - 1.5) & (fit.time <= times[-1])
    curves = [
        Curve("limb", fit.time[drawn], np.rad2deg(fit.bend_angle[drawn]), ROLLOUT_COLOR),
        Curve("its sinusoid", times, np.rad2deg(measured(times)), NEUTRAL_COLOR),
        Curve(f"model's decay, σ = {fit.damping}", times, decay, PLAN_COLOR, "dashed"),
    ]
    return [SIGNALS["bend_angle"].panel(curves, height=230)]


def wire_panels(heat: HeatFit, force: ForceFit, color: str) -> list[Panel]:
    """Return panels of heat transfer over time, and of bend against wire temperature."""
    # Draw the fit of (6) and (7): readings, wire temperature and bend over time.
    angles = np.rad2deg(heat.recorded_angle)
    fitted = np.rad2deg(heat.bend_angle)
    readings = [
        Curve("limb, V", heat.time, heat.recorded_temperature, color),
        Curve("fit, V", heat.time, heat.measured_temperature, PLAN_COLOR, "dashed"),
        Curve("fit, T", heat.time, heat.wire_temperature, NEUTRAL_COLOR),
    ]
    bend = [
        Curve("limb", heat.time, angles, ROLLOUT_COLOR),
        Curve("φ = (T − T0) / b", heat.time, fitted, PLAN_COLOR, "dashed"),
    ]
    # Draw the fit of (4): a line through the equilibria.
    temperatures = np.array([heat.ambient, heat.wire_temperature.max()])
    slope = np.mean(force.bend_angle / (force.wire_temperature - heat.ambient) / force.ratios)
    line = np.rad2deg(slope * force.beta.value * (temperatures - heat.ambient))
    equilibria = np.rad2deg(force.bend_angle)
    over_temperature = [
        Curve("recording", heat.wire_temperature, angles, REFERENCE_COLOR, width=1.0),
        Curve("equilibria", force.wire_temperature, equilibria, color, width=2.0, marks=True),
        Curve(f"β = {force.beta}", temperatures, line, PLAN_COLOR, "dashed"),
    ]
    return [
        SIGNALS["measured_temperature"].panel(readings),
        SIGNALS["bend_angle"].panel(bend, height=230),
        SIGNALS["bend_angle"].panel(over_temperature, x_label="simulated wire temperature T (°C)"),
    ]
