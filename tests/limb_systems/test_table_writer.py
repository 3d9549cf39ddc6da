"""Tables that are written row by row: nothing waits for the disk, and no file is written over."""

import os
import queue
import shutil
import tempfile
import threading
import time

import numpy as np
import pytest

from limb_systems.files import table_writer
from limb_systems.files.csv_format import KILLED_REASON, FileFormatError, parse_table
from limb_systems.files.output import OutputError
from limb_systems.files.table_writer import TableWriter, is_unfinished


@pytest.fixture
def path(tmp_path):
    return tmp_path / "table.csv"


@pytest.fixture
def unfinished(path):
    return path.with_name("table.unfinished.csv")


def writer_with(path, num_rows):
    writer = TableWriter(path, "recording", "source: a test\n", ["time_s", "bend_angle_deg"])
    append(writer, num_rows)
    return writer


def append(writer, num_rows, after_each=lambda: None):
    for index in range(writer.num_rows, num_rows):
        writer.append([index, 0.1 * index])
        after_each()


def read(path, **options):
    return parse_table(path.read_bytes(), "recording", **options)


def assert_rows(table, num_rows):
    np.testing.assert_array_equal(table.columns["time_s"], np.arange(num_rows))
    np.testing.assert_array_equal(table.columns["bend_angle_deg"], 0.1 * np.arange(num_rows))


def test_a_file_has_its_name_when_it_is_finished_and_not_before(path, unfinished):
    path.write_text("old")
    writer = writer_with(path, 3)
    assert writer.path == unfinished
    assert path.read_text() == "old"
    writer.finish()
    writer.finish()
    assert list(path.parent.iterdir()) == [path]
    table = read(path)
    assert_rows(table, 3)
    assert table.interrupted == ""


def test_no_file_is_ever_written_over(path, unfinished):
    unfinished.write_text("left")
    second, third = writer_with(path, 1), writer_with(path, 2)
    assert second.path.name == "table.unfinished_2.csv"
    assert third.path.name == "table.unfinished_3.csv"
    assert all(map(is_unfinished, (unfinished, second.path, third.path)))
    assert not is_unfinished(path)
    second.finish()
    assert_rows(read(path), 1)
    third.finish()
    assert_rows(read(path), 2)
    assert unfinished.read_text() == "left"


def test_an_interrupted_table_names_the_reason_and_keeps_the_old_file(path, unfinished):
    path.write_text("old")
    writer_with(path, 0).abandon("no board")
    assert list(path.parent.iterdir()) == [path]  # no row, no file
    writer = writer_with(path, 2)
    with pytest.warns(UserWarning, match=r"recorded until then is in .*table\.unfinished\.csv\.$"):
        writer.abandon("The cable\nwas \x1b[31mcut.")
    writer.abandon("again")
    assert path.read_text() == "old"
    table = read(unfinished)
    assert_rows(table, 2)
    assert table.interrupted == "The cable was ?[31mcut."
    numbers = np.loadtxt(unfinished, delimiter=",", comments=("#", "time_s"))
    assert numbers.shape == (2, 2)  # other programs read it as they read any other


def test_the_reason_of_an_interruption_is_under_the_checksum(path):
    writer_with(path, 2).finish("by hand")
    data = path.read_bytes()
    for change in (b"# interrupted: by mind\n", b""):
        path.write_bytes(data.replace(b"# interrupted: by hand\n", change))
        with pytest.raises(FileFormatError, match="checksum"):
            read(path)


def test_a_file_cut_anywhere_is_read_to_its_last_whole_row(path):
    writer_with(path, 3).finish("by hand")
    data = path.read_bytes()
    for size in range(data.index(b"time_s"), len(data)):
        path.write_bytes(data[:size])
        whole = data[:size].count(b"\n", data.index(b"time_s"))  # lines: names, rows, the remark
        if whole == 0:
            with pytest.raises(FileFormatError, match="no line of column names"):
                read(path, unfinished=True)
            continue
        table = read(path, unfinished=True)
        assert_rows(table, min(whole - 1, 3))
        assert table.interrupted == (KILLED_REASON if whole < 5 else "by hand")


class Stalled:
    """A disk that does not answer until it is let go."""

    def __init__(self, monkeypatch, function):
        self.go, self.reached = threading.Event(), threading.Event()
        original = getattr(os, function)

        def stall(*arguments):
            self.reached.set()
            self.go.wait()
            return original(*arguments)

        monkeypatch.setattr(table_writer.os, function, stall)


