"""Every fit drawn over its data."""

import numpy as np

from calibration.damping import DampingFit
from calibration.force import ForceFit
from calibration.heat import HeatFit
from calibration.prediction import Predicted
from calibration.stiffness import StiffnessFit
from calibration.validation import Validation
from limb_systems.views.colors import (
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.figure import Figure
from limb_systems.views.plots import WIDTH, dress


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
    wires = list(
        zip(wire_colors(len(recording.duty)), recording.parameters.wire_names, strict=True)
    )
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


def plot_predicted(predicted: Predicted) -> Figure:
    """A recording and its open-loop simulation by the fitted law."""
    course = predicted.course
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    bend, heat = figure.subplots(2, 1, sharex=True)
    bend.plot(course.times, np.rad2deg(course.bend), color=ROLLOUT_COLOR, lw=0.8, label="limb")
    bend.plot(
        course.times, np.rad2deg(predicted.bend), color=PLAN_COLOR, linestyle="--", label="law"
    )
    bend.set_ylabel("bend angle (°)")
    for color, measured, law in zip(
        wire_colors(course.temperature.shape[1]),
        course.temperature.T,
        predicted.temperature.T,
        strict=True,
    ):
        heat.plot(course.times, measured, color=color, lw=0.8)
        heat.plot(course.times, law, "--", color=color)
    heat.set_ylabel("measured\ntemperature (°C)")
    heat.set_xlabel("time (s)")
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
    axis.set_ylim(0, 1.15 * max(*sags, np.rad2deg(abs(fit.simulated_sag))))
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
    # The model's fit has another release: it is drawn with the limb's phase and offset.
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
