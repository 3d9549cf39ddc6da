"""A calibration to look at: every fit drawn over its data, in one HTML page."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from calibration.calibrate import Calibration
from calibration.damping import DampingFit
from calibration.force import ForceFit
from calibration.heat import HeatFit
from calibration.stiffness import StiffnessFit
from calibration.validation import Validation
from limb_systems.output import write_atomically
from limb_systems.views import page
from limb_systems.views.figure import Figure
from limb_systems.views.plots import (
    LEFT_RIGHT_COLORS,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    WIDTH,
    dress,
)

_MEANING = {
    "ambient_temperature": "T0",
    "stiffness": "k, Sec. V-A",
    "damping": "σ, Sec. V-B",
    "a1": "cooling (6), Sec. V-C1",
    "a2": "heating (6), Sec. V-C1",
    "a3": "thermocouple's lag (7), Sec. V-C1",
    "beta": "torque per degree (4), Sec. V-C2",
}


def calibration_summary(calibration: Calibration) -> str:
    """What was calibrated and how good it is, in lines of text."""
    lines = [f"{name:<22}{estimate}" for name, estimate in calibration.estimates.items()]
    if calibration.stiffness:
        lines.append(f"{'correction factor λ':<22}{calibration.stiffness.correction_factor:.3f}")
    if calibration.validation:
        lines.append(f"{'validation':<22}{validation_summary(calibration.validation)}")
    return "\n".join(lines + [f"note: {remark}" for remark in calibration.remarks])


def validation_summary(validation: Validation) -> str:
    """The errors of a validation in one line."""
    degrees = np.rad2deg([validation.mean, validation.median, validation.percentile_90])
    return (
        "|φ - φ_sim|: mean {:.2f}°, median {:.2f}°, 90th percentile {:.2f}°; ".format(*degrees)
        + f"|V - V_sim|: mean {validation.temperature_mean:.1f} °C"
    )


def calibration_facts(calibration: Calibration) -> dict[str, Any]:
    """What `calibration_summary` says, for programs."""
    stiffness, validation = calibration.stiffness, calibration.validation
    return {
        "estimates": {
            name: dataclasses.asdict(estimate) for name, estimate in calibration.estimates.items()
        },
        "correction_factor": stiffness.correction_factor if stiffness else None,
        "validation": validation_facts(validation) if validation else None,
        "remarks": calibration.remarks,
    }


def validation_facts(validation: Validation) -> dict[str, float]:
    """What `validation_summary` says, for programs: numbers by names that carry the unit."""
    return {
        "bend_angle_mean_deg": math.degrees(validation.mean),
        "bend_angle_median_deg": math.degrees(validation.median),
        "bend_angle_percentile_90_deg": math.degrees(validation.percentile_90),
        "temperature_mean_c": validation.temperature_mean,
    }


def save_parameters(calibration: Calibration, path: str | Path) -> None:
    """Writes the calibrated limb as YAML, with the uncertainties in comments."""
    lines = ["# A calibrated limb; value ± standard error:"]
    lines += [f"#   {name}: {estimate}" for name, estimate in calibration.estimates.items()]
    if calibration.validation:
        lines.append(f"# Validation, open loop: {validation_summary(calibration.validation)}")
    for kind, sources in calibration.sources.items():
        lines.append(f"# {len(sources)} of {kind}: {', '.join(sorted(set(sources)))}")
    text = "\n".join(line.replace("\n", " ") for line in lines)
    write_atomically(path, f"{text}\n{calibration.parameters.to_yaml()}")


def write_report(calibration: Calibration, path: str | Path) -> None:
    """Writes one HTML page, with all pictures in it."""
    sources = sorted({source for group in calibration.sources.values() for source in group})
    parts = [page.paragraph(f"From recordings of: {', '.join(sources)}.")]
    if calibration.validation:
        parts.append(page.paragraph(f"{validation_summary(calibration.validation)}."))
    parts.append(parameter_table(calibration))
    if calibration.remarks:
        parts.append(page.section("What the recordings lack", page.items(calibration.remarks)))
    if calibration.validation:
        parts.append(
            _section(
                "Validation, Sec. V-D and Fig. 4",
                plot_validation(calibration.validation),
                "The duty of a recording that was not used in any fit, simulated open loop.",
            )
        )
    if calibration.stiffness:
        parts.append(
            _section(
                "Spring constant, Sec. V-A",
                plot_stiffness(calibration.stiffness),
                f"The correction factor of (9) comes to λ = "
                f"{calibration.stiffness.correction_factor:.3f}.",
            )
        )
    if calibration.damping:
        parts.append(
            _section(
                "Damping, Sec. V-B and Algorithm 1",
                plot_damping(calibration.damping),
                _compare_decay(calibration.damping),
            )
        )
    for index, fits in enumerate(
        zip(calibration.heat, calibration.heat_compared, calibration.force, strict=True)
    ):
        heat, compared, _ = fits
        parts.append(
            _section(
                f"The {heat.wire} wire, Sec. V-C",
                plot_wire(*fits, LEFT_RIGHT_COLORS[index]),
                _compare(heat, compared),
            )
        )
    page.write_page(path, "Calibration of a limb", parts)


def parameter_table(calibration: Calibration) -> str:
    """The calibrated quantities with their standard errors, as part of a page."""
    rows = [
        [name, str(estimate), _MEANING[name.split(".")[-1]]]
        for name, estimate in calibration.estimates.items()
    ]
    return page.table(["parameter", "value ± standard error", "meaning"], rows)


def plot_validation(validation: Validation) -> Figure:
    """Fig. 4: the calibrated model against the limb, for the same duty."""
    recording, simulation = validation.recording, validation.simulation
    figure = Figure(figsize=(WIDTH, 6.5), layout="constrained")
    bend, heat, duty = figure.subplots(3, 1, sharex=True, height_ratios=[1.6, 1.3, 0.8])
    if recording.reference is not None:
        bend.plot(
            recording.time,
            np.rad2deg(recording.reference[0]),
            color=REFERENCE_COLOR,
            linewidth=0.8,
            label="set point",
        )
    bend.plot(
        recording.time,
        np.rad2deg(recording.bend_angle[0]),
        color=ROLLOUT_COLOR,
        lw=0.8,
        label="limb",
    )
    bend.plot(
        simulation.time,
        np.rad2deg(simulation.bend_angle[0]),
        color=PLAN_COLOR,
        linestyle="--",
        label="model",
    )
    bend.set_ylabel("bend angle (°)")
    wires = list(zip(LEFT_RIGHT_COLORS, recording.parameters.wire_names, strict=True))
    for what, source, style, width in (
        ("limb", recording, "-", 0.8),
        ("model", simulation, "--", None),
    ):
        for index, (color, name) in enumerate(wires):
            measured = source.measured_temperature[index]
            heat.plot(source.time, measured, style, color=color, lw=width, label=f"{name}, {what}")
    for index, (color, name) in enumerate(wires):
        duty.plot(recording.time, recording.duty[index], color=color, lw=0.8, label=name)
    heat.set_ylabel("measured\ntemperature (°C)")
    duty.set_ylabel("duty")
    duty.set_xlabel("time (s)")
    return _dress(figure)


def plot_stiffness(fit: StiffnessFit) -> Figure:
    """The sag of each trial, and that of the fitted limb."""
    figure = Figure(figsize=(WIDTH, 2.6), layout="constrained")
    axis = figure.subplots()
    sags = np.rad2deg(np.abs(fit.sags))
    axis.plot(np.arange(1, len(sags) + 1), sags, "o", color=ROLLOUT_COLOR, label="limb, each trial")
    axis.axhline(
        np.rad2deg(abs(fit.simulated_sag)),
        color=PLAN_COLOR,
        linestyle="--",
        label=f"model, k = {fit.stiffness}",
    )
    axis.set_xticks(np.arange(1, len(sags) + 1))
    axis.set_ylim(0, None)
    axis.set_xlabel("trial")
    axis.set_ylabel("sag (°)")
    return _dress(figure)


def plot_damping(fit: DampingFit) -> Figure:
    """The first ring-down's sinusoid, and that of the model; recordings in its offset."""
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    axis = figure.subplots()
    measured, simulated = fit.measured[0], fit.simulated[0]
    axis.plot(fit.time, np.rad2deg(fit.bend_angle), ".", color=ROLLOUT_COLOR, ms=3, label="limb")
    span = measured.start + np.linspace(0, min(2.0, fit.time[-1] - measured.start), 400)
    axis.plot(span, np.rad2deg(measured(span)), color="k", lw=0.8, label="its sinusoid")
    # The model's fit starts at a release of its own: drawn with the limb's phase and offset.
    model = np.exp(-simulated.damping_ratio * simulated.natural_frequency * (span - span[0]))
    axis.plot(
        span,
        np.rad2deg(measured.offset + measured.amplitude * model),
        color=PLAN_COLOR,
        linestyle="--",
        label=f"model's decay, σ = {fit.damping}",
    )
    axis.set_xlim(max(0.0, measured.start - 1.5), span[-1])
    axis.set_xlabel("time (s)")
    axis.set_ylabel("bend angle (°)")
    return _dress(figure)


