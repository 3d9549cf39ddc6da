"""Ctrl-C while a command starts: it ends before `run_command` takes over."""

import os
import signal
import sys
from pathlib import Path


def let_ctrl_c_end_imports() -> None:
    """If a command of ours starts, Ctrl-C ends it with a line until `run_command` takes over.

    What imports half a library would show or swallow KeyboardInterrupt. Programs that
    only use our packages are left alone.
    """
    words = sys.orig_argv
    module = words[words.index("-m") + 1 :][:1] if "-m" in words else []
    ours = module == ["soft_limb"] or Path(sys.argv[0]).stem == "soft-limb"
    if ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _exit)


def _exit(*_: object) -> None:
    os.write(2, b"stopped before it began; nothing was written\n")
    os._exit(128 + signal.SIGINT)
