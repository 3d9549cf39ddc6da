"""Replaying a planned trajectory, open loop, and recording a limb that is moved by hand."""

import contextlib
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import MatrixGain, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from hardware.robot.journal import add_journal
from limb_systems import (
    LimbError,
    LimbVisualizer,
    Recording,
    Trajectory,
    joint_angles_from_bend_angle,
    simulate,
)
from limb_systems.simulation import REAL_TIME_STEP, record

AMBIENT_TOLERANCE = 10.0  # °C, by which a wire may differ from where the plan starts


class ReplayError(LimbError):
    """A trajectory must not be replayed on this limb."""


def replay(
    trajectory: Trajectory,
    limb: System,
    *,
    sample_rate: float = 20.0,
    journal: str | Path | None = None,
    meshcat: Meshcat | None = None,
) -> Recording:
    """Drives a limb with a trajectory's duty and records it.

    A `SerialLimb` is driven in real time and closed at the end, whatever the
    end is: the wires are off then. All else is simulated, in real time if it
    is shown.

    Args:
        trajectory: a plan that passed its check.
        limb: a `SerialLimb`, a `LimbTwin`, a `Limb` or a system with their
            ports; it becomes part of a diagram and cannot be replayed on twice.
        sample_rate: of the recording, Hz.
        journal: file to which each sample goes as it comes.
        meshcat: where to show the limb meanwhile, by its bend angle, measured
            temperatures and duty, with ghosts of the plan and its reference.

    Raises:
        ReplayError: if the trajectory failed its check, if it was planned for
            another limb, hotter than this one allows or from another
            temperature than its wires have.
        HardwareError: if the robot fails on the way.
        LimbError: if it is to be shown, and is of another shape than the plan's.
    """
    with contextlib.closing(limb) if _is_robot(limb) else contextlib.nullcontext():
        check_replayable(trajectory, limb)
        if not _is_robot(limb) and journal is None and meshcat is None:
            return simulate(limb, trajectory, sample_rate=sample_rate)
        duty = trajectory.duty_trajectory()
        duty.shiftRight(-trajectory.time[0])
        return _run(limb, duty, trajectory.duration, sample_rate, journal, meshcat, trajectory)


def watch(
    limb: System,
    duration: float,
    *,
    sample_rate: float = 20.0,
    journal: str | Path | None = None,
    meshcat: Meshcat | None = None,
) -> Recording:
    """Records a limb with its wires off, while it hangs, swings or is moved by hand.

    Args:
        duration: s.
        limb, sample_rate, journal, meshcat: as for `replay`.

    Raises:
        HardwareError: if the robot fails on the way.
    """
    off = PiecewisePolynomial.ZeroOrderHold(
        [0.0, duration], np.zeros((len(limb.parameters.wires), 2))
    )
    with contextlib.closing(limb) if _is_robot(limb) else contextlib.nullcontext():
        return _run(limb, off, duration, sample_rate, journal, meshcat)


def check_replayable(trajectory: Trajectory, limb: System) -> None:
    """Raises ReplayError if a trajectory must not be replayed on a limb."""
    if failure := trajectory.check.failure():
        raise ReplayError(f"This trajectory failed its check and is not replayed: {failure}")
    planned, present = trajectory.parameters, limb.parameters
    if len(planned.wires) != len(present.wires):
        raise ReplayError(
            f"This trajectory drives {len(planned.wires)} wires, but the limb has "
            f"{len(present.wires)}."
        )
    hottest, limit = trajectory.wire_temperature.max(), present.temperature_limits.maximum
    if hottest > limit + 1e-6:
        raise ReplayError(
            f"This trajectory heats a wire to {hottest:.1f} °C, but this limb's "
            f"temperature_limits.maximum is {limit:g} °C; plan it again for this limb."
        )
    if _is_robot(limb):
        _check_robot(trajectory, limb)


def _check_robot(trajectory: Trajectory, limb) -> None:
    """What only a robot can tell: who it is, and how warm."""
    board, planned = limb.info.serial_number, trajectory.parameters
    if planned.board.identity and planned.board.identity != board:
        raise ReplayError(
            f"This trajectory was planned with the calibration of the limb "
            f"{planned.board.identity}, but the limb on {limb.link.port} is {board}; calibrate "
            "that one."
        )
    limit = planned.temperature_limits.maximum
    if limit > limb.info.temperature_limit:
        raise ReplayError(
            f"This trajectory may heat wires to {limit:g} °C, but the board switches off at "
            f"{limb.info.temperature_limit:g} °C; plan it again with a lower "
            "temperature_limits.maximum."
        )
    measured = limb.link.sample().temperature
    for name, now, start in zip(
        planned.wire_names, measured, trajectory.measured_temperature[:, 0], strict=True
    ):
        if abs(now - start) > AMBIENT_TOLERANCE:
            raise ReplayError(
                f"The {name} wire is at {now:.1f} °C, but the trajectory starts at {start:.1f} °C; "
                "wait until it has cooled, or plan from where it is."
            )


def _run(
    limb: System,
    duty,
    duration: float,
    sample_rate: float,
    journal,
    meshcat: Meshcat | None,
    plan: Trajectory | None = None,
) -> Recording:
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(duty))
    builder.AddSystem(limb)
    writer = None
    if journal is not None:
        writer = add_journal(builder, journal, limb, source.get_output_port(), sample_rate)
    try:
        if meshcat is not None:
            _add_view(builder, limb, source.get_output_port(), meshcat, plan)
        return record(
            builder,
            limb,
            source.get_output_port(),
            duration,
            real_time=meshcat is not None,
            sample_rate=sample_rate,
            remark=_remark(limb) if _is_robot(limb) else None,
        )
    finally:
        if writer:
            writer.close()


def _add_view(
    builder: DiagramBuilder,
    limb: System,
    duty: OutputPort,
    meshcat: Meshcat,
    plan: Trajectory | None,
) -> None:
    """Shows a limb as it is measured; its joint angles follow from the bend angle by eqn (11)."""
    angles = joint_angles_from_bend_angle(
        limb.parameters, np.eye(limb.GetOutputPort("bend_angle").size())
    )
    joint_state = builder.AddSystem(MatrixGain(np.vstack([angles, np.zeros_like(angles)])))
    # At the period of the robot, which was added before: its command leaves first.
    view = builder.AddSystem(
        LimbVisualizer(limb.parameters, meshcat, plan, publish_period=REAL_TIME_STEP)
    )
    builder.Connect(limb.GetOutputPort("bend_angle"), joint_state.get_input_port())
    builder.Connect(joint_state.get_output_port(), view.GetInputPort("joint_state"))
    measured = limb.GetOutputPort("measured_temperature")
    builder.Connect(measured, view.GetInputPort("wire_temperature"))
    builder.Connect(duty, view.GetInputPort("duty"))


def _remark(limb: System):
    """Angle, temperatures and duty for the progress line."""

    def remark(root: Context) -> str:
        context = limb.GetMyContextFromRoot(root)
        values = [port.Eval(context) for port in map(limb.get_output_port, range(2))]
        (left, right), (angle,) = values
        duty = limb.get_input_port().Eval(context)
        return (
            f"φ {np.rad2deg(angle):+5.1f}°, left {left:.1f} °C at {duty[0]:.2f}, "
            f"right {right:.1f} °C at {duty[1]:.2f}"
        )

    return remark


def _is_robot(limb: System) -> bool:
    return getattr(limb, "real_time", False)
