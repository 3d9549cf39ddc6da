"""What cannot or must not be written is refused before the work."""

import errno
import json
import os
import re
from pathlib import Path

import pytest

from limb_systems import Limb, LimbParameters, simulate, write_meshcat_replay
from limb_systems.files.output import OutputError, check_folder, check_outputs, write_atomically
from limb_systems.views.panels import Curve, Panel
from limb_systems.views.plots import draw, save_figure
from soft_limb.command import main
from soft_limb.reports.page import write_page


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "file.csv").write_text("kept")
    return tmp_path


def test_outputs_that_cannot_be_written_are_refused(folder, refused):
    for name, message in (
        (".", "is a folder; give the name of a file in it"),
        ("file.csv/plan.csv", "file.csv is a file, but a folder is needed there"),
        ("file.csv/deep/plan.csv", "file.csv is a file, but a folder is needed there"),
        ("file.csv", "file.csv exists; give another name, or --force"),
    ):
        with refused(OutputError, message):
            check_outputs([folder / name])


def test_force_replaces_files_but_never_inputs_also_through_links(folder, monkeypatch):
    path = folder / "file.csv"
    check_outputs([path], force=True)
    (folder / "soft.csv").symlink_to(path)
    (folder / "hard.csv").hardlink_to(path)
    monkeypatch.chdir(folder)
    for read in (path, folder / "soft.csv", folder / "hard.csv"):
        for same in ("file.csv", "./file.csv", "soft.csv", f"../{folder.name}/hard.csv"):
            with pytest.raises(OutputError, match="is read by the same command"):
                check_outputs([Path(same)], inputs=[read], force=True)
    for twice in ([Path("new.csv")] * 2, [path, folder / "hard.csv"]):
        with pytest.raises(OutputError, match="is written by the same command"):
            check_outputs(twice, force=True)


def test_folders_without_permission_are_refused(folder, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(OutputError, match="is a folder that you may not write to"):
        check_folder(folder / "new")


def test_a_full_disk_keeps_the_old_file_and_raises_an_error_that_names_it(tmp_path, full_disk):
    figure = draw([Panel("a line", [Curve("one", [0.0, 1.0], [0.0, 1.0], "black")])])
    recording = simulate(Limb(), [0.0, 0.0], 10.0)
    writers = {
        "table.csv": recording.save,
        "picture.png": lambda path: save_figure(figure, path),
        "picture.pdf": lambda path: save_figure(figure, path),
        "replay.html": lambda path: write_meshcat_replay(path, recording, frames_per_second=1.0),
        "report.html": lambda path: write_page(path, "A page", [], None),
        "limb.yaml": LimbParameters().save,
    }
    for name, write in writers.items():
        path = tmp_path / name
        path.write_text("old")
        said = f"Cannot write {path}: File too large."
        with full_disk(100), pytest.raises(OutputError, match=f"^{re.escape(said)}$"):
            write(path)
        assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == len(writers)
    with pytest.raises(OutputError, match=r"^Cannot write .*old.csv: No space left on device\.$"):
        write_atomically(tmp_path / "old.csv", no_space())
    assert not (tmp_path / "old.csv").exists()


def no_space():
    yield "a part"
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def limb(tmp_path):
    LimbParameters().save(tmp_path / "limb.yaml")
    simulate(Limb(), [0.0, 0.1], 2.0).save(tmp_path / "recording.csv")
    (tmp_path / "reference.csv").write_text("0,0\n1,0\n2,5\n")
    return tmp_path


COMMANDS = (
    "plan reference.csv -o kept.csv",
    "plan reference.csv -o new.csv --plot kept",
    "plan reference.csv -o reference.csv --force",
    "plan reference.csv -o new.csv --plot new.xyz",
    "plan reference.csv -o new.png",
    "plan reference.csv -o new.csv --report new.txt",
    "compare recording.csv recording.csv -o new.csv",
    "runs -o new.txt",
    "replay reference.csv -o kept.csv -p nowhere",
    "teach nowhere -o kept.csv",
    "show recording.csv --recover kept.csv",
    "emulate --log kept",
    "collect -o .",
    "fit . -o kept",
    "fit . -l limb.yaml -o limb.yaml --force",
    "validate limb.yaml recording.csv --plot kept",
)


def test_commands_do_not_replace_existing_files(limb, monkeypatch, capsys):
    monkeypatch.chdir(limb)
    for name in ("kept", "kept.csv"):
        (limb / name).write_text(json.dumps("kept"))
    before = {path: path.read_bytes() for path in limb.iterdir()}
    reasons = ("exists", "same command", "format", "name must end with", "holds", "is a file")
    for line in COMMANDS:
        assert main(line.split()) == 1
        error = capsys.readouterr().err
        assert error.startswith("error: ")
        assert error.count("\n") == 1
        assert {path: path.read_bytes() for path in limb.iterdir()} == before
        assert any(word in error for word in reasons), line
