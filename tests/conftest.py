"""What several test files share, and which tests run beside each other.

Two workers of pytest-xdist run the tests: a file is on one worker, and so are the files of
`CALIBRATION`, so that what tests share is made once. What starts hosts of boards in real time is on
one worker as well, and all others leave the processor to it: a host that comes too late is started
again, which takes time. No verdict depends on how fast the computer is.
"""

import contextlib
import gc
import os
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from xdist.scheduler import LoadScopeScheduling

# A worker for each core: more threads would only wait for each other. Before numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import Simulator

from limb_systems import LimbParameters, PlanCheck, Recording, SegmentParameters, Trajectory
from planners import Task, plan, references
from walking import Gait, GaitCheck, GaitPhase, GaitVariation, RobotParameters

CONTROL_PERIOD = 0.05  # s
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
REAL_TIME = (
    "tests/hardware/test_live_page.py",
    "tests/hardware/test_serial_limb.py",
    "tests/examples/test_bridge.py",
)
# These share recordings that take long to make.
CALIBRATION = (
    "tests/calibration/test_calibrate.py",
    "tests/calibration/test_checks.py",
    "tests/calibration/test_collect.py",
    "tests/calibration/test_logs_of_labs.py",
    "tests/calibration/test_wire_fits.py",
)
# What takes long goes first, so that both processes end with short files, and about together.
LONG = (
    "tests/examples/test_reproduce_paper.py",
    CALIBRATION,
    "tests/walking/test_gait_in_space.py",
    "tests/calibration/test_mechanics.py",
    "tests/test_docs.py",
    "tests/walking/test_gait_commands.py",
    "tests/calibration/",
    "tests/examples/",
    "tests/test_wheel.py",
    "tests/walking/",
    "tests/planners/",
    "tests/hardware/",
)


MESHCATS: list[Meshcat] = []


@pytest.fixture
def meshcat() -> Meshcat:
    """A Meshcat that nothing frees.

    Drake ends the process where the garbage of a diagram is collected on another thread than the
    one that made its Meshcat, such as a thread that reads a board.
    """
    MESHCATS.append(Meshcat(MeshcatParams(host="localhost", port=0)))
    return MESHCATS[-1]


