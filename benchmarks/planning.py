"""How fast the planner plans, against the same program in CasADi.

The Fig. 5 reference, 60 s, for limbs of 3, 5 and 10 links and 121, 301 and 601
knots. All solvers get the same program, eqns (15)-(20), the same discretization
(direct collocation as Drake's), the same quasi-static guess and the same time
limit. Each run is a process of its own, all solvers of a size run in turn, and
the medians of the repetitions count, in processor time; who fails once is not
run again. One judge, with the dynamics of Drake's diagram, looks at all
solutions.

    python benchmarks/planning.py [--quick]

Writes the tables ``results.md``. Only CasADi's part needs CasADi.
"""

import argparse
import dataclasses
import importlib
import importlib.metadata
import importlib.util
import multiprocessing
import os
import platform
import re
import resource
import statistics
import sys
from pathlib import Path

# Nothing of Drake, CasADi or Matplotlib is imported here: each process imports this file, and its
# memory is to be that of its own solver.

LINKS, KNOTS = (3, 5, 10), (121, 301, 601)
QUICK_LINKS, QUICK_KNOTS = (3, 5), (121,)
SAME_COST = 1e-6  # relative
FEASIBLE = 1e-6  # of defects as the judge scales them
WITHIN_BOUNDS = 1e-8
TIME_LIMIT = "fails: time limit"
GRACE = 60.0  # s beyond the time limit, for building, until a process is killed


@dataclasses.dataclass(frozen=True, eq=False)
class Solver:
    """One way to solve the program.

    - ``name``: in the tables.
    - ``module``, ``function``: what runs it, as function(problem, time_limit,
      **options).
    - ``options``: that tell it from the others.
    - ``kind``: what the summary compares: "exact" is CasADi with its exact
      Hessian, given its best shot.
    """

    name: str
    module: str
    function: str = "run"
    options: dict = dataclasses.field(default_factory=dict)
    kind: str = ""


def _casadi(name: str, kind: str, **options) -> Solver:
    return Solver(f"CasADi, {name}", "casadi_peer", "run", options, kind)


OURS = Solver("ours", "our_planner", "run", kind="ours")
SOLVERS = (
    OURS,
    _casadi("implicit", "exact", form="implicit"),
    _casadi("explicit", "exact", form="explicit"),
    _casadi("implicit, our Hessian", "our Hessian", form="implicit", hessian="gauss-newton"),
    _casadi("explicit, our Hessian", "our Hessian", form="explicit", hessian="gauss-newton"),
)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="small sizes, one repetition")
    parser.add_argument("--repetitions", type=int, default=3, help="default %(default)s")
    parser.add_argument("--time-limit", type=float, default=120.0, help="s, default %(default)g")
    parser.add_argument(
        "--output", type=Path, default=Path(__file__).parent, help="folder of the results"
    )
    options = parser.parse_args(arguments)
    repetitions = 1 if options.quick else options.repetitions
    links, knots = (QUICK_LINKS, QUICK_KNOTS) if options.quick else (LINKS, KNOTS)

    options.output.mkdir(parents=True, exist_ok=True)
    results = {}
    for size in ((n, N) for n in links for N in knots):
        results[size] = run_size(*size, SOLVERS, repetitions, options.time_limit)
        report = "\n\n".join([*introduction(repetitions, options.time_limit), *tables(results)])
        (options.output / "results.md").write_text(report + "\n", encoding="utf-8")
    _say(f"written: {options.output / 'results.md'}")
    return 0


