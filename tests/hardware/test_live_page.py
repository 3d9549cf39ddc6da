"""The live page: what it shows, its button, who may see it, and that no run depends on it."""

import contextlib
import dataclasses
import http.client
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.geometry import Meshcat, MeshcatParams

from controllers import Learner
from hardware import LimbTwin, SerialLimb, replay
from hardware.live_feed import Message, Reading, RunHeader
from limb_systems import (
    LimbError,
    LimbParameters,
    LimbVisualizer,
    Recording,
    Trajectory,
    joint_angles_from_bend_angle,
)
from planners import plan, references
from soft_limb.command import main
from soft_limb.commands import options
from soft_limb.live import server
from soft_limb.live.live_page import LivePage
from soft_limb.live.run import MOST_POINTS, Run
from soft_limb.live.shown import Browser, columns
from soft_limb.live.site import COOKIE, Gate
from soft_limb.live.view import View
from soft_limb.runs.cooling import cool_down
from soft_limb.runs.repetitions import repeat
from soft_limb.runs.rollout import roll_out

from .conftest import last_numbers, wait_for

PATIENCE = 600_000  # ms, after which a page hangs

READ = """() => {
    const source = Bokeh.documents[0].get_model_by_name("readings");
    const columns = Object.entries(source.data).map(([name, values]) => [name, [...values]]);
    const facts = document.querySelector("#facts").innerHTML;
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
from hardware import LimbTwin, replay
from limb_systems import Trajectory
from soft_limb.command import run_command
from soft_limb.live.live_page import LivePage

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
        # Chromium draws in 3D without a graphics card here, on the cores that keep time.
        one.route("**/view/", lambda route: route.fulfill(body=""))
        one.on("request", lambda request: asked.append(request.url))
        one.goto(url)
        one.get_by_text("No limb runs").wait_for()
    assert {address.split("/")[2] for address in asked if "//" in address} == {url.split("/")[2]}
    host.stdin.write("\n")
    host.stdin.flush()
    page.wait_for_function(f"() => ({COUNT}) > 30")
    closed.context.close()
    shown = [page.evaluate(READ)]
    page.wait_for_function(f"() => ({COUNT}) > 50")
    assert host.poll() is None, host.stderr.read()
    page.get_by_role("button", name="STOP").click()
    page.get_by_text("Ended: stopped by Ctrl-C, by a signal or on the page").wait_for()
    shown.append(page.evaluate(READ))  # the curves stay
    page.context.close()
    return host.communicate()[1], shown


def test_a_page_that_freezes_and_dies_changes_nothing(virtual_time, emulator, beginning, tmp_path):
    """It is frozen on the way, and then killed; what is told to it is lost."""
    limb = SerialLimb(emulator.port, beginning.parameters)
    with LivePage() as live:

        def kill():
            live._process.kill()
            live._process.wait()

        def is_hot():
            return emulator.duty()[1] > 0.0

        virtual_time.when(is_hot, lambda: os.kill(live._process.pid, signal.SIGSTOP), after=0.3)
        virtual_time.when(is_hot, kill, after=0.6)
        recording = replay(beginning, limb, journal=tmp_path / "journal.csv", live=live)
        with pytest.warns(UserWarning, match="page's process ended before"):
            live.end("done")
    assert len(recording.time) == len(Recording.load(tmp_path / "journal.csv").time) == 21
    assert limb.link.lost_samples == 0


class Told:
    """In place of a `LivePage`: keeps what it is told."""

    url = "http://127.0.0.1:1/"

    def __init__(self, address=""):
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


def test_commands_say_where_the_page_is_and_what_runs(virtual_time, monkeypatch, tmp_path, capsys):
    pages = []
    monkeypatch.setattr(options, "LivePage", lambda at: pages.append(Told(at)) or pages[-1])
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
    assert re.fullmatch(r"Repetition 2 of 2; mean \|φ\* - φ\| so far \d\.\d\d°", second)
    assert (len(replayed.phases), len(learned.phases), learned.rested) == (1, 2, 2)
    assert main(["replay", path, "-o", str(tmp_path / "unseen.csv")]) == 0
    assert len(pages) == 2


@pytest.mark.whole
def test_a_page_says_when_its_program_is_silent(browser, live):
    page = browser.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(re.sub(r"//.+:", "//127.0.0.1:", live.url))
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


@pytest.fixture(scope="module")
def live():
    """A page for other computers, of a program that a shell runs in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with LivePage("0.0.0.0", open_browser=False) as live:
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
    """The status of an answer, its headers, and its text unless a websocket has begun."""
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    connection = http.client.HTTPConnection("127.0.0.1", port)
    with contextlib.closing(connection):
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read() if answer.status != 101 else b""


