"""What happens before the packages are imported: Ctrl-C is heeded, and hidden packages named."""

import importlib.util
import os
import signal
import sys
import warnings
from pathlib import Path

NEEDED = ("urdf",)  # by limb_systems itself
OTHERS = ("planners", "controllers", "hardware", "calibration", "walking", "soft_limb")


def let_ctrl_c_end_imports() -> None:
    """If a command of ours starts, Ctrl-C ends it with a line until `run_command` takes over.

    What imports half a library would show or swallow KeyboardInterrupt. Programs that
    only use our packages are left alone.
    """
    words = sys.orig_argv
    module = words[words.index("-m") + 1 :][:1] if "-m" in words else []
    ours = module[0].split(".")[0] in OTHERS if module else Path(sys.argv[0]).stem == "soft-limb"
    if ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def _end(*_: object) -> None:
    os.write(2, b"stopped before it began; nothing was written\n")
    os._exit(128 + signal.SIGINT)


def check_shadows() -> None:
    """Warns of modules that Python finds in place of ours, such as those beside a script.

    Raises:
        ImportError: if `limb_systems` itself needs the hidden package.
    """
    ours = Path(__file__).resolve().parents[1]
    for name in NEEDED + OTHERS:
        found = importlib.util.find_spec(name)
        if found is None or found.origin is None:
            continue
        if Path(found.origin).resolve().parents[1] == ours:
            continue
        sentence = (
            f"The module {name} at {found.origin} hides soft-limb's package of that name; rename "
            "it or run elsewhere."
        )
        if name in NEEDED:
            raise ImportError(sentence)
        warnings.warn(sentence, stacklevel=3)