def run_size(links: int, knots: int, solvers, repetitions: int, time_limit: float) -> dict:
    """Medians of what all solvers do with one size.

    Returns:
        By solver: what its function returns, without arrays; ``both``, to
        build and to solve, s; what the judge says; ``relative
        cost`` to the best; and ``verdict``, "ok" or what is wrong.
    """
    problem = in_process(GRACE, "our_planner", "make_problem", links, knots)
    if "times" not in problem:
        raise RuntimeError(f"There is no problem to solve: {problem['status']}")
    del problem["peak"], problem["imports"]
    runs = {solver: [] for solver in solvers}
    for repetition in range(repetitions):
        for solver in solvers:
            if any(not run.get("success") for run in runs[solver]):
                continue
            _say(f"n = {links}, N = {knots}, {repetition + 1} of {repetitions}: {solver.name} ... ")
            run = in_process(
                time_limit + GRACE,
                solver.module,
                solver.function,
                problem,
                time_limit,
                **solver.options,
            )
            if "states" in run:
                solution = run.pop("states"), run.pop("duty")
                run = in_process(GRACE, "our_planner", "judge", problem, *solution) | run
            runs[solver].append(run)
    results = {solver: _medians(several) for solver, several in runs.items()}
    best = min(
        (result["cost"] for result in results.values() if _feasible(result)), default=float("nan")
    )
    for result in results.values():
        result["verdict"] = _verdict(result, best, time_limit)
        if "cost" in result:
            result["relative cost"] = result["cost"] / best - 1
        if "build" in result:
            result["both"] = result["build"] + result["solve"]
    return results


