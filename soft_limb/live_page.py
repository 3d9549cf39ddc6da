"""The live page: it shows a limb in the browser while it runs, and stops the run on request.

The process that runs the limb has a `LivePage`, which starts this module as another process. The
other process serves a `Page` to each browser by Bokeh's server. Importing this module takes as
long as importing Bokeh.
"""

import collections
import contextlib
import itertools
import math
import os
import pickle
import secrets
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import warnings
import webbrowser
from collections.abc import Iterable
from typing import IO, Any

import numpy as np
from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.document import Document
from bokeh.layouts import column
from bokeh.models import Button, ColumnDataSource, Div, Range1d
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPMessageDelegate, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import ErrorHandler, OutputTransform

from hardware.live_feed import DONE, Message, Reading, RunHeader
from limb_systems import LimbError, LimbModel
from limb_systems.views.colors import REFERENCE_COLOR
from limb_systems.views.panels import Curve, Panel, measured_panels
from soft_limb.reports import charts
from soft_limb.reports.page import TEMPLATES, part

LOOPBACK = "127.0.0.1"
STARTUP_TIMEOUT = 60.0  # s, for the page's process on a busy computer
MAX_REASON_LENGTH = 2000  # characters, which a pipe takes though a frozen page does not read them
STOPPED = "stopped by Ctrl-C, by a signal or on the page"
NO_REASON = (
    "the program ended without a reason: it was stopped while it planned, it was killed, or it "
    "crashed"
)

NICENESS = 10  # of the page's process, which gives way to the program that runs the limb
UPDATE_PERIOD = 0.2  # s, between updates of the page
MIN_STOP_INTERVAL = 2.0  # s, so that a second click does not interrupt the orderly end
FAREWELL_TIME = 4.0  # s, for which the page is served after the end
TOKEN_LIFETIME = 30 * 86400  # s, for which a page may connect again, after a break or a sleep
MAX_DATAGRAM_SIZE = 65_536  # bytes
MAX_WEBSOCKET_MESSAGE = 100_000  # bytes, from a browser
PING_INTERVAL = 10  # s, within which a browser must answer, or its connection is closed

MAX_READINGS = 12_000  # in the curves, the newest: of ten minutes
SILENCE_TIMEOUT = 1.0  # s without a reading, after which the page says so
NEAR_LIMIT = 10.0  # °C below T_max; a wire above that is called near T_max
LIMIT_COLOR = "#c62828"
T_MAX_COLOR = "#b08900"
# Style of the parts with text. Alarms differ in brightness and in words, not only in colour.
TEXT_STYLE = """
:host { color: var(--text); font: 15px/1.4 system-ui, sans-serif; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
td { text-align: right; padding: .15rem .5rem; border-bottom: 1px solid var(--line); }
td:first-child { text-align: left; padding-left: 0; }
tr:first-child { font-weight: bold; }
.bk-clearfix { width: 100%; }
p { margin: .6rem 0; }
b.big { font-size: 1.35rem; line-height: 1.25; display: block; }
b.alarm { display: inline-block; padding: 0 .4rem; border-radius: .25rem; }
b.alarm.near { background: #ffc107; color: #222; }
b.alarm.bad { background: #c62828; color: #fff; }
b.armed { color: var(--hot); } b.bad { color: var(--bad); } b.off { color: var(--good); }
"""
BUTTON_STYLE = ".bk-btn { font-size: 1.3rem; padding: .6rem 1.3rem; background: #c62828; }"


