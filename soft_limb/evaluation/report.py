"""The page that has all of the evaluation in it."""

import collections
from collections.abc import Mapping, Sequence
from pathlib import Path

from limb_systems.views.panels import Panel
from limb_systems.views.plots import Figure
from soft_limb.evaluation.experiment import MOTIONS, Experiment
from soft_limb.evaluation.tables import (
    APPROACH_HEADER,
    DISTANCE_HEADER,
    DISTURBANCE_HEADER,
    TABLE_1_HEADER,
    Summary,
    approach_table,
    distance_table,
    disturbance_table,
    of_family,
    split_table,
    table_1,
)
from soft_limb.evaluation.ways import PAUSE
from soft_limb.reports import page

EMULATED = (
    "These limbs are emulated. The numbers say how the method fares on an emulation with physics "
    "that the model leaves out, and nothing of a real limb."
)


def write_report(
    path: str | Path,
    summaries: Sequence[Summary],
    experiment: Experiment,
    pictures: dict[str, tuple[Figure | list[Panel], str]],
    data: Mapping[str, Path],
) -> None:
    """Writes the page.

    Args:
        path: the HTML file.
        summaries: one for each limb.
        experiment: the limb that is shown.
        pictures: `figures` of it.
        data: files that the page links to, by what they are.
    """
    count = len(of_family(summaries))
    limbs = f"{count} emulated limbs" if count > 1 else "an emulated limb"
    parts: list[page.Part] = [
        page.paragraph(
            "Trajectory optimization for a thermally actuated soft planar limb, after Wertz, "
            f"Sabelhaus and Majidi: {limbs}, recorded, calibrated, taught, planned for and driven "
            "open loop and in closed loop. Planner, calibration and controllers know of a limb "
            "what its sensors tell."
        ),
        page.verdict(EMULATED),
        _distances(summaries),
        _table_1(summaries),
        *_disturbances(summaries),
        _approaches(summaries),
        _error_split(summaries),
    ]
    for drawn, text in pictures.values():
        heading, _, caption = text.partition(": ")
        shown = page.chart(drawn, text) if isinstance(drawn, list) else page.picture(drawn, text)
        caption = f"{caption[0].upper()}{caption[1:]}."
        parts.append(page.section(heading, page.paragraph(caption), shown))
    parts += [
        _what_was_done(summaries, experiment),
    ]
    title = "The paper reproduced, on emulated limbs"
    page.write_page(path, title, parts, summaries[0].provenance, data)


def _distances(summaries: Sequence[Summary]) -> page.Section:
    caption = (
        "Best within the limits: the best plan for the calibrated model, whatever its duty. "
        "Open loop, not calibrated: the plan for the limb as it was described. Follow: plans of "
        "the coming seconds by feedback, as of soft-limb follow. Learning: the best repetition."
    )
    drawn = [page.table(DISTANCE_HEADER, distance_table(summaries), caption)]
    return page.section("How near to what was asked for", *drawn)


def _table_1(summaries: Sequence[Summary]) -> page.Section:
    caption = (
        "Validation is Fig. 5's reference; T&R 1 and 2 were taught by hand, to be repeated; the "
        "ramps are ours. "
        "What counts comes first: the mean distance |φ_REF − φ| of the true bend from the "
        "reference, in degrees; then as the sensor reads it; and |φ_REF − φ*|, what the plan asks "
        "for. The first row of each motion has what the limits leave: the same of the best plan "
        "within them, whatever the price of duty, by the calibrated model. "
        "From the plan: |φ* − φ| of the rollouts as the sensor reads it, and its mean of the true "
        "bend; highest reading V and true temperature T of any wire, °C; how many rollouts were "
        "aborted as a wire was measured at the board's limit of 110 °C; these count up to then."
    )
    parts = [page.table(TABLE_1_HEADER, table_1(summaries), caption)]
    if len(of_family(summaries)) > 1:
        parts.append(page.paragraph("± is half of the 95% confidence interval over limbs."))
    return page.section("Table I, distances from reference and plan", *parts)


def _disturbances(summaries: Sequence[Summary]) -> list[page.Section]:
    rows = disturbance_table(summaries)
    if not rows:
        return []
    text = (
        "Something changes after the calibration, or a reading fails in mid motion. The plan of "
        "Fig. 5 is driven with plan feedback, and in open loop if the limb has changed."
    )
    caption = (
        "Mean |φ_REF − φ| of the true bend; mean |φ* − φ|, as read / of the true bend, in degrees; "
        "highest V and T of any wire, °C; aborted rollouts."
    )
    table = page.table(DISTURBANCE_HEADER, rows, caption)
    return [page.section("Disturbances", page.paragraph(text), table)]


def _approaches(summaries: Sequence[Summary]) -> page.Section:
    laws = collections.Counter(s.law for s in of_family(summaries))
    chosen = ", ".join(f"{law} for {count}" for law, count in laws.most_common())
    others = (
        "The same limbs and references, planned with other calibrated models: the paper's law "
        "and calibration, and each law by prediction error, whose plans were rolled out once. "
    )
    compared = any(len(s.approaches) > 1 for s in summaries)
    return page.section(
        "Calibrated models",
        page.paragraph(
            (others if compared else "")
            + f"The law that predicts motions best is {chosen} of the limbs."
        ),
        page.table(
            APPROACH_HEADER,
            approach_table(summaries),
            "Mean |φ_REF − φ| of the true bend from the reference; mean |φ* − φ| from the plan, as "
            "the sensor reads it / of the true bend, in degrees; mean error of the readings V of "
            "both wires; share of aborted rollouts.",
        ),
    )


def _error_split(summaries: Sequence[Summary]) -> page.Section:
    parts = [
        page.paragraph(
            "From the plan to the sensor's reading, one thing is replaced at a time: the "
            "plan by the simulated model, the calibrated parameters by those that fit this limb "
            "best in hindsight, the model by the limb, and the limb's angle by its sensor's "
            "reading. Only first rollouts are used, at all samples that Table I counts. The steps "
            "partly cancel each other, so the first table adds up to more than the whole error; "
            "the second one adds up to it."
        ),
        page.table(
            ["step", *MOTIONS],
            split_table(summaries, 0),
            "Mean absolute difference that each step makes, in degrees.",
        ),
        page.table(
            ["part of the step", *MOTIONS],
            split_table(summaries, 1),
            "Mean part that each step has in the whole error, in degrees: its difference, positive "
            "where it leads away from the plan as the whole error does, negative where it leads "
            "back.",
        ),
    ]
    return page.section("Where the error comes from", *parts)


def _what_was_done(summaries: Sequence[Summary], experiment: Experiment) -> page.Section:
    seeds = ", ".join(str(s.seed) for s in of_family(summaries))
    return page.section(
        "What was done",
        page.items(
            [
                f"Limbs: seeds {seeds}; pictures show seed {experiment.specimen.seed}. A seed "
                "draws a limb and its sensors' noise from ranges that "
                "hardware/emulation/specimen.py lists with their sources; none was left out.",
                f"Rollouts of each plan: {len(experiment.motions[0].open_loop.rollouts)}, in open "
                "loop and with each controller, but one with the receding horizon. The first one "
                "of each plan and way begins where the limb was left by the recordings, the hand "
                f"and {PAUSE:g} s without heat, the others where the first one left it.",
                "Closed loop and learning follow plans with a margin of temperature and duty, "
                "open loop the paper's.",
                "Bands in the figures are mean ± 1.96 standard deviations of the rollouts.",
            ]
        ),
    )