def test_from_beyond_this_computer_the_token_is_needed(port, token):
    assert len(token) > 40
    known = f"{COOKIE}_{port}={token}"
    for path in ("/", "/?token=wrong", "/view/", "/live", "/nothing"):
        assert ask(port, path)[0] == 403, path
        assert ask(port, path, Cookie=f"{known[:-1]}-")[0] == 403, path
    code, headers, _ = ask(port, f"/?token={token}")
    assert (code, headers["Location"]) == (302, "/")
    assert headers["Set-Cookie"] == f"{known}; HttpOnly; Path=/; SameSite=Strict"
    for path in ("/", "/view/"):
        code, headers, _ = ask(port, path, Cookie=known)
        assert (code, headers["X-Frame-Options"]) == (200, "SAMEORIGIN"), path
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    # Browsers say from which page a websocket is opened.
    websocket = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13"}
    websocket |= {"Sec_WebSocket_Key": "x", "Cookie": known}
    assert ask(port, "/live", Origin=f"http://127.0.0.1:{port}", **websocket)[0] == 101
    for origin in ("http://example.org", f"https://127.0.0.1:{port}", "null"):
        assert ask(port, "/live", Origin=origin, **websocket)[0] == 403
        assert ask(port, "/", Origin=origin, Cookie=known)[0] == 403


def test_nothing_else_listens(live, port, token, motion):
    """Meshcat's own server asks nobody who they are: it is gone when it has made its page."""
    live.begin(RunHeader("a limb", motion.parameters, 110.0, plan=motion))
    pid, cookie = live._process.pid, f"{COOKIE}_{port}={token}"
    assert wait_for(lambda: len(ask(port, "/view/", Cookie=cookie)[2]) > 1e6)
    mine = {os.readlink(f"/proc/{pid}/fd/{fd}") for fd in os.listdir(f"/proc/{pid}/fd")}
    tables = (Path(f"/proc/{pid}/net/{name}").read_text() for name in ("tcp", "tcp6"))
    rows = [line.split() for table in tables for line in table.splitlines()]
    listening = [row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in mine]
    assert [int(address.split(":")[1], 16) for address in listening] == [port]


def test_the_view_is_what_meshcat_shows(motion):
    """What browsers are told, beside what a `LimbVisualizer` tells a Meshcat."""
    meshcat = Meshcat(MeshcatParams(host="localhost", port=0))
    visualizer = LimbVisualizer(motion.parameters, meshcat, motion)
    context = visualizer.CreateDefaultContext()
    reading = Reading(7.0, [0.3], [60.0, 30.0], [0.2, 0.6])
    angles = joint_angles_from_bend_angle(motion.parameters, reading.bend_angle)
    inputs = (np.append(angles, 0.0 * angles), reading.measured_temperature)
    for index, values in enumerate(inputs):
        visualizer.get_input_port(index).FixValue(context, values)
    context.SetTime(reading.time)
    visualizer.ForcedPublish(context)
    told = View()
    told.begin(RunHeader("a limb", motion.parameters, 110.0, plan=motion))
    told = told.commands(reading)
    kinds = [command["type"] for command in told]
    assert (kinds.count("set_transform"), kinds.count("set_property")) == (16, 10)
    for command in told:
        path, name = command["path"], command.get("property")
        said = command["value"] if name else command["matrix"]
        message = (
            meshcat._GetPackedProperty(path, name) if name else meshcat._GetPackedTransform(path)
        )
        np.testing.assert_allclose(said, last_numbers(message, len(said)), atol=1e-9)


def test_at_home_a_page_has_a_name_of_this_computer():
    """Or another site's name could be made to lead here, and its page would be of this origin."""
    gate = Gate(loopback=True, port=5006)
    assert not gate.token

    def is_at_home(host, origin=None):
        headers = {"Origin": origin} if origin else {}
        return gate.is_at_home(SimpleNamespace(host=host, headers=headers))

    assert is_at_home("127.0.0.1:5006")
    assert is_at_home("localhost:5006", "http://localhost:5006")
    assert not is_at_home("example.org:5006")
    assert not is_at_home("example.org:5006", "http://example.org:5006")
    assert not is_at_home("localhost:5006", "http://localhost:5007")
    assert not is_at_home("localhost:5006", "http://127.0.0.1:5006")


