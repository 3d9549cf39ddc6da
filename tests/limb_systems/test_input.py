"""Every input file is a regular file of a size that is stated; nothing else is waited for."""

import os

import pytest

from limb_systems import LimbError, LimbParameters, Recording, Trajectory
from limb_systems.files.input import LARGEST_TABLE, LARGEST_TEXT, read_bytes
from planners import Task, references

READERS = {
    "limb": (LimbParameters.load, LARGEST_TEXT),
    "task": (Task.load, LARGEST_TEXT),
    "reference": (references.load, LARGEST_TABLE),
    "recording": (Recording.load, LARGEST_TABLE),
    "trajectory": (Trajectory.load, LARGEST_TABLE),
}


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_devices_pipes_and_folders_are_refused_at_once(refused, pipe):
    for load, _ in READERS.values():
        for path, said in (
            ("/dev/zero", "/dev/zero is a device or a pipe, but must be a file"),
            (pipe, f"{pipe} is a device or a pipe"),
            (pipe.parent, f"{pipe.parent} is a folder"),
            ("a\0b", "null"),
            ("/proc/self/mem", ": /proc/self/mem: "),  # it opens, and then cannot be read
            (pipe.parent / "none", f": {pipe.parent}/none: No such file or directory."),
        ):
            with refused(LimbError, said):
                load(path)


def test_files_beyond_the_limit_are_refused_unread(refused, tmp_path):
    path = tmp_path / "large"
    for load, largest in READERS.values():
        path.touch()
        os.truncate(path, largest + 1)
        with refused(LimbError, path, f"larger than the {largest / 1e6:g} MB that are read"):
            load(path)


def test_files_that_grow_or_hide_their_size_are_read_to_the_limit(refused):
    status = "/proc/self/status"
    assert os.stat(status).st_size == 0
    assert read_bytes(status, "status", 10**6, LimbError).startswith(b"Name:")
    with refused(LimbError, "larger than the 1e-05 MB"):
        read_bytes(status, "status", 10, LimbError)
