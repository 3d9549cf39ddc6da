"""Fig. 4 as a picture."""

from typing import TYPE_CHECKING

import numpy as np

from calibration.validation import Validation
from limb_systems.views.colors import (
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)

if TYPE_CHECKING:
    from limb_systems.views.figure import Figure


def plot_validation(validation: Validation) -> "Figure":
    """Fig. 4: the calibrated model against the limb, for the same duty."""
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.figure import Figure
    from limb_systems.views.plots import WIDTH, dress

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
    for axis in figure.axes:
        dress(axis)
    return figure
