"""The documentation says what is there: links, snippets, commands, ports, names and files."""

import contextlib
import functools
import importlib
import inspect
import pkgutil
import re
import runpy
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from pydrake.systems.framework import System
from pydrake.trajectories import PiecewisePolynomial

import hardware.board.serial_limb
from calibration import (
    BendAngleController,
    EquilibriumSchedule,
    LimitedDuty,
    calibrate,
    collect_equilibria,
    excitations,
)
from controllers import (
    LimbObserver,
    PlanFeedback,
    PlanRegulator,
    RecedingHorizon,
    TemperatureSupervisor,
)
from hardware import LimbTwin, SerialLimb, Station
from hardware.board.listener import SignalListener
from limb_systems import (
    CalibrationRecord,
    HeatBounds,
    Limb,
    LimbActuation,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SegmentParameters,
    TemperatureLimits,
    TipTangentSensor,
    WireColors,
    WireParameters,
)
from planners import plan
from soft_limb.command import all_commands, main
from soft_limb.commands.options import SHARED
from walking import (
    GaitFeedback,
    HeatFeedback,
    Robot,
    RobotParameters,
    RobotTwin,
    Wayfinder,
)
from walking.gait_planning import GaitRequest

ROOT = Path(__file__).parents[1]
PACKAGES = ("limb_systems", "urdf", "planners", "controllers", "calibration", "hardware", "walking")
ANY_PACKAGE = "|".join((*PACKAGES, "soft_limb"))
PAGES = {name: ROOT / "docs" / f"{name}.md" for name in PACKAGES}
DOCUMENTS = [
    path
    for path in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "benchmarks" / "README.md",
        ROOT / "examples" / "README.md",
        ROOT / "hardware" / "firmware" / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
    )
    if path.exists()
]
TEXTS = {path: path.read_text(encoding="utf-8") for path in DOCUMENTS}
PACKAGE_INDEX = ROOT / "docs" / "site" / "package_index.md"
RUN = "<!-- run by tests/test_docs.py -->"
NOT_RUN = re.compile(r"<!-- not run: .+ -->\n$")


def name_of(path):
    return str(path.relative_to(ROOT))


