"""Every fit over its data, as charts."""

import numpy as np
from bokeh.models import Model

from calibration.prediction.law_fit import Predicted
from calibration.section_v.damping import DampingFit
from calibration.section_v.force import ForceFit
from calibration.section_v.heat import HeatFit
from calibration.section_v.stiffness import StiffnessFit
from calibration.validation import Validation
from limb_systems.views.charts import DUTY_RANGE, NEUTRAL_COLOR, Curve, panel, stacked
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR, wire_colors


def validation_chart(validation: Validation) -> Model:
    """Fig. 4: the calibrated model against the limb, for the same duty."""
    recording, simulation = validation.recording, validation.simulation
    wires = list(
        zip(wire_colors(len(recording.duty)), recording.parameters.wire_names, strict=True)
    )
    limb, model = np.rad2deg(recording.bend_angle[0]), np.rad2deg(simulation.bend_angle[0])
    bend = [
        Curve("limb", recording.time, limb, ROLLOUT_COLOR),
        Curve("model", simulation.time, model, PLAN_COLOR, "dashed"),
    ]
    if recording.reference is not None:
        wanted = np.rad2deg(recording.reference[0])
        bend.insert(0, Curve("set point", recording.time, wanted, REFERENCE_COLOR))
    readings = [
        Curve(f"{name}, {what}", source.time, source.measured_temperature[index], color, dash)
        for what, source, dash in (("limb", recording, "solid"), ("model", simulation, "dashed"))
        for index, (color, name) in enumerate(wires)
    ]
    duties = [
        Curve(name, recording.time, recording.duty[index], color)
        for index, (color, name) in enumerate(wires)
    ]
    return stacked(
        [
            panel("bend angle (°)", bend, height=270),
            panel("measured temperature (°C)", readings, height=250),
            panel("duty", duties, height=190, y_range=DUTY_RANGE),
        ]
    )


def predicted_chart(predicted: Predicted, wire_names: list[str]) -> Model:
    """A recording and its open-loop simulation by the fitted law."""
    run = predicted.run
    bend = [
        Curve("limb", run.times, np.rad2deg(run.bend), ROLLOUT_COLOR),
        Curve("law", run.times, np.rad2deg(predicted.bend), PLAN_COLOR, "dashed"),
    ]
    colors = wire_colors(len(wire_names))
    readings = [
        Curve(f"{name}, {what}", run.times, reading, color, dash)
        for what, source, dash in (
            ("limb", run.temperature, "solid"),
            ("law", predicted.temperature, "dashed"),
        )
        for name, color, reading in zip(wire_names, colors, source.T, strict=True)
    ]
    return stacked(
        [panel("bend angle (°)", bend), panel("measured temperature (°C)", readings, height=250)]
    )


def stiffness_chart(fit: StiffnessFit) -> Model:
    """The sag of each trial, and that of the fitted limb."""
    sags = np.rad2deg(np.abs(fit.sags))
    trials = np.arange(1, len(sags) + 1)
    model = np.full(len(sags), np.rad2deg(abs(fit.simulated_sag)))
    curves = [
        Curve("limb, each trial", trials, sags, ROLLOUT_COLOR, marks=True),
        Curve(f"model, k = {fit.stiffness}", trials, model, PLAN_COLOR, "dashed"),
    ]
    ticks = {int(trial): str(trial) for trial in trials}
    return stacked([panel("sag (°)", curves, x_label="trial", from_zero=True, x_ticks=ticks)])


def damping_chart(fit: DampingFit) -> Model:
    """The first ring-down's sinusoid, and the model's decay with its phase and offset."""
    measured, simulated = fit.measured[0], fit.simulated[0]
    span = measured.start + np.linspace(0, min(2.0, fit.time[-1] - measured.start), 400)
    # The model's fit has another release: it is drawn with the limb's phase and offset.
    model = np.exp(-simulated.damping_ratio * simulated.natural_frequency * (span - span[0]))
    shown = (fit.time >= measured.start - 1.5) & (fit.time <= span[-1])
    curves = [
        Curve("limb", fit.time[shown], np.rad2deg(fit.bend_angle[shown]), ROLLOUT_COLOR),
        Curve("its sinusoid", span, np.rad2deg(measured(span)), NEUTRAL_COLOR),
        Curve(
            f"model's decay, σ = {fit.damping}",
            span,
            np.rad2deg(measured.offset + measured.amplitude * model),
            PLAN_COLOR,
            "dashed",
        ),
    ]
    return stacked([panel("bend angle (°)", curves)])


def wire_charts(heat: HeatFit, force: ForceFit, color: str) -> tuple[Model, Model]:
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
    over_time = stacked(
        [panel("temperature (°C)", readings, height=260), panel("bend angle (°)", bend)]
    )
    span = np.array([heat.ambient, heat.wire_temperature.max()])
    slope = np.mean(force.bend_angle / (force.wire_temperature - heat.ambient) / force.ratios)
    line = np.rad2deg(slope * force.beta.value * (span - heat.ambient))
    equilibria = np.rad2deg(force.bend_angle)
    curves = [
        Curve("recording", heat.wire_temperature, angles, REFERENCE_COLOR, width=1.0),
        Curve("equilibria", force.wire_temperature, equilibria, color, width=2.0, marks=True),
        Curve(f"β = {force.beta}", span, line, PLAN_COLOR, "dashed"),
    ]
    label = "simulated wire temperature T (°C)"
    return over_time, stacked([panel("bend angle (°)", curves, x_label=label, height=270)])
