"""A gait as one HTML page."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from limb_systems.views.panels import motion_panels
from limb_systems.views.replay_page import replay_page
from soft_limb.reports import page
from walking.commands.gait_summaries import gait_summary, overheating_remark
from walking.gait import Gait, GaitVariation
from walking.gait_check import NOMINAL_IN_MUJOCO


def gait_verdict(gait: Gait) -> str:
    """Return a gait's motion, temperature and the result of its check, in words."""
    # Describe the motion.
    turn = np.rad2deg(gait.turn)
    cycle_noun = _cycle_noun(gait)
    goes = [] if gait.on_the_spot else [f"{cycle_noun} of {1e3 * gait.stride:.1f} mm"]
    paces = [] if gait.on_the_spot else [f"{1e3 * gait.speed:.2f} mm/s"]
    if abs(turn) > 1e-6:
        side = "left" if turn > 0 else "right"
        goes.append(f"turns of {abs(turn):.1f}° to the {side}")
        paces.append(f"{abs(turn) / gait.period:.2f} °/s")
    text = (
        f"{' and '.join(goes)} in {gait.period:.1f} s, {' and '.join(paces)}, with wires up to "
        f"{gait.wire_temperature.max():.0f} °C."
    )
    text = text[0].upper() + text[1:]

    # Describe the check.
    if failure := gait.check.failure():
        return f"{text} Not to be used: {failure}"
    simulation = gait.check.simulation
    num_cycles = len(simulation.strides)
    from_second = ", from the second on," * (num_cycles > 1)
    shares = simulation.settled_strides
    text += (
        f" Checked: simulated with contact over {num_cycles} cycle{'s' * (num_cycles > 1)}, "
        f"{cycle_noun}{from_second} are "
        f"{min(shares):.1%} to {max(shares):.1%} of the planned one"
    )
    if asides := simulation.settled_aside:
        text += f", and the robot goes or turns aside by at most {max(asides):.1%} of it"
    text += "."
    others = [each for each in gait.check.spread if each.what != NOMINAL_IN_MUJOCO]
    if fallen := sum(bool(variation.fall) for variation in others):
        remedy = "a smaller sticking_share" if gait.in_space else "more steadiness"
        text += (
            f" On other robots or ground {fallen} of {len(others)} fall; a gait of {remedy} falls "
            "less and is slower."
        )
    if hot := overheating_remark(gait):
        text += f" {hot[0].upper()}{hot[1:]}."
    return text


def gait_report(gait: Gait, path: str | Path, data: Mapping[str, str | Path] | None = None) -> None:
    """Write one HTML page: verdict, replay, the cycle's signals, check, and the robot.

    Args:
        path: path of the page.
        data: files that the page links to, by what they are.
    """
    check = gait.check
    height = 34 + max(0, len(gait.parameters.wire_names) - 4)  # of a replay and its caption, rem
    parts: list[page.Part] = [
        page.verdict(gait_verdict(gait)),
        page.section("Replay", page.frame(replay_page(gait), "the robot in 3D", height)),
    ]
    if not check.is_missing:
        nominal = dataclasses.replace(check.simulation, what="as planned")
        one = _cycle_noun(gait).removesuffix("s")
        names = ["robot or ground", f"mean {one}, %", "least, %", "most, %"]
        names += ["aside, %"] * gait.in_space + ["T, °C", "fall"]
        aside = ", the most that the robot goes or turns aside of it" * gait.in_space
        rows = [_variation_row(variation, gait.in_space) for variation in [nominal, *check.spread]]
        caption = (
            f"{one.capitalize()}s in simulation with contact as shares of the planned one{aside}, "
            "the highest temperature of any wire, and how it fell, if it did."
        )
        parts.append(page.section("Check", page.table(names, rows, caption)))
    cycle = page.chart(motion_panels(gait), "Feet, body, forces, bends and heat")
    parts += [
        page.section("The cycle", cycle),
        page.section("How it was found", page.facts(gait_summary(gait))),
        page.section("Robot", page.preformatted(gait.robot.to_yaml())),
    ]
    page.write_page(path, "Gait of a robot", parts, gait.provenance, data)


def _cycle_noun(gait: Gait) -> str:
    """Return the noun for a gait's cycles: strides, or turns on the spot."""
    return "turns" if gait.on_the_spot else "strides"


def _variation_row(variation: GaitVariation, in_space: bool) -> list[str]:
    strides = 100 * np.array(variation.strides)
    shares = [strides.mean(), strides.min(), strides.max()] if len(strides) else [np.nan] * 3
    if in_space:
        shares.append(100 * max(variation.aside, default=np.nan))
    heat = variation.highest_temperature
    return [
        variation.what,
        *(f"{share:.1f}" if np.isfinite(share) else "" for share in shares),
        f"{heat:.0f}" if np.isfinite(heat) else "",
        variation.fall,
    ]
