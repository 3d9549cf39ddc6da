"""Teach and go: plans a motion, and follows the plan by feedback."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from limb_systems import LimbParameters, LimbSystem
from planners import Task
from planners.planning import MAX_KNOTS
from soft_limb.live.page import LivePage
from soft_limb.reports.drive import write_drive_report
from soft_limb.runs.drive import Drive, drive
from soft_limb.runs.request import Request, make_plan

PLAN, RECORDING, PICTURE, REPORT = "plan.csv", "recording.csv", "tracking.png", "report.html"


@dataclasses.dataclass(frozen=True)
class Following:
    """How a limb followed its plan, and how far it was from what the plan is for.

    - ``driven``: `Drive`.
    """

    driven: Drive

    @property
    def distance(self) -> float:
        """The mean of |φ_ref - φ| over segments and usable samples, rad."""
        recording, plan = self.driven.recording, self.driven.trajectory.since_start()
        good = recording.usable
        wanted = [np.interp(recording.time[good], plan.time, row) for row in plan.reference]
        return float(np.abs(wanted - recording.bend_angle[:, good]).mean())

    @property
    def planned_distance(self) -> float:
        """The same of the plan, rad: what a reference asks for that the limb cannot do."""
        plan = self.driven.trajectory
        return float(np.abs(plan.reference - plan.bend_angle).mean())

    @property
    def hottest(self) -> np.ndarray:
        """The highest reading of each wire (W,), °C."""
        return self.driven.recording.measured_temperature[:, self.driven.recording.usable].max(
            axis=1
        )

    def facts(self) -> dict:
        """For JSON."""
        return {
            **self.driven.facts(),
            "reference_distance_deg": float(np.rad2deg(self.distance)),
            "planned_distance_deg": float(np.rad2deg(self.planned_distance)),
            "highest_readings_c": self.hottest.tolist(),
        }

    def lines(self) -> list[str]:
        """For people."""
        distance, planned = np.rad2deg([self.distance, self.planned_distance])
        names = self.driven.recording.parameters.wire_names
        heat = (f"{name} {value:.0f} °C" for name, value in zip(names, self.hottest, strict=True))
        return [
            *self.driven.lines(),
            f"reference   |φ_ref - φ|: mean {distance:.2f}°, of which the plan has {planned:.2f}°",
            f"heat        read at most: {', '.join(heat)}",
        ]


def closed_loop_request(
    reference: str, limb: Path | None = None, smoothing_time: float = 0.5
) -> Request:
    """For `follow`: a plan with margins for feedback; arguments as of `Request`."""
    return Request(
        reference=reference,
        limb=limb,
        task=Task.closed_loop(),
        smoothing_time=smoothing_time,
        knot_rate=10.0,
        max_knots=MAX_KNOTS,
        tolerance_deg=0.1,
    )


def follow(
    request: Request,
    make_limb: Callable[[LimbParameters], LimbSystem],
    folder: str | Path,
    *,
    controller: str = "pi",
    real_time: bool = False,
    live: LivePage | None = None,
) -> Following:
    """Plans, and drives a limb along the plan.

    The folder has ``plan.csv``, ``recording.csv``, ``tracking.png`` and ``report.html``.
    If the limb fails, the plan is there, and of a robot an unfinished recording.

    Args:
        request: of the plan, such as a `closed_loop_request`.
        make_limb: gives the limb for the parameters of the plan.
        controller, real_time, live: as for `soft_limb.runs.drive.drive`.

    Raises:
        PlanningError: if there is no plan.
        ReplayError, HardwareError, OutputError: as `hardware.replay.replay` does.
        LimbError: if a file cannot be read.
    """
    folder = Path(folder)
    say = live.say if live else lambda _: None
    say(f"Planning {request.reference}")
    trajectory = make_plan(request)
    trajectory.save(folder / PLAN)
    say(f"Following {request.reference}, controller {controller}")
    driven = drive(
        trajectory,
        lambda: make_limb(trajectory.parameters),
        folder / RECORDING,
        controller=controller,
        real_time=real_time,
        live=live,
    )
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.plots import plot_tracking, save_figure

    save_figure(plot_tracking(trajectory, [driven.recording]), folder / PICTURE)
    followed = Following(driven)
    data = {"plan": folder / PLAN, "recording": folder / RECORDING, "picture": folder / PICTURE}
    write_drive_report(driven, followed.lines(), folder / REPORT, data)
    return followed
