"""``--live`` of the commands that run a limb."""

import argparse
import contextlib
import sys
from collections.abc import Iterator

from soft_limb.live.page import LOOPBACK, LivePage


def add_live_options(command: argparse.ArgumentParser) -> None:
    """Adds ``--live`` and ``--live-address``, for `live_page`."""
    command.add_argument(
        "--live",
        action="store_true",
        help="show the limb on a page of this computer while it runs, in curves and in 3D, with a "
        "button that stops it; "
        "an emulated limb runs in real time",
    )
    command.add_argument(
        "--live-address",
        metavar="HOST[:PORT]",
        help="serve that page there, for other computers too, with a token in its address "
        f"(default {LOOPBACK}, and a free port)",
    )


@contextlib.contextmanager
def live_page(options: argparse.Namespace) -> Iterator[LivePage | None]:
    """The page that a command was asked for, if any, until it ends; it says where the page is.

    Raises:
        LimbError: if the page cannot be served there.
    """
    if not (options.live or options.live_address):
        yield None
        return
    with LivePage(options.live_address or LOOPBACK) as live:
        stream = sys.stderr if vars(options).get("json") else sys.stdout
        print(f"live        {live.url}", file=stream, flush=True)
        yield live
