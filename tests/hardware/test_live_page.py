"""The live page: what it shows, its button, who may see it, and that no run depends on it."""

import asyncio
import concurrent.futures
import contextlib
import dataclasses
import html
import http.client
import math
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import warnings
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from bokeh.document import Document
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from controllers import Learner
from hardware import LimbTwin, SerialLimb, replay
from hardware.board.link import Sample
from hardware.firmware import guard
from hardware.live_feed import Message, Reading, RunHeader
from limb_systems import LimbParameters, Recording, Trajectory
from planners import plan, references
from soft_limb import live_page
from soft_limb.command import main
from soft_limb.live_page import LivePage, Page, Run

from .conftest import wait_for

PATIENCE = 600_000  # ms, after which a page hangs

READ = """() => {
    const source = Bokeh.documents[0].get_model_by_name("readings");
    const columns = Object.entries(source.data).map(([name, values]) => [name, [...values]]);
    const facts = Bokeh.documents[0].get_model_by_name("facts").text;
    return {columns: Object.fromEntries(columns), facts};
}"""
COUNT = "window.Bokeh?.documents[0]?.get_model_by_name('readings')?.data.time?.length ?? 0"


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    """Twenty seconds that heat the right wire all the time."""
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 100.0
    return plan(parameters, references.from_samples([0.0, 20.0], [0.0, 0.4]), knot_rate=4.0)


@pytest.fixture
def beginning(motion) -> Trajectory:
    """A second of it."""
    reference = references.from_samples([0.0, 1.0], [0.0, 0.05])
    return plan(motion.parameters, reference, knot_rate=4.0)


PROGRAM = """
from controllers import Learner
from hardware import LimbTwin, replay
from limb_systems import Trajectory
from soft_limb.command import run_command
from soft_limb.live_page import LivePage

def run():
    plan = Trajectory.load("plan.csv")
    with LivePage() as live:
        print(live.url, flush=True)
        input()
        replay(plan, LimbTwin(plan.parameters, seed=1), journal="rec.csv", live=live)

run_command(run, "stopped; wires are off")
"""


@pytest.mark.whole
def test_browsers_show_what_is_recorded_and_their_button_stops(
    start_host, browser, motion, tmp_path
):
    """One run in real time, on two pages: one is closed on the way, the other stops it.

    An emulated limb bears a computer that is busy. A board's host that gets the button's signal
    switches off in time in test_faults.py.
    """
    long = dataclasses.replace(motion, time=30 * motion.time)  # than any browser takes
    long.save(tmp_path / "plan.csv")
    said, shown = run_and_stop(start_host, browser, tmp_path)
    assert "stopped; wires are off" in said
    recording = Recording.load(tmp_path / "rec.unfinished.csv")
    assert recording.interrupted == "stopped by Ctrl-C or a signal"
    np.testing.assert_allclose(np.diff(recording.time), 0.05, atol=1e-9)
    for page in shown:
        columns = page["columns"]
        assert len(columns["time"]) > 30
        index = np.round(np.array(columns["time"]) * 20).astype(int)
        index = index[index < len(recording.time)]  # the journal comes after the feed
        for name, scale in (
            ("bend_angle", np.rad2deg(1.0)),
            ("measured_temperature", 1.0),
            ("duty", 1.0),
            ("applied_duty", 1.0),
        ):
            for row, recorded in enumerate(scale * getattr(recording, name)[:, index]):
                told = columns[f"{name}_{row}"][: len(index)]
                np.testing.assert_allclose(told, recorded, atol=1e-6)
    read = re.search(r"reading V, °C</td><td>([\d.]+)</td><td>([\d.]+)", shown[0]["facts"])
    for wire in range(2):
        away = np.abs(recording.measured_temperature[wire] - float(read[wire + 1]))
        assert away.min() <= 0.06