def test_the_button_stops_once_in_two_seconds_and_nothing_else_than_its_program(monkeypatch):
    now, sent = [100.0], []
    monkeypatch.setattr(server.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(server.os, "kill", lambda *what: sent.append(what))
    switch = server.StopSwitch(os.getppid())
    for step in (0.0, 0.3, 1.0, 1.0):
        now[0] += step
        switch.press()
    assert sent == [(os.getppid(), signal.SIGINT)] * 2
    server.StopSwitch(os.getppid() + 1).press()
    assert len(sent) == 2


def test_the_button_is_heeded_in_the_background(live):
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_a_frozen_page_is_never_waited_for(live):
    reading = Reading(0.0, [0.0], [25.0] * 2, [0.0] * 2)

    def tell_much():
        for _ in range(3000):
            live.show(reading)
        live.begin(RunHeader("a limb", LimbParameters(), 110.0))

    os.kill(live._process.pid, signal.SIGSTOP)
    try:
        thread = threading.Thread(target=tell_much, daemon=True)
        thread.start()
        thread.join(PATIENCE / 1000)
        assert not thread.is_alive()
        assert live._phase  # it was not taken; it goes with what is told next
    finally:
        os.kill(live._process.pid, signal.SIGCONT)

    def is_sent():
        live.show(reading)
        return live._phase is None

    assert wait_for(is_sent)


def test_a_page_that_is_opened_late_shows_what_was_before(motion):
    """All of a run with an end, also beyond it, and minutes of what has none."""
    for duration, first in ((20.0, 0.0), (None, 100.0)):
        run = Run()
        run._begin(RunHeader("a limb", motion.parameters, 110.0, duration))
        early, shown = Browser(run), []
        for step in range(14000):
            reading = Reading(step / 20, [0.0], [30.0, 20.0], [0.0] * 2)
            run.take(pickle.dumps(Message("", reading)), [])
            if step % 2000 == 0 or step == 13999:
                news = early.curves()
                assert ("charts" in news) == (step == 0)
                shown = news["data"]["time"] if "data" in news else shown + news["rows"]["time"]
        for times in (shown[-MOST_POINTS:], Browser(run).curves()["data"]["time"]):
            assert times[0] == pytest.approx(first, abs=1.0)
            assert times[-1] == pytest.approx(700.0, abs=1.0)
            np.testing.assert_allclose(np.diff(times), times[1] - times[0])
            assert len(times) <= MOST_POINTS


def test_a_value_that_is_missing_is_a_gap(motion):
    """JSON has no number for it, and Meshcat no pose."""
    phase = RunHeader("a limb", motion.parameters, 110.0)
    reading = Reading(1.0, [float("nan")], [30.0, 20.0], [0.0] * 2)
    told, view = columns(phase, [reading]), View()
    view.begin(phase)
    assert (told["bend_angle_0"], told["reference_0"]) == ([None], [None])
    assert told["measured_temperature_1"] == [20.0]
    assert view.commands(reading) == []
    other = RunHeader("a chain", LimbParameters.in_space(), 110.0, plan=motion)
    with pytest.raises(LimbError, match="cannot be shown together"):
        view.begin(other)  # the page goes on without the view
    assert view.page == ""
    assert view.commands(dataclasses.replace(reading, bend_angle=[0.1])) == []


def test_a_limb_is_shown_while_it_cools(virtual_time, motion):
    told, twin = Told(), LimbTwin(seed=1)
    recording = replay(motion, twin)
    cool_down(twin, recording, told, 0.5)
    assert not told.phases  # the curves go on
    assert told.rested == 1
    assert [reading.time for reading in told.readings] == pytest.approx(
        recording.time[-1] + np.arange(11) / 20
    )
    assert all(reading.cooling and reading.duty == [0.0, 0.0] for reading in told.readings)
    warm = recording.measured_temperature[1, -1]
    assert warm - 5.0 < told.readings[-1].measured_temperature[1] < warm + 1.0
    cool_down(LimbTwin(seed=1), recording, told, 5.0)  # which is cool
    assert len(told.readings) == 12


def test_an_emulated_limb_that_is_stopped_on_the_page_leaves_its_recording(
    virtual_time, motion, tmp_path
):
    """As the page does, which sends the signal of Ctrl-C."""

    class Stopping(Told):
        def show(self, reading):
            if reading.time >= 0.5:
                raise KeyboardInterrupt

        def __init__(self):
            super().__init__()
            del self.show

    output = tmp_path / "recording.csv"
    with pytest.raises(KeyboardInterrupt), pytest.warns(UserWarning, match="until then is in"):
        roll_out(motion, LimbTwin, output, live=Stopping())
    kept = Recording.load(tmp_path / "recording.unfinished.csv")
    assert kept.time[-1] == pytest.approx(0.5, abs=0.06)
    assert kept.interrupted == "stopped by Ctrl-C or a signal"
    learner = Learner(motion)
    with pytest.raises(KeyboardInterrupt), pytest.warns(UserWarning, match="until then is in"):
        repeat(learner, LimbTwin, 1, tmp_path, live=Stopping())
    assert len(Recording.load(tmp_path / "repetition_1.unfinished.csv").time) > 5


def test_a_page_that_cannot_be_served_is_said_before_anything_is_heated(
    port, motion, tmp_path, capsys
):
    motion.save(tmp_path / "plan.csv")
    arguments = ["replay", str(tmp_path / "plan.csv"), "-o", str(tmp_path / "recording.csv")]
    assert main([*arguments, "--live-address", f"127.0.0.1:{port}"]) == 1
    said = f"error: The page cannot be served at 127.0.0.1:{port}: Address already in use"
    assert said in capsys.readouterr().err
    assert not (tmp_path / "recording.csv").exists()
    for wrong in ("", "somewhere:port", "host/path", "host:99999"):
        with pytest.raises(LimbError, match="is no address for a page"):
            LivePage(wrong)
