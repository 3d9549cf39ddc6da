"""The emulated limb of physics "continuum" for benchmarks: importing this makes it known."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "witnesses"))
from continuum import ContinuumSpecimen

__all__ = ["ContinuumSpecimen"]
