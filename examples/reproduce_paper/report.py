"""Write the page of the evaluation: tables, figures and settings."""

import collections
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from limb_systems.views.panels import Panel
from limb_systems.views.plots import Figure
from reproduce_paper import tables
from reproduce_paper.driving import OPEN_LOOP, PAUSE
from reproduce_paper.experiment import Experiment
from soft_limb.reports import page

Table = Callable[[Sequence[tables.Summary]], tables.Rows]
EMULATED = (
    "These limbs are emulated, with physics that the model leaves out. The numbers are results of "
    "the method on this emulation, and say nothing about a real limb."
)


def write_report(
    path: str | Path,
    summaries: Sequence[tables.Summary],
    experiment: Experiment,
    pictures: dict[str, tuple[Figure | list[Panel], str]],
    data: Mapping[str, Path],
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        summaries: one for each limb.
        experiment: the limb of the figures.
        pictures: `figures` of that limb.
        data: files that the page links to, by their descriptions.
    """
    # Begin with the tables.
    limbs = tables.limbs_of_family(summaries)
    title = "The paper reproduced, on emulated limbs"
    parts: list[page.Part] = [
        page.paragraph(
            "Trajectory optimization for a thermally actuated soft planar limb, after Wertz, "
            f"Sabelhaus and Majidi. Number of emulated limbs: {len(limbs)}. Each limb was "
            "recorded, calibrated, taught, planned for and driven, open loop and in closed loop. "
            "Planner, calibration and controllers know of a limb only what its sensors tell."
        ),
        page.verdict(EMULATED),
        *_measured(summaries),
    ]
    # Add the figures.
    for drawn, text in pictures.values():
        heading, _, caption = text.partition(": ")
        chart = page.chart(drawn, text) if isinstance(drawn, list) else page.picture(drawn, text)
        caption = f"{caption[0].upper()}{caption[1:]}."
        parts.append(page.section(heading, page.paragraph(caption), chart))
    # Describe the settings.
    seeds = ", ".join(str(limb.seed) for limb in limbs)
    rollouts = len(next(iter(experiment.ways.values()))[OPEN_LOOP].rollouts)
    done = [
        f"Limbs: seeds {seeds}; pictures show seed {experiment.specimen.seed}. A seed draws a limb "
        "and its sensors' noise from ranges that hardware/emulation/specimen.py lists with their "
        "sources; no limb was left out.",
        f"Rollouts of each plan: {rollouts} in open loop, at most two with each controller, and "
        "one with the receding horizon. The first rollout of each plan and way begins where the "
        f"limb was left by the recordings, the hand and {PAUSE:g} s without heat; the others begin "
        "where the first one left it. Plans begin with what is read before the first one.",
        "Closed loop and learning follow plans with a margin of temperature and duty. Open loop "
        "follows the paper's plans.",
        "Bands in the figures are mean ± 1.96 standard deviations of the rollouts.",
    ]
    parts.append(page.section("What was done", page.items(done)))
    page.write_page(path, title, parts, summaries[0].provenance, data)


def _measured(summaries: Sequence[tables.Summary]) -> list[page.Section]:
    """Return a section for each table that is not empty."""
    limbs = tables.limbs_of_family(summaries)
    laws = collections.Counter(limb.law for limb in limbs)
    chosen = ", ".join(f"{law} for {count}" for law, count in laws.most_common())
    margin = "± is half of the 95% confidence interval over limbs." if len(limbs) > 1 else ""
    # Headings, texts, and tables by their captions.
    sections: list[tuple[str, str, dict[str, Table]]] = [
        (
            "Distance from the reference",
            "Best within the limits: the best plan for the calibrated model, whatever its duty. "
            "Open loop, not calibrated: the plan for the limb as it was described. Follow: "
            "feedback that plans the coming seconds, as soft-limb follow does. Learning: the "
            "repetition whose bend was read nearest to the reference, with its true bend; another "
            "repetition may have been truly nearer.",
            {"Mean distance of the true bend from the reference.": tables.distance_table},
        ),
        (
            "Table I, distances from reference and plan",
            "Validation is the reference of Fig. 5. T&R 1 and 2 were taught by hand. The ramps are "
            f"not in the paper. {margin}",
            {
                "First the mean distance |φ_REF − φ| of the true bend from the reference, in "
                "degrees, then of the bend as the sensor reads it, and |φ_REF − φ*| of the plan. "
                "The first row of each motion is the best plan within the limits, by the "
                "calibrated model. The best repetition of learning is the repetition that was "
                "read nearest to the reference. From the plan: |φ* − φ| as the sensor reads it, "
                "and its mean for the true bend; highest reading V and true temperature T of any "
                "wire, °C; rollouts that were aborted as a wire was measured at the board's limit "
                "of 110 °C, which count up to then.": tables.table_1
            },
        ),
        (
            "Disturbances",
            "After the calibration the limb changes, or a reading fails in mid motion. Plan "
            "feedback drives the plan of Fig. 5, and so does open loop if the limb has changed.",
            {
                "Mean |φ_REF − φ| of the true bend; mean |φ* − φ|, as read / of the true bend, in "
                "degrees; highest V and T of any wire, °C; aborted rollouts.": (
                    tables.disturbance_table
                )
            },
        ),
        (
            "Calibrated models",
            "The same limbs and references, planned with other models: the limb as described and, "
            "if they were compared, the paper's law and calibration, and each law by prediction "
            "error. Each of these plans has one rollout. The law that predicts motions best is "
            f"{chosen} of the limbs.",
            {
                "Mean |φ_REF − φ| of the true bend from the reference; mean |φ* − φ| from the "
                "plan, as the sensor reads it / of the true bend, in degrees; mean error of the "
                "readings V of both wires; share of aborted rollouts.": tables.approach_table
            },
        ),
        (
            "Where the error comes from",
            "From the plan to the sensor's reading, one thing is replaced at a time: the plan by "
            "the simulated model, the calibrated parameters by those that fit this limb best in "
            "hindsight, the model by the limb, and the limb's angle by its sensor's reading. Only "
            "first rollouts are used, at all samples that Table I counts. The steps partly cancel "
            "each other, so the first table adds up to more than the whole error; the second one "
            "adds up to it.",
            {
                "Mean absolute difference that each step makes, in degrees.": tables.step_table,
                "Mean part of each step in the whole error, in degrees: its difference, positive "
                "where it leads away from the plan as the whole error does, negative where it "
                "leads back.": tables.part_table,
            },
        ),
    ]
    # Leave out tables without rows, such as disturbances of a quick run.
    filled = []
    for heading, text, captions in sections:
        drawn = []
        for caption, make_table in captions.items():
            header, *rows = make_table(summaries)
            if rows:
                drawn.append(page.table(header, rows, caption))
        if drawn:
            filled.append(page.section(heading, page.paragraph(text), *drawn))
    return filled
