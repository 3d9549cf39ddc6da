"""What made a result: that it is told truly, and stays with the result."""

import copy
import dataclasses
import datetime
import hashlib
import importlib.metadata
import shlex
import subprocess
import sys

import pytest

from limb_systems import (
    CalibrationRecord,
    EmulatedLimb,
    Limb,
    LimbParameters,
    Provenance,
    simulate,
)
from limb_systems.files import provenance
from limb_systems.files.provenance import command_line

MADE = Provenance(
    "0.1.0",
    "0123456789ab-dirty",
    "soft-limb plan 'a b.csv' -o °.csv: # {x}",
    "aaaaaaaaaaaa",
    "2030-01-31T12:00:00Z",
    limb_seed=7,
)


def calibrated(made: Provenance | None) -> LimbParameters:
    record = CalibrationRecord(["left.a2"], [20.0], [1.0], [[1.0]], provenance=made)
    return LimbParameters(calibration=record)


def test_a_simulation_is_stamped_with_its_provenance(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["swing.py", "a b", "--n=3"])
    before = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    made = simulate(Limb(), [0.0, 0.1], 0.1).provenance
    assert made.version == importlib.metadata.version("soft-limb")
    assert shlex.split(made.command) == ["python", "swing.py", "a b", "--n=3"]
    yaml = LimbParameters().to_yaml().encode()
    assert made.parameters == hashlib.sha256(yaml).hexdigest()[:12]
    time = datetime.datetime.fromisoformat(made.time)
    assert before <= time <= datetime.datetime.now(datetime.UTC)
    assert made.limb_seed is made.seed is None


def test_a_command_is_as_it_was_typed():
    for arguments, command in (
        (["/opt/bin/soft-limb", "plan", "my file.csv"], "soft-limb plan 'my file.csv'"),
        (["/opt/soft_limb/__main__.py", "show", "x"], "python -m soft_limb show x"),
        (["examples/own.py"], "python examples/own.py"),
        ([""], "python"),
        ([], "python"),
        (["x.py", "two\nlines\x1b[2J"], "python x.py 'two?lines?[2J'"),
        (["x.py", "a" * 5000], f"python x.py {'a' * 985}..."),
    ):
        assert command_line(arguments) == command


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository with one commit, in place of this project's."""

    def git(*arguments):
        config = ["-c", "user.name=a", "-c", "user.email=a@b"]
        done = subprocess.run(
            ["git", *config, *arguments], cwd=tmp_path, check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    git("init", "-q")
    (tmp_path / "file").write_text("1")
    git("add", "file")
    git("commit", "-q", "-m", "first")
    monkeypatch.setattr(provenance, "_ROOT", tmp_path)
    return git


def test_commit_is_gits_with_a_mark_for_changes(checkout, tmp_path, monkeypatch):
    def ask():
        return provenance.version_and_commit.__wrapped__()[1]

    commit = checkout("rev-parse", "HEAD")[:12]
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "elsewhere"))  # as in a hook
    assert ask() == commit
    (tmp_path / "own.csv").write_text("of a user")
    assert ask() == commit
    (tmp_path / "file").write_text("2")
    assert ask() == f"{commit}-dirty"
    # An installed package within a repository of somebody else's.
    (tmp_path / "site-packages").mkdir()
    monkeypatch.setattr(provenance, "_ROOT", tmp_path / "site-packages")
    assert ask() == ""


def test_a_result_keeps_its_provenance_when_it_is_saved_again(tmp_path, fig5_plan):
    recording = simulate(Limb(), [0.0, 0.1], 0.1)
    for result, made in ((recording, MADE), (fig5_plan, MADE), (fig5_plan, None)):
        original = dataclasses.replace(result, provenance=made)
        original.save(tmp_path / "once.csv")
        loaded = type(original).load(tmp_path / "once.csv")
        assert loaded.provenance == original.provenance
        loaded.save(tmp_path / "twice.csv")
        assert (tmp_path / "twice.csv").read_bytes() == (tmp_path / "once.csv").read_bytes()


def test_digest_depends_on_every_parameter_and_not_on_provenance():
    later = dataclasses.replace(MADE, time="2031-01-31T12:00:00Z")
    assert calibrated(MADE).digest == calibrated(later).digest == calibrated(None).digest
    assert calibrated(MADE) == calibrated(later)
    changed = [copy.deepcopy(calibrated(MADE)) for _ in range(5)]
    changed[0].segments[0].wire("left").law.beta += 1e-12
    changed[1].gravity[2] = -0.0
    changed[2].board = EmulatedLimb(1)
    changed[3].calibration.standard_errors[0] = 1.1
    changed[4].segments[0].links = 6
    digests = {limb.digest for limb in [*changed, calibrated(MADE)]}
    assert len(digests) == 6