@pytest.fixture
def full_disk() -> Callable[[int], contextlib.AbstractContextManager]:
    """A context in which no file gets longer than so many bytes, as on a disk that is full then.

    The operating system's word for it is "File too large" here.
    """

    @contextlib.contextmanager
    def at(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return at


def pytest_configure(config) -> None:
    """Take the signals that tests send, which shells in the background and nohup leave ignored."""
    if config.getoption("numprocesses", None):  # its workers run the tests
        # Compiled modules are kept, or each worker and each command compiles all of them again.
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_ignore_collect(collection_path, config) -> bool | None:
    """Leave out files of which no test is selected: what they import takes long to load."""
    if config.option.markexpr != "not whole" or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text(encoding="utf-8")
    return "\npytestmark = pytest.mark.whole\n" in text or None


class Scheduling(LoadScopeScheduling):
    """By file, `REAL_TIME` and `CALIBRATION`.

    Marks of pytest-xdist's own groups do nothing under pytest 9.2.
    """

    def _split_scope(self, nodeid):
        if nodeid.startswith(REAL_TIME):
            return "real time"
        return "calibration" if nodeid.startswith(CALIBRATION) else nodeid.partition("::")[0]


def pytest_xdist_make_scheduler(config, log):
    return Scheduling(config, log)


def pytest_collection_modifyitems(items):
    """What takes longest goes first."""
    for item in items:
        if "real_emulator" in item.fixturenames and not item.nodeid.startswith(REAL_TIME):
            raise pytest.UsageError(f"{item.nodeid} is timed; name it in REAL_TIME of conftest.py.")

    def order(item):
        places = (place for place, start in enumerate(LONG) if item.nodeid.startswith(start))
        return not item.nodeid.startswith(REAL_TIME), next(places, len(LONG))

    items.sort(key=order)


def pytest_collection_finish():
    """What was imported stays, so that collections of garbage need not look at it again."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item):
    """What is not timed gives way, and so do the programs that it starts."""
    if not item.nodeid.startswith(REAL_TIME) and os.nice(0) == 0:
        os.nice(5)


@pytest.fixture(scope="session")
def fig5_plan() -> Trajectory:
    """The paper's plan of its Fig. 5 reference for the nominal limb, 10 Hz knots over 60 s."""
    return plan(LimbParameters(), references.step_and_decaying_sine(), task=Task.paper())


@pytest.fixture(scope="session")
def plan_like() -> Callable[..., Trajectory]:
    """Makes a trajectory that is no plan, but has the samples of a recording of a model."""
    signals = ("time", "duty", "joint_state", "wire_temperature", "measured_temperature")

    def make(recording: Recording, **others) -> Trajectory:
        given = {name: getattr(recording, name) for name in (*signals, "parameters")}
        usual = {"reference": recording.bend_angle, "check": PlanCheck()}
        return Trajectory(**given | usual | others)

    return make


@pytest.fixture
def gait() -> Gait:
    """A gait of the crawler that is made up: strides of 30 mm in 15 s."""
    robot, turn = RobotParameters(), np.linspace(0, 2 * np.pi, 7)
    wave = np.array([np.sin(turn), np.cos(turn)])
    wave[:, -1] = wave[:, 0]
    angles = np.repeat(0.1 * wave, 5, axis=0)
    heat = np.vstack([60 + 20 * wave, 50 - 10 * wave[:1], np.full((1, 7), 64.0)])
    stick, slide = "stick", "slide_forward"
    contacts = {0.0: [slide, stick], 5.0: [stick, stick], 7.0: [stick, slide], 11.0: [stick, stick]}
    return Gait(
        time=np.linspace(0.0, 15.0, 7),
        duty=np.vstack([0.3 + 0.2 * wave, 0.3 - 0.2 * wave]),
        joint_state=np.vstack([angles, 0 * angles]),
        wire_temperature=heat,
        measured_temperature=heat,
        body_pose=np.vstack([np.linspace(0, 0.03, 7), np.full(7, 0.06), 0.02 * wave[0]]),
        contact_force=np.array([0.03 * wave[0], 0 * turn + 0.25] * 2),
        robot=robot,
        phases=[GaitPhase(start, done) for start, done in contacts.items()],
        check=GaitCheck(solver="IPOPT", status="solved", objective="speed", violation=1e-9),
    )


@pytest.fixture
def gait_in_space() -> Gait:
    """A gait of three limbs that is made up: a turn of 20° to the right in 8 s, on the spot."""
    knots, heat, pose = np.linspace(0.0, 1.0, 5), np.full((9, 5), 60.0), np.zeros((6, 5))
    pose[2], pose[5] = 0.061, np.deg2rad(-20.0) * knots
    return Gait(
        time=8.0 * knots,
        duty=np.zeros((9, 5)),
        joint_state=np.zeros((36, 5)),
        wire_temperature=heat,
        measured_temperature=heat,
        body_pose=pose,
        contact_force=np.ones((9, 5)),
        robot=RobotParameters.in_space(3),
        phases=[GaitPhase(0.0, ["stick", "slide", "stick"])],
        check=GaitCheck(violation=0.0, simulation=GaitVariation("", [0.98], 61.0, "", [0.03])),
    )


def outputs_under(system, inputs, context=None):
    """What a system shows at each of the controllers' ticks, before it takes the inputs in.

    Args:
        system: with events every 0.05 s.
        inputs: by the name of the port, one row for each tick (K, size).
        context: to go on from; that of the system by default if None.

    Returns:
        The outputs by the name of their port, each (K, size), and ``context``, that of the
        end.
    """
    simulator = Simulator(system, context or system.CreateDefaultContext())
    context = simulator.get_mutable_context()
    start = round(context.get_time() / CONTROL_PERIOD)
    ports = [system.get_output_port(index) for index in range(system.num_output_ports())]
    shown = {port.get_name(): [] for port in ports}
    for k in range(len(next(iter(inputs.values())))):
        for name, rows in inputs.items():
            system.GetInputPort(name).FixValue(context, np.asarray(rows[k], float))
        for port in ports:
            shown[port.get_name()].append(port.Eval(context).copy())
        simulator.AdvanceTo(CONTROL_PERIOD * (start + k + 1))  # begins with the tick's update
    return SimpleNamespace(
        **{name: np.array(rows) for name, rows in shown.items()}, context=context.Clone()
    )


@pytest.fixture(scope="session")
def fed():
    """`outputs_under`."""
    return outputs_under


@pytest.fixture(scope="session")
def short_plan() -> Trajectory:
    """Two joints that bend by 12° after a second, from cold, within four."""
    parameters = LimbParameters()
    parameters.segments[0].links = 2
    parameters.temperature_limits.warm_up_time = 1000.0
    reference = references.from_samples([0.0, 1.0, 2.0, 4.0], np.deg2rad([0.0, 0.0, 12.0, 12.0]))
    return plan(parameters, reference, knot_rate=5.0, tolerance_deg=0.5)


@pytest.fixture(scope="session")
def refused():
    """A context in which an error must come, as one sentence with some words in it."""

    @contextlib.contextmanager
    def expect(error_type, *words):
        with pytest.raises(error_type) as caught:
            yield
        message = str(caught.value)
        assert len(message.splitlines()) == 1, repr(message)
        assert message.endswith((".", "?")), message
        assert "Traceback" not in message
        assert "object at 0x" not in message
        for word in words:
            assert str(word) in message, f"{word!r} is not in {message!r}"

    return expect


@pytest.fixture
def two_segments() -> LimbParameters:
    """Two unlike segments in series, of two and three links."""
    tip = SegmentParameters(links=3, length=0.06, mass=0.010, stiffness=0.08)
    tip.wire("left").law.beta, tip.wire("right").law.beta = 2.5e-4, 3.0e-4
    tip.wire("left").law.a1, tip.wire("right").law.a2 = -0.09, 26.0
    return LimbParameters(segments=[SegmentParameters(links=2), tip])


@pytest.fixture(scope="session")
def browser(tmp_path_factory) -> Iterator:
    """Playwright's handle of a headless Chromium; without one, the test is skipped.

    It gives way to what is timed, as one does that a live page opens.
    """
    # Few tests look at pages.
    from playwright.sync_api import Error, sync_playwright

    installed = next(filter(None, map(shutil.which, BROWSERS)), None)
    with sync_playwright() as playwright:
        polite = tmp_path_factory.mktemp("browser") / "chromium"
        path = installed or playwright.chromium.executable_path
        # As root it would raise its own priority above that of what is timed, as no user's can.
        user = "setpriv --bounding-set=-sys_nice --inh-caps=-sys_nice" * (os.geteuid() == 0)
        polite.write_text(f'#!/bin/sh\nexec nice -n 10 {user} "{path}" "$@"\n')
        polite.chmod(0o755)
        try:
            # Its sandbox needs rights that containers do not have. It draws as it does by itself
            # where there is no graphics card.
            chromium = playwright.chromium.launch(
                executable_path=polite,
                args=["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"],
            )
        except Error:
            pytest.skip("there is no Chromium here; `make browser` installs one")
        yield chromium
        chromium.close()


def is_complaint(message) -> bool:
    """Whether a message on a browser's console is the page's, and not its graphics driver's."""
    return message.type in ("error", "warning") and "GL Driver Message" not in message.text


@pytest.fixture
def look_at(browser) -> Iterator[Callable[[Path], None]]:
    """Opens a report as a reader without a network would, on a phone and on a desktop."""
    phone = {"width": 420, "height": 800}
    context = browser.new_context(offline=True, color_scheme="dark", viewport=phone)
    context.set_default_timeout(600_000)  # ms

    def look(path: Path) -> None:
        page, complaints = context.new_page(), []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "console", lambda message: is_complaint(message) and complaints.append(message.text)
        )
        page.on("request", lambda r: r.url.startswith("http") and complaints.append(r.url))
        page.goto(path.as_uri())
        drawn = "Bokeh.documents.length == document.querySelectorAll('figure.chart').length"
        page.wait_for_function(f"{drawn} && Bokeh.documents.every(chart => chart.is_idle)")
        for width in (420, 1100, 1440):
            page.set_viewport_size({"width": width, "height": 800})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        tables = "[...document.querySelectorAll('.table')]"
        assert not page.evaluate(f"{tables}.some(table => table.scrollWidth > table.clientWidth)")
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(22, 22, 22)"
        assert path.stat().st_size < 5e6
        assert complaints == []
        page.close()

    yield look
    context.close()