class LivePage:
    """A page in the browser of this computer that shows a limb while it runs, and can stop it.

    Another process serves the page. The run never waits for it: messages that it does not receive
    are lost, and the run goes on when the page is closed or its process dies. The button sends this
    process SIGINT, the signal of Ctrl-C, which raises KeyboardInterrupt in the main thread, also in
    the background. Use it as a context manager; when that ends, the page says why and keeps its
    curves::

        with LivePage() as live:
            print(live.url)
            replay(trajectory, limb, live=live)

    - ``url``: address of the page, on the loopback; its token is a password.
    """

    def __init__(self, *, open_browser: bool = True):
        """
        Args:
            open_browser: whether to open the page, where there is a display.

        Raises:
            LimbError: if the page does not start.
        """
        if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
            # A shell ignores it for a script in the background: the button would do nothing.
            signal.signal(signal.SIGINT, signal.default_int_handler)
        # Start the page's process, connected by a socket.
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        ours.setblocking(False)
        self._socket = ours
        self._activity = ""
        self._ended = False
        self._unsent_header: IO[bytes] | None = None
        # Bokeh takes settings from the environment, such as other origins that may connect.
        env = {name: text for name, text in os.environ.items() if not name.startswith("BOKEH_")}
        command = [sys.executable, "-m", "soft_limb.live_page"]
        command += [str(theirs.fileno()), str(os.getpid()), str(int(open_browser))]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # the terminal's Ctrl-C is not for it
            env=env | {"OPENBLAS_NUM_THREADS": "1"},
        )
        theirs.close()
        # Wait until it serves the page.
        try:
            self.url = self._read_url()
        except BaseException:
            self._process.kill()
            self._process.communicate()
            ours.close()
            raise

    def __enter__(self) -> "LivePage":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, _: object) -> None:
        if error is None:
            self.end(DONE)
        else:
            self.end(STOPPED if isinstance(error, KeyboardInterrupt) else str(error))

    def begin(self, header: RunHeader) -> None:
        """Show a new recording, before its wires are heated."""
        # A plan is longer than a message may be.
        self._unsent_header = tempfile.TemporaryFile()  # noqa: SIM115, closed when it is sent
        pickle.dump(header, self._unsent_header)
        self._unsent_header.flush()
        self._send(None)

    def say(self, sentence: str) -> None:
        """Show a sentence on the present activity, until the next call."""
        self._activity = sentence
        self._send(None)

    def show(self, reading: Reading) -> None:
        """Show a reading of the limb."""
        self._send(reading)

    def rest(self) -> None:
        """Show that no limb runs any more; the curves stay."""
        self._send(None)

    def end(self, reason: str) -> None:
        """Show that the program ends, and the reason; a second call does nothing.

        The page's process ends some seconds later. A warning is given if it had died before.
        """
        if self._ended:
            return
        self._ended = True
        # Send the reason by the pipe, as a datagram could be lost.
        died = self._process.poll() is not None
        self._socket.close()
        assert self._process.stdin
        try:
            self._process.stdin.write(reason[:MAX_REASON_LENGTH].encode(errors="replace"))
            self._process.stdin.close()
        except OSError:
            died = True
        if died:
            warnings.warn(
                "The live page's process died; the run did not depend on it.", stacklevel=2
            )

    def _send(self, reading: Reading | None) -> None:
        """Send a reading without waiting; it is lost if the page's process does not receive it."""
        files = [self._unsent_header.fileno()] if self._unsent_header else []
        message = pickle.dumps(Message(self._activity, reading))
        try:
            socket.send_fds(self._socket, [message], files)
        except OSError:
            return
        if self._unsent_header:
            self._unsent_header.close()
            self._unsent_header = None

    def _read_url(self) -> str:
        """Return the URL, which the page's process prints when it is ready."""
        stdout = self._process.stdout
        assert stdout
        ready, _, _ = select.select([stdout], [], [], STARTUP_TIMEOUT)
        url = stdout.readline().decode().strip() if ready else ""
        stdout.close()
        if not url:
            raise LimbError("The live page does not start; try again, or leave --live out.")
        return url


class Run:
    """The state of the program that runs a limb, by its process's number, from its messages.

    - ``activity``: sentence on the present activity.
    - ``header``, ``reading``: header and newest reading of the newest recording; None before.
    - ``is_running``: whether a limb runs.
    - ``readings``: newest readings of that recording, for its curves.
    - ``num_readings``: number of its readings so far, also of dropped readings.
    - ``last_message``, ``last_stop``: times of the last message, and of the button's last signal, s
      of the monotonic clock.
    - ``end_reason``: reason why all ended; empty until then.
    """

    def __init__(self, program: int):
        self.activity = ""
        self.header: RunHeader | None = None
        self.reading: Reading | None = None
        self.is_running = False
        self.readings: collections.deque[Reading] = collections.deque(maxlen=MAX_READINGS)
        self.num_readings = 0
        self.last_message = time.monotonic()
        self.end_reason = ""
        self.last_stop = -math.inf
        self._program = program

    def take(self, data: bytes, files: Iterable[int]) -> None:
        """Process a message, and the file with a header if a recording begins."""
        for handle in files:
            with os.fdopen(handle, "rb") as file:
                file.seek(0)
                self.begin(pickle.load(file))
        # Note the activity, also if there is no reading.
        message: Message = pickle.loads(data)
        self.last_message = time.monotonic()
        self.activity = message.activity
        self.is_running = message.reading is not None
        # Keep the reading for the curves.
        if message.reading is None:
            return
        self.reading = message.reading
        self.readings.append(message.reading)
        self.num_readings += 1

    def begin(self, header: RunHeader) -> None:
        """Drop the previous recording."""
        self.header = header
        self.reading = None
        self.readings.clear()
        self.num_readings = 0

    def end(self, reason: str) -> None:
        """Note the end of the program; it was killed if it gave no reason."""
        self.end_reason = reason or NO_REASON
        self.is_running = False

    def stop(self) -> None:
        """Send the program SIGINT, at most once in two seconds, if its run has not ended."""
        now = time.monotonic()
        if self.end_reason:
            return
        if now - self.last_stop >= MIN_STOP_INTERVAL and os.getppid() == self._program:
            self.last_stop = now
            os.kill(self._program, signal.SIGINT)