def run_and_stop(start_host, browser, folder):
    """What the host said, and what the page showed on the way and at the end."""
    screenless = {"DISPLAY", "WAYLAND_DISPLAY"}
    host = start_host(
        [sys.executable, "-c", PROGRAM],
        cwd=folder,
        env={name: value for name, value in os.environ.items() if name not in screenless},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    url, asked = host.stdout.readline().strip(), []
    closed, page = (browser.new_context().new_page() for _ in range(2))
    for one in (closed, page):
        one.set_default_timeout(PATIENCE)
        one.on("request", lambda request: asked.append(request.url))
        one.goto(url)
        one.get_by_text("No limb runs").wait_for()
    assert {address.split("/")[2] for address in asked if "//" in address} == {url.split("/")[2]}
    host.stdin.write("\n")
    host.stdin.flush()
    page.wait_for_function(f"() => ({COUNT}) > 30")
    # A browser that comes late has the curves from the beginning.
    late = browser.new_context().new_page()
    late.set_default_timeout(PATIENCE)
    late.goto(url)
    late.wait_for_function(f"() => ({COUNT}) > 30")
    late.context.close()
    closed.context.close()
    shown = [page.evaluate(READ)]
    page.wait_for_function(f"() => ({COUNT}) > 50")
    assert host.poll() is None, host.stderr.read()
    page.get_by_role("button", name="STOP").click()
    page.get_by_text("Ended: stopped by Ctrl-C, by a signal or on the page").wait_for()
    shown.append(page.evaluate(READ))  # the curves stay
    page.context.close()
    return host.communicate()[1], shown


class Told:
    """In place of a `LivePage`: keeps what it is told."""

    url = "http://127.0.0.1:1/"

    def __init__(self):
        self.phases, self.readings, self.said, self.ended = [], [], [], []
        self.begin, self.show, self.say = self.phases.append, self.readings.append, self.said.append
        self.end = self.ended.append
        self.rested = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end("left")

    def rest(self):
        self.rested += 1


def test_what_is_told_is_what_is_recorded(virtual_time, beginning):
    told = Told()
    begun = virtual_time.monotonic()
    recording = replay(beginning, LimbTwin(seed=1), live=told)
    assert virtual_time.monotonic() - begun >= 1.0  # in real time
    (phase,) = told.phases
    assert phase.source == "emulated limb, seed 1"
    assert (phase.limit, phase.duration, phase.plan.time[-1]) == (110.0, 1.0, 1.0)
    assert told.rested == 1
    np.testing.assert_allclose([r.time for r in told.readings], recording.time, atol=1e-9)
    for name in ("bend_angle", "measured_temperature", "duty", "applied_duty"):
        values = np.array([getattr(reading, name) for reading in told.readings]).T
        np.testing.assert_allclose(values, getattr(recording, name), atol=1e-9)


def test_what_is_told_of_a_robot_has_the_samples_of_its_board(virtual_time, emulator, beginning):
    told = Told()
    limb = SerialLimb(emulator.port, beginning.parameters)
    recording = replay(beginning, limb, live=told)
    assert all(reading.sample.armed for reading in told.readings)
    assert not any(reading.lost_samples for reading in told.readings)
    applied = [reading.sample.duty[1] for reading in told.readings]
    assert max(applied) == recording.applied_duty[1].max() > 0.0


def test_commands_say_where_the_page_is_and_what_runs(virtual_time, monkeypatch, tmp_path, capsys):
    pages = []
    monkeypatch.setattr("soft_limb.runs.repetitions.REST_TIME", 1.0)
    monkeypatch.setattr("soft_limb.runs.repetitions.write_learning_report", lambda *_: None)
    monkeypatch.setattr(live_page, "LivePage", lambda: pages.append(Told()) or pages[-1])
    reference = references.from_samples([0.0, 0.5], [0.0, 0.02])
    plan(LimbParameters(), reference, knot_rate=4.0).save(tmp_path / "plan.csv")
    path = str(tmp_path / "plan.csv")
    assert main(["replay", path, "-o", str(tmp_path / "rec.csv"), "--live"]) == 0
    assert "live        http://127.0.0.1:1/\n" in capsys.readouterr().out
    assert main(["learn", path, "-o", str(tmp_path / "l"), "-n", "2", "--live", "--json"]) == 0
    assert "live        http://127.0.0.1:1/\n" in capsys.readouterr().err
    replayed, learned = pages
    assert replayed.said == [f"Replay of {path}, controller open-loop"]
    assert replayed.ended == ["done", "left"]
    first, second = learned.said
    assert first == "Repetition 1 of 2"
    earlier = Learner.load(tmp_path / "l" / "learning.txt").repetitions[0]
    distance = f"{np.rad2deg(earlier.reference_distance):.2f}°"
    so_far = "mean distances from the reference so far, as read"
    assert second == f"Repetition 2 of 2; {so_far}: {distance}"
    assert (len(replayed.phases), len(learned.phases), learned.rested) == (1, 2, 2)
    assert main(["replay", path, "-o", str(tmp_path / "unseen.csv")]) == 0
    assert len(pages) == 2


@pytest.mark.whole
def test_a_page_says_when_its_program_is_silent(browser, live):
    page = browser.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(live.url)
    page.get_by_text("No limb runs").wait_for()
    silent = page.get_by_text("Nothing comes from the page's own program")
    silent.wait_for(state="hidden")
    os.kill(live._process.pid, signal.SIGSTOP)
    try:
        silent.wait_for()
    finally:
        os.kill(live._process.pid, signal.SIGCONT)
    silent.wait_for(state="hidden")
    page.close()


def test_the_end_of_a_program_does_not_wait_for_a_frozen_page():
    """Whatever the reason: a pipe without a reader takes 64 kB."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    page = object.__new__(LivePage)
    page._ended = False
    page._socket = mock.Mock()
    page._process = mock.Mock(stdin=os.fdopen(writer, "wb"), poll=lambda: None)
    with warnings.catch_warnings(action="error"):
        page.end("\udcff.csv: " + 10_000 * "too hot ")  # the name of a file is no UTF-8
    assert os.read(reader, 100_000).decode().startswith("?.csv: too hot too hot")
    os.close(reader)


@pytest.fixture(scope="module")
def live():
    """A page of a program that a shell runs in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with LivePage(open_browser=False) as live:
            yield live
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def port(live):
    return int(re.search(r":(\d+)/", live.url)[1])


@pytest.fixture(scope="module")
def token(live):
    return live.url.partition("?token=")[2]


def ask(port, path, **headers):
    """The status, headers and text of an answer."""
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    connection = http.client.HTTPConnection("127.0.0.1", port)
    with contextlib.closing(connection):
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read().decode()


def connect(port, query, page_token, **headers):
    """The first message of a page's websocket; None if it is closed, a status if it is refused."""

    async def first_message():
        request = HTTPRequest(f"ws://127.0.0.1:{port}/ws{query}", headers=headers)
        protocols = ["bokeh", page_token] if page_token else None
        connection = await websocket_connect(request, subprotocols=protocols)
        with contextlib.closing(connection):
            return await connection.read_message()

    try:
        # Playwright's loop is that of this thread.
        with concurrent.futures.ThreadPoolExecutor() as pool:
            return pool.submit(asyncio.run, first_message()).result()
    except HTTPClientError as error:
        return error.code


def test_without_the_token_there_is_no_page_and_no_websocket(port, token):
    assert len(token) > 40
    right, wrong = f"?token={token}", f"?token={token[:-1]}-"
    for path in ("/", "/autoload.js", "/metadata", "/ws", "/nothing"):
        for query in ("", wrong, "?token=", f"?bokeh-session-id={token}"):
            assert ask(port, f"{path}{query}")[0] == 403, (path, query)
        assert ask(port, path, Cookie=f"token={token}")[0] == 403
    status, headers, page = ask(port, f"/{right}")
    assert (status, headers["X-Frame-Options"]) == (200, "DENY")
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "Set-Cookie" not in headers
    # The page opens its websocket with a word of its own too, which Bokeh signs.
    signed = re.search(r'"token":"([^"]+)"', page)[1]
    assert "ACK" in connect(port, right, signed)
    assert connect(port, wrong, signed) == 403
    content, _, signature = signed.partition(".")
    for forged in (None, content, f"{content}.{signature[::-1]}", token):
        assert connect(port, right, forged) is None, forged


def test_other_sites_are_refused(port, token):
    """Their pages name themselves; their names, made to lead here, are none of this page."""
    query = f"?token={token}"
    signed = re.search(r'"token":"([^"]+)"', ask(port, f"/{query}")[2])[1]
    for name in ("127.0.0.1", "localhost"):
        home = {"Host": f"{name}:{port}", "Origin": f"http://{name}:{port}"}
        assert ask(port, f"/{query}", **home)[0] == 200
        assert "ACK" in connect(port, query, signed, **home)
    home = f"127.0.0.1:{port}"
    for host, origin in (
        (home, "http://example.org"),
        (home, f"https://{home}"),
        (home, f"http://localhost:{port}"),
        (home, f"http://127.0.0.1:{port + 1}"),
        (home, "null"),
        (f"example.org:{port}", f"http://example.org:{port}"),
        ("127.0.0.1", "http://127.0.0.1"),
    ):
        assert ask(port, f"/{query}", Host=host, Origin=origin)[0] == 403, (host, origin)
        assert connect(port, query, signed, Host=host, Origin=origin) == 403, (host, origin)
    for path in (f"/{query}", "/static/js/bokeh.min.js"):
        assert ask(port, path, Host=f"example.org:{port}")[0] == 403


def test_only_the_page_listens_and_only_on_the_loopback(live, port, motion):
    live.begin(RunHeader("a limb", motion.parameters, 110.0, 20.0, plan=motion))
    pid = live._process.pid
    mine = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        # The process may close a file between its listing and here.
        with contextlib.suppress(FileNotFoundError):
            mine.add(os.readlink(link))
    tables = (Path(f"/proc/{pid}/net/{name}").read_text() for name in ("tcp", "tcp6"))
    rows = [line.split() for table in tables for line in table.splitlines()]
    listening = [row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in mine]
    assert listening == [f"0100007F:{port:04X}"]


def test_the_button_stops_once_in_two_seconds_and_nothing_else_than_its_program(monkeypatch):
    now, sent = [100.0], []
    monkeypatch.setattr(live_page.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(live_page.os, "kill", lambda *what: sent.append(what))
    run = Run(os.getppid())
    for step in (0.0, 0.3, 1.0, 1.0):
        now[0] += step
        run.stop()
    assert sent == [(os.getppid(), signal.SIGINT)] * 2
    Run(os.getppid() + 1).stop()
    run.end(live_page.DONE)
    now[0] += 3.0
    run.stop()
    assert len(sent) == 2


def test_the_button_is_heeded_in_the_background(live):
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_a_frozen_page_is_never_waited_for(live):
    reading = Reading(0.0, [0.0], [25.0] * 2, [0.0] * 2)

    def tell_much():
        for _ in range(3000):
            live.show(reading)
        live.begin(RunHeader("a limb", LimbParameters(), 110.0, 20.0))

    os.kill(live._process.pid, signal.SIGSTOP)
    try:
        thread = threading.Thread(target=tell_much, daemon=True)
        thread.start()
        thread.join(PATIENCE / 1000)
        assert not thread.is_alive()
        assert live._unsent_header  # it was not taken; it goes with what is told next
    finally:
        os.kill(live._process.pid, signal.SIGCONT)

    def is_sent():
        live.show(reading)
        return live._unsent_header is None

    assert wait_for(is_sent)


def tell(run, *readings):
    for reading in readings:
        run.take(pickle.dumps(Message("a run", reading)), [])


def test_pages_have_the_newest_readings_also_if_they_are_opened_late(monkeypatch, motion):
    monkeypatch.setattr(live_page, "MAX_READINGS", 150)
    run = Run(0)
    early = Page(run)
    for count in (100, 500):
        run.begin(RunHeader("a limb", motion.parameters, 110.0, 30.0))
        for step in range(count):
            tell(run, Reading(step / 20, [0.0], [30.0, 20.0], [0.0] * 2))
            if step % 40 == 0:
                early.update()
        for page in (early, Page(run)):
            page.update()
            times = np.array(page.source.data["time"])
            np.testing.assert_allclose(times, np.arange(max(0, count - 150), count) / 20)


def test_a_value_that_is_missing_is_a_gap_and_charts_that_fail_leave_the_texts(monkeypatch, motion):
    run, document = Run(0), Document()
    page = Page(run)
    page.add_to(document)
    run.begin(RunHeader("a limb", motion.parameters, 110.0, 20.0))
    tell(run, Reading(1.0, [math.nan], [30.0, 20.0], [0.0] * 2))
    page.update()
    told = page.source.data
    assert np.isnan([*told["bend_angle_0"], *told["reference_0"]]).all()
    assert told["measured_temperature_1"] == [20.0]
    monkeypatch.setattr(live_page, "panels", lambda *_: 1 / 0)
    run.begin(RunHeader("another limb", motion.parameters, 110.0, 20.0))
    with pytest.raises(ZeroDivisionError):  # which the server logs
        page.update()
    assert "another limb" in document.get_model_by_name("facts").text
    run.end("done")
    page.update()  # the page goes on without them
    assert "Ended: done" in document.get_model_by_name("state").text
    assert document.get_model_by_name("stop").disabled


def test_alarms_say_which_wire_is_hot(motion):
    run = Run(0)
    limits = motion.parameters.temperature_limits
    run.begin(RunHeader("a limb", motion.parameters, 110.0, 20.0))
    for temperature, expected in (
        (limits.maximum - 11.0, []),
        (limits.maximum - 1.0, [("near", "near T_max")]),
        (limits.maximum + 0.1, [("near", "above T_max")]),
        (110.0, [("bad", "too hot")]),
    ):
        tell(run, Reading(1.0, [0.0], [20.0, temperature], [0.0] * 2))
        found = live_page.alarms(run)
        assert len(found) == len(expected)
        for (kind, sentence), (expected_kind, word) in zip(found, expected, strict=True):
            assert kind == expected_kind
            assert sentence.startswith(f"right: {temperature:.1f} °C, {word}")
            assert sentence in live_page.state(run)
    tell(run, Reading(1.0, [0.0], [20.0, math.nan], [0.0] * 2))
    assert live_page.alarms(run) == [("near", "right: no reading")]


def test_the_page_says_whether_the_board_is_armed_and_else_why_not(motion):
    run = Run(0)
    run.begin(RunHeader("a limb", motion.parameters, 110.0, 20.0))
    cold = np.zeros(2)
    warmest = np.array([41.0, 52.0])
    armed = Sample(0.0, 1, 1.0, 7, True, 0, 1, cold, np.zeros(1), cold, warmest)
    reading = Reading(1.0, [0.0], [20.0] * 2, [0.0] * 2, sample=armed, lost_samples=3)
    tell(run, reading)
    assert "Armed: wires may be heated" in live_page.state(run)
    for text in ("3 samples lost", "41", "52"):
        assert text in live_page.facts(run)
    off = dataclasses.replace(armed, armed=False, reason=guard.RESTARTED)
    tell(run, dataclasses.replace(reading, sample=off))
    assert f"Wires off: {off.reason_text}" in html.unescape(live_page.state(run))


def test_a_page_that_does_not_start_is_said_before_anything_is_heated(
    monkeypatch, motion, tmp_path, capsys
):
    monkeypatch.setattr(live_page.sys, "executable", "/bin/false")
    motion.save(tmp_path / "plan.csv")
    arguments = ["replay", str(tmp_path / "plan.csv"), "-o", str(tmp_path / "recording.csv")]
    assert main([*arguments, "--live"]) == 1
    assert "error: The live page does not start" in capsys.readouterr().err
    assert not (tmp_path / "recording.csv").exists()


def test_a_page_that_freezes_and_dies_changes_nothing(
    live, virtual_time, emulator, beginning, tmp_path
):
    """It is frozen on the way, and then killed; what is told to it is lost. No test may follow."""
    limb = SerialLimb(emulator.port, beginning.parameters)

    def kill():
        live._process.kill()
        live._process.wait()

    def is_hot():
        return emulator.duty()[1] > 0.0

    virtual_time.when(is_hot, lambda: os.kill(live._process.pid, signal.SIGSTOP), after=0.3)
    virtual_time.when(is_hot, kill, after=0.6)
    recording = replay(beginning, limb, journal=tmp_path / "journal.csv", live=live)
    with pytest.warns(UserWarning, match="page's process died"):
        live.end("done")
    assert len(recording.time) == len(Recording.load(tmp_path / "journal.csv").time) == 21
    assert limb.link.lost_samples == 0
