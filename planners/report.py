"""What there is to say about a plan, in plain text."""

import numpy as np

from limb_systems import Trajectory


def plan_summary(trajectory: Trajectory) -> str:
    """A few lines on how a plan was found, how it was checked and what limits it."""
    check = trajectory.check
    joints, segments = trajectory.parameters.num_joints, len(trajectory.parameters.segments)
    missed = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))
    lines = [
        f"limb        {segments} segment{'s' * (segments > 1)}, {joints} joints, "
        f"{len(trajectory.parameters.wires)} wires",
        f"plan        {trajectory.duration:g} s, {len(trajectory.time)} knots, "
        f"from request to checked plan in {check.total_time:.2f} s",
        f"solver      {check.solver}: {check.status} in {check.iterations} iterations, "
        f"{check.solve_time:.2f} s; cost {check.cost:.6g} (at the start {check.guess_cost:.6g})",
        f"check       simulated again: within {check.largest_difference_deg:.4f}° of the plan "
        f"(allowed {check.tolerance_deg:g}°); largest defect {check.largest_defect:.1e}",
        f"reference   missed by {missed.mean():.2f}° on average, {missed.max():.2f}° at most",
        "limits      " + ("the plan runs along" if check.active_constraints else "none is active"),
    ]
    stretches = {}
    for active in check.active_constraints:
        stretch = f"{active.start:.1f}-{active.end:.1f}"
        stretches.setdefault(active.bound, []).append(stretch)
    width = max((len(bound) for bound in stretches), default=0)
    lines += [
        f"            {bound.ljust(width)}  at {', '.join(when)} s"
        for bound, when in stretches.items()
    ]
    return "\n".join(lines)
