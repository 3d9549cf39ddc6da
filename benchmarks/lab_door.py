"""Logs of labs through import, fit and plan from the shell, and their results.

Each log of `lab_logs` and `lab_tables` takes three commands to a calibrated limb and a plan. Shown
are

- how many lines of the mapping had to be corrected, and which;
- how far the bend in the recording is from what the limb did, without a constant;
- |φ - φ_sim| of the calibrated limb for a motion that the log does not have, of a new limb of the
  same seed, and the same of the limb as described: as it is, and without a constant, since limbs
  with tags are bent at rest by something else, and no camera knows where 0 is.

Last come files that are no logs of a heated limb, and the sentence that each gets.

    python benchmarks/lab_door.py [--quick] [--unseen] [--seeds 1] [--out FOLDER] [NAME ...]
"""

import argparse
import copy
import shutil
import subprocess
import sys
import time
from pathlib import Path

import lab_logs
import numpy as np
from lab_logs import SIDES, Log, Truth
from lab_tables import STYLES, UNSEEN, table
from pydrake.trajectories import PiecewisePolynomial

from calibration.import_logs.mapping import LogMapping, WireColumns
from limb_systems import Limb, LimbParameters, Recording, SegmentParameters, simulate

TOLERANCE = 0.03  # of a factor
OFFSET = 5.0  # °, that a limb may be bent at rest
FIELDS = ("duty", "temperature", "full", "unit")  # of a wire
MOTION = 90.0  # s, of the motion that is predicted
HEAD = "{:<20}{:>6}{:>9}{:>14}{:>14}{:>9}{:>5}  {}"
REFERENCE = "time_s,bend_deg\n0,0\n25,0\n30,12\n40,12\n50,-6\n60,-6\n"


def announced(seed: int) -> list[Log]:
    """Return logs of the known loggers and of `STYLES`."""
    logs = [
        lab_logs.two_limbs(10 * seed + number, **quirks)
        for number, quirks in enumerate(
            [
                {"physics": "continuum"},
                {"kind": "steps", "rate": 10.0, "swapped": True, "flex": True, "camera": False},
                {"kind": "bang-bang", "duration": 300.0, "heated": (1,), "midnight": True},
                {"kind": "ramps", "arrays": True, "forward": ("left", "right")},
                {"kind": "dance", "duration": 60.0, "nested": True, "swapped": True},
                {"kind": "steps", "physics": "lumped", "forward": ("left", "left"), "flex": True},
            ]
        )
    ]
    return [*logs, lab_logs.pneumatic(seed), *(table(s, seed) for s in STYLES)]


def refused() -> dict[str, bytes]:
    """Return files that are no logs of a limb, by their kind."""
    head = "ms,pwmL,pwmR,T1,T2,angle\n"
    rows = [f"{100 * k},{{}},0,{25 + k / 9:.1f},25,{k % 7}\n" for k in range(200)]
    picture = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + bytes(range(256)) * 40
    return {
        "a picture": picture,
        "nothing": b"",
        "a header alone": head.encode(),
        "no duty": (head + "".join(rows)).replace("{}", "0").encode(),
        "no column of duty": "".join(
            f"{k / 10},{25 + k / 99:.2f},{k % 7}\n" for k in range(-1, 300)
        )
        .replace("-0.1,24.99,6", "time_s,temp,angle")
        .encode(),
        "time that stands": (
            head + "".join(f"0,{k % 50},0,25.0,25,{k % 7}\n" for k in range(200))
        ).encode(),
        "words": b"Dear all,\nhere is the log.\nRegards\n" * 20,
    }


def command(*words: str | Path) -> subprocess.CompletedProcess:
    """Run ``soft-limb``."""
    line = [sys.executable, "-m", "soft_limb", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, check=False)


def last_line(done: subprocess.CompletedProcess) -> str:
    """Return the end of the output of a command that failed; a traceback is named as such."""
    lines = (done.stderr.strip() or done.stdout.strip() or "(nothing)").splitlines()
    told = [line for line in lines if line.startswith(("error", "next"))] or lines
    return ("TRACEBACK: " if "Traceback" in done.stderr else "") + told[-1]


