"""A summary of a plan, in words, in numbers and as a picture."""

from typing import Any

import numpy as np

from limb_systems import Trajectory
from limb_systems.model.wire_law import TEMPERATURE_SCALE
from limb_systems.model.wires import num_wire_states
from limb_systems.views.figure import Figure
from limb_systems.views.plots import WIDTH, dress
from planners.program import TrajectoryProgram

SHOWN_INTERVALS = 4  # of the Jacobian; it repeats from interval to interval


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
    if check.highest_readings:
        lines.insert(
            -1,
            f"band        of limbs alike: ±{check.bend_band_deg:.2f}° about the plan (95%), "
            f"readings up to {max(check.highest_readings):.0f} °C (99.5%)",
        )
    stretches: dict[str, list[str]] = {}
    for active in check.active_constraints:
        stretch = f"{active.start:.1f}-{active.end:.1f}"
        stretches.setdefault(active.bound, []).append(stretch)
    width = max((len(bound) for bound in stretches), default=0)
    lines += [
        f"            {bound.ljust(width)}  at {', '.join(when)} s"
        for bound, when in stretches.items()
    ]
    return "\n".join(lines)


def plan_facts(trajectory: Trajectory) -> dict[str, Any]:
    """The content of `plan_summary` for programs: numbers, with the unit in the name."""
    check = trajectory.check
    missed = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))
    return {
        "duration_s": trajectory.duration,
        "knots": len(trajectory.time),
        "solver": check.solver,
        "status": check.status,
        "iterations": check.iterations,
        "refinements": check.refinements,
        "solve_time_s": check.solve_time,
        "total_time_s": check.total_time,
        "cost": check.cost,
        "guess_cost": check.guess_cost,
        "largest_defect": check.largest_defect,
        "largest_difference_deg": check.largest_difference_deg,
        "tolerance_deg": check.tolerance_deg,
        "reference_missed_mean_deg": float(missed.mean()),
        "reference_missed_largest_deg": float(missed.max()),
        "bend_band_deg": check.bend_band_deg if check.highest_readings else None,
        "highest_readings_c": check.highest_readings,
        "active_constraints": [
            {"bound": active.bound, "start_s": active.start, "end_s": active.end}
            for active in check.active_constraints
        ],
    }


def plot_diagnostics(trajectory: Trajectory) -> Figure:
    """A solution: violation of the dynamics, distance to the bounds, and the Jacobian.

    Everything is scaled as for the solver. The Jacobian is that of the first
    intervals; all others look the same.
    """
    parameters, time = trajectory.parameters, trajectory.time
    n, num_states = parameters.num_joints, len(trajectory.state)
    program = TrajectoryProgram(parameters, time)
    x = program.variables(trajectory.state, trajectory.duty)
    figure = Figure(figsize=(WIDTH, 8.5), layout="constrained")
    defects_axis, room_axis, jacobian_axis = figure.subplots(3, 1, height_ratios=[1, 1, 1.3])

    defects = np.abs(program.defects_of(x))
    sizes = np.cumsum([n, n, num_wire_states(parameters)])
    for label, rows in zip(("θ", "θ̇", "wires", "V"), np.split(defects, sizes), strict=True):
        largest = np.maximum(rows.max(axis=0), 1e-17)
        defects_axis.semilogy(time[:-1], largest, linewidth=1.0, label=f"largest of {label}")
    defects_axis.set_ylabel("violation of the\ndynamics (17), scaled")

    limits = parameters.temperature_limits
    for index, name in enumerate(parameters.wire_names):
        duty = trajectory.duty[index]
        room = np.minimum(duty, 1 - duty)
        color = f"C{index}"
        room_axis.plot(time, room, color=color, linewidth=1.0, label=f"duty {name}")
        wire = trajectory.wire_temperature[index]
        low = np.where(time > limits.warm_up_time, wire - limits.warm, np.inf)
        room = np.minimum(low, limits.maximum - wire) / TEMPERATURE_SCALE
        room_axis.plot(time, room, "--", color=color, linewidth=1.0, label=f"T {name}")
    room_axis.axhline(0.0, color="0.4", linewidth=0.8)
    room_axis.set_ylabel("distance to bounds\n(18)-(20), scaled")
    for axis in (defects_axis, room_axis):
        axis.set_xlim(time[0], time[-1])
        axis.set_xlabel("time (s)")
        dress(axis)

    if program.defects is not None:
        shown = program.defects.rows < SHOWN_INTERVALS * num_states
        shown &= ~np.isin(program.defects.columns, program.time_steps)
        rows, columns = program.defects.rows[shown], program.defects.columns[shown]
        _, columns = np.unique(columns, return_inverse=True)
        jacobian_axis.plot(columns, rows, "s", color="0.25", markersize=2.0)
        share = len(program.defects.rows) / (len(program.defects.lower) * program.prog.num_vars())
        jacobian_axis.set_title(
            f"Jacobian of (17), first {SHOWN_INTERVALS} of {len(time) - 1} intervals "
            f"({len(program.defects.rows)} nonzeros, {100 * share:.2g}% of it)",
            fontsize=10,
        )
        jacobian_axis.invert_yaxis()
        jacobian_axis.set_aspect("equal")
    jacobian_axis.set_xlabel("variable")
    jacobian_axis.set_ylabel("constraint")
    return figure