@pytest.fixture(params=["write", "fsync"])
def stalled(request, monkeypatch):
    monkeypatch.setattr(table_writer, "SYNC_PERIOD", 0.0)
    monkeypatch.setattr(table_writer, "PATIENCE", 0.05)
    monkeypatch.setattr(table_writer, "MOST_WAITING", 20)
    disk = Stalled(monkeypatch, request.param)
    yield disk
    disk.go.set()


def test_a_stalled_disk_blocks_no_writer_until_the_queue_is_full(path, stalled):
    writer = writer_with(path, 0)
    assert stalled.reached.wait(600.0)
    with pytest.raises(OutputError, match=r"disk is stalled: 20 rows wait .*table\.unfinished"):
        append(writer, 30)
    assert 19 <= writer.num_rows <= 21
    with pytest.warns(UserWarning, match=r"stalled: the last \d+ rows of .*csv are not on it\.$"):
        writer.abandon("stalled")


def test_the_end_waits_for_a_stalled_disk_but_not_for_ever(path, unfinished, stalled):
    writer = writer_with(path, 3)
    with pytest.raises(OutputError, match=r"the last [123] rows of .*csv are not on it\.$"):
        writer.finish()
    assert not path.exists()
    stalled.go.set()
    writer._thread.join(600.0)
    assert_rows(read(path), 3)  # the disk came back


def test_a_full_disk_is_named(path, monkeypatch):
    failed = queue.SimpleQueue()

    def full(*_):
        failed.put(True)
        raise OSError(28, "No space left on device")

    writer = writer_with(path, 1)
    monkeypatch.setattr(table_writer.os, "write", full)
    with pytest.raises(OutputError, match=r"^Cannot write .*No space left on device\.$"):
        append(writer, 100, lambda: failed.get(timeout=600.0) and writer._thread.join(600.0))
    with pytest.warns(UserWarning, match="Cannot write"):
        writer.abandon("full")


def test_rows_are_forced_to_the_disk_now_and_then_and_at_the_end(path, monkeypatch):
    synced, written = [], queue.SimpleQueue()
    now = [0.0]
    fsync, write = os.fsync, os.write
    monkeypatch.setattr(table_writer.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(table_writer.os, "fsync", lambda file: (synced.append(now[0]), fsync(file)))

    def note(file, data):
        count = write(file, data)
        written.put(data)
        return count

    monkeypatch.setattr(table_writer.os, "write", note)
    writer = writer_with(path, 0)
    written.get(timeout=600.0)

    def pass_time():
        written.get(timeout=600.0)  # with the operating system before the next one comes
        now[0] += 0.1

    append(writer, 50, pass_time)
    writer.finish()
    assert len(path.read_bytes().splitlines()) == 2 + 1 + 50 + 1
    assert 5 <= len(synced) <= 8  # about one for each second, the file's at the end, its name's


def test_a_removed_file_is_written_again(monkeypatch, tmp_path):
    """On the way, when the next row comes, or before the end."""
    monkeypatch.setattr(table_writer, "SYNC_PERIOD", 0.0)  # it looks at each row
    path = tmp_path / "folder" / "table.csv"
    for removed, at in (("file", 2), ("folder", 2), ("file", 5), ("folder", 5)):
        writer = writer_with(path, at)
        wait_until_written(writer)
        writer.path.unlink() if removed == "file" else shutil.rmtree(path.parent)
        append(writer, 5)
        writer.finish()
        assert list(path.parent.iterdir()) == [path]
        assert_rows(read(path), 5)


def test_a_removed_file_goes_to_the_temporary_folder_if_its_folder_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(table_writer, "SYNC_PERIOD", 0.0)
    path, elsewhere = tmp_path / "folder" / "table.csv", tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(elsewhere))
    writer = writer_with(path, 3)
    wait_until_written(writer)
    shutil.rmtree(path.parent)
    path.parent.write_text("in its place")
    append(writer, 4)
    kept = elsewhere / "table.unfinished.csv"
    wait_until_written(writer)
    with pytest.raises(OutputError, match=f"Cannot write {path}: .*is in {kept}"):
        append(writer, 5)
    with pytest.warns(UserWarning, match=f"what was recorded is in {kept}"):
        writer.abandon("the folder has gone")
    assert_rows(read(kept, unfinished=True), 4)


def wait_until_written(writer):
    end = time.monotonic() + 600.0
    while time.monotonic() < end:
        rows = writer.path.read_text().count("\n") if writer.path.exists() else 0
        if rows >= writer.num_rows + 3:
            return
        time.sleep(0.01)
