"""A calibration, or its validation, as one HTML page."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from calibration.calibrate import Calibration
from calibration.prediction.selection import Prediction
from calibration.section_v.mechanics import DampingFit
from calibration.section_v.wires import HeatFit
from calibration.validation import Validation
from limb_systems.views.colors import wire_colors
from limb_systems.views.panels import Panel
from soft_limb.reports import calibration_panels as panels
from soft_limb.reports import page
from soft_limb.results.summaries import ranked, validation_summary

if TYPE_CHECKING:
    from limb_systems.views.plots import Figure

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
    "rest_angle": "bend angle at rest, cold",
    "rest_angle_e3": "the same towards E3",
    "angle": "wire's place around the axis, from E2 towards E3",
    "roll": "angle by which the bend sensor is turned about the axis",
    "stiffness_ratio": "stiffness against bends towards E3, as a share of k",
    "stiffening": "share added to k at 45°",
    "shift": "Δ of the rest angle's memory",
    "rate": "λ of the rest angle's memory",
}


def plot_validation(validation: Validation) -> "Figure":
    """Fig. 4 as a picture: the calibrated model against the limb, for the same duty."""
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.plots import draw

    return draw(panels.validation_panels(validation))


def write_report(
    calibration: Calibration, path: str | Path, data: Mapping[str, str | Path] | None = None
) -> None:
    """Writes one HTML page: verdict, what to do next, result, and every fit over its data.

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
    if calibration.validation:
        parts.append(
            _section(
                "Validation, Sec. V-D and Fig. 4",
                f"The duty of a recording that was not used in any fit, simulated open loop. "
                f"{validation_summary(calibration.validation).line()}.",
                panels.validation_panels(calibration.validation),
            )
        )
    parts.append(
        page.section(
            "Parameters",
            page.paragraph(f"From recordings of: {', '.join(sources)}."),
            parameter_table(calibration),
            *([page.paragraph(f"As described: {', '.join(kept)}.")] if kept else []),
        )
    )
    if calibration.prediction:
        parts += _prediction(calibration.prediction, calibration.parameters.wire_names)
    if calibration.stiffness:
        parts.append(
            _section(
                "Spring constant, Sec. V-A",
                f"The correction factor of (9) is {calibration.stiffness.factor_in_words}.",
                panels.stiffness_panels(calibration.stiffness),
            )
        )
    if calibration.damping:
        parts.append(
            _section(
                "Damping, Sec. V-B and Algorithm 1",
                _compare_decay(calibration.damping),
                panels.damping_panels(calibration.damping),
            )
        )
    colors = wire_colors(len(calibration.heat))
    for heat, force, color in zip(calibration.heat, calibration.force, colors, strict=True):
        parts.append(
            _section(
                f"The {heat.wire} wire, Sec. V-C",
                _heat_in_words(heat),
                panels.wire_panels(heat, force, color),
            )
        )
    record = calibration.parameters.calibration
    made = record.provenance if record else None
    page.write_page(path, "Calibration of a limb", parts, made, data)


def write_validation_report(
    validation: Validation, path: str | Path, data: Mapping[str, str | Path]
) -> None:
    """Writes one HTML page on how a calibrated limb predicts a recording; see `write_report`."""
    parts: list[page.Part] = [
        page.verdict(validation.verdict),
        page.paragraph(f"{validation_summary(validation).line()}."),
        page.chart(panels.validation_panels(validation), "Limb and model for the same duty"),
    ]
    made = validation.simulation.provenance
    page.write_page(path, "Validation of a calibrated limb", parts, made, data)


def _prediction(prediction: Prediction, wire_names: list[str]) -> list[page.Part]:
    rows = [
        [
            f"{candidate.name}{' *' if candidate is prediction.best else ''}",
            f"{np.rad2deg(candidate.bend_error):.2f}",
            f"{candidate.temperature_error:.1f}",
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
        parts.append(
            _section(
                title,
                f"{predicted.run.source}: bend within {np.rad2deg(predicted.bend_error):.2f}°, "
                f"V within {predicted.temperature_error:.1f} °C on average.",
                panels.predicted_panels(predicted, wire_names),
            )
        )
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
