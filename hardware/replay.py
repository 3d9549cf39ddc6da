"""Replaying a planned trajectory, open loop."""

from pydrake.systems.framework import System

from limb_systems import LimbError, Recording, Trajectory, simulate


class ReplayError(LimbError):
    """A trajectory must not be replayed on this limb."""


def replay(trajectory: Trajectory, limb: System, *, sample_rate: float = 20.0) -> Recording:
    """Drives a limb with a trajectory's duty and records it, in simulated time.

    Args:
        trajectory: a plan that passed its check.
        limb: a `LimbTwin`, a `Limb` or a system with their ports; it becomes
            part of a diagram and cannot be replayed on twice.
        sample_rate: of the recording, Hz.

    Raises:
        ReplayError: if the trajectory failed its check, or if it was planned
            for another kind of limb or hotter than this one allows.
    """
    check_replayable(trajectory, limb)
    return simulate(limb, trajectory, sample_rate=sample_rate)


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