class Page:
    """The page of a run in one browser, as a Bokeh document, with a button that stops the run.

    Browsers cannot share a document: Bokeh sends new charts in full only to the first browser.

    - ``source``: readings of the curves, angles in degrees, columns numbered by bend or wire.
    """

    def __init__(self, run: Run):
        self.source = ColumnDataSource()
        self._run = run
        self._drawn_header: RunHeader | None = None
        self._num_drawn = 0  # readings
        self._num_updates = 0
        self._state = Div(name="state", stylesheets=[TEXT_STYLE], sizing_mode="stretch_width")
        self._facts = Div(name="facts", stylesheets=[TEXT_STYLE], sizing_mode="stretch_width")
        self._curves = column(name="curves", sizing_mode="stretch_width")
        self._button = Button(
            name="stop", label="STOP", button_type="danger", stylesheets=[BUTTON_STYLE]
        )
        self._button.on_click(run.stop)

    def add_to(self, document: Document) -> None:
        """Put the page into a document, and update it periodically."""
        for model in (self._state, self._button, self._curves, self._facts):
            document.add_root(model)
        document.title = "Soft limb, live"
        document.template = (TEMPLATES / "live.html").read_text(encoding="utf-8")
        colors = (TEMPLATES / "colors.css").read_text(encoding="utf-8")
        document.template_variables["colors"] = colors
        document.config.notify_connection_status = False  # the template's script does
        document.add_periodic_callback(self.update, round(1000 * UPDATE_PERIOD))

    def update(self) -> None:
        """Show the messages since the last update."""
        run = self._run
        header = run.header
        self._update_texts()
        if header is None:
            return
        # Draw the charts of a new recording. If this fails, its texts and the button remain.
        if header is not self._drawn_header:
            self._drawn_header = header
            self._num_drawn = 0
            self.source = ColumnDataSource(columns(header, []), name="readings")
            x_range = Range1d(start=0.0, end=header.duration)
            drawn = [charts.draw(panel, self.source, x_range) for panel in panels(header)]
            for above in drawn[:-1]:
                above.xaxis.axis_label = None
            self._curves.children = drawn
        # Append the new readings to the curves.
        num_new = min(run.num_readings - self._num_drawn, len(run.readings))
        self._num_drawn = run.num_readings
        if num_new:
            first = len(run.readings) - num_new
            new_readings = itertools.islice(run.readings, first, None)
            self.source.stream(columns(header, new_readings), rollover=MAX_READINGS)

    def _update_texts(self) -> None:
        run = self._run
        self._state.text = state(run)
        self._facts.text = facts(run)
        if math.isfinite(run.last_stop):
            self._button.label = "STOP again"
        self._button.disabled = bool(run.end_reason)
        # Count for the page's script, which sees by it that this process lives.
        self._num_updates += 1
        self._state.tags = [self._num_updates]


def columns(header: RunHeader, readings: Iterable[Reading]) -> dict[str, list[float]]:
    """Return columns of the curves: angles in degrees, numbered by bend or wire; NaN for a gap."""
    readings = list(readings)
    layout = LimbModel.of(header.parameters).layout
    columns_by_name = {"time": [reading.time for reading in readings]}
    # Number the rows of each signal; a signal without readings is a gap.
    for name, size, scale in (
        ("bend_angle", layout.num_bends, 180.0 / np.pi),
        ("reference", layout.num_bends, 180.0 / np.pi),
        ("measured_temperature", layout.num_wires, 1.0),
        ("duty", layout.num_wires, 1.0),
        ("applied_duty", layout.num_wires, 1.0),
    ):
        gap = [math.nan] * size
        rows = [getattr(reading, name) or gap for reading in readings]
        for number, values in enumerate(scale * np.reshape(rows, (-1, size)).T):
            columns_by_name[f"{name}_{number}"] = values.tolist()
    return columns_by_name


