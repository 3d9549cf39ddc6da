"""How far a plan is from its reference, where, and why."""

import numpy as np

from limb_systems import LimbError, LimbParameters, Trajectory, bend_angle
from limb_systems.model.statics import static_equilibrium

# A plan is far if a side's largest angle is missed by more than a share of the largest that is
# asked for, or the mean of the misses is more than another; but not by less than a degree.
SHARE_OF_LARGEST = 0.15
SHARE_ON_AVERAGE = 0.2
LITTLE = np.deg2rad(1.0)


def missed(trajectory: Trajectory) -> np.ndarray:
    """|φ_ref - φ*| at the knots (S, K), degrees."""
    return np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))


def far_from_reference(trajectory: Trajectory) -> str | None:
    """How far, where and why a plan is far from its reference, or None if it is not."""
    reference, planned = trajectory.reference, trajectory.bend_angle
    largest = np.abs(reference).max()
    short = np.array(
        [
            (reference - planned.max(axis=1, keepdims=True)).max(axis=1),
            (planned.min(axis=1, keepdims=True) - reference).max(axis=1),
        ]
    )
    is_short = short.max() > max(LITTLE, SHARE_OF_LARGEST * largest)
    distance = np.abs(reference - planned)
    if not is_short and distance.mean() <= max(LITTLE, SHARE_ON_AVERAGE * largest):
        return None
    if is_short:
        side, segment = map(int, np.unravel_index(np.argmax(short), short.shape))
        sign = (1, -1)[side]
        wanted, reached = sign * reference[segment], sign * planned[segment]
        # Where it comes nearest to what it never reaches.
        knot = int(np.argmax(np.where(wanted > reached.max(), reached, -np.inf)))
    else:
        segment, knot = map(int, np.unravel_index(np.argmax(distance), distance.shape))
    asked, has = np.rad2deg([reference[segment, knot], planned[segment, knot]])
    time = trajectory.time[knot]
    of_segment = f" of segment {segment + 1}" if len(reference) > 1 else ""
    misses = missed(trajectory)
    said = (
        f"The plan is far from its reference: {misses.mean():.1f}° on average, {misses.max():.1f}° "
        f"at most. At {time:.1f} s, {asked:.1f}°{of_segment} are asked for, and the plan has "
        f"{has:.1f}°"
    )
    active = [
        constraint.bound
        for constraint in trajectory.check.active_constraints
        if constraint.start <= time <= constraint.end
    ]
    said += f", where limits are {', '.join(active)}." if active else ", where no limit is active."
    reach = _reach(trajectory.parameters, segment)
    if reach is not None:
        said += (
            f" With wires between T_warm and T_max, this limb can hold {reach[0]:.1f}° to "
            f"{reach[1]:.1f}°."
        )
    return said + " Ask for less, or for a slower motion."


def _reach(parameters: LimbParameters, segment: int) -> np.ndarray | None:
    """The least and the largest bend angle (2,) that a segment can hold, degrees, if known."""
    limits = parameters.temperature_limits
    sides = np.sign([wire.direction for wire in parameters.segments[segment].wires])
    held = []
    for side in (-1, 1):
        temperature = np.full(len(parameters.wires), limits.warm)
        of_segment = temperature[parameters.wire_slices[segment]]  # a view
        of_segment[sides == side] = limits.maximum
        try:
            angles, _ = static_equilibrium(parameters, temperature)
        except LimbError:
            return None  # it folds
        held.append(bend_angle(parameters, angles[:, None])[segment, 0])
    return np.rad2deg(held)
