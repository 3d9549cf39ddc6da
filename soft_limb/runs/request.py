"""Plans whose inputs are files."""

import dataclasses
from pathlib import Path

from pydrake import trajectories

from limb_systems import LimbParameters, Recording, Trajectory
from limb_systems.signals import ended_at_once
from planners import references
from planners.planning import plan
from planners.task import Task

RECORDED = b"# limb recording"  # with which the file of a recording starts


@dataclasses.dataclass(frozen=True)
class Request:
    """What the command line asks for.

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
    """Plans for a command, which a signal then ends at once.

    Raises:
        PlanningError: as of `planners.plan`.
    """
    limb, reference = LimbParameters.of(request.limb), _reference(request)
    with ended_at_once():
        return plan(
            limb,
            reference,
            task=request.task,
            knot_rate=request.knot_rate,
            tolerance_deg=request.tolerance_deg,
            max_knots=request.max_knots,
        )


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
