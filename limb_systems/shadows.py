"""Warnings about modules of other programs that hide the packages of soft-limb."""

import importlib.util
import warnings
from pathlib import Path

NEEDED = ("urdf",)  # by limb_systems itself
OTHER_PACKAGES = ("planners", "controllers", "hardware", "calibration", "walking", "soft_limb")


def check_shadows() -> None:
    """Warn of modules that Python finds instead of our packages, such as files beside a script.

    Raises:
        ImportError: if `limb_systems` itself needs the hidden package.
    """
    package_root = Path(__file__).resolve().parents[1]
    for name in NEEDED + OTHER_PACKAGES:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            continue
        if Path(spec.origin).resolve().parents[1] == package_root:
            continue
        sentence = (
            f"The module {name} at {spec.origin} hides soft-limb's package of that name; rename "
            "it or run elsewhere."
        )
        if name in NEEDED:
            raise ImportError(sentence)
        warnings.warn(sentence, stacklevel=3)