def panels(header: RunHeader) -> list[Panel]:
    """Return Fig. 5 of a recording that grows, with the plan, its band and the limits."""
    plan = header.plan
    band = header.band
    limits = header.parameters.temperature_limits

    # Draw the measured curves from columns that grow.
    def growing(name: str, column: str, color: str, **style) -> Curve:
        return Curve(name, np.zeros(0), np.zeros(0), color, column=column, **style)

    def measured(signal: str, row: int, wire: str, color: str) -> list[Curve]:
        column = f"{signal}_{row}"
        if signal == "measured_temperature":
            return [growing(f"{wire}V measured", column, color, width=2.0)]
        if signal == "bend_angle":
            reading = growing("measured φ", column, color, width=2.0)
            reference = growing("asked for", f"reference_{row}", REFERENCE_COLOR)
            return [reference, reading] if plan is None else [reading]
        wide = {"width": 5.0, "alpha": 0.3, "steps": True}
        return [
            growing(f"{wire}D applied", f"applied_duty_{row}", color, **wide),
            growing(f"{wire}D asked for", column, color, steps=True),
        ]

    # Shade the bands that readings of such limbs stay in.
    bands = {}
    if plan is not None and band is not None:
        width = np.interp(plan.time, band.time, band.bend_reading)
        planned = plan.measured_temperature
        above = [np.interp(plan.time, band.time, row) for row in band.measured_temperature]
        bands = {
            "bend_angle": np.array([plan.bend_angle - width, plan.bend_angle + width]),
            "measured_temperature": np.array([planned, planned + above]),
        }
    # Draw the limits of temperature as lines.
    ends = np.array([0.0, header.duration])

    def limit_line(name: str, value: float, color: str, dash: str) -> Curve:
        return Curve(f"{name} {value:g} °C", ends, np.full(2, value), color, dash, 2.0)

    lines = [
        limit_line("T_max", limits.maximum, T_MAX_COLOR, "dotted"),
        limit_line("off at", header.limit, LIMIT_COLOR, "solid"),
    ]
    return measured_panels(header.parameters, measured, plan, limits=lines, bands=bands)


def state(run: Run) -> str:
    """Return the line on top, HTML: state of the wires or reason of the end, activity, alarms."""
    # Choose the first state that applies; the colour is red for failures.
    silence = time.monotonic() - run.last_message
    sample = run.reading.sample if run.reading is not None else None
    kind = "off"
    if run.end_reason:
        kind = "off" if run.end_reason == DONE else "bad"
        text = f"Ended: {run.end_reason}"
    elif not run.is_running:
        text = "No limb runs"
    elif silence > SILENCE_TIMEOUT:
        kind = "bad"
        text = f"No reading of the limb for {silence:.0f} s"
    elif sample is None:
        kind = "armed"
        text = "Running"
    elif sample.armed:
        kind = "armed"
        text = "Armed: wires may be heated"
    else:
        text = f"Wires off: {sample.reason_text}"
    return part("state", kind, text, run.activity, alarms(run))


def alarms(run: Run) -> list[tuple[str, str]]:
    """Return kind ("near" or "bad") and sentence for each wire near T_max or without a reading."""
    if run.header is None or run.reading is None or not run.is_running:
        return []
    parameters = run.header.parameters
    limits = parameters.temperature_limits
    # Compare the readings with T_max and the limit at which the heaters go off.
    wire_alarms = []
    for name, value in zip(parameters.wire_names, run.reading.measured_temperature, strict=True):
        wire = name.replace("_", " ")
        if math.isnan(value):
            wire_alarms.append(("near", f"{wire}: no reading"))
            continue
        is_too_hot = value >= min(limits.measured_maximum, run.header.limit)
        if not is_too_hot and value < limits.maximum - NEAR_LIMIT:
            continue
        words = "above T_max" if value > limits.maximum else "near T_max"
        words = "too hot" if is_too_hot else words
        text = f"{wire}: {value:.1f} °C, {words} (T_max {limits.maximum:g} °C)"
        wire_alarms.append(("bad" if is_too_hot else "near", text))
    return wire_alarms


