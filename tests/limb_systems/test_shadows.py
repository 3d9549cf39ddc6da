"""A user's own modules with the names of ours are named, not met by accident."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run_beside(folder, module, script):
    (folder / module).parent.mkdir(exist_ok=True)
    (folder / module).write_text("")
    (folder / "script.py").write_text(script)
    return subprocess.run(
        [sys.executable, "script.py"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )


def test_a_user_module_named_urdf_raises_an_import_error(tmp_path):
    done = run_beside(tmp_path, "urdf.py", "import limb_systems")
    assert done.stderr.splitlines()[-1] == (
        f"ImportError: The module urdf at {tmp_path / 'urdf.py'} hides soft-limb's package of that "
        "name; rename it or run elsewhere."
    )


def test_a_user_module_named_hardware_raises_a_warning_only(tmp_path):
    """And nothing else is warned of: ours are not complained of."""
    done = run_beside(tmp_path, "hardware/__init__.py", "from limb_systems import Limb")
    assert done.returncode == 0
    assert f"The module hardware at {tmp_path / 'hardware' / '__init__.py'} hides" in done.stderr
    assert done.stderr.count("hides") == 1
