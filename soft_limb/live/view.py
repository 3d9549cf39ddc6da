"""The 3D view of the live page: Meshcat's page without Meshcat's server."""

import gc
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform

from hardware.live_feed import Reading, RunHeader
from limb_systems import joint_angles_from_bend_angle
from limb_systems.views.limb_view import LimbView, ghosts_of_plan, view_of

# The page around it says whether there is a connection, and there is nothing to control.
STYLE = "<style>#status-message, .dg { display: none !important; }</style>"


class View:
    """A limb as it is measured, beside ghosts of its plan and reference, or a robot.

    Where the body of a robot is is not measured: it stays where it stands at first.

    Meshcat's server lets every page of every site command it. Here it lives for the moment in which
    it writes the page of a phase. The site of the live page sends the commands that move the limb.

    - ``page``: HTML.
    """

    def __init__(self):
        self.page = ""
        self._limb: LimbView | None = None

    def begin(self, phase: RunHeader) -> None:
        """Make the page of another limb, or of another plan."""
        self.page, self._limb = "", None  # if this fails
        self._parameters = parameters = phase.parameters
        shown, ghosts = phase.robot or parameters, []
        if phase.plan and shown is parameters:
            ghosts = ghosts_of_plan(parameters, phase.plan)
        limb = view_of(shown, ghosts)
        meshcat = Meshcat(MeshcatParams(host="127.0.0.1", port=0, show_stats_plot=False))
        limb.add_to(meshcat)
        limb.set_scene(meshcat)
        wires = np.zeros(len(parameters.wires))
        limb.show(meshcat, np.zeros(parameters.num_joints), 0.0)
        limb.show_heat(meshcat, wires)
        self.page = meshcat.StaticHtml().replace("</head>", f"{STYLE}</head>")
        self._limb = limb
        del meshcat
        gc.collect()  # a diagram is a cycle of references, and its Meshcat keeps a port open

    def commands(self, reading: Reading) -> list[dict[str, Any]]:
        """The commands by which Meshcat's page shows a reading; none without a view or a value."""
        limb, values = self._limb, [*reading.bend_angle, *reading.measured_temperature]
        if limb is None or not np.isfinite([*values, *reading.duty]).all():
            return []
        told: Any = _Told()
        angles = joint_angles_from_bend_angle(self._parameters, reading.bend_angle)
        limb.show(told, angles, reading.time)
        limb.show_heat(told, np.array(reading.measured_temperature))
        return told.commands


class _Told:
    """Stands in for a Meshcat: keeps the commands, in the form that Meshcat's page takes."""

    def __init__(self):
        self.commands: list[dict[str, Any]] = []

    def SetTransform(self, path: str, pose: RigidTransform, _time: float = 0.0) -> None:
        matrix = pose.GetAsMatrix4().T.ravel().tolist()  # column by column
        command = {"type": "set_transform", "path": f"/drake/{path}", "matrix": matrix}
        self.commands.append(command)

    def SetProperty(self, path: str, name: str, value: list, _time: float = 0.0) -> None:
        command = {"type": "set_property", "path": f"/drake/{path}", "property": name}
        self.commands.append({**command, "value": value})
