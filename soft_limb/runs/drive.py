"""Drives limbs along plans by what is named on the command line, and says how it went."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, System

from controllers import PlanFeedback, PlanRegulator, RecedingHorizon
from hardware.replay import replay
from hardware.robot.serial_limb import DEADLINE, SerialLimb
from limb_systems import LimbSystem, Recording, Trajectory
from limb_systems.model.ownership import weak_method
from limb_systems.simulation import PERIOD
from limb_systems.tracking import tracking_errors
from soft_limb.live.page import LivePage

OPEN = "open"
CONTROLLERS = {OPEN: None, "pi": PlanFeedback, "lqr": PlanRegulator, "mpc": RecedingHorizon}
CONTROLLER_HELP = (
    "what drives it: open, the plan's duty; pi, feedback about the plan; lqr, time-varying LQR "
    "about the plan; mpc, plans of the coming seconds towards the reference"
)


@dataclasses.dataclass(frozen=True)
class Drive:
    """How a limb was driven along a plan.

    - ``controller``: its key in `CONTROLLERS`.
    - ``trajectory``, ``recording``: the plan and what came of it.
    - ``late``: by which each command was late, s; None in simulated time.
    - ``lost_samples``: on the cable; None in simulated time.
    - ``replans``: how many plans were begun, late and failed; None if none were to be made.
    """

    controller: str
    trajectory: Trajectory
    recording: Recording
    late: np.ndarray | None
    lost_samples: int | None
    replans: np.ndarray | None

    def facts(self) -> dict:
        """For JSON."""
        recording = self.recording
        errors = tracking_errors(self.trajectory, [recording])
        mean, median, percentile_90 = np.rad2deg(
            [errors.mean, errors.median, errors.percentile_90]
        ).tolist()
        replans = self.replans
        return {
            "source": recording.source,
            "controller": self.controller,
            "interrupted": recording.interrupted,
            "tracking": {
                "mean_deg": mean,
                "median_deg": median,
                "percentile_90_deg": percentile_90,
            },
            "timing": self._timing(),
            "replans": None
            if replans is None
            else dict(zip(("begun", "late", "failed"), replans.astype(int).tolist(), strict=True)),
        }

    def _timing(self) -> dict | None:
        if self.late is None:
            return None
        median, percentile_99 = 1000 * np.percentile(self.late, [50, 99])
        missed = int(np.sum(self.late > DEADLINE))
        return {
            "late_median_ms": float(median),
            "late_percentile_99_ms": float(percentile_99),
            "missed_deadline": missed,
            "missed_deadline_share": missed / len(self.late),
            "lost_samples": self.lost_samples,
            "reduced_s": reduced_time(self.recording),
        }

    def lines(self) -> list[str]:
        """For people."""
        facts = self.facts()
        lines = []
        if timing := facts["timing"]:
            lines += [
                f"timing      commands were late by {timing['late_median_ms']:.1f} ms (median), "
                f"{timing['late_percentile_99_ms']:.1f} ms (99%); {timing['missed_deadline']} "
                f"({timing['missed_deadline_share']:.1%}) by more than {1000 * DEADLINE:g} ms; "
                f"{timing['lost_samples']} samples were lost"
            ]
            if timing["reduced_s"]:
                lines.append(
                    f"reduced     the board reduced the duty for {timing['reduced_s']:.1f} s, as a "
                    "wire got hot, both asked for too much or it was just started"
                )
        lines.append(f"source      {facts['source']}")
        if replans := facts["replans"]:
            lines.append(
                f"replans     {replans['begun']} begun, {replans['late']} late, "
                f"{replans['failed']} failed"
            )
        lines += trouble(self.recording)
        tracking = facts["tracking"]
        lines.append(
            f"tracking    |φ* - φ|: mean {tracking['mean_deg']:.2f}°, median "
            f"{tracking['median_deg']:.2f}°, 90th percentile {tracking['percentile_90_deg']:.2f}°"
        )
        return lines


def trouble(recording: Recording) -> list[str]:
    """Why a recording was interrupted or is to be doubted, a line each."""
    named = {"interrupted": recording.interrupted, "doubt": recording.doubt}
    return [f"{name:<11} {what}" for name, what in named.items() if what]


def drive(
    trajectory: Trajectory,
    make_limb: Callable[[], LimbSystem],
    output: Path,
    *,
    controller: str = OPEN,
    real_time: bool = False,
    live: LivePage | None = None,
) -> Drive:
    """Drives a limb along a plan and writes the recording.

    Args:
        make_limb: gives the limb once its controller is there.
        output: file of the recording; that of a limb in real time is written while it runs.
        controller: a key of `CONTROLLERS`.
        real_time: whether the limb is a robot.
        live: as for `replay`.

    Raises:
        ReplayError, HardwareError, OutputError, LimbError: as `replay` does.
    """
    driver = controller_of(controller, trajectory, real_time=real_time)
    counted = _Counted(driver) if driver and driver.HasOutputPort("replans") else None
    limb = make_limb()
    if driver:
        limb.source += f", driven by {type(driver).__name__}"
    is_slow = real_time or live is not None  # so that it may be stopped on the way
    recording = replay(
        trajectory,
        limb,
        controller=counted or driver,
        journal=output if is_slow else None,
        live=live,
    )
    if not is_slow:
        recording.save(output)
    robot = limb if isinstance(limb, SerialLimb) else None
    return Drive(
        controller,
        trajectory,
        recording,
        np.array(robot.timing_errors) if robot else None,
        robot.link.lost_samples if robot else None,
        counted.replans if counted else None,
    )


def controller_of(name: str, trajectory: Trajectory, *, real_time: bool = False) -> System | None:
    """A controller by its key in `CONTROLLERS`; None for open loop."""
    kind = CONTROLLERS[name]
    if kind is None:
        return None
    return kind(trajectory, real_time=real_time) if kind is RecedingHorizon else kind(trajectory)


def reduced_time(recording: Recording) -> float:
    """s for which the board applied less than a duty that was commanded before and after."""
    assert recording.applied_duty is not None  # a robot's
    commanded = np.minimum(recording.duty[:, :-2], recording.duty[:, 1:-1])
    reduced = (recording.applied_duty[:, 2:] < commanded - 2e-3).any(axis=0)
    return float(np.sum(reduced) / recording.sample_rate)


class _Counted(Diagram):
    """A `RecedingHorizon` with its ports, and what it has counted at the end of a simulation."""

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, controller: System):
        super().__init__()
        builder = DiagramBuilder()
        builder.AddSystem(controller)
        for index in range(controller.num_input_ports()):
            port = controller.get_input_port(index)
            builder.ExportInput(port, port.get_name())
        builder.ExportOutput(controller.GetOutputPort("duty"), "duty")
        counts = controller.GetOutputPort("replans")
        self._last = builder.AddSystem(_Last(counts.size()))
        builder.Connect(counts, self._last.get_input_port())
        builder.BuildInto(self)

    @property
    def replans(self) -> np.ndarray:
        """How many plans were begun, late and failed (3)."""
        return self._last.value


class _Last(LeafSystem):
    """Remembers what came in last, after a simulation and its Context.

    - input 0 ``value``: (size)
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, size: int):
        super().__init__()
        self.value = np.zeros(size)
        self.DeclareVectorInputPort("value", size)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._look))

    def _look(self, context) -> None:
        self.value = self.get_input_port().Eval(context).copy()
