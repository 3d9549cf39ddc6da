"""Plans whose inputs are files, and which can be stopped at any time."""

import concurrent.futures.process
import dataclasses
import multiprocessing
import signal
import warnings
from pathlib import Path

from pydrake import trajectories

from limb_systems import LimbParameters, Recording, Trajectory
from planners import references
from planners.planning import number_of_knots, plan
from planners.solving import PlanningError
from planners.task import Task

# Knots times joints above which single calls into Drake take a second or more.
LARGE = 5000
RECORDED = b"# limb recording"  # with which the file of a recording starts


@dataclasses.dataclass(frozen=True)
class Request:
    """What the command line asks for; it can be sent to another process.

    - ``reference``: "fig5", or the path of a recording or a CSV.
    - ``limb``: path of the parameters; None for the nominal limb.
    - ``task``: None for the default one.
    - ``smoothing_time``: of a recording's bend angle, s.
    - ``knot_rate``, ``max_knots``, ``tolerance_deg``: as of `planners.plan`.
    """

    reference: str
    limb: Path | None
    task: Task | None
    smoothing_time: float
    knot_rate: float
    max_knots: int
    tolerance_deg: float


def make_plan(request: Request) -> Trajectory:
    """Plans; large plans in a separate process.

    Python handles Ctrl-C and signals only between calls into Drake and the
    solvers, and in a large plan some of these take many seconds. A process can
    be killed at once, and it writes no files.

    Raises:
        PlanningError: as of `planners.plan`.
    """
    limb, reference = _limb(request), _reference(request)
    num_knots = number_of_knots(reference, request.knot_rate, request.max_knots)
    if num_knots * limb.num_joints < LARGE:
        return _plan(request, limb, reference)
    # Not forked, because threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, context, _leave_signals_alone) as pool:
        try:
            return pool.submit(_plan_apart, request).result()
        except concurrent.futures.process.BrokenProcessPool as error:
            raise PlanningError(
                "The process that made the plan was killed, probably because memory ran out; ask "
                "for fewer knots."
            ) from error
        except KeyboardInterrupt:
            for process in multiprocessing.active_children():
                process.kill()
            raise


def _plan(request: Request, limb: LimbParameters, reference) -> Trajectory:
    return plan(
        limb,
        reference,
        task=request.task,
        knot_rate=request.knot_rate,
        tolerance_deg=request.tolerance_deg,
        max_knots=request.max_knots,
    )


def _plan_apart(request: Request) -> Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the first process has already warned
        reference = _reference(request)
    return _plan(request, _limb(request), reference)


def _leave_signals_alone() -> None:
    """Ctrl-C reaches both processes, and the parent decides."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _limb(request: Request) -> LimbParameters:
    return LimbParameters.of(request.limb)


def _reference(request: Request) -> trajectories.Trajectory:
    if request.reference == "fig5":
        return references.step_and_decaying_sine()
    path = Path(request.reference)
    if path.is_file():
        with path.open("rb") as file:
            recorded = file.read(len(RECORDED)) == RECORDED
        if recorded:
            return references.from_recording(Recording.load(path), request.smoothing_time)
    return references.load(path)
