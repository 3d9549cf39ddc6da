"""A calibration to look at: every fit drawn over its data, in one HTML page."""

import base64
import dataclasses
import html
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration.calibrate import Calibration
from calibration.damping import DampingFit
from calibration.force import ForceFit
from calibration.heat import HeatFit
from calibration.stiffness import StiffnessFit
from calibration.validation import Validation
from limb_systems.files import write_atomically
from limb_systems.plots import LEFT_RIGHT_COLORS, PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 60rem; margin: 0 auto;
       padding: 1rem; }
figure { margin: 1rem 0; overflow-x: auto; }
img { width: 100%; min-width: 40rem; height: auto; }
.table { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: .25rem .75rem .25rem 0; border-bottom: 1px solid #ddd; }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
h2 { margin-top: 2.5rem; } li { margin: .3rem 0; }
@media (max-width: 40rem) { table { font-size: .85rem; } td.number { white-space: normal; } }
@media print { h2 { break-after: avoid; } figure { break-inside: avoid; } img { min-width: 0; } }
"""

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
    title = "Calibration of a limb"
    sources = sorted({source for group in calibration.sources.values() for source in group})
    parts = [f"<h1>{title}</h1>", f"<p>From recordings of: {html.escape(', '.join(sources))}.</p>"]
    if calibration.validation:
        parts.append(f"<p>{html.escape(validation_summary(calibration.validation))}.</p>")
    parts.append(_table(calibration))
    if calibration.remarks:
        items = "".join(f"<li>{html.escape(remark)}</li>" for remark in calibration.remarks)
        parts.append(f"<h2>What the recordings lack</h2><ul>{items}</ul>")
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
                "Damped sinusoids fitted to the limb and to its model, whose damping constant "
                "makes both decay alike.",
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
    body = "\n".join(parts)
    write_atomically(
        path,
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head><body>{body}</body></html>\n",
    )


def plot_validation(validation: Validation) -> Figure:
    """Fig. 4: the calibrated model against the limb, for the same duty."""
    recording, simulation = validation.recording, validation.simulation
    figure = Figure(figsize=(9, 7), layout="constrained")
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
    for index, color in enumerate(LEFT_RIGHT_COLORS):
        name = recording.parameters.wire_names[index]
        measured = recording.measured_temperature[index]
        heat.plot(recording.time, measured, color=color, lw=0.8, label=f"{name}, limb")
        heat.plot(
            simulation.time,
            simulation.measured_temperature[index],
            color=color,
            linestyle="--",
            label=f"{name}, model",
        )
        duty.plot(recording.time, recording.duty[index], color=color, lw=0.8, label=name)
    heat.set_ylabel("measured\ntemperature (°C)")
    duty.set_ylabel("duty")
    duty.set_xlabel("time (s)")
    return _dress(figure)


def plot_stiffness(fit: StiffnessFit) -> Figure:
    """The sag of each trial, and that of the fitted limb."""
    figure = Figure(figsize=(9, 2.6), layout="constrained")
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
    figure = Figure(figsize=(9, 3), layout="constrained")
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
    axis.set_title(
        f"limb {measured.frequency:.2f} Hz, ζ {measured.damping_ratio:.3f}; "
        f"model {simulated.frequency:.2f} Hz, ζ {simulated.damping_ratio:.3f}",
        fontsize=10,
    )
    return _dress(figure)


def plot_wire(heat: HeatFit, compared: HeatFit, force: ForceFit, color: str) -> Figure:
    """Heat transfer over time by both methods, and bend against wire temperature."""
    figure = Figure(figsize=(9, 7.5), layout="constrained")
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
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    return figure


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


def _table(calibration: Calibration) -> str:
    rows = "".join(
        f"<tr><td>{name}</td><td class=number>{html.escape(str(estimate))}</td>"
        f"<td>{_MEANING[name.split('.')[-1]]}</td></tr>"
        for name, estimate in calibration.estimates.items()
    )
    return (
        '<div class="table"><table><tr><th>parameter</th><th>value ± standard error</th>'
        f"<th>meaning</th></tr>{rows}</table></div>"
    )


def _section(title: str, figure: Figure, text: str) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    picture = base64.b64encode(buffer.getvalue()).decode()
    return (
        f"<h2>{html.escape(title)}</h2><p>{html.escape(text)}</p><figure>"
        f'<img alt="{html.escape(title)}" src="data:image/png;base64,{picture}"></figure>'
    )
