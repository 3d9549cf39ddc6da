"""Every fit over its data, as panels."""

from collections.abc import Sequence

import numpy as np

from calibration.prediction.law_fit import Predicted
from calibration.section_v.mechanics import DampingFit, StiffnessFit
from calibration.section_v.wires import ForceFit, HeatFit
from calibration.validation import Validation
from limb_systems.views.colors import (
    NEUTRAL_COLOR,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.panels import SIGNALS, Curve, Panel

Samples = tuple[str, np.ndarray, np.ndarray, np.ndarray]  # name, times, φ (F, K) in rad, V (W, K)


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
    model = np.full(len(sags), np.rad2deg(abs(fit.simulated_sag)))
    curves = [
        Curve("limb, each trial", trials, sags, ROLLOUT_COLOR, marks=True),
        Curve(f"model, k = {fit.stiffness}", trials, model, PLAN_COLOR, "dashed"),
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
