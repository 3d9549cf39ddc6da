"""The process that serves a live page: ``python -m soft_limb.live.server``, by `LivePage` alone."""

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
import time
from typing import Any

from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from hardware.live_feed import Reading
from limb_systems import LimbError
from soft_limb.live.live_page import open_in_browser
from soft_limb.live.run import Run
from soft_limb.live.shown import Browser, facts, state
from soft_limb.live.site import PageHandler, Site
from soft_limb.live.view import View
from soft_limb.reports.page import bokeh_scripts, template

PRIORITY = 10  # by which it gives way to the program that runs the limb
PERIOD = 0.2  # s, in which browsers are told what is new
BETWEEN_STOPS = 2.0  # s, so that a second click does not interrupt what the first has begun
FAREWELL = 4.0  # s, in which browsers hear of the end
LARGEST_DATAGRAM = 65_536


class StopSwitch:
    """Sends the program that runs the limb the signal of Ctrl-C."""

    def __init__(self, program: int):
        self._program, self._pressed = program, -BETWEEN_STOPS

    def press(self) -> None:
        """Send the signal, once in two seconds, and only while that program is there."""
        now = time.monotonic()
        if now - self._pressed >= BETWEEN_STOPS and os.getppid() == self._program:
            self._pressed = now
            os.kill(self._program, signal.SIGINT)


class LiveSite(Site):
    """The page of one run, its 3D view, and the websocket that keeps the page up to date.

    - ``watchers``: browsers that look at the page; without one nothing is drawn in 3D.
    """

    def __init__(self, host: str, port: int, messages: socket.socket, program: int):
        """
        Args:
            host, port: address to listen on.
            messages: socket of the program that runs the limb.
            program: number of its process.

        Raises:
            LimbError: if it cannot listen there.
        """
        super().__init__(host, port, [("/", _Page), ("/view/", _View), ("/live", _Watcher)])
        self.page = template("live.html").render(bokeh=bokeh_scripts())
        self.run, self.view, self.switch = Run(), View(), StopSwitch(program)
        self.watchers: set[_Watcher] = set()
        self._number, self._drawn = 0, Reading(0.0, [], [], [])
        self._commands: list[dict[str, Any]] = []
        self._loop, self._messages = IOLoop.current(), messages
        messages.setblocking(False)

    def serve(self) -> None:
        """Serve the page until the run has ended."""
        self.open()
        self._loop.add_handler(self._messages, lambda *_: self._take(), IOLoop.READ)
        self._loop.add_handler(sys.stdin.fileno(), lambda *_: self._end(), IOLoop.READ)
        for callback in (self._draw, self._tell):
            PeriodicCallback(callback, 1000 * PERIOD).start()
        self._loop.start()

    def _take(self) -> None:
        """Take in all messages that have come."""
        with contextlib.suppress(OSError):  # there is no more
            while True:
                data, files, *_ = socket.recv_fds(self._messages, LARGEST_DATAGRAM, 1)
                self.run.take(data, files)

    def _end(self) -> None:
        """Note why the program ends, or that it is gone."""
        self._take()
        self._loop.remove_handler(sys.stdin.fileno())
        self.run.end(sys.stdin.read())
        self._loop.call_later(FAREWELL, self._loop.stop)

    def _draw(self) -> None:
        """Draw what is new in 3D. If this fails, everything else goes on."""
        run = self.run
        if run.phase is not None and self._number != run.number:
            self._number = run.number
            self.view.begin(run.phase)
        if self.watchers and run.reading is not None and run.reading is not self._drawn:
            self._drawn = run.reading
            self._commands = self.view.commands(run.reading)

    def _tell(self) -> None:
        """Tell all browsers what is new."""
        run, commands = self.run, self._commands
        self._commands = []
        news: dict[str, Any] = {"view": self._number, "commands": commands}
        news |= {"state": state(run), "facts": facts(run), "ended": bool(run.ended)}
        news["cooling"] = run.reading is not None and run.reading.cooling
        for watcher in list(self.watchers):
            watcher.tell(news)


class _Page(PageHandler):
    def get(self) -> None:
        self.finish(self.application.page)


class _View(PageHandler):
    def get(self) -> None:
        self.finish(self.application.view.page)


class _Watcher(WebSocketHandler):
    """A browser that looks at the page, and may press its button."""

    application: Any

    def open(self, *_: str) -> None:
        self._browser = Browser(self.application.run)
        self._sent: asyncio.Future[None] | None = None
        self.application.watchers.add(self)

    def check_origin(self, origin: str) -> bool:
        """The gate has checked it, as for everything that the site serves."""
        return True

    def on_message(self, message: str | bytes) -> None:
        if message == "stop":
            self.application.switch.press()

    def tell(self, news: dict[str, Any]) -> None:
        """Send what is new, unless the browser has not yet taken what came before."""
        if self._sent is None or self._sent.done():
            with contextlib.suppress(WebSocketClosedError):
                self._sent = self.write_message(json.dumps(news | self._browser.curves()))

    def on_close(self) -> None:
        self.application.watchers.discard(self)


def main() -> None:
    """Serve a page as `LivePage` asks for it."""
    host, port, messages, program, open_browser = sys.argv[1:]
    os.nice(PRIORITY)
    try:
        site = LiveSite(host, int(port), socket.socket(fileno=int(messages)), int(program))
    except LimbError as error:
        print(error)
        return
    print(site.url, flush=True)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    if int(open_browser):
        open_in_browser(site.url)
    site.serve()


if __name__ == "__main__":
    main()
