"""The process that serves the live page: ``python -m soft_limb.live.server``, by `LivePage` alone.

All that it serves, the 3D view and websockets too, passes one gate. Who asks must name this
server as it names itself, so that no page of another site can ask in a person's name. From
beyond this computer, who asks must also know the token.
"""

import contextlib
import ipaddress
import os
import secrets
import signal
import socket
import sys
import threading
import time
import webbrowser
from collections.abc import Callable
from http.cookies import Morsel
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPMessageDelegate, HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import ErrorHandler, OutputTransform, RequestHandler

from hardware.live.messages import Reading
from soft_limb.live.document import LiveDocument
from soft_limb.live.run import Run
from soft_limb.live.view import View, ViewHandler

PRIORITY = 10  # by which it gives way to who commands
PERIOD = 0.2  # s, of the view
BETWEEN_STOPS = 2.0  # s, so that a second click does not interrupt what the first has begun
FAREWELL = 4.0  # s, in which browsers hear of the end
COOKIE = "soft_limb_live"
LARGEST_MESSAGE = 100_000  # bytes, from a browser
LARGEST_DATAGRAM = 65_536


class Gate:
    """Who may see the page.

    - ``token``: word that is needed; empty if the page is for this computer alone.
    """

    def __init__(self, loopback: bool, port: int):
        self.token = "" if loopback else secrets.token_urlsafe()
        self.cookie = f"{COOKIE}_{port}"  # browsers send those of all ports
        names = ("127.0.0.1", "localhost", "[::1]")
        self._hosts = {f"{name}:{port}" for name in names} if loopback else None

    def is_at_home(self, request: HTTPServerRequest) -> bool:
        """Whether it asks for this server by a name of its own, from none but its own page."""
        host, origin = request.host.lower(), request.headers.get("Origin")
        if self._hosts is not None and host not in self._hosts:
            return False
        return origin is None or origin.lower() == f"http://{host}"

    def knows(self, request: HTTPServerRequest) -> bool:
        """Whether it brings the token in its cookie, or needs none."""
        return not self.token or self._is_token(request.cookies.get(self.cookie, Morsel()).value)

    def introduces_itself(self, request: HTTPServerRequest) -> bool:
        """Whether it brings the token in its address."""
        return any(self._is_token(word.decode()) for word in request.arguments.get("token", []))

    def _is_token(self, word: str | None) -> bool:
        return secrets.compare_digest((word or "").encode(), self.token.encode())


class SignIn(RequestHandler):
    """Keeps the token in a cookie, and takes it out of the address."""

    def initialize(self, gate: Gate) -> None:
        """Takes the gate that has the token."""
        self._gate = gate

    def get(self) -> None:
        """Answers with a cookie."""
        self.set_cookie(self._gate.cookie, self._gate.token, httponly=True, samesite="Strict")
        self.redirect("/")


class ForThisPage(OutputTransform):
    """Tells browsers that no page of another site may contain or read what is served."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        """Adds the headers that say so."""
        headers["X-Frame-Options"] = "SAMEORIGIN"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        return status_code, headers, chunk


class LiveApplication(BokehTornado):
    """Bokeh's application and the 3D view, behind the gate."""

    def __init__(self, gate: Gate, view: View, make_document: Callable):
        self._gate = gate
        super().__init__(
            {"/": Application(FunctionHandler(make_document))},
            extra_websocket_origins=["*"],  # the gate has looked at them
            extra_patterns=[(r"/view/", ViewHandler, {"view": view})],
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )
        self.add_transform(ForThisPage)

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> HTTPMessageDelegate:
        """The handler of a request that may pass."""
        if self._gate.is_at_home(request) and request.path != "/autoload.js":
            if self._gate.knows(request):
                return super().find_handler(request, **kwargs)
            if request.path == "/" and self._gate.introduces_itself(request):
                return self.get_handler_delegate(request, SignIn, {"gate": self._gate})
        return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})


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
            OSError: if it cannot listen there.
        """
        sockets = bind_sockets(port, host)
        port = sockets[0].getsockname()[1]
        loopback = all(
            ipaddress.ip_address(listening.getsockname()[0]).is_loopback for listening in sockets
        )
        self._loop = IOLoop.current()
        self._run, self._view, self._number = Run(), View(), 0
        self._shown: Reading | None = None
        gate, switch = Gate(loopback, port), StopSwitch(program)
        application = LiveApplication(
            gate, self._view, lambda document: LiveDocument(document, self._run, switch.press)
        )
        http_server = HTTPServer(application)
        http_server.add_sockets(sockets)
        BaseServer(self._loop, application, http_server).start()
        name = (
            host if sockets[0].getsockname()[0] not in ("0.0.0.0", "::") else socket.gethostname()
        )
        name = f"[{name}]" if ":" in name else name
        self.url = f"http://{name}:{port}/{f'?token={gate.token}' if gate.token else ''}"
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
    except OSError as error:
        at = f"{host}:{port}" if port != "0" else host
        print(f"The live page cannot be served at {at}: {error.strerror}; give another address.")
        return
    print(server.url, flush=True)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    has_display = {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys() or sys.platform == "darwin"
    if int(open_browser) and has_display:
        threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
    server.serve()


if __name__ == "__main__":
    main()
