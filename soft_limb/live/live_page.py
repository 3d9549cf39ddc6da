"""The live page, as the process that runs a limb sees it."""

import os
import pickle
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import urllib.parse
import warnings
import webbrowser
from typing import IO

from hardware.live_feed import Message, Reading, RunHeader
from limb_systems import LimbError

LOOPBACK = "127.0.0.1"
READY_TIME = 60.0  # s, in which the page's process starts, on a computer that is busy
LONGEST_REASON = 2000  # characters, which a pipe takes without a reader
DONE, STOPPED = "done", "stopped by Ctrl-C, by a signal or on the page"


class LivePage:
    """A page in the browser of this computer that shows a limb while it runs, and can stop it.

    Another process serves it, at a lower priority. What is told to it is lost if it
    does not listen: whoever runs the limb never waits for it, and does not notice when the
    page is closed or its process dies. Its button sends this process the signal of Ctrl-C,
    which is heeded from then on, also in the background: it raises KeyboardInterrupt in the
    main thread.

    Use it as a context manager, and give it to what runs the limb::

        with LivePage() as live:
            print(live.url)
            replay(trajectory, limb, live=live)

    When that ends, the page says why and keeps its curves.

    - ``url``: address of the page. Its token, if it has one, is like a password.
    """

    def __init__(self, address: str = LOOPBACK, *, open_browser: bool = True):
        """
        Args:
            address: HOST or HOST:PORT to listen on; a free port if none is given. For
                another host than the loopback, the URL has a token.
            open_browser: whether to open the page, where there is a display.

        Raises:
            LimbError: if the page cannot be served there.
        """
        host, port = host_and_port(address)
        if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
            # As of a script that a shell runs in the background: the button would do nothing.
            signal.signal(signal.SIGINT, signal.default_int_handler)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        ours.setblocking(False)
        self._socket, self._said, self._ended = ours, "", False
        self._phase: IO[bytes] | None = None  # that has not been sent yet
        command = [sys.executable, "-m", "soft_limb.live.server", host, str(port)]
        command += [str(theirs.fileno()), str(os.getpid()), str(int(open_browser))]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # the terminal's Ctrl-C is not for it
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        theirs.close()
        try:
            self.url = self._answer()
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

    def begin(self, phase: RunHeader) -> None:
        """Show a new recording, before its wires are heated."""
        self._phase = tempfile.TemporaryFile()  # noqa: SIM115, it is closed when it is sent
        pickle.dump(phase, self._phase)
        self._phase.flush()
        self._send(None)

    def say(self, what: str) -> None:
        """Say what runs, in words, until something else is said."""
        self._said = what
        self._send(None)

    def show(self, reading: Reading) -> None:
        """Show what is known of the limb."""
        self._send(reading)

    def rest(self) -> None:
        """Say that no limb runs any more. The curves stay."""
        self._send(None)

    def end(self, reason: str) -> None:
        """Say that all has ended, and why; its process ends soon. A second call does nothing.

        It warns if that process had ended before.
        """
        if self._ended:
            return
        self._ended = True
        died = self._process.poll() is not None
        self._socket.close()
        assert self._process.stdin
        try:
            self._process.stdin.write(reason.encode()[:LONGEST_REASON])
            self._process.stdin.close()
        except OSError:
            died = True
        if died:
            warnings.warn(
                "The live page's process ended before; nothing else depended on it.", stacklevel=2
            )

    def _send(self, reading: Reading | None) -> None:
        """Send a reading, or lose it if the page's process does not listen; never wait."""
        files = [self._phase.fileno()] if self._phase else []
        try:
            socket.send_fds(self._socket, [pickle.dumps(Message(self._said, reading))], files)
        except OSError:
            return
        if self._phase:
            self._phase.close()
            self._phase = None

    def _answer(self) -> str:
        """The URL, which the page's process prints when it is ready."""
        stdout = self._process.stdout
        assert stdout
        ready, _, _ = select.select([stdout], [], [], READY_TIME)
        answer = stdout.readline().decode().strip() if ready else ""
        stdout.close()
        if not answer.startswith("http"):
            raise LimbError(answer or "The live page does not start; try again, or go without it.")
        return answer


def open_in_browser(url: str) -> None:
    """Open a page in the browser of this computer, where there is a display, and do not wait."""
    if {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys() or sys.platform == "darwin":
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


def host_and_port(address: str) -> tuple[str, int]:
    """Host and port of HOST or HOST:PORT; port 0 is any that is free.

    Raises:
        LimbError: if it is something else.
    """
    try:
        parts = urllib.parse.urlsplit(f"//{address}")
        if parts.hostname and parts.netloc == address:
            return parts.hostname, parts.port or 0
    except ValueError:
        pass
    raise LimbError(f"'{address}' is no address for a page; give HOST or HOST:PORT.")