def corrected(mapping: LogMapping, truth: Truth, mirror: bool) -> tuple[LogMapping, list[str]]:
    """Return a mapping as it should be, of the limb or its mirror image, and its wrong lines.

    In a mirror sides are exchanged and the bend's sign is turned, which is as right.
    """
    fixed = copy.deepcopy(mapping)
    wrong = []

    def put(owner: object, name: str, value: str | float) -> None:
        given = getattr(owner, name)
        if given != value and not (
            isinstance(value, float) and abs(given - value) <= TOLERANCE * abs(value)
        ):
            wrong.append(f"{name}: {given} -> {value}")
            setattr(owner, name, value)

    wires = {wire.name: wire for wire in fixed.wires}
    for side, name in zip(SIDES, SIDES[::-1] if mirror else SIDES, strict=True):
        if side in truth.wires:
            wire = wires.pop(name, None) or WireColumns(name, "?", temperature="?")
            for field, value in zip(FIELDS, truth.wires[side], strict=True):
                if field == "full":
                    put(wire, "sign", float(np.sign(value)))
                    put(fixed, field, abs(value))
                else:
                    put(wire, field, value)
            fixed.wires = [*(w for w in fixed.wires if w.name != name), wire]
    for name in wires:
        wrong.append(f"wire {name}, which is not there")
        fixed.wires = [wire for wire in fixed.wires if wire.name != name]
    column, scale, measures, zero = truth.bend
    if column:  # else of tags
        put(fixed.bend, "column", column)
        if not fixed.bend.scale and measures != fixed.bend.measures:  # a scale may be of either
            scale = scale / 2
            measures = fixed.bend.measures
        put(fixed.bend, "scale", -scale if mirror else scale)
        put(fixed.bend, "measures", measures)
        if abs((fixed.bend.zero - zero) * scale) > OFFSET:
            put(fixed.bend, "zero", zero)
        fixed.bend.line = []
    if (fixed.time.column, fixed.time.unit) not in truth.times:
        put(fixed.time, "column", truth.times[0][0])
        put(fixed.time, "unit", truth.times[0][1])
        fixed.time.wraps_after = 0.0
    return fixed, wrong


def true_bend(joints: np.ndarray) -> np.ndarray:
    """Return the angle of a limb's chord (K,), rad, of joint angles (n, K)."""
    return SegmentParameters(links=len(joints)).chain.bend_angle(joints)[0]


def error_of(limb: LimbParameters, truth: Truth, mirror: bool) -> tuple[float, float]:
    """Return mean |φ - φ_sim| of the motion, degrees: as it is, and without a constant."""
    seed, physics, _, _, *rest = truth.drive
    done = lab_logs.drive(seed, physics, "motion", MOTION, *rest)
    sides = [1 - SIDES.index(name) if mirror else SIDES.index(name) for name in limb.wire_names]
    held = PiecewisePolynomial.ZeroOrderHold(done.time, done.duty[sides])
    predicted = simulate(Limb(limb), held, sample_rate=lab_logs.RATE).bend_angle[0]
    difference = np.rad2deg((-1 if mirror else 1) * predicted - true_bend(done.joints))
    return np.abs(difference).mean(), np.abs(difference - np.median(difference)).mean()


def misread(recordings: list[Recording], truth: Truth, mirror: bool) -> float:
    """Return the mean distance of recorded bends from the true bend, °, without a constant."""
    done = lab_logs.drive(*truth.drive)
    sides = [1 - s if mirror else s for s in (0, 1)]
    bend = (-1 if mirror else 1) * true_bend(done.joints)
    apart = []
    for recording in recordings:
        duty = np.zeros((2, len(recording.time)))
        for name, row in zip(recording.parameters.wire_names, recording.duty, strict=True):
            duty[sides[SIDES.index(name)]] = row
        spare = max(0.0, done.time[-1] - recording.time[-1])
        starts = np.arange(0.0, spare + 0.05, 0.05)
        best = min(
            starts, key=lambda s: np.abs(duty - done.duty[:, done.at(recording.time + s)]).sum()
        )
        apart.append(recording.bend_angle[0] - bend[done.at(recording.time + best)])
        apart[-1] = apart[-1] - np.nanmedian(apart[-1])
    return float(np.rad2deg(np.nanmean(np.abs(np.concatenate(apart)))))


