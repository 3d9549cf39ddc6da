"""The 3D view of the live page, in the page's process, and how it comes to the browser."""

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.framework import DiagramBuilder
from tornado.httpclient import AsyncHTTPClient, HTTPClientError
from tornado.web import HTTPError
from tornado.websocket import WebSocketClosedError, WebSocketHandler, websocket_connect

from hardware.live.messages import Phase, Reading
from limb_systems import LimbVisualizer, joint_angles_from_bend_angle

# The page around it says whether there is a connection, and there is nothing to control.
STYLE = b"<style>#status-message, .dg { display: none !important; }</style></head>"


class View:
    """A limb in Meshcat, as it is measured, beside ghosts of its plan and reference.

    - ``url``: where Meshcat is, for this computer alone.
    - ``watchers``: how many browsers look at it; without one nothing is drawn.
    """

    def __init__(self):
        self._meshcat = Meshcat(MeshcatParams(host="127.0.0.1", port=0, show_stats_plot=False))
        self.url = self._meshcat.web_url()
        self.watchers = 0

    def begin(self, phase: Phase) -> None:
        """Shows another limb, or another plan."""
        builder = DiagramBuilder()
        view = builder.AddSystem(LimbVisualizer(phase.parameters, self._meshcat, phase.plan))
        for name in ("joint_state", "wire_temperature", "duty"):
            builder.ExportInput(view.GetInputPort(name), name)
        self._parameters, self._diagram = phase.parameters, builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def show(self, reading: Reading) -> None:
        """Shows a reading of the limb that began."""
        angles = joint_angles_from_bend_angle(self._parameters, reading.bend_angle)
        self._context.SetTime(reading.time)
        signals = {
            "joint_state": np.append(angles, np.zeros_like(angles)),
            "wire_temperature": reading.measured_temperature,
            "duty": reading.duty,
        }
        for name, values in signals.items():
            self._diagram.GetInputPort(name).FixValue(self._context, values)
        self._diagram.ForcedPublish(self._context)


class ViewHandler(WebSocketHandler):
    """Passes Meshcat's page and what it sends on to the browser, and nothing back to it."""

    def initialize(self, view: View) -> None:
        """Takes the view that it passes on."""
        self._view = view

    async def get(self, path: str) -> None:
        """Meshcat's page has its websocket at its own address."""
        if self.request.headers.get("Upgrade", "").lower() == "websocket":
            await super().get(path)
            return
        try:
            answer = await AsyncHTTPClient().fetch(f"{self._view.url}/{path}")
        except HTTPClientError as error:
            raise HTTPError(404) from error
        if path:
            self.set_header("Content-Type", "text/javascript")  # Meshcat leaves it to the browser
            self.finish(answer.body)
        else:
            self.finish(answer.body.replace(b"</head>", STYLE))

    def check_origin(self, origin: str) -> bool:
        """The application has checked it, as for all that it serves."""
        return True

    async def open(self, _path: str) -> None:
        """Passes on until either end closes, at the browser's pace."""
        meshcat = await websocket_connect(self._view.url.replace("http", "ws", 1))
        self._view.watchers += 1
        try:
            while (message := await meshcat.read_message()) is not None:
                await self.write_message(message, binary=True)
        except WebSocketClosedError:
            pass
        finally:
            self._view.watchers -= 1
            meshcat.close()