def in_process(timeout: float, module: str, function: str, *arguments, **options) -> dict:
    """What a function returns that runs in a new process, and the memory that it took.

    Args:
        timeout: s, after which the process is killed.

    Returns:
        The function's dict with ``peak`` and the part of it that importing took, ``imports``
        (MB); or ``status``, what went wrong.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    call = (sender, module, function, arguments, options)
    process = context.Process(target=_call, args=call, daemon=True)
    process.start()
    sender.close()
    try:
        return receiver.recv() if receiver.poll(timeout) else {"status": "time limit"}
    except EOFError:
        process.join()
        return {"status": f"its process ended with exit code {process.exitcode}"}
    finally:
        process.kill()
        process.join()


def _call(sender, module: str, function: str, arguments: tuple, options: dict) -> None:
    function = getattr(importlib.import_module(module), function)
    imports = peak_memory()
    try:
        result = function(*arguments, **options)
    except Exception as error:
        result = {"status": f"{type(error).__name__}: {error}".splitlines()[0]}
    sender.send(result | {"imports": imports, "peak": peak_memory()})


def peak_memory() -> float:
    """Of this process, MB."""
    status = Path("/proc/self/status")
    if status.exists():  # there, getrusage counts the memory of the parent as well
        return int(re.search(r"VmHWM:\s*(\d+)", status.read_text())[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _medians(runs: list[dict]) -> dict:
    """Of all numbers, the rest from the last run; a failure stands for itself."""
    result = dict(runs[-1])
    if result.get("success"):
        for key, value in result.items():
            if isinstance(value, float):
                result[key] = statistics.median(run[key] for run in runs)
    return result


def _feasible(result: dict) -> bool:
    return (
        result.get("success", False)
        and result["defect"] < FEASIBLE
        and result["violation"] < WITHIN_BOUNDS
    )


def _verdict(result: dict, best_cost: float, time_limit: float) -> str:
    if result.get("solve", 0.0) >= time_limit:
        return TIME_LIMIT
    if not result.get("success"):
        return f"fails: {result['status']}"
    if not _feasible(result):
        return "fails: not feasible"
    return "ok" if result["cost"] <= best_cost * (1 + SAME_COST) else "fails: higher cost"


def introduction(repetitions: int, time_limit: float) -> list[str]:
    """What was measured, how and on what, as Markdown."""
    versions = [f"Python {platform.python_version()}"]
    for package in ("drake", "casadi", "numpy"):
        if importlib.util.find_spec("pydrake" if package == "drake" else package):
            versions.append(f"{package} {importlib.metadata.version(package)}")
    return [
        "# The planner against the same program in CasADi",
        "Written by `python benchmarks/planning.py`.",
        f"{_machine()}; {', '.join(versions)}. Medians of {repetitions} run(s), each in a process "
        f"of its own; time limit {time_limit:g} s. Times are of the processor, without imports.",
        "Fig. 5 reference, 60 s, n links, N knots, from the same quasi-static guess. *Build* is "
        "making the program, derivatives and compilation included; *again* is solving once more "
        f"with the solver that was built. A solution counts if its cost is within {SAME_COST:g} of "
        f"the lowest, and its collocation constraints hold to {FEASIBLE:g} with the dynamics of "
        "Drake's diagram, scaled to rad and to 50 °C.",
        "*Implicit* has accelerations as variables and the inverse dynamics as constraints, "
        "*explicit* solves for accelerations inside. Derivatives are those of one small CasADi "
        "function, mapped over all points and assembled by the chain rule. *Our Hessian* is that "
        "of the cost alone.",
    ]


def tables(results: dict) -> list[str]:
    """All results as Markdown: a summary, our stages, and who failed."""
    failed = [
        f"- n = {links}, N = {knots}, {solver.name}: {result['verdict']}"
        for (links, knots), of_size in results.items()
        for solver, result in of_size.items()
        if result["verdict"] != "ok"
    ]
    parts = ["## Summary", *summary(results), "## Ours, stage by stage", stages(results)]
    return [*parts, "## Without a solution", "\n".join(failed) or "None."]


def summary(results: dict) -> list[str]:
    """Ours against the fastest CasADi of each kind, s, and how many times faster."""
    rows = []
    for (links, knots), of_size in results.items():
        ours = of_size[OURS]
        row = [str(links), str(knots), _cell(ours.get("both"))]
        for kind in ("exact", "our Hessian"):
            name, peer = fastest(of_size, kind, "both")
            row += _against(ours.get("both"), peer.get("both"))
            if name and kind == "exact":
                row[-2] += f" ({name})"
        _, peer = fastest(of_size, "exact", "again")
        row += [_cell(ours.get("solve")), *_against(ours.get("solve"), peer.get("again"))]
        rows.append(row)
    heads = (
        "n|N|ours|CasADi, its best|times|CasADi, our Hessian|times|ours, solve alone"
        "|CasADi, built before|times"
    )
    return [
        "Seconds to build and solve: ours, the fastest CasADi variant with its exact Hessian, and "
        "the fastest that is given our Hessian; and seconds to solve alone against the fastest "
        "CasADi solver that was built before.",
        _table(heads.split("|"), rows),
    ]


def stages(results: dict) -> str:
    """Where our time goes, s."""
    rows = []
    for (links, knots), of_size in results.items():
        ours = of_size[OURS]
        row = [str(links), str(knots)]
        row += [_cell(ours.get(key)) for key in ("guess", "build", "solve", "check", "whole")]
        row.append(_cell(ours.get("inside_ipopt")))
        share = ours["evaluation"] / ours["solve"] if "evaluation" in ours else None
        row += [_cell(share, ".0%"), _cell(ours.get("difference_deg"), ".3f")]
        rows.append(row)
    heads = (
        "n|N|guess s|build s|solve s|check s|whole s|inside IPOPT s|evaluation, of solve"
        "|from its simulation °"
    )
    return _table(heads.split("|"), rows)


def fastest(of_size: dict, kind: str, key: str) -> tuple[str, dict]:
    """Name and result of the fastest solver of a kind; without one, of none."""
    candidates = {
        solver.name.removeprefix("CasADi, "): result
        for solver, result in of_size.items()
        if solver.kind == kind and result["verdict"] == "ok"
    }
    return min(candidates.items(), key=lambda item: item[1][key], default=("", {}))


def _against(ours: float | None, peer: float | None) -> list[str]:
    ratio = peer / ours if ours and peer else None
    return [_cell(peer), _cell(ratio, ".1f")]


def _cell(value: float | None, format_spec: str | None = None) -> str:
    if value is None:
        return ""
    return format(value, format_spec or ("d" if isinstance(value, int) else ".3g"))


def _table(heads: list[str], rows: list[list[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _machine() -> str:
    """Processor, cores and memory, in words."""
    cpuinfo = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", cpuinfo.read_text()) if cpuinfo.exists() else []
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    processor = names[0] if names else platform.machine()
    return f"{processor}, {os.cpu_count()} cores, {memory:.0f} GiB of memory, {platform.system()}"


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