def plot_wire(heat: HeatFit, compared: HeatFit, force: ForceFit, color: str) -> Figure:
    """Heat transfer over time by both methods, and bend against wire temperature."""
    figure = Figure(figsize=(WIDTH, 7.5), layout="constrained")
    (figure_top,), (figure_bottom,) = figure.subfigures(2, 1, squeeze=False, height_ratios=[2, 1.2])
    temperature, bend = figure_top.subplots(2, 1, sharex=True)
    temperature.plot(heat.time, heat.recorded_temperature, color=color, lw=0.8, label="limb, V")
    for fit, style in ((heat, "--"), (compared, ":")):
        temperature.plot(
            fit.time,
            fit.measured_temperature,
            "k",
            linestyle=style,
            label=f"fit from {fit.method}, V",
        )
    temperature.plot(
        heat.time, heat.wire_temperature, color="0.6", lw=0.8, label=f"fit from {heat.method}, T"
    )
    temperature.set_ylabel("temperature (°C)")
    bend.plot(heat.time, np.rad2deg(heat.recorded_angle), color=ROLLOUT_COLOR, lw=0.8, label="limb")
    by_bend = heat if heat.method == "bend" else compared
    assert by_bend.bend_angle is not None
    bend.plot(
        by_bend.time,
        np.rad2deg(by_bend.bend_angle),
        "k--",
        lw=1,
        label=r"$\varphi = (T - T_0) / b$",
    )
    bend.set_ylabel("bend angle (°)")
    bend.set_xlabel("time (s)")

    axis = figure_bottom.subplots()
    axis.plot(
        heat.wire_temperature,
        np.rad2deg(heat.recorded_angle),
        color="0.8",
        lw=0.6,
        label="recording",
    )
    axis.plot(
        force.wire_temperature, np.rad2deg(force.bend_angle), "o", color=color, label="equilibria"
    )
    span = np.array([heat.ambient, heat.wire_temperature.max()])
    slope = np.mean(force.bend_angle / (force.wire_temperature - heat.ambient) / force.ratios)
    axis.plot(
        span,
        np.rad2deg(slope * force.beta.value * (span - heat.ambient)),
        "k--",
        label=f"β = {force.beta}",
    )
    axis.set_xlabel("simulated wire temperature T (°C)")
    axis.set_ylabel("bend angle (°)")
    return _dress(figure)