def through_the_door(log: Log, folder: Path) -> list[dict]:
    """Import, fit and plan each limb in a log, and return the results."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    path = folder / f"{log.name}.csv"
    reference = folder / "mine.csv"
    path.write_bytes(log.content)
    reference.write_text(REFERENCE)
    start = time.perf_counter()
    first = command("import", path, "-o", folder / "recordings")
    rows = [] if log.truths else [{"log": log.name, "lines": [], "told": first.stdout}]
    mappings = {p: LogMapping.load(p) for p in sorted(folder.glob("recordings/**/*.mapping.yaml"))}
    for truth in log.truths:
        row = {"log": log.name, "lines": [], "told": last_line(first), "remarks": ""}
        rows.append(row)
        duties = {wire[0] for wire in truth.wires.values()}
        ours = [(p, m) for p, m in mappings.items() if duties & {w.duty for w in m.wires}]
        given, mapping = (ours or list(mappings.items()) or [(None, None)])[0]
        if mapping is None:
            continue
        tried = {mirror: corrected(mapping, truth, mirror) for mirror in (False, True)}
        mirror = len(tried[True][1]) < len(tried[False][1])
        fixed, row["lines"] = tried[mirror]
        recordings = given.parent
        if row["lines"]:
            recordings = folder / "again"
            given = folder / "corrected.yaml"
            fixed.save(given)
            again = command("import", path, "-o", recordings, "--mapping", given)
            row["told"] = last_line(again)
        limb = folder / f"{recordings.name}.yaml"
        plan = folder / f"{recordings.name}_plan.csv"
        read = [Recording.load(p) for p in sorted(recordings.glob("*.csv"))]
        if not read:
            continue
        row["misread"] = misread(read, truth, mirror)
        fit = command("fit", recordings, "-o", limb)
        row["told"] = fit.stdout if fit.returncode == 0 else last_line(fit)
        if fit.returncode:
            continue
        planned = command("plan", reference, "-l", limb, "-o", plan)
        row["plan"] = last_line(planned) if planned.returncode else "planned"
        fitted = LimbParameters.load(limb)
        plain = LimbParameters()
        plain.segments[0].wires = [
            w for w in plain.segments[0].wires if w.name in fitted.wire_names
        ]
        row["error"] = error_of(fitted, truth, mirror)
        row["nominal"] = error_of(plain, truth, mirror)
        row["seconds"] = time.perf_counter() - start
        start = time.perf_counter()
    return rows


def shown(row: dict) -> str:
    """Return a line of the table."""
    pair = {key: "{:.1f}° {:.1f}°".format(*row[key]) for key in ("error", "nominal") if key in row}
    misread_by = f"{row['misread']:.2f}°" if "misread" in row else "-"
    cells = row["log"], len(row["lines"]), misread_by, pair.get("error", "-")
    told = row["told"].strip().splitlines()[0].removeprefix("verdict").strip()
    more = pair.get("nominal", "-"), row.get("plan", "-"), f"{row.get('seconds', 0.0):.0f}", told
    return "\n    ".join([HEAD.format(*cells, *more), *row["lines"]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one log of each format")
    parser.add_argument("--unseen", action="store_true", help="tables that nobody announced, too")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path, default=lab_logs.CACHE / "door")
    parser.add_argument("names", nargs="*", help="logs whose names begin so; all if left out")
    options = parser.parse_args()
    print(HEAD.format(*["log", "lines", "misread", "|φ-φ_sim|", "described", "plan", "s", "told"]))
    for seed in range(options.seeds):
        logs = announced(seed)
        logs = [logs[1], logs[6], logs[7]] if options.quick else logs
        logs += [table(style, seed) for style in UNSEEN] if options.unseen else []
        for log in logs:
            if log.name.startswith(tuple(options.names or [""])):
                for row in through_the_door(log, options.out / log.name):
                    print(shown(row), flush=True)
    shutil.rmtree(options.out / "refused", ignore_errors=True)
    for name, content in {} if options.names else refused().items():
        path = options.out / f"{name.replace(' ', '_')}.csv"
        path.write_bytes(content)
        done = command("import", path, "-o", options.out / "refused")
        print(f"{name:<20} exit {done.returncode}  {last_line(done)}")


if __name__ == "__main__":
    main()
