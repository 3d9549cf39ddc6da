"""Packages of others that hide ours are named before they are imported."""

import importlib.util
import warnings
from pathlib import Path

NEEDED = ("urdf",)  # by limb_systems itself
OTHERS = ("planners", "controllers", "hardware", "calibration", "walking", "soft_limb")


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
