"""Export of plans for other programs that drive a limb: rows of duty, as CSV or as a C header."""

import dataclasses
import io
import json
import math
from pathlib import Path

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.output import write_atomically
from limb_systems.files.signal_table import doses
from limb_systems.files.trajectory import Trajectory


def zero_order_hold_duty(plan: Trajectory, rate: float, duty_max: int = 1) -> np.ndarray:
    """Return duty (W, N + 1) for a program that holds each column for a period; the last is zero.

    The duty of a plan ramps between its knots. Each column is its mean over the period, so
    that wires get the plan's heat. Counts carry their rounding into the next one: at the
    end of each period the sum is within half a count of the plan's.

    Args:
        plan: a plan that passed its check.
        rate: columns per second, Hz.
        duty_max: number that stands for a duty of 1; 1 for duty itself, and whole numbers
            up to 65535 for counts, such as 255.

    Raises:
        LimbError: if the plan did not pass its check, or a number is out of range.
    """
    if failure := plan.check.failure():
        raise LimbError(f"This trajectory must not drive a limb: {failure}")
    if not 0.1 <= rate <= 1000:
        raise LimbError(f"The rate is {rate:g} Hz; it must be from 0.1 to 1000 Hz.")
    if duty_max not in range(1, 65536):
        raise LimbError(f"The largest duty is {duty_max}; it must be a whole number up to 65535.")
    # Integrate the ramps of the plan over each period.
    knots = plan.time - plan.time[0]
    ends = np.arange(math.ceil(plan.duration * rate - 1e-9) + 1) / rate
    times = np.union1d(knots, ends[ends < knots[-1]])
    ramps = np.array([np.interp(times, knots, duty) for duty in plan.duty])
    means = doses((ramps[:, 1:] + ramps[:, :-1]) / 2, times, ends) * rate
    duty = np.clip(means, 0.0, 1.0)
    # Round the running sum to counts, so that rounding does not add up.
    if duty_max > 1:
        sums = np.floor(np.cumsum(duty, axis=1) * duty_max + 0.5)
        duty = np.clip(np.diff(sums, axis=1, prepend=0.0), 0, duty_max)
    return np.column_stack([duty, np.zeros(len(duty))])


def write_rows(plan: Trajectory, path: str | Path, rate: float, duty_max: int = 1) -> None:
    """Write a CSV file: comments that start with #, then time and `zero_order_hold_duty` in rows.

    Raises:
        LimbError: as `zero_order_hold_duty` does.
    """
    duty = zero_order_hold_duty(plan, rate, duty_max)
    # Write the comment and the names.
    scale = "" if duty_max == 1 else f"_of_{duty_max}"
    comment = _comment(plan, rate, duty_max).replace("\n", "\n# ")
    names = [f"duty_{name}{scale}" for name in plan.parameters.wire_names]
    lines = [f"# {comment}", ",".join(["time_s", *names])]
    # Write the rows.
    times = np.arange(duty.shape[1]) / rate
    row_format = ",".join(["%.9g", *["DUTY"] * len(duty)])
    lines += _formatted_rows(np.vstack([times, duty]), row_format, duty_max)
    write_atomically(path, "\n".join(lines) + "\n")


def write_c_header(plan: Trajectory, path: str | Path, rate: float, duty_max: int = 1) -> None:
    """Write a C header: `zero_order_hold_duty` as an array of rows, its rate, size and wire names.

    Numbers are of the smallest type that has them: uint8_t, uint16_t, or float for duty itself.

    Raises:
        LimbError: as `zero_order_hold_duty` does.
    """
    duty = zero_order_hold_duty(plan, rate, duty_max)
    # Choose the type of the numbers, and format the rows.
    number_type = "float" if duty_max == 1 else "uint8_t" if duty_max < 256 else "uint16_t"
    suffix = "f" if duty_max == 1 else ""
    row = ", ".join([f"DUTY{suffix}"] * len(duty))
    rows = _formatted_rows(duty, f"    {{{row}}},", duty_max)
    # Write them between definitions and a guard against double inclusion.
    comment = _comment(plan, rate, duty_max).replace("*/", "* /").replace("\n", "\n * ")
    lines = [
        f"/* {comment}",
        " */",
        "#ifndef PLAN_H",
        "#define PLAN_H",
        "#include <stdint.h>",
        f"#define PLAN_RATE_HZ {float(rate)!r}f",
        f"#define PLAN_ROWS {len(rows)}",
        f"#define PLAN_WIRES {len(duty)}",
        f"#define PLAN_DUTY_MAX {duty_max}",
        "#ifndef PLAN_MEMORY",
        "#define PLAN_MEMORY /* PROGMEM on an AVR, if defined before */",
        "#endif",
        "static const char *const plan_wires[PLAN_WIRES] = "
        f"{{{', '.join(map(json.dumps, plan.parameters.wire_names))}}};",
        f"static const {number_type} plan_duty[PLAN_ROWS][PLAN_WIRES] PLAN_MEMORY = {{",
        *rows,
        "};",
        "#endif",
    ]
    write_atomically(path, "\n".join(lines) + "\n")


def _formatted_rows(columns: np.ndarray, row_format: str, duty_max: int) -> list[str]:
    """Return the text of each of the K rows of columns (C, K).

    In ``row_format`` DUTY stands for the format of a duty, a whole number if it is in counts.
    """
    text = io.StringIO()
    np.savetxt(text, columns.T, row_format.replace("DUTY", "%.9f" if duty_max == 1 else "%.0f"))
    return text.getvalue().splitlines()


def _comment(plan: Trajectory, rate: float, duty_max: int) -> str:
    """Return the comment for the program that drives the limb."""
    # Name the wires, the rate, the end of the rows and the assumptions.
    limits = plan.parameters.temperature_limits
    names = ", ".join(plan.parameters.wire_names)
    start_temperatures = ", ".join(f"{value:.1f}" for value in plan.wire_temperature[:, 0])
    lines = [
        f"Duty of the wires {names}, of {duty_max}, {rate:g} rows per second.",
        f"Hold each row for {1 / rate:.9g} s. The plan's duty ramps between its knots; each row is",
        "its mean until the next row, so that the wires get the planned heat.",
        "The last row is zero: what stops there leaves the wires off.",
        "These rows switch nothing off. End with zero duty on every way out, and as soon as a",
        f"reading is above {limits.measured_maximum:g} degC.",
        "Assumed: the limb that the plan was made for, at rest; wires at "
        f"{start_temperatures} degC; air at",
        f"{plan.parameters.ambient_temperature:g} degC; the supply that it was calibrated with.",
    ]
    # Add the provenance, without empty fields.
    provenance = dataclasses.asdict(plan.provenance) if plan.provenance else {}
    for name, value in provenance.items():
        if value not in ("", None):
            lines.append(f"provenance.{name}: {value}")
    return "\n".join(lines)
