"""A solution as a picture: violations, distances to bounds and the Jacobian."""

import numpy as np

from limb_systems import Trajectory
from limb_systems.views.plots import WIDTH, Figure, apply_axis_style
from limb_systems.wire_laws.wire_law import TEMPERATURE_SCALE
from planners.task import Task
from planners.transcription.ipopt import ConstraintBlock
from planners.transcription.program import TrajectoryProgram
from planners.transcription.quasi_static import QuasiStaticProgram

SHOWN_INTERVALS = 4  # of the Jacobian; it repeats from interval to interval


def plot_diagnostics(trajectory: Trajectory) -> Figure:
    """A solution: violation of the dynamics, distance to the bounds, and the Jacobian.

    Everything is scaled as for the solver. The Jacobian is shown for the first intervals; all
    others look the same.
    """
    parameters, time = trajectory.parameters, trajectory.time
    model = trajectory.model
    n = model.layout.num_joints
    num_states = model.wires.num_states
    figure = Figure(figsize=(WIDTH, 8.5), layout="constrained")
    defects_axis, room_axis, jacobian_axis = figure.subplots(3, 1, height_ratios=[1, 1, 1.3])

    sizes = {"θ": n, "θ̇": n, "wires": num_states, "V": len(parameters.wires)}
    program: TrajectoryProgram | QuasiStaticProgram
    block: ConstraintBlock
    if model.layout.is_planar:
        program = TrajectoryProgram(model, time)
        block, x = program.defects, program.variables(trajectory.state, trajectory.duty)
        motion, heat = (block.evaluate(x) for block in program.blocks)
        places = block.rows % (len(time) - 1) * 2 * n + block.rows // (len(time) - 1)
        defects = np.vstack([motion.reshape(2 * n, -1), heat.reshape(len(time) - 1, -1).T])
    else:  # which has heat alone
        program = QuasiStaticProgram(model, time, model.statics, Task())
        block, x = program.blocks[0], program.variables(trajectory.state[2 * n :], trajectory.duty)
        defects, places = block.evaluate(x).reshape(len(time) - 1, -1).T, block.rows
        sizes = {"wires": num_states, "V": len(parameters.wires)}
    ends = np.cumsum([*sizes.values()])[:-1]
    for label, rows in zip(sizes, np.split(np.abs(defects), ends), strict=True):
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
        apply_axis_style(axis)

    # Rows interval by interval.
    shown = places < SHOWN_INTERVALS * len(block.lower) // (len(time) - 1)
    shown &= ~np.isin(block.columns, program.time_steps)
    _, columns = np.unique(block.columns[shown], return_inverse=True)
    jacobian_axis.plot(columns, places[shown], "s", color="0.25", markersize=2.0)
    share = len(block.rows) / (len(block.lower) * program.prog.num_vars())
    jacobian_axis.set_title(
        f"Jacobian of (17), first {SHOWN_INTERVALS} of {len(time) - 1} intervals\n"
        f"({len(block.rows)} nonzeros, {100 * share:.2g}% of it)",
        fontsize=10,
    )
    jacobian_axis.invert_yaxis()
    jacobian_axis.set_aspect("equal")
    jacobian_axis.set_xlabel("variable")
    jacobian_axis.set_ylabel("constraint")
    return figure
