"""Where pages are served, and who may see them.

Everything that a server has passes one gate, websockets too. A request must name the server as the
server names itself, so that no page of another site can ask in a person's name. A request from
beyond this computer must also bring the token.
"""

import ipaddress
import secrets
import socket
from collections.abc import Sequence
from http.cookies import Morsel
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.netutil import bind_sockets
from tornado.web import Application, ErrorHandler, HTTPError, OutputTransform, RequestHandler

from limb_systems import LimbError

COOKIE = "soft_limb_live"
LARGEST_MESSAGE = 1000  # bytes, from a browser
PING = 10.0  # s, between the signs of life that a browser must give


class Gate:
    """Who may see a site.

    - ``token``: word that a request must bring; empty if the site is for this computer alone.
    """

    def __init__(self, loopback: bool, port: int):
        self.token = "" if loopback else secrets.token_urlsafe()
        self.cookie = f"{COOKIE}_{port}"  # browsers send the cookies of all ports
        names = ("127.0.0.1", "localhost", "[::1]")
        self._hosts = {f"{name}:{port}" for name in names} if loopback else None

    def is_at_home(self, request: HTTPServerRequest) -> bool:
        """Whether a request names this server, and comes from no page but the server's own."""
        host, origin = request.host.lower(), request.headers.get("Origin")
        if self._hosts is not None and host not in self._hosts:
            return False
        return origin is None or origin.lower() == f"http://{host}"

    def knows(self, request: HTTPServerRequest) -> bool:
        """Whether a request brings the token in its cookie, or needs none."""
        return not self.token or self._is_token(request.cookies.get(self.cookie, Morsel()).value)

    def introduces_itself(self, request: HTTPServerRequest) -> bool:
        """Whether a request brings the token in its address."""
        return any(self._is_token(word.decode()) for word in request.arguments.get("token", []))

    def _is_token(self, word: str | None) -> bool:
        return secrets.compare_digest((word or "").encode(), self.token.encode())


class Site(Application):
    """Pages behind a gate.

    - ``url``: address of the first page, with the token if there is one.
    - ``gate``: who may see the pages.
    """

    def __init__(self, host: str, port: int, handlers: Sequence[tuple[str, type]]):
        """
        Args:
            host, port: address to listen on; port 0 is any that is free.
            handlers: what answers each path.

        Raises:
            LimbError: if it cannot listen there.
        """
        try:
            self._sockets = bind_sockets(port, host)
        except OSError as error:
            at = f"{host}:{port}" if port else host
            raise LimbError(
                f"The page cannot be served at {at}: {error.strerror}; give another address."
            ) from error
        addresses = [ipaddress.ip_address(one.getsockname()[0]) for one in self._sockets]
        port = self._sockets[0].getsockname()[1]
        self.gate = Gate(all(address.is_loopback for address in addresses), port)
        name = socket.gethostname() if addresses[0].is_unspecified else host
        token = f"?token={self.gate.token}" if self.gate.token else ""
        self.url = f"http://{f'[{name}]' if ':' in name else name}:{port}/{token}"
        super().__init__(
            [*handlers],
            log_function=lambda handler: None,
            websocket_max_message_size=LARGEST_MESSAGE,
            websocket_ping_interval=PING,
        )
        self.add_transform(_ForThisSite)

    def open(self) -> HTTPServer:
        """Begin to answer, in the event loop that runs."""
        server = HTTPServer(self)
        server.add_sockets(self._sockets)
        return server

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """The handler of a request that may pass."""
        if self.gate.is_at_home(request):
            if self.gate.knows(request):
                return super().find_handler(request, **kwargs)
            if request.path == "/" and self.gate.introduces_itself(request):
                return self.get_handler_delegate(request, _SignIn)
        return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})


class _ForThisSite(OutputTransform):
    """Tells browsers to keep nothing, and that no page of another site may contain or read it."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        headers["X-Frame-Options"] = "SAMEORIGIN"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Cache-Control"] = "no-store"
        return status_code, headers, chunk


class PageHandler(RequestHandler):
    """A page, which answers with one sentence if it cannot be shown."""

    application: Any

    def write_error(self, status_code: int, **details: Any) -> None:
        """Answer with the sentence of a `LimbError`, or with the name of the status."""
        error = details.get("exc_info", (None, None))[1]
        said = str(error) if isinstance(error, LimbError) else self._reason
        self.set_status(409 if isinstance(error, LimbError) else status_code)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{said}\n")

    def log_exception(self, kind: Any, error: Any, trace: Any) -> None:
        """Log errors that are not for users."""
        if not isinstance(error, LimbError | HTTPError):
            super().log_exception(kind, error, trace)


class _SignIn(PageHandler):
    """Keeps the token in a cookie, and takes it out of the address."""

    def get(self) -> None:
        gate = self.application.gate
        self.set_cookie(gate.cookie, gate.token, httponly=True, samesite="Strict")
        self.redirect("/")
