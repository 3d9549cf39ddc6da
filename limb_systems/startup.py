"""How a command ends before it runs, while its packages are imported."""

import os
import signal
import sys
from pathlib import Path

PACKAGES = ("planners", "calibration", "hardware", "soft_limb")


def let_ctrl_c_end_imports() -> None:
    """If a command of ours starts, Ctrl-C ends it quietly until `run_command` takes over.

    What imports half a library would show or swallow KeyboardInterrupt. Programs that
    only use our packages are left alone.
    """
    words = sys.orig_argv
    module = words[words.index("-m") + 1 :][:1] if "-m" in words else []
    ours = module[0].split(".")[0] in PACKAGES if module else Path(sys.argv[0]).stem == "soft-limb"
    if ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(128 + signal.SIGINT))
