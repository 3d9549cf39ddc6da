"""The paper's evaluation, end to end, on emulated limbs.

Records emulated limbs with richer physics than the model, calibrates the model
to the recordings, plans the motion of Fig. 5, ramps and two motions taught by
hand, replays each plan five times open loop and with each controller, learns it
over ten repetitions, disturbs the limbs, and writes Table I, Figs. 4 to 7, the
sources of the error, and all the data to a folder. Only values that are called
true, and the split of the error, use the hidden state of the emulated limbs.

    python examples/reproduce_paper [FOLDER] [--quick] [--limbs N] [--others N]

`make demo` does this with --quick.
"""

import argparse
import dataclasses
import sys
from pathlib import Path

from soft_limb.command import run_command
from soft_limb.runs.jobs import load_module

EXAMPLES = Path(__file__).parents[1]
WITNESSES = EXAMPLES.parent / "tests" / "witnesses"
load_module("reproduce_paper", EXAMPLES)  # as a package, also in other processes

from reproduce_paper.experiment import Settings  # noqa: E402
from reproduce_paper.reproduce import reproduce_in  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="exit status: 0 done; 1 failed; 2 wrong usage; 130 stopped by Ctrl-C",
    )
    parser.add_argument("folder", nargs="?", default="out", type=Path, help="for all results")
    parser.add_argument(
        "--limbs", type=int, default=10, help="number of limbs (default %(default)s)"
    )
    parser.add_argument(
        "--others",
        type=int,
        default=0,
        help="number of additional limbs with other physics (default %(default)s)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one limb, without comparisons and disturbances; closed loop only as soft-limb "
        "follow, and learning only of the ramps",
    )
    # Run the evaluation until it ends or a signal comes.
    options = parser.parse_args()
    if options.limbs < 1 or options.others < 0:
        parser.error("--limbs must be one or more, and --others zero or more")
    stopped = f"stopped; complete limbs are in {options.folder}"
    return run_command(lambda: reproduce_in(options.folder, _jobs(options)), stopped)


def _jobs(options) -> list[Settings]:
    """Return the settings of each limb."""
    is_whole = not options.quick
    whole = Settings(0, compare=is_whole, disturb=is_whole, quick=options.quick)
    # List the limbs with the usual physics, then those with other physics.
    seeds = range(1 if options.quick else options.limbs)
    jobs = [dataclasses.replace(whole, seed=seed) for seed in seeds]
    if options.others:
        load_module("continuum", WITNESSES)  # which adds its physics
    other = dataclasses.replace(whole, physics="continuum", compare=False, disturb=False)
    return jobs + [dataclasses.replace(other, seed=seed) for seed in range(options.others)]


if __name__ == "__main__":
    sys.exit(main())
