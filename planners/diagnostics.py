"""The diagram of a solution: violations, distances to bounds and the Jacobian."""

import numpy as np

from limb_systems import Trajectory
from limb_systems.views.plots import WIDTH, Figure, apply_axis_style
from limb_systems.wire_laws.wire_law import TEMPERATURE_SCALE
from planners.task import Task
from planners.transcription.ipopt import ConstraintBlock
from planners.transcription.program import TrajectoryProgram
from planners.transcription.quasi_static import QuasiStaticProgram

NUM_DRAWN_INTERVALS = 4  # of the drawn Jacobian; it repeats from interval to interval
MIN_DRAWN_DEFECT = 1e-17  # below rounding errors: a logarithmic axis has no place for zero


def plot_diagnostics(trajectory: Trajectory) -> Figure:
    """Draw a solution: violation of the dynamics, distance to the bounds, and the Jacobian.

    A defect is the error of the collocation equations (17) in an interval between two knots: how
    far the solution violates the dynamics there. Everything is scaled as for the solver. The
    Jacobian is drawn for the first intervals; all others look the same.
    """
    figure = Figure(figsize=(WIDTH, 8.5), layout="constrained")
    defects_axis, bounds_axis, jacobian_axis = figure.subplots(3, 1, height_ratios=[1, 1, 1.3])
    _plot_bounds(bounds_axis, trajectory)

    # Evaluate the defects (row, interval). The Jacobian is the motion's, or the heat's in space.
    time = trajectory.time
    num_intervals = len(time) - 1
    model = trajectory.model
    num_joints = model.layout.num_joints
    # Numbers of rows by kind: states of the wires, and readings V of the thermocouples.
    num_rows = {"wires": model.wires.num_states, "V": model.wires.num_wires}
    program: TrajectoryProgram | QuasiStaticProgram
    block: ConstraintBlock
    if model.layout.is_planar:
        program = TrajectoryProgram(model, time)
        block = program.defects
        x = program.variables(trajectory.state, trajectory.duty)
        motion, heat = (each_block.evaluate(x) for each_block in program.blocks)
        defects = np.vstack([motion.reshape(2 * num_joints, -1), heat.reshape(num_intervals, -1).T])
        # The block has all intervals of one row of θ or θ̇, then of the next; draw by interval.
        interval = block.rows % num_intervals
        row_in_interval = block.rows // num_intervals
        drawn_rows = interval * 2 * num_joints + row_in_interval
        num_rows = {"θ": num_joints, "θ̇": num_joints, **num_rows}
    else:  # a program of the heat alone
        program = QuasiStaticProgram(model, time, model.statics, Task())
        block = program.blocks[0]
        x = program.variables(trajectory.state[2 * num_joints :], trajectory.duty)
        defects = block.evaluate(x).reshape(num_intervals, -1).T
        drawn_rows = block.rows  # in the order of intervals already

    # Draw the largest defect of each kind.
    ends = np.cumsum([*num_rows.values()])[:-1]
    for label, rows in zip(num_rows, np.split(np.abs(defects), ends), strict=True):
        largest = np.maximum(rows.max(axis=0), MIN_DRAWN_DEFECT)
        defects_axis.semilogy(time[:-1], largest, linewidth=1.0, label=f"largest of {label}")
    defects_axis.set_ylabel("violation of the\ndynamics (17), scaled")
    for axis in (defects_axis, bounds_axis):
        axis.set_xlim(time[0], time[-1])
        axis.set_xlabel("time (s)")
        apply_axis_style(axis)

    # Draw the nonzeros of the first intervals, without the columns of the (fixed) time steps.
    is_drawn = drawn_rows < NUM_DRAWN_INTERVALS * len(block.lower) // num_intervals
    time_step_columns = program.time_steps
    is_drawn &= ~np.isin(block.columns, time_step_columns)
    _, columns = np.unique(block.columns[is_drawn], return_inverse=True)
    jacobian_axis.plot(columns, drawn_rows[is_drawn], "s", color="0.25", markersize=2.0)
    share = len(block.rows) / (len(block.lower) * program.prog.num_vars())
    jacobian_axis.set_title(
        f"Jacobian of (17), first {NUM_DRAWN_INTERVALS} of {num_intervals} intervals\n"
        f"({len(block.rows)} nonzeros, {100 * share:.2g}% of it)",
        fontsize=10,
    )
    jacobian_axis.invert_yaxis()
    jacobian_axis.set_aspect("equal")
    jacobian_axis.set_xlabel("variable")
    jacobian_axis.set_ylabel("constraint")
    return figure


def _plot_bounds(axis, trajectory: Trajectory) -> None:
    """Draw the distances of duty and temperature from their bounds (18)-(20)."""
    time = trajectory.time
    limits = trajectory.parameters.temperature_limits
    for index, name in enumerate(trajectory.parameters.wire_names):
        duty = trajectory.duty[index]
        color = f"C{index}"
        axis.plot(
            time, np.minimum(duty, 1 - duty), color=color, linewidth=1.0, label=f"duty {name}"
        )
        wire = trajectory.wire_temperature[index]
        above_warm = np.where(time > limits.warm_up_time, wire - limits.warm, np.inf)
        room = np.minimum(above_warm, limits.maximum - wire) / TEMPERATURE_SCALE
        axis.plot(time, room, "--", color=color, linewidth=1.0, label=f"T {name}")
    axis.axhline(0.0, color="0.4", linewidth=0.8)
    axis.set_ylabel("distance to bounds\n(18)-(20), scaled")