def facts(run: Run) -> str:
    """Return the numbers, HTML: readings and duty of each wire, bends, time and board."""
    header = run.header
    reading = run.reading
    if header is None:
        return ""
    rows: list[tuple[str, list[str]]] = []
    lines: list[str] = []

    def add(name: str, values: Iterable[float] | None, digits: int) -> None:
        if values is not None:
            rows.append((name, [f"{value:.{digits}f}" for value in values]))

    if reading is not None:
        sample = reading.sample
        # A table with a column for each wire.
        add("reading V, °C", reading.measured_temperature, 1)
        add("at most, by its duty, °C", sample.warmest if sample else None, 0)
        if run.is_running:  # else the last duty is no longer applied
            add("duty", reading.duty, 2)
            add("duty applied", reading.applied_duty, 2)
        # A line for each fact about the whole limb.
        bends = ", ".join(f"{np.rad2deg(bend):+.1f}°" for bend in reading.bend_angle)
        lines.append(f"φ {bends}")
        lines.append(f"{reading.time:.1f} s of {header.duration:g} s")
        if sample is not None:
            lines.append(f"{reading.lost_samples} samples lost")
    if header.band is not None:
        lines.append("Shaded: 95% band of the bend reading, 99.5% upper bound of the reading V.")
    names = [name.replace("_", " ") for name in header.parameters.wire_names]
    return part("facts", names, rows, [*lines, header.source])


class Site(BokehTornado):
    """Bokeh's server application behind a check of host, origin and token.

    A request must name this server as its host, and must not come from a page of another site. It
    must have the token, except requests for Bokeh's scripts. Bokeh checks websockets in addition:
    their origin, and a signature that only pages of this server have.

    - ``token``: password that is part of each request's address.
    """

    def __init__(self, run: Run, port: int):
        self.token = secrets.token_urlsafe()
        super().__init__(
            Application(FunctionHandler(lambda document: Page(run).add_to(document))),
            extra_websocket_origins=[f"{LOOPBACK}:{port}", f"localhost:{port}"],
            secret_key=secrets.token_bytes(),
            sign_sessions=True,
            session_token_expiration=TOKEN_LIFETIME,
            include_headers=[],  # the page needs neither headers nor cookies
            include_cookies=[],
            use_index=False,
            keep_alive_milliseconds=0,  # Tornado's pings close connections that do not answer
            websocket_ping_interval=PING_INTERVAL,
            websocket_max_message_size_bytes=MAX_WEBSOCKET_MESSAGE,
        )
        self.add_transform(_SameSiteOnly)

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> HTTPMessageDelegate:
        """Return the handler of a request if it passes the checks, or a handler that refuses it."""
        # Check the host, and the origin if the browser sends it.
        host = request.host.lower()
        origin = request.headers.get("Origin", f"http://{host}").lower()
        is_same_site = host in self.websocket_origins and origin == f"http://{host}"
        # Check the token in constant time.
        words = request.query_arguments.get("token", [])
        has_token = any(secrets.compare_digest(word, self.token.encode()) for word in words)
        if is_same_site and (has_token or request.path.startswith("/static/")):
            return super().find_handler(request, **kwargs)
        return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})


class _SameSiteOnly(OutputTransform):
    """Headers that forbid browsers to store a page, and other sites to embed or read it."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        headers["X-Frame-Options"] = "DENY"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cache-Control"] = "no-store"
        return status_code, headers, chunk


def serve(messages: socket.socket, program: int, open_browser: bool) -> None:
    """Serve a page until its run has ended; print its URL first.

    Args:
        messages: socket of the program that runs the limb; stdin brings the reason of its end.
        program: number of that program's process.
        open_browser: whether to open the page, where there is a display.
    """
    # Start the server on a free port of the loopback.
    loop = IOLoop.current()
    run = Run(program)
    sockets = bind_sockets(0, LOOPBACK)
    port = sockets[0].getsockname()[1]
    site = Site(run, port)
    http_server = HTTPServer(site)
    http_server.add_sockets(sockets)
    BaseServer(loop, site, http_server).start()
    # Print its address, and open a browser.
    url = f"http://{LOOPBACK}:{port}/?token={site.token}"
    print(url, flush=True)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    has_display = bool({"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys())
    if open_browser and (has_display or sys.platform == "darwin"):
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()

    # Process messages until the program ends.
    def take_messages(*_event) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                data, files, _, _ = socket.recv_fds(messages, MAX_DATAGRAM_SIZE, 1)
                run.take(data, files)

    def end(*_event) -> None:
        take_messages()
        loop.remove_handler(sys.stdin.fileno())
        run.end(sys.stdin.read())
        loop.call_later(FAREWELL_TIME, loop.stop)

    messages.setblocking(False)
    loop.add_handler(messages, take_messages, IOLoop.READ)
    loop.add_handler(sys.stdin.fileno(), end, IOLoop.READ)
    loop.start()


if __name__ == "__main__":
    os.nice(NICENESS)
    serve(socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2]), sys.argv[3] == "1")
