"""The start page: what it lists, what belongs together, who may read and start what."""

import asyncio
import contextlib
import dataclasses
import http.client
import os
import re
import shutil
import sys
import threading
import time
from pathlib import Path

import pytest

from limb_systems import LimbParameters
from limb_systems.views.replay_page import write_meshcat_replay
from soft_limb.command import main
from soft_limb.live import start_page
from soft_limb.live.start_page import StartPage
from soft_limb.reports import page
from soft_limb.results import overview
from soft_limb.results.overview import Overview, overview_page

from .test_results import MADE, make_plan, make_recording


def made(minute: int, command: str):
    time = f"2030-01-31T12:{minute:02}:00Z"
    return dataclasses.replace(MADE, command=f"soft-limb {command}", time=time)


@pytest.fixture
def folder(lab, tmp_path) -> Path:
    return shutil.copytree(lab.parent, tmp_path / "copy", symlinks=True) / "lab"


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Path:
    """A plan of a limb, recordings of it and of another plan, pages, and what is no result."""
    folder = tmp_path_factory.mktemp("labs") / "lab"
    (folder / "day 1").mkdir(parents=True)
    limb = LimbParameters(total_duty=1.25)
    limb.save(folder / "limb.yaml")
    os.utime(folder / "limb.yaml", (1.8e9, 1.8e9))
    plan, recording = make_plan(), make_recording()
    plan.parameters, plan.provenance = limb, made(1, "plan fig5 -l limb.yaml -o plan.csv")
    plan.save(folder / "plan.csv")
    recording.provenance = made(2, "replay ../plan.csv -o a.csv --report b.csv")
    recording.save(folder / "day 1/a.csv")
    page.write_page(folder / "day 1/a.html", "How a went", [], recording.provenance)
    write_meshcat_replay(folder / "day 1/3d.html", recording, title="a in 3D")
    plan.provenance = recording.provenance = made(3, "follow fig5 -o 'day 1'")
    plan.save(folder / "day 1/plan.csv")
    recording.save(folder / "day 1/b.csv")
    text = (folder / "plan.csv").read_text()
    (folder / "broken.csv").write_text(text[: len(text) // 2])
    (folder / "<script>alert(1)<.csv").write_text("a,b\n1,2\n")
    (folder / "mine.html").write_text("<!doctype html><title>mine</title>")
    (folder / "notes.txt").write_text("not ours")
    (folder / "../secret.csv").write_text((folder / "plan.csv").read_text())
    (folder / "out.csv").symlink_to("../secret.csv")
    return folder


def test_what_is_in_a_folder_and_what_belongs_together(folder):
    found = Overview(folder)
    found.look()
    assert [file.key for file in found.files if file.kind and file.kind != "report"] == [
        "day 1/b.csv",
        "day 1/plan.csv",
        "day 1/a.csv",
        "plan.csv",
        "limb.yaml",
    ]
    origins = {key: [file.key for file in files] for key, files in found.origins().items()}
    assert origins == {
        "day 1/b.csv": ["day 1/plan.csv"],  # of the same command, with no name in it
        "day 1/plan.csv": ["limb.yaml"],  # by its digest
        "day 1/a.csv": ["plan.csv"],  # and not b.csv, which the command wrote
        "plan.csv": ["limb.yaml"],
        "limb.yaml": [],
    }
    pages = {key: {page.key for page in files} for key, files in found.pages().items()}
    assert pages == {"day 1/a.csv": {"day 1/a.html", "day 1/3d.html"}}
    troubles = " ".join(file.trouble for file in found.files)
    for name in ("broken.csv", "<script>alert(1)<.csv", "mine.html"):
        assert name in troubles
    assert "notes.txt" not in troubles
    assert "secret" not in troubles
    shown = overview_page(found, lambda file: file.key)
    assert "<script>alert" not in shown
    assert "day%201/a.html" in shown
    assert ">a in 3D</a>" in shown
    assert 'aria-label="bend angle, -9 to 11°, over 4 s"' in shown
    assert shown.count("<polyline") == 2 * 4 + 2 * 5  # plans have a reference


def test_a_file_is_read_again_only_if_it_has_changed(folder, monkeypatch):
    read = []
    whole = overview.read_result
    monkeypatch.setattr(
        overview, "read_result", lambda path, **how: read.append(path) or whole(path, **how)
    )
    found = Overview(folder)
    while not read or found.unread:
        found.look(0.0)  # one at a time
    files = found.files
    count = len(read)
    make_recording(5.0).save(folder / "day 1/b.csv")
    (folder / "plan.csv").unlink()
    found.look()
    assert read[count:] == [folder / "day 1/b.csv"]
    assert len(found.files) == len(files) - 1


@pytest.fixture
def serve():
    """A function that serves a folder and returns a function that asks, and the page."""
    ends = []

    def start(folder):
        started, served = threading.Event(), {}

        def run():
            async def go():
                served["page"] = StartPage(folder, "127.0.0.1", 0, ["my_law"])
                served["end"] = asyncio.current_task().cancel
                served["loop"] = asyncio.get_running_loop()
                started.set()
                await served["page"].serve()

            with contextlib.suppress(asyncio.CancelledError):
                asyncio.run(go())

        thread = threading.Thread(target=run)
        thread.start()
        assert started.wait(600.0)
        ends.append((thread, served))
        port = int(re.search(r":(\d+)/", served["page"].url)[1])

        def ask(path, body=None, **headers):
            connection = http.client.HTTPConnection("127.0.0.1", port)
            method = "GET" if body is None else "POST"
            connection.request(method, path, body, {"Host": f"127.0.0.1:{port}"} | headers)
            answer = connection.getresponse()
            return answer.status, answer.read().decode("utf-8", "replace"), answer.headers

        return ask, served["page"]

    yield start
    for thread, served in ends:
        served["loop"].call_soon_threadsafe(served["end"])
        thread.join()


def test_results_are_served_and_nothing_else(folder, serve):
    ask, _ = serve(folder)
    status, shown, headers = ask("/")
    assert status == 200
    assert headers["X-Frame-Options"] == "SAMEORIGIN"
    assert "Compare what is ticked" in shown
    status, text, headers = ask("/file/day%201/a.html")
    assert (status, "How a went" in text) == (200, True)
    # A page in the folder is of no origin: what it asks for here is refused.
    assert headers["Content-Security-Policy"].startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in headers["Content-Security-Policy"]
    (folder / "day 1/tracking.png").write_bytes(b"picture")
    (folder / "private.png").symlink_to("/etc/hostname")
    (folder / "day 1/private.png").symlink_to("/etc/hostname")
    assert ask("/file/day%201/tracking.png")[:2] == (200, "picture")
    for path in (
        "/file/../secret.csv",
        "/file/%2e%2e/secret.csv",
        "/file/day%201/..%2f..%2fsecret.csv",
        f"/file/{folder.parent}/secret.csv",
        "/file/out.csv",
        "/file/notes.txt",
        "/file/mine.html",
        "/file/broken.csv",
        "/file/private.png",
        "/file/day%201/private.png",
        "/file/day%201/%00.png",
        "/compare?run=plan.csv&run=../secret.csv",
    ):
        assert ask(path)[0] == 404, path
    # What was a result, and leads out of the folder since.
    (folder / "plan.csv").unlink()
    (folder / "plan.csv").symlink_to(folder.parent / "secret.csv")
    assert ask("/file/plan.csv")[0] == 404


FORM = {"Content-Type": "application/x-www-form-urlencoded"}
CHILD = "print('live        http://127.0.0.1:1/', flush=True); input(); print('done')"


def test_a_plan_is_replayed_on_an_emulated_limb_and_on_nothing_else(folder, serve, monkeypatch):
    words, create = [], asyncio.create_subprocess_exec

    async def start(*command, **options):
        words.append(command)
        options["stdin"] = asyncio.subprocess.PIPE  # which waits for its end
        return await create(sys.executable, "-c", CHILD, **options)

    monkeypatch.setattr(start_page.asyncio, "create_subprocess_exec", start)
    ask, shown = serve(folder)
    ask("/")
    for body, headers in (
        ("plan=day+1%2Fa.csv", {}),  # no plan
        ("plan=..%2Fsecret.csv", {}),
        ("plan=plan.csv&port=%2Fdev%2FttyACM0", {"Origin": "http://example.org"}),
        ("plan=plan.csv", {"Origin": "null"}),
        ("plan=plan.csv", {"Host": "example.org"}),
    ):
        assert ask("/start", body, **FORM, **headers)[0] in (403, 404)
    assert not words
    (folder / "plan_emulated_1.csv").write_text("is not replaced")
    status, _, headers = ask("/start", "plan=plan.csv&port=%2Fdev%2FttyACM0", **FORM)
    assert (status, headers["Location"]) == (303, "http://127.0.0.1:1/")
    output = folder.resolve() / "plan_emulated_2.csv"
    (command,) = words
    assert list(command[4:]) == [
        *["--import", "my_law", "replay", str(folder.resolve() / "plan.csv")],
        *["-o", str(output), "--live"],
    ]
    assert "is replayed on an emulated limb" in ask("/")[1]
    assert ask("/start", "plan=plan.csv", **FORM)[2]["Location"] == "/"  # one at a time
    assert len(words) == 1
    shown._replay.stdin.write(b"\n")
    end = time.monotonic() + 20.0
    while "was replayed" not in ask("/")[1]:
        assert time.monotonic() < end


def test_soft_limb_alone_lists_what_is_there_and_runs_writes_a_page(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main([]) == 0
    said = capsys.readouterr().out
    assert said.startswith("8 results here, newest first:\n")
    assert re.search(r"\d\d:\d\d  trajectory  day 1/plan.csv\n", said)
    assert "soft-limb --help" in said
    assert main(["runs", "-o", "day 1/all.html"]) == 0
    written = Path("day 1/all.html").read_text()
    assert 'href="../plan.csv"' in written
    assert 'href="a.html"' in written
    assert "<button" not in written
    assert main(["runs", "-o", "day 1/all.html"]) == 1
    assert main(["runs", "nowhere"]) == 1
    assert "Cannot list nowhere" in capsys.readouterr().err
