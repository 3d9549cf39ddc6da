"""Serves the results in a folder: `soft-limb runs`.

The page stands behind the gate of the live page. It serves the results in the folder, and pictures
beside reports. It writes nothing but recordings of emulated limbs, and knows no robot.
"""

import asyncio
import contextlib
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from tornado.web import HTTPError

from limb_systems import LimbError
from soft_limb.live.site import PageHandler, Site
from soft_limb.results.comparison import compare, comparison_page
from soft_limb.results.overview import ListedFile, Overview, overview_page
from soft_limb.results.read_result import REPORT, TRAJECTORY, read_result

PATIENCE = 0.7  # s, for which one request reads files
START_TIME = 90.0  # s, in which a replay must show its page
TYPES = {".html": "text/html", ".png": "image/png"}
FAREWELL = 5.0  # s, in which a replay ends as by Ctrl-C
T = TypeVar("T")


class StartPage(Site):
    """The page of a folder, and the replay that was started from it, one at a time.

    - ``url``: address of the page. Its token, if it has one, is like a password.
    - ``overview``: results in the folder.
    - ``news``: sentences on what was started, each with the address of its live page or "".
    """

    def __init__(self, folder: Path, host: str, port: int, modules: Sequence[str] = ()):
        """
        Args:
            folder: folder whose results are shown.
            host, port: address to listen on; port 0 is any that is free.
            modules: modules that commands import first, as with ``--import``.

        Raises:
            LimbError: if it cannot listen there, or there is no such folder.
        """
        self.overview = Overview(folder)
        self.overview.look(0.0)
        super().__init__(
            host,
            port,
            [("/", _List), ("/compare", _Compare), ("/start", _Start), (r"/file/(.+)", _File)],
        )
        self._host, self._modules = "" if not self.gate.token else host, modules
        self._reader = ThreadPoolExecutor(1)
        self._replay: asyncio.subprocess.Process | None = None
        self._watcher: asyncio.Task | None = None
        self.news: list[tuple[str, str]] = []

    async def serve(self) -> None:
        """Serve the page until this is cancelled; what was started from the page ends, too."""
        server = self.open()
        try:
            await asyncio.Event().wait()
        finally:
            server.stop()
            self._reader.shutdown(wait=False, cancel_futures=True)
            if self._replay and self._replay.returncode is None:
                self._replay.send_signal(signal.SIGINT)
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._replay.wait(), FAREWELL)

    async def read(self, work: Callable[[], T]) -> T:
        """Do work in a thread, one piece at a time."""
        return await asyncio.get_running_loop().run_in_executor(self._reader, work)

    def listed(self, key: str) -> ListedFile:
        """A file by its key.

        Raises:
            HTTPError: if there is no such result.
        """
        for file in self.overview.files:
            if file.key == key and file.kind and self.is_inside(file.path):
                return file
        raise HTTPError(404)

    def is_inside(self, path: Path) -> bool:
        """Whether a path leads to a file in the folder."""
        resolved = path.resolve()
        return resolved.is_relative_to(self.overview.folder.resolve()) and resolved.is_file()

    async def start(self, plan: ListedFile) -> str:
        """Replay a plan on an emulated limb, and return the address of its live page.

        Raises:
            LimbError: if it does not start, or another has not ended.
        """
        if self._watcher and not self._watcher.done():
            raise LimbError("A replay runs already; stop it on its page, or wait for its end.")
        number = 1
        while (output := plan.path.with_name(f"{plan.path.stem}_emulated_{number}.csv")).exists():
            number += 1
        words = [word for module in self._modules for word in ("--import", module)]
        words += ["replay", str(plan.path.resolve()), "-o", str(output.resolve()), "--live"]
        words += ["--live-address", self._host] * bool(self._host)
        address: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._watcher = asyncio.create_task(self._run(words, plan, output, address))
        try:
            return await asyncio.wait_for(address, START_TIME)
        except TimeoutError as error:
            raise LimbError("The replay does not show its page; this computer is busy.") from error

    async def _run(
        self, words: list[str], plan: ListedFile, output: Path, address: asyncio.Future
    ) -> None:
        """Run a replay to its end, and say what becomes of it."""
        self._replay = await asyncio.create_subprocess_exec(
            *[sys.executable, "-P", "-m", "soft_limb", *words],
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env={**os.environ, "BROWSER": "true"},  # the browser that asked shows it
            start_new_session=True,  # it gets one signal, from here
        )
        assert self._replay.stdout
        last = ""
        async for line in self._replay.stdout:
            last = line.decode("utf-8", "replace").strip() or last
            if (match := re.match(r"live +(http\S+)", last)) and not address.done():
                address.set_result(match[1])
                self.news = [(f"{plan.key} is replayed on an emulated limb.", match[1])]
        status = await self._replay.wait()
        if not address.done():
            address.set_exception(LimbError(last or f"It ended with the exit status {status}."))
        done = f"{plan.key} was replayed on an emulated limb: {output.name}."
        self.news = [(done if status == 0 else f"The replay of {plan.key} ended: {last}", "")]


class _List(PageHandler):
    async def get(self) -> None:
        site = self.application
        await site.read(lambda: site.overview.look(PATIENCE))
        self.finish(
            overview_page(site.overview, lambda f: f"file/{f.key}", served=True, news=site.news)
        )


class _Compare(PageHandler):
    async def get(self) -> None:
        site, keys = self.application, self.get_query_arguments("run", strip=False)

        def compared() -> str:
            return comparison_page(compare([read_result(site.listed(key).path) for key in keys]))

        self.finish(await site.read(compared))


class _Start(PageHandler):
    async def post(self) -> None:
        plan = self.application.listed(self.get_body_argument("plan", strip=False))
        if plan.kind != TRAJECTORY:
            raise HTTPError(404)
        try:
            self.redirect(await self.application.start(plan), status=303)
        except LimbError:  # the page says why
            self.redirect("/", status=303)


class _File(PageHandler):
    async def get(self, key: str) -> None:
        site = self.application
        path, beside = site.overview.folder / key, site.overview.of_kind(REPORT)
        is_picture = key.isprintable() and path.suffix == ".png"
        if not (
            is_picture
            and path.parent in {report.path.parent for report in beside}
            and site.is_inside(path)
        ):
            path = site.listed(key).path
        self.set_header("Content-Type", TYPES.get(path.suffix, "text/plain; charset=utf-8"))
        # As of another site: a page in the folder, whoever wrote it, cannot ask for anything here.
        self.set_header(
            "Content-Security-Policy", "sandbox allow-scripts allow-popups allow-downloads"
        )
        self.finish(await site.read(path.read_bytes))
