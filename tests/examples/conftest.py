"""The demo, which takes most of a minute, runs on another core beside the other examples."""

import subprocess
import sys
from pathlib import Path

import pytest

DEMO = Path(__file__).parents[2] / "examples" / "reproduce_paper.py"


@pytest.fixture(scope="session", autouse=True)
def _demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "out"
    with subprocess.Popen(
        [sys.executable, DEMO, folder, "--quick"],
        cwd=folder.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        yield folder, process
        process.kill()


@pytest.fixture(scope="session")
def demo(_demo):
    """The folder that the demo leaves, and what it said."""
    folder, process = _demo
    said, complained = process.communicate()
    assert process.returncode == 0, complained
    return folder, said, complained
