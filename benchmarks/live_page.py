"""What the live page costs the loop that commands the board.

A plan of 60 s is replayed over a pseudo-terminal by feedback, in turns without a page and with
one that is open in a headless Chromium, which draws on the same cores. The firmware runs on an
emulated board in another process. Printed is by how much commands left late, how many by more
than 5 ms and by more than 100 ms, which would end the run, and what each step took that tells
the page. The targets are 99% within 10 ms, none by more than 100 ms, and less than 1 ms a step.

    python benchmarks/live_page.py [--seconds 60] [--repetitions 1]
"""

import argparse
import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, sync_playwright

from controllers import PlanFeedback
from hardware import HardwareError, SerialLimb, emulated_port, replay
from hardware.board.serial_limb import COMMAND_DEADLINE, MAX_COMMAND_DELAY
from hardware.live_feed import Feed
from limb_systems import LimbParameters, Trajectory
from planners import Task, plan, references
from soft_limb.live_page import LivePage

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of the plan")
    parser.add_argument("--repetitions", type=int, default=1)
    options = parser.parse_args()
    times = np.linspace(0.0, options.seconds, round(10 * options.seconds) + 1)
    reference = references.from_samples(times, 0.3 * np.sin(times / 3))
    trajectory = plan(LimbParameters(), reference, task=Task.closed_loop())
    steps = timed_steps()
    print(
        "page       commands   late: median       99%    largest   > 5 ms   > 100 ms   samples lost"
        "   step: median       99%   largest   load"
    )
    with tempfile.TemporaryDirectory() as folder, open_browser(Path(folder)) as browser:
        for _ in range(options.repetitions):
            for browser_or_none in (None, browser):
                steps.clear()
                report(trajectory, browser_or_none, steps)


def timed_steps() -> list[float]:
    """The list to which each step of a `Feed` adds what it took from now on, s."""
    steps, tell = [], Feed._tell

    def timed(self, context):
        start = time.perf_counter()
        tell(self, context)
        steps.append(time.perf_counter() - start)

    Feed._tell = timed
    return steps


@contextlib.contextmanager
def open_browser(folder: Path) -> Iterator[Browser]:
    """A headless Chromium at the priority of one that the page opens."""
    with sync_playwright() as playwright:
        path = next(filter(None, map(shutil.which, BROWSERS)), playwright.chromium.executable_path)
        polite = folder / "chromium"
        # As root it would raise its own priority above that of the loop, as no user's can.
        user = "setpriv --bounding-set=-sys_nice --inh-caps=-sys_nice" * (os.geteuid() == 0)
        polite.write_text(f'#!/bin/sh\nexec nice -n 10 {user} "{path}" "$@"\n')
        polite.chmod(0o755)
        # It draws as it does by itself where there is no graphics card.
        arguments = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
        yield playwright.chromium.launch(executable_path=polite, args=arguments)


def report(trajectory: Trajectory, browser: Browser | None, steps: list[float]) -> None:
    """A replay, with a page that is looked at or without one, and what came of it."""
    ended = ""
    with contextlib.ExitStack() as stack:
        limb = SerialLimb(stack.enter_context(emulated_port()), trajectory.parameters)
        live = stack.enter_context(LivePage(open_browser=False)) if browser else None
        if browser:
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            page.goto(live.url)
            page.get_by_text("No limb runs").wait_for()
            time.sleep(5.0)  # for what is loaded once
        try:
            replay(trajectory, limb, controller=PlanFeedback(trajectory), live=live)
        except HardwareError as error:
            ended = f"   {error}"
        if browser:
            page.close()
    late, took = 1000 * np.array(limb.timing_errors), 1000 * np.array(steps or [np.nan])
    median, most = np.percentile(late, [50, 99])
    step_median, step_most = np.percentile(took, [50, 99])
    print(
        f"{'open' if browser else 'none':<9}{len(late):>10}{median:>13.2f} ms{most:>7.2f} ms"
        f"{late.max():>8.2f} ms{np.sum(late > 1000 * COMMAND_DEADLINE):>9}"
        f"{np.sum(late > 1000 * MAX_COMMAND_DELAY):>11}{limb.link.lost_samples:>15}"
        f"{step_median:>12.3f} ms{step_most:>7.3f} ms{took.max():>7.3f} ms"
        f"{os.getloadavg()[0]:>7.1f}{ended}",
        flush=True,
    )


if __name__ == "__main__":
    main()
