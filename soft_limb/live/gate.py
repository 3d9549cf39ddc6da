"""Where a page is served, and who may see it.

All that a server has, a 3D view and websockets too, passes one gate. Who asks must name the
server as it names itself, so that no page of another site can ask in a person's name. From
beyond this computer, who asks must also know the token.
"""

import ipaddress
import secrets
import socket
from http.cookies import Morsel
from typing import Any

from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.netutil import bind_sockets
from tornado.web import Application, ErrorHandler, OutputTransform, RequestHandler

from limb_systems import LimbError

COOKIE = "soft_limb_live"


def listen(host: str, port: int) -> tuple[list[socket.socket], "Gate", str]:
    """The sockets of a page, its gate and its URL, which has the token if there is one.

    Args:
        port: number of the port; 0 for any that is free.

    Raises:
        LimbError: if it cannot listen there.
    """
    try:
        sockets = bind_sockets(port, host)
    except OSError as error:
        at = f"{host}:{port}" if port else host
        raise LimbError(
            f"The page cannot be served at {at}: {error.strerror}; give another address."
        ) from error
    addresses = [ipaddress.ip_address(one.getsockname()[0]) for one in sockets]
    port = sockets[0].getsockname()[1]
    gate = Gate(all(address.is_loopback for address in addresses), port)
    name = socket.gethostname() if addresses[0].is_unspecified else host
    name = f"[{name}]" if ":" in name else name
    return sockets, gate, f"http://{name}:{port}/{f'?token={gate.token}' if gate.token else ''}"


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


class Gated(Application):
    """An application of Tornado's behind a gate."""

    def __init__(self, gate: Gate, *arguments: Any, **settings: Any):
        self._gate = gate
        super().__init__(*arguments, **settings)
        self.add_transform(ForThisPage)

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """The handler of a request that may pass."""
        if self._gate.is_at_home(request):
            if self._gate.knows(request):
                return super().find_handler(request, **kwargs)
            if request.path == "/" and self._gate.introduces_itself(request):
                return self.get_handler_delegate(request, SignIn, {"gate": self._gate})
        return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})
