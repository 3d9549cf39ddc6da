"""How much processor time things take, against another revision of this repository.

Another revision is checked out in a temporary folder, by `git worktree`. Each measurement is a
process of its own, of the two trees in turn, and the ratios are those of the medians; that holds on
a busy machine as well. Imports are not counted, but in the rows of `soft-limb`.

    python benchmarks/against.py [REVISION] [--only NAME ...] [--repetitions 5]
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
BEFORE = "df068b4"
# What runs in each tree, after PREPARATION; it sets `measured`, a dict.
PREPARATION = """
import json, resource, sys, time, warnings
import numpy as np
from limb_systems import CoupledLaw, HystereticLaw, LimbParameters, SegmentParameters
from planners import Task, plan, references
warnings.simplefilter("ignore")

def timed(function):
    started = time.process_time()
    function()
    return time.process_time() - started

def planned(limb, reference=None, **options):
    found = []
    reference = reference or references.step_and_decaying_sine()
    seconds = timed(lambda: found.append(plan(limb, reference, **options)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return found[0], {"seconds": seconds, "MB": peak, "cost": found[0].check.cost}

def of_links(links):
    segment = SegmentParameters(links=links, stiffness=0.1246 * (links + 1) / 6)
    return LimbParameters(segments=[segment])

def with_law(law):
    limb = LimbParameters()
    for wire in limb.wires:
        wire.law = law()
    return limb
"""
PLANAR = "measured = planned({}, task=Task.paper(), tolerance_deg=2.0)[1]"
CHECK = """
try:
    from planners.plan_check import simulated_differences
except ImportError:  # of an older revision
    from planners.checks import simulated_differences
trajectory = planned(LimbParameters(), task=Task.paper())[0]
measured = {"seconds": timed(lambda: simulated_differences(trajectory))}
"""
HORIZON = """
from controllers import RecedingHorizon
sys.path.insert(0, "benchmarks")
try:
    from controller_step_time import steps
except ImportError:  # as the script was called at df068b4
    from controller_steps import steps
from limb_systems import Limb, simulate
trajectory = planned(with_law(CoupledLaw), task=Task.closed_loop(with_law(CoupledLaw)))[0]
time.perf_counter = time.process_time
recording = simulate(Limb(trajectory.parameters), trajectory)
seconds = steps(RecedingHorizon(trajectory), recording)
measured = {"seconds": float(np.percentile(seconds[::5], 99))}
"""
IN_SPACE = "LimbParameters.in_space(), references.circle(np.radians(12.0), 50.0)"
SCRIPTS = {
    "plan, n = 3": PLANAR.format("of_links(3)"),
    "plan, n = 5": PLANAR.format("of_links(5)"),
    "plan, n = 10": PLANAR.format("of_links(10)"),
    "plan, hysteretic": PLANAR.format("with_law(HystereticLaw)"),
    "plan, coupled": PLANAR.format("with_law(CoupledLaw)"),
    "plan, in space": f"measured = planned({IN_SPACE})[1]",
    "check of a plan": CHECK,
    "step of RecedingHorizon, 99%": HORIZON,
}
COMMANDS = {"soft-limb --help": ["--help"], "soft-limb show FILE": ["show"]}


def run_script(tree: Path, script: str) -> dict:
    """Return what a script measures in a tree."""
    command = [sys.executable, "-c", PREPARATION + script + "\nprint(json.dumps(measured))"]
    ended = subprocess.run(
        command, cwd=tree, env=_environment(tree), capture_output=True, text=True
    )
    if ended.returncode:
        raise RuntimeError(f"{tree} could not be measured:\n{ended.stderr}")
    return json.loads(ended.stdout.splitlines()[-1])


def run_command(tree: Path, words: list[str]) -> dict:
    """Return the processor time of a command of ``soft-limb``, start and all."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "soft_limb", *words]
    subprocess.run(command, cwd=tree, env=_environment(tree), stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": used}


def _environment(tree: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(tree)}


def table(trees: list[Path], names: list[str], repetitions: int, plan: Path) -> None:
    """Print a row for each thing that is measured, as soon as it is."""
    print("| what | before, CPU s | now, CPU s | ratio | peak memory, ratio | costs differ by |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in names:
        runs: list[list[dict]] = [[], []]
        for _ in range(repetitions):
            for tree, of_tree in zip(trees, runs, strict=True):
                if name in SCRIPTS:
                    of_tree.append(run_script(tree, SCRIPTS[name]))
                else:
                    file = [str(plan)] if name.endswith("FILE") else []
                    of_tree.append(run_command(tree, COMMANDS[name] + file))
        before, now = (
            {key: statistics.median(run[key] for run in of_tree) for key in of_tree[0]}
            for of_tree in runs
        )
        cells = [name, f"{before['seconds']:.3f}", f"{now['seconds']:.3f}"]
        cells.append(f"{now['seconds'] / before['seconds']:.2f}")
        cells.append(f"{now['MB'] / before['MB']:.2f}" if "MB" in now else "")
        cells.append(f"{abs(now['cost'] / before['cost'] - 1):.0e}" if "cost" in now else "")
        print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("revision", nargs="?", default=BEFORE, help="default %(default)s")
    parser.add_argument("--only", nargs="+", choices=[*SCRIPTS, *COMMANDS], metavar="NAME")
    parser.add_argument("--repetitions", type=int, default=5, help="default %(default)s")
    options = parser.parse_args()
    names = options.only or [*SCRIPTS, *COMMANDS]
    with tempfile.TemporaryDirectory() as folder:
        tree, file = Path(folder) / "before", Path(folder) / "plan.csv"
        git = ["git", "-C", str(HERE), "worktree"]
        subprocess.run([*git, "add", "--detach", str(tree), options.revision], check=True)
        try:
            saved = PLANAR.format("LimbParameters()").replace("[1]", "[0]")
            run_script(tree, f"{saved}\nmeasured.save({str(file)!r})\nmeasured = {{}}")
            table([tree, HERE], names, options.repetitions, file)
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


if __name__ == "__main__":
    main()