def blocks(text, language):
    """Code blocks, and what stands before each."""
    for match in re.finditer(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        yield match[1], text[: match.start()]


def prose(text):
    return re.sub(r"^ *```.*?^ *```$", "", text, flags=re.DOTALL | re.MULTILINE)


def inline_code(text):
    return re.findall(r"`([^`\n]+)`", prose(text))


def anchors(text):
    """Of headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", prose(text), re.MULTILINE)
    return [re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings]


def tables(text, first_cell):
    """Rows of the tables whose heads begin with a cell."""
    for match in re.finditer(r"(?:^\|.*\|\n)+", text, re.MULTILINE):
        rows = [
            [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))]
            for line in match[0].splitlines()
        ]
        if rows[0][0] == first_cell:
            yield rows[2:]


def test_links_lead_somewhere():
    for path, text in TEXTS.items():
        for target in re.findall(r"\]\(([^()\s]+)\)", re.sub(r"`[^`\n]+`", "", prose(text))):
            if target.startswith("https://"):
                continue
            name, _, anchor = target.partition("#")
            file = (path.parent / name).resolve() if name else path
            where = f"{name_of(path)} links to {target}, which is not there"
            assert file.exists(), where
            assert not anchor or anchor in anchors(file.read_text(encoding="utf-8")), where


def test_all_pages_are_on_the_site():
    """Without Sphinx, which builds it; pages of test data are no documentation."""
    site = runpy.run_path(str(ROOT / "docs" / "site" / "make_site.py"))
    shown = [page for pages in site["navigation"]().values() for page in pages]
    assert len(shown) == len(set(shown))
    aside = {".venv", "build", "out", "tests", PACKAGE_INDEX.parent.name}
    folders = [path for path in ROOT.iterdir() if path.is_dir() and path.name[0] != "."]
    pages = {
        page
        for folder in folders
        if folder.name not in aside
        for kind in ("*.md", "*.ipynb")
        for page in folder.rglob(kind)
        if aside.isdisjoint(page.relative_to(ROOT).parts)
    }
    assert {*pages, *ROOT.glob("*.md")} == {*shown, ROOT / site["START"]}


def test_the_site_begins_at_this_version_and_lists_all(tmp_path):
    write_entry = runpy.run_path(str(ROOT / "docs" / "site" / "make_site.py"))["write_entry"]
    for name in ("0.9.0", "0.10.0", "0.1.0"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "index.html").touch()
    write_entry.__globals__.update(SITES=tmp_path, SITE=tmp_path / "0.9.0")
    write_entry()
    assert 'url=0.9.0/index.html"' in (tmp_path / "index.html").read_text()
    listed = (tmp_path / "versions.js").read_text()
    assert listed == 'var versions = ["0.10.0", "0.9.0", "0.1.0"];\n'


def test_files_targets_and_symbols_that_are_named_exist():
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for path, text in TEXTS.items():
        for target in re.findall(r"(?:^|`)make ([a-z]+)", text, re.MULTILINE):
            assert target in targets, f"{name_of(path)} has make {target}"
        for script in re.findall(r"python ((?:benchmarks|docs|examples)/\w+\.py)", text):
            assert (ROOT / script).exists(), f"{name_of(path)} has {script}"
        for code in inline_code(text):
            if re.fullmatch(rf"(tests|benchmarks|docs|examples|{ANY_PACKAGE})/[\w/.]+", code):
                there = (ROOT / code).exists() or path.name == "paper_to_code.md"
                assert there, f"{name_of(path)} names {code}"
            symbol = re.fullmatch(rf"({ANY_PACKAGE})(\.\w+)+", code)
            if symbol and not code.endswith((".html", ".csv", ".ino", ".yaml", ".png")):
                assert exists(code), f"{name_of(path)} names {code}"


def test_each_benchmark_has_its_line():
    scripts = {path.name for path in (ROOT / "benchmarks").glob("*.py")}
    listed = re.findall(r"`(\w+\.py)`", TEXTS[ROOT / "benchmarks" / "README.md"])
    assert sorted(listed) == sorted(scripts)


def exists(symbol):
    """Whether there is what a name with dots says, which may be a module that is not loaded."""
    with contextlib.suppress(ImportError, AttributeError):
        return pkgutil.resolve_name(symbol) is not None
    return False


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("package", PACKAGES)
def test_snippets_run(package, tmp_path, monkeypatch, gait, gait_in_space):
    """With gaits that are made up, few knots, short recordings and one law, as all take long."""

    def plan_gait_briefly(robot, **changes):
        GaitRequest(**changes).validate(robot, gait.schedule)
        return gait_in_space if robot == gait_in_space.robot else gait

    def collect_briefly(*limb_and_wires, **options):
        return collect_equilibria(*limb_and_wires, **options | {"longest": 10.0})

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("planners.plan_gait", plan_gait_briefly, raising=False)
    monkeypatch.setattr("planners.plan", functools.partial(plan, knot_rate=2.0))
    monkeypatch.setattr("calibration.calibrate", functools.partial(calibrate, laws=[LinearLaw]))
    monkeypatch.setattr("calibration.collect_equilibria", collect_briefly)
    names, count = {}, 0
    for code, before in blocks(TEXTS[PAGES[package]], "python"):
        if not NOT_RUN.search(before):
            exec(compile(code, name_of(PAGES[package]), "exec"), names)
            count += 1
    assert count


def test_first_steps_of_the_readme_run(tmp_path, monkeypatch):
    """Line by line; what Python runs in this process, which has imported Drake."""
    (script,) = (
        code
        for code, before in blocks(TEXTS[ROOT / "README.md"], "sh")
        if before.endswith(f"{RUN}\n")
    )
    monkeypatch.chdir(tmp_path)
    for line in script.splitlines():
        if line.startswith("soft-limb "):
            assert main(shlex.split(line, comments=True)[1:]) == 0
        else:
            subprocess.run(["sh", "-e", "-c", line], check=True)
    for name in ("plan.csv", "plan.png", "recording.csv", "tracking.png"):
        assert (tmp_path / "out" / name).stat().st_size > 10_000


def test_commands_parse(monkeypatch):
    """Each that a page shows."""
    monkeypatch.setattr("soft_limb.command.run_command", lambda run, stopped: 0)
    lines = [
        line
        for text in TEXTS.values()
        for code, _ in blocks(text, "sh")
        for line in code.splitlines()
        if line.startswith("soft-limb ")
    ]
    assert len(lines) > 40
    for line in lines:
        try:
            assert main(shlex.split(line, comments=True)[1:]) == 0
        except SystemExit:
            pytest.fail(f"not accepted: {line}")


def test_page_has_the_shared_options_and_all_commands():
    text = TEXTS[ROOT / "docs" / "soft_limb.md"]
    (options,), (commands,) = (tables(text, first) for first in ("option", "command"))
    listed, named = (
        {code for row in rows for code in re.findall(r"`([^`]+)`", row[0])}
        for rows in (options, commands)
    )
    assert named == set(all_commands())
    groups = (entry if isinstance(entry, list) else [entry] for entry in SHARED.values())
    shared = {name for group in groups for option in group for name in option.names}
    assert listed - {"--import"} == {name for name in shared if name.startswith("-")}


class Board:
    """In place of `BoardLink`: what `SerialLimb` asks at construction."""

    def __init__(self, port, *_):
        self.port, self.serial_number, self.channels, self.angles = port, "none", 2, 1

    def info(self):
        return self

    sample = close = info


@pytest.fixture
def station(tmp_path):
    """That of the scenario on the page, with the files of the gripper."""
    shutil.copytree(ROOT / "examples" / "gripper", tmp_path, dirs_exist_ok=True)
    (scenario,) = (
        code for code, _ in blocks(TEXTS[PAGES["hardware"]], "yaml") if "drivers" in code
    )
    (tmp_path / "scenario.yaml").write_text(scenario, encoding="utf-8")
    return Station(tmp_path / "scenario.yaml")


@pytest.fixture
def systems(monkeypatch, short_plan, gait, gait_in_space, meshcat, station):
    """All systems by the names of their classes, with those that the limbs consist of."""
    monkeypatch.setattr(hardware.board.serial_limb, "open_link", Board)
    nominal, known = LimbParameters(), LimbParameters()
    # A heating rate that was calibrated.
    known.calibration = CalibrationRecord(["left.a2"], [20.0], [1.0], [[1.0]])
    course = PiecewisePolynomial.ZeroOrderHold([0.0, 1.0], [[0.0, 0.0]])
    limb, twin = Limb(), LimbTwin(hand=course, extra=["memory"])
    made = [*limb.GetSystems(), *twin.GetSystems(), limb, LimbTwin(), Robot(), RobotTwin()]
    made += [
        BendAngleController(nominal, "right"),
        EquilibriumSchedule([0.1]),
        LimitedDuty(known, excitations(2)[0].duty),
        LimbObserver(nominal),
        PlanFeedback(short_plan),
        GaitFeedback(gait, 1),
        HeatFeedback(short_plan),
        Wayfinder({"spot": gait_in_space}, [(0.1, 0.0)]),
        PlanRegulator(short_plan),
        RecedingHorizon(short_plan),
        TemperatureSupervisor(nominal),
        SerialLimb("port"),
        SignalListener({"duty": 2}, 20.0, print),
        LimbActuation(),
        WireColors(nominal, meshcat),
        station,
    ]
    return {class_name(system): system for system in made}


def class_name(system):
    return type(system).__name__.partition("_𝓣")[0]


def interface(system):
    """Ports and states of a system, as the tables have them."""
    rows = [
        (f"{kind} {index}", port.get_name(), port.size())
        for kind, count, get in (
            ("input", system.num_input_ports(), system.get_input_port),
            ("output", system.num_output_ports(), system.get_output_port),
        )
        for index, port in ((index, get(index)) for index in range(count))
    ]
    context = system.CreateDefaultContext()
    groups = range(context.num_discrete_state_groups())
    for kind, size in (
        ("continuous", context.num_continuous_states()),
        ("discrete", sum(context.get_discrete_state(i).size() for i in groups)),
    ):
        if size:
            rows.append((f"{kind} state", "", size))
    return rows


SECTIONS = [
    (package, *section)
    for package, path in PAGES.items()
    if package in PACKAGES
    for section in re.findall(r"^### `(\w+)`\n(.*?)(?=^#|\Z)", TEXTS[path], re.DOTALL | re.M)
]


def test_tables_of_ports_are_those_of_the_systems(systems):
    """They leave their names to Drake, so that two of a kind fit into one diagram; parts do not."""
    named = {name for name, system in systems.items() if system.get_name()}
    parts = (*Limb().GetSystems(), *LimbTwin(extra=["memory"]).GetSystems())
    assert named <= {class_name(part) for part in parts} | {"Hand"}
    for _, name, section in SECTIONS:
        (rows,) = tables(section, "port")
        listed = [(row[0], row[1].strip("`"), int(re.search(r"\d+$", row[2])[0])) for row in rows]
        assert listed == interface(systems[name]), name


def test_page_has_all_public_names_and_systems():
    for package in PACKAGES:
        module = importlib.import_module(package)
        named = {word for code in inline_code(TEXTS[PAGES[package]]) for word in code.split(".")}
        named = {word.partition("(")[0] for word in named}
        assert set(module.__all__) <= named
        systems = {
            name
            for name in module.__all__
            if inspect.isclass(getattr(module, name)) and issubclass(getattr(module, name), System)
        }
        assert systems <= {name for home, name, _ in SECTIONS if home == package}


def test_pictures_have_the_systems_of_the_diagrams():
    for picture, make in (("limb", Limb), ("limb_twin", LimbTwin)):
        drawn = (ROOT / "docs" / f"{picture}.svg").read_text(encoding="utf-8")
        for system in make().GetSystems():
            if not system.get_name().startswith("memory"):
                assert f">{class_name(system)}<" in drawn


def test_parameters_on_the_page_are_the_nominal_ones():
    pages = [TEXTS[PAGES[package]] for package in ("limb_systems", "walking")]
    codes = (code for page in pages for code, _ in blocks(page, "yaml"))
    text, *others = sorted(codes, key=lambda code: "limbs:" in code)
    assert LimbParameters.from_yaml(text) == LimbParameters()
    # Tags aside: no field is left out on the page.
    plain = [yaml.load(t, yaml.BaseLoader) for t in (text, LimbParameters().to_yaml())]
    assert plain[0] == plain[1]
    for other in others:
        kind = RobotParameters if "limbs:" in other else LimbParameters
        kind.from_yaml(other)
    kinds = [SegmentParameters, RestMemory, TipTangentSensor, WireParameters, LinearLaw]
    kinds += [HeatBounds, TemperatureLimits, LimbParameters]
    ranges = {
        (name, kind.__name__): field.metadata
        for kind in kinds
        for name, field in kind.__dataclass_fields__.items()
        if "unit" in field.metadata
    }
    (rows,) = tables(TEXTS[PAGES["limb_systems"]], "field")
    numbers = [[cell.strip("`") for cell in row] for row in rows if row[4] != "text"]
    listed = {(name, kind): (unit, text) for name, kind, _, unit, text in numbers}
    assert listed.keys() == ranges.keys()
    for field, (unit, text) in listed.items():
        assert unit == ranges[field]["unit"].replace("links", "1")
        assert tuple(map(float, text.split(" to "))) == ranges[field]["range"]
