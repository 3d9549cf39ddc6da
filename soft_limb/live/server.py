"""The process that serves a live page: ``python -m soft_limb.live.server``, by `LivePage` alone."""

import contextlib
import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.web import ErrorHandler

from hardware.live.messages import Reading
from limb_systems import LimbError
from soft_limb.live.document import LiveDocument
from soft_limb.live.gate import Gate, Gated, listen
from soft_limb.live.page import open_in_browser
from soft_limb.live.run import Run
from soft_limb.live.view import View, ViewHandler

PRIORITY = 10  # by which it gives way to who commands
PERIOD = 0.2  # s, of the view
BETWEEN_STOPS = 2.0  # s, so that a second click does not interrupt what the first has begun
FAREWELL = 4.0  # s, in which browsers hear of the end
LARGEST_MESSAGE = 100_000  # bytes, from a browser
LARGEST_DATAGRAM = 65_536


class LiveApplication(Gated, BokehTornado):
    """Bokeh's application and the 3D view, behind the gate."""

    def __init__(self, gate: Gate, view: View, make_document: Callable):
        super().__init__(
            gate,
            {"/": Application(FunctionHandler(make_document))},
            extra_websocket_origins=["*"],  # the gate has looked at them
            extra_patterns=[(r"/view/", ViewHandler, {"view": view})],
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """The handler of a request that may pass; no page of another site needs Bokeh's scripts."""
        if request.path == "/autoload.js":
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})
        return super().find_handler(request, **kwargs)


class StopSwitch:
    """Sends the program that runs the limb the signal of Ctrl-C."""

    def __init__(self, program: int):
        self._program, self._pressed = program, -BETWEEN_STOPS

    def press(self) -> None:
        """Once in two seconds, and only while that program is there."""
        now = time.monotonic()
        if now - self._pressed >= BETWEEN_STOPS and os.getppid() == self._program:
            self._pressed = now
            os.kill(self._program, signal.SIGINT)


class Server:
    """Serves the page of one run, and ends soon after it."""

    def __init__(self, host: str, port: int, messages: socket.socket, program: int):
        """
        Args:
            host, port: address to listen on.
            messages: socket of the program that runs the limb.
            program: number of its process.

        Raises:
            LimbError: if it cannot listen there.
        """
        sockets, gate, self.url = listen(host, port)
        self._loop = IOLoop.current()
        self._run, self._view, self._number = Run(), View(), 0
        self._shown: Reading | None = None
        switch = StopSwitch(program)
        application = LiveApplication(
            gate, self._view, lambda document: LiveDocument(document, self._run, switch.press)
        )
        http_server = HTTPServer(application)
        http_server.add_sockets(sockets)
        BaseServer(self._loop, application, http_server).start()
        self._messages = messages
        messages.setblocking(False)
        self._loop.add_handler(messages, lambda *_: self._take(), IOLoop.READ)
        self._loop.add_handler(sys.stdin.fileno(), lambda *_: self._end(), IOLoop.READ)
        PeriodicCallback(self._show, 1000 * PERIOD).start()

    def serve(self) -> None:
        """Until the run has ended."""
        self._loop.start()

    def _take(self) -> None:
        """All that was told since."""
        with contextlib.suppress(OSError):  # there is no more
            while True:
                data, files, *_ = socket.recv_fds(self._messages, LARGEST_DATAGRAM, 1)
                self._run.take(data, files)

    def _end(self) -> None:
        """The program has said why it ends, or is gone."""
        self._take()
        self._loop.remove_handler(sys.stdin.fileno())
        self._run.end(sys.stdin.read())
        self._loop.call_later(FAREWELL, self._loop.stop)

    def _show(self) -> None:
        run = self._run
        if run.phase is not None and self._number != run.number:
            self._number = run.number
            self._view.begin(run.phase)
        if self._view.watchers and run.reading is not None and run.reading is not self._shown:
            self._shown = run.reading
            self._view.show(run.reading)


def main() -> None:
    """Serves a page as `LivePage` asks for it."""
    host, port, messages, program, open_browser = sys.argv[1:]
    os.nice(PRIORITY)
    settings.resources = "server"  # nothing comes from the network, whatever the environment says
    try:
        server = Server(host, int(port), socket.socket(fileno=int(messages)), int(program))
    except LimbError as error:
        print(error)
        return
    print(server.url, flush=True)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    if int(open_browser):
        open_in_browser(server.url)
    server.serve()


if __name__ == "__main__":
    main()
