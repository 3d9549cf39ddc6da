"""A gait as one HTML page."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from limb_systems.files.gait import Gait, GaitVariation
from limb_systems.views.panels import motion_panels
from limb_systems.views.replay_page import replay_page
from soft_limb.reports import page
from soft_limb.results.summaries import gait_summary


def gait_verdict(gait: Gait) -> str:
    """How far and how fast a gait goes, and whether it was checked."""
    said = (
        f"Strides of {1e3 * gait.stride:.1f} mm in {gait.period:.1f} s, {1e3 * gait.speed:.2f} "
        f"mm/s, with wires up to {gait.wire_temperature.max():.0f} °C."
    )
    if failure := gait.check.failure():
        return f"{said} Not to be used: {failure}"
    strides, spread = gait.check.simulation.strides, gait.check.spread
    said += (
        f" Checked: simulated with contact over {len(strides)} cycles, strides are "
        f"{min(strides):.1%} to {max(strides):.1%} of the planned one."
    )
    if fallen := sum(bool(variation.fall) for variation in spread):
        said += (
            f" With other friction or parameters {fallen} of {len(spread)} fall; a gait of more "
            "steadiness falls less and is slower."
        )
    return said


def gait_report(gait: Gait, path: str | Path, data: Mapping[str, str | Path] | None = None) -> None:
    """Write one HTML page: verdict, picture, replay, the cycle's signals, check, and the robot.

    Args:
        path: path of the page.
        data: files that the page links to, by what they are.
    """
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.walk import draw_walk

    check, what = gait.check, "The robot's side at six moments, its feet and its wires' heat"
    parts: list[page.Part] = [
        page.verdict(gait_verdict(gait)),
        page.picture(draw_walk(gait), what),
        page.section("Replay", page.frame(replay_page(gait), "the robot in 3D")),
    ]
    if not check.is_missing:
        nominal = dataclasses.replace(check.simulation, what="as planned")
        parts.append(
            page.section(
                "Check",
                page.table(
                    ["robot or ground", "mean stride, %", "least, %", "most, %", "T, °C", "fall"],
                    [_row(variation) for variation in [nominal, *check.spread]],
                    "Strides in simulation with contact as shares of the planned one, the highest "
                    "temperature of any wire, and how it fell, if it did.",
                ),
            )
        )
    cycle = page.chart(motion_panels(gait), "Feet, body, forces, bends and heat")
    parts += [
        page.section("The cycle", cycle),
        page.section("How it was found", page.facts(gait_summary(gait))),
        page.section("Robot", page.preformatted(gait.robot.to_yaml())),
    ]
    page.write_page(path, "Gait of a robot", parts, gait.provenance, data)


def _row(variation: GaitVariation) -> list[str]:
    strides = 100 * np.array(variation.strides)
    shares = [strides.mean(), strides.min(), strides.max()] if len(strides) else []
    heat = variation.highest_temperature
    return [
        variation.what,
        *([f"{share:.1f}" for share in shares] or [""] * 3),
        f"{heat:.0f}" if np.isfinite(heat) else "",
        variation.fall,
    ]