def _dress(figure: Figure) -> Figure:
    for axis in figure.axes:
        dress(axis)
    return figure


def _compare_decay(fit: DampingFit) -> str:
    limb, model = fit.measured[0], fit.simulated[0]
    return (
        "Damped sinusoids fitted to the limb and to its model, whose damping constant makes both "
        f"decay alike: the limb at {limb.frequency:.2f} Hz with ζ = {limb.damping_ratio:.3f}, the "
        f"model at {model.frequency:.2f} Hz with ζ = {model.damping_ratio:.3f}."
    )


def _compare(heat: HeatFit, compared: HeatFit) -> str:
    by_method = {fit.method: fit for fit in (heat, compared)}
    bend, temperature = by_method["bend"], by_method["temperature"]
    assert bend.angle_residual is not None
    return (
        f"Used: the fit from {heat.method}. From bend: a1 = {bend.a1}, a2 = {bend.a2}, a3 = "
        f"{bend.a3}, V within {bend.temperature_residual:.1f} °C and φ within "
        f"{np.rad2deg(bend.angle_residual):.1f}° (root mean square). From temperature alone: a1 = "
        f"{temperature.a1}, a2 = {temperature.a2}, a3 = {temperature.a3}, delay "
        f"{temperature.delay}, V within {temperature.temperature_residual:.1f} °C."
    )


def _section(title: str, figure: Figure, text: str) -> str:
    return page.section(title, page.paragraph(text), page.picture(figure, title))
