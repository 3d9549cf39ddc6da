"""The application: commands, runs of limbs, reports, and readers of result files."""

import os
import signal
import sys
from pathlib import Path


def let_ctrl_c_end_imports() -> None:
    """Let Ctrl-C end ``soft-limb`` with one line while it imports libraries.

    A KeyboardInterrupt in the middle of an import would print a traceback or be swallowed.
    Programs that only use our packages keep their handler.
    """
    words = sys.orig_argv
    module = words[words.index("-m") + 1 :][:1] if "-m" in words else []
    is_soft_limb = module == ["soft_limb"] or Path(sys.argv[0]).stem == "soft-limb"
    if is_soft_limb and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, exit_before_start)


def exit_before_start(*_: object) -> None:
    """Handle a signal that arrives before `run_command` runs a command."""
    os.write(2, b"stopped before it began; nothing was written\n")
    os._exit(128 + signal.SIGINT)


let_ctrl_c_end_imports()
