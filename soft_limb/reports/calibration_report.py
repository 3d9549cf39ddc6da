"""A calibration, or its validation, as one HTML page, with every fit over its data."""

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
from soft_limb.results.summaries import ranked, validation_summary

_MEANING = {
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


Samples = tuple[str, np.ndarray, np.ndarray, np.ndarray]  # name, times, φ (F, K) in rad, V (W, K)


def write_report(
    calibration: Calibration, path: str | Path, data: Mapping[str, str | Path] | None = None
) -> None:
    """Write one HTML page: verdict, what to do next, result, and every fit over its data.

    Args:
        path: path of the page.
        data: files that the page links to, by what they are.
    """
    sources = sorted({source for group in calibration.sources.values() for source in group})
    parts: list[page.Part] = [page.verdict(calibration.verdict)]
    to_do, kept = ranked(calibration), calibration.as_described
    if calibration.next_recording:
        to_do.append(f"next recording: {calibration.next_recording}")
    if to_do:
        parts.append(page.section("What to do next", page.items(to_do)))
    if validation := calibration.validation:
        judged = calibration.prediction.parts if calibration.prediction else []
        what = "The duty of a recording that was not used in any fit, simulated open loop"
        if len(judged) > 1:
            what = (
                f"The duties of {len(judged)} recordings, none of which was used in the fit that "
                "predicts it, simulated open loop and shown one after the other"
            )
        said = f"{what}. {validation_summary(validation).line()}."
        shown = validation_panels(validation)
        parts.append(_section("Validation, Sec. V-D and Fig. 4", said, shown))
    parameters = [
        page.paragraph(f"From recordings of: {', '.join(sources)}."),
        parameter_table(calibration),
        *([page.paragraph(f"As described: {', '.join(kept)}.")] if kept else []),
    ]
    parts.append(page.section("Parameters", *parameters))
    if calibration.prediction:
        parts += _prediction(calibration.prediction, calibration.parameters.wire_names)
    if stiffness := calibration.stiffness:
        said = f"The correction factor of (9) is {stiffness.factor_in_words}."
        parts.append(_section("Spring constant, Sec. V-A", said, stiffness_panels(stiffness)))
    if damping := calibration.damping:
        said, title = _compare_decay(damping), "Damping, Sec. V-B and Algorithm 1"
        parts.append(_section(title, said, damping_panels(damping)))
    colors = wire_colors(len(calibration.heat))
    for heat, force, color in zip(calibration.heat, calibration.force, colors, strict=True):
        said, title = _heat_in_words(heat), f"The {heat.wire} wire, Sec. V-C"
        parts.append(_section(title, said, wire_panels(heat, force, color)))
    record = calibration.parameters.calibration
    made = record.provenance if record else None
    page.write_page(path, "Calibration of a limb", parts, made, data)


def write_validation_report(
    validation: Validation, path: str | Path, data: Mapping[str, str | Path]
) -> None:
    """Write one HTML page on how a calibrated limb predicts a recording; see `write_report`."""
    parts: list[page.Part] = [
        page.verdict(validation.verdict),
        page.paragraph(f"{validation_summary(validation).line()}."),
        page.chart(validation_panels(validation), "Limb and model for the same duty"),
    ]
    made = validation.simulation.provenance
    page.write_page(path, "Validation of a calibrated limb", parts, made, data)


def _prediction(prediction: Prediction, wire_names: list[str]) -> list[page.Part]:
    rows = [
        [
            f"{candidate.name}{' *' if candidate is prediction.best else ''}",
            f"{np.rad2deg(candidate.bend_error):.2f}",
            f"{candidate.temperature_error:.1f}" if prediction.fit.measures_heat else "",
        ]
        for candidate in prediction.candidates
    ]
    table = page.table(
        ["law", "bend, °", "V, °C"],
        rows,
        f"Mean errors of open-loop predictions, judged by {prediction.judges}. {prediction.choice}",
    )
    parts: list[page.Part] = [page.section("Laws of the wires", table)]
    for number, predicted in enumerate(prediction.fit.predicted, 1):
        title = f"Recording {number} of {len(prediction.fit.predicted)} as fitted"
        said = f"{predicted.run.source}: bend within {np.rad2deg(predicted.bend_error):.2f}°"
        if predicted.run.is_read:
            said += f", V within {predicted.temperature_error:.1f} °C"
        said += " on average."
        parts.append(_section(title, said, predicted_panels(predicted, wire_names)))
    return parts


def parameter_table(calibration: Calibration) -> Markup:
    """The calibrated quantities with their standard errors, as part of a page."""
    rows = [
        [name, str(estimate), _MEANING.get(name.split(".")[-1], "")]
        for name, estimate in calibration.estimates.items()
    ]
    return page.table(["parameter", "value ± standard error", "meaning"], rows)


def _compare_decay(fit: DampingFit) -> str:
    limb, model = fit.measured[0], fit.simulated[0]
    return (
        "Damped sinusoids fitted to the limb and to its model, whose damping constant makes both "
        f"decay alike: the limb at {limb.frequency:.2f} Hz with ζ = {limb.damping_ratio:.3f}, the "
        f"model at {model.frequency:.2f} Hz with ζ = {model.damping_ratio:.3f}."
    )


def _heat_in_words(fit: HeatFit) -> str:
    delay = f", delay {fit.delay}" if fit.delay else ""
    return (
        f"a1 = {fit.a1}, a2 = {fit.a2}, a3 = {fit.a3}{delay}; V within "
        f"{fit.temperature_residual:.1f} °C and φ within {np.rad2deg(fit.angle_residual):.1f}° "
        "(root mean square)."
    )


def _section(title: str, text: str, shown: list[Panel]) -> page.Section:
    return page.section(title, page.paragraph(text), page.chart(shown, title))


def validation_panels(validation: Validation) -> list[Panel]:
    """Fig. 4: the calibrated model against the limb, for the same duty."""
    recording, simulation = validation.recording, validation.simulation
    names = recording.parameters.wire_names
    runs = [
        (name, run.time, run.bend_angle, run.measured_temperature)
        for name, run in (("limb", recording), ("model", simulation))
    ]
    wanted = None if recording.reference is None else np.rad2deg(recording.reference)
    colors = wire_colors(len(names))
    duties = [
        Curve(name, recording.time, duty, color, width=1.0)
        for name, duty, color in zip(names, recording.duty, colors, strict=True)
    ]
    return [*_against_model(runs, names, wanted), SIGNALS["duty"].panel(duties)]


def predicted_panels(predicted: Predicted, wire_names: Sequence[str]) -> list[Panel]:
    """A recording and its open-loop simulation by the fitted law."""
    run = predicted.run
    runs = [
        ("limb", run.times, run.bend.T, run.temperature.T),
        ("law", run.times, predicted.bend.T, predicted.temperature.T),
    ]
    return _against_model(runs, wire_names)


def _against_model(
    runs: list[Samples], wire_names: Sequence[str], wanted: np.ndarray | None = None
) -> list[Panel]:
    """Bends and readings of a limb, and dashed of its model; with set points (F, K), degrees."""
    panels, readings, colors = [], [], wire_colors(len(wire_names))
    styles = ((ROLLOUT_COLOR, "solid", 1.0), (PLAN_COLOR, "dashed", 1.75))
    for bend, suffix in enumerate(["_e2", "_e3"] if len(runs[0][2]) == 2 else [""]):
        curves = [
            Curve(run, time, np.rad2deg(angles[bend]), *style)
            for (run, time, angles, _), style in zip(runs, styles, strict=True)
        ]
        if wanted is not None:
            point = Curve("set point", runs[0][1], wanted[bend], REFERENCE_COLOR, width=1.0)
            curves.insert(0, point)
        panels.append(SIGNALS["bend_angle"].panel(curves, suffix))
    for (run, time, _, heats), (_, dash, width) in zip(runs, styles, strict=True):
        for wire, color, heat in zip(wire_names, colors, heats, strict=True):
            readings.append(Curve(f"{wire}, V {run}", time, heat, color, dash, width))
    return [*panels, SIGNALS["measured_temperature"].panel(readings)]


def stiffness_panels(fit: StiffnessFit) -> list[Panel]:
    """The sag of each trial, and that of the fitted limb."""
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
    """The first ring-down's sinusoid, and the model's decay with its phase and offset."""
    measured, simulated = fit.measured[0], fit.simulated[0]
    span = measured.start + np.linspace(0, min(2.0, fit.time[-1] - measured.start), 400)
    # The model's fit has another release: it is drawn with the limb's phase and offset.
    model = np.exp(-simulated.damping_ratio * simulated.natural_frequency * (span - span[0]))
    decay = np.rad2deg(measured.offset + measured.amplitude * model)
    shown = (fit.time >= measured.start - 1.5) & (fit.time <= span[-1])
    curves = [
        Curve("limb", fit.time[shown], np.rad2deg(fit.bend_angle[shown]), ROLLOUT_COLOR),
        Curve("its sinusoid", span, np.rad2deg(measured(span)), NEUTRAL_COLOR),
        Curve(f"model's decay, σ = {fit.damping}", span, decay, PLAN_COLOR, "dashed"),
    ]
    return [SIGNALS["bend_angle"].panel(curves, height=230)]


def wire_panels(heat: HeatFit, force: ForceFit, color: str) -> list[Panel]:
    """Heat transfer over time, and bend against wire temperature."""
    angles, fitted = np.rad2deg(heat.recorded_angle), np.rad2deg(heat.bend_angle)
    readings = [
        Curve("limb, V", heat.time, heat.recorded_temperature, color),
        Curve("fit, V", heat.time, heat.measured_temperature, PLAN_COLOR, "dashed"),
        Curve("fit, T", heat.time, heat.wire_temperature, NEUTRAL_COLOR),
    ]
    bend = [
        Curve("limb", heat.time, angles, ROLLOUT_COLOR),
        Curve("φ = (T − T0) / b", heat.time, fitted, PLAN_COLOR, "dashed"),
    ]
    span = np.array([heat.ambient, heat.wire_temperature.max()])
    slope = np.mean(force.bend_angle / (force.wire_temperature - heat.ambient) / force.ratios)
    line = np.rad2deg(slope * force.beta.value * (span - heat.ambient))
    equilibria = np.rad2deg(force.bend_angle)
    over_heat = [
        Curve("recording", heat.wire_temperature, angles, REFERENCE_COLOR, width=1.0),
        Curve("equilibria", force.wire_temperature, equilibria, color, width=2.0, marks=True),
        Curve(f"β = {force.beta}", span, line, PLAN_COLOR, "dashed"),
    ]
    return [
        SIGNALS["measured_temperature"].panel(readings),
        SIGNALS["bend_angle"].panel(bend, height=230),
        SIGNALS["bend_angle"].panel(over_heat, x_label="simulated wire temperature T (°C)"),
    ]
