"""The 3D view of the live page: Meshcat's page without Meshcat's server."""

import asyncio
import contextlib
import gc
import json
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from hardware.live.messages import Reading, RunHeader
from limb_systems import LimbParameters, joint_angles_from_bend_angle
from limb_systems.views.limb_view import LimbView, ghosts_of_plan

# The page around it says whether there is a connection, and there is nothing to control.
STYLE = "<style>#status-message, .dg { display: none !important; }</style>"
LISTEN = """
<script>
  new WebSocket(location.href.replace("http", "ws")).onmessage = (event) => {
    const commands = JSON.parse(event.data);
    if (!commands) location.reload();
    else if (typeof viewer !== "undefined")  // there is none before the first limb
      commands.forEach((command) => viewer.handle_command(command));
  };
</script>
</body>"""
EMPTY = f"<!DOCTYPE html><html><head></head><body>{LISTEN}</html>"


class View:
    """A limb as it is measured, beside ghosts of its plan and reference, or a robot.

    Where the body of a robot is is not measured: it stays where it stands at first.

    Meshcat's server lets every page of every site command it. Here it lives for the
    moment in which it writes the page of a phase; what moves then goes to the browsers
    from here, by the websocket of the page, which passes the gate.

    - ``page``: HTML.
    - ``watchers``: the browsers that look at it; without one nothing is drawn.
    """

    def __init__(self):
        self.page = EMPTY
        self.watchers: set[ViewHandler] = set()

    def begin(self, phase: RunHeader) -> None:
        """Shows another limb, or another plan."""
        self._parameters = parameters = phase.parameters
        shown, ghosts = phase.robot or parameters, []
        if phase.plan and shown is parameters:
            ghosts = ghosts_of_plan(parameters, phase.plan)
        self._limb = LimbView(shown, ghosts)
        meshcat = Meshcat(MeshcatParams(host="127.0.0.1", port=0, show_stats_plot=False))
        self._limb.add_to(meshcat)
        self._limb.set_scene(meshcat)
        self._limb.show(
            meshcat, np.zeros(parameters.num_joints), np.zeros(len(parameters.wires)), 0.0
        )
        self._limb.show_heat(meshcat, np.zeros(len(parameters.wires)))
        page = meshcat.StaticHtml()
        self.page = page.replace("</head>", f"{STYLE}</head>").replace("</body>", LISTEN)
        del meshcat
        gc.collect()  # a diagram is a cycle of references, and its Meshcat keeps a port open
        for watcher in self.watchers:
            watcher.reload()

    def show(self, reading: Reading) -> None:
        """Shows a reading of the limb that began."""
        if np.isfinite([*reading.bend_angle, *reading.measured_temperature, *reading.duty]).all():
            said = commands(self._limb, self._parameters, reading)
            for watcher in self.watchers:
                watcher.tell(said)


def commands(limb: LimbView, parameters: LimbParameters, reading: Reading) -> list[dict]:
    """What tells Meshcat's page to show a reading."""
    told = _Told()
    meshcat: Any = told
    angles = joint_angles_from_bend_angle(parameters, reading.bend_angle)
    limb.show(meshcat, angles, np.array(reading.duty), reading.time)
    limb.show_heat(meshcat, np.array(reading.measured_temperature))
    return told.commands


class _Told:
    """In place of a Meshcat: keeps what it is told, as its page takes it."""

    def __init__(self):
        self.commands: list[dict] = []

    def SetTransform(self, path: str, pose: RigidTransform, _time: float = 0.0) -> None:
        matrix = pose.GetAsMatrix4().T.ravel().tolist()  # column by column
        command = {"type": "set_transform", "path": f"/drake/{path}", "matrix": matrix}
        self.commands.append(command)

    def SetProperty(self, path: str, name: str, value: list, _time: float = 0.0) -> None:
        command = {"type": "set_property", "path": f"/drake/{path}", "property": name}
        self.commands.append({**command, "value": value})


class ViewHandler(WebSocketHandler):
    """Serves the view's page, and its websocket at the same address."""

    def initialize(self, view: View) -> None:
        """Takes the view that it shows."""
        self._view = view
        self._sent: asyncio.Future[None] | None = None

    async def get(self, *_: str) -> None:
        """The page, or its websocket."""
        if self.request.headers.get("Upgrade", "").lower() == "websocket":
            await super().get()
        else:
            self.finish(self._view.page)

    def check_origin(self, origin: str) -> bool:
        """The application has checked it, as for all that it serves."""
        return True

    def open(self, *_: str) -> None:
        """Begins to tell a browser."""
        self._view.watchers.add(self)

    def tell(self, what: list[dict]) -> None:
        """Sends commands, unless the browser has not yet taken what came before."""
        if self._sent is None or self._sent.done():
            with contextlib.suppress(WebSocketClosedError):
                self._sent = self.write_message(json.dumps(what))

    def reload(self) -> None:
        """Lets the browser ask for the page again."""
        with contextlib.suppress(WebSocketClosedError):
            self.write_message("null")

    def on_close(self) -> None:
        """Forgets the browser."""
        self._view.watchers.discard(self)
