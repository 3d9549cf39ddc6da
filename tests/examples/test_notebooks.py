"""The notebooks run from top to bottom, show what they draw, and what they say is so."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
FAR = "UserWarning: The plan is far from its reference"  # of those beyond the limb's reach
# All that calibration compares would take the longest by far; the kernel is this test's alone.
FEWER_LAWS = """
import functools
import calibration
from limb_systems import HystereticLaw, LinearLaw
whole = getattr(calibration.calibrate, "func", calibration.calibrate)
calibration.calibrate = functools.partial(whole, laws=(LinearLaw, HystereticLaw))
del calibration, functools, HystereticLaw, LinearLaw, whole
"""
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def kernel(tmp_path_factory):
    """One for all notebooks, as starting one and importing Drake takes longer than some of them."""
    from jupyter_client.manager import start_new_kernel

    folder = tmp_path_factory.mktemp("ipython")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "IPYTHONDIR": str(folder)}
    manager, client = start_new_kernel(env=environment)
    client.stop_channels()
    yield manager
    manager.shutdown_kernel(now=True)


def run(path, folder, kernel):
    """A notebook with its outputs, run in a folder, without the names of those before it."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    afresh = nbformat.v4.new_code_cell(f"%reset -f\n%cd -q {folder}\n{FEWER_LAWS}")
    notebook.cells.insert(0, afresh)
    NotebookClient(notebook, km=kernel, timeout=None).execute()
    return notebook


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def said(notebook):
    """Return the text that a notebook printed."""
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    return "".join(output.text for output in outputs if output.output_type == "stream")


def number(pattern, text):
    return float(re.search(pattern, text)[1])


def check_limb_in_ten_minutes(text):
    """The bend of (12), as in test_examples; the plan fits its model, and not another."""
    assert number(r"after 60 s: (.*)°", text) == pytest.approx(37.0, rel=0.02)
    assert number(r"its simulation: (.*)°", text) < 0.1
    assert 2.0 < number(r"mean tracking error: (.*)°", text) < 8.0


def check_plan_your_own_motion(text):
    distances = [float(shown) for shown in re.findall(r" (\d\.\d\d)° from the reference", text)]
    default, near, far = distances
    assert near < default / 2
    assert default < far / 2
    assert "cannot be at T_warm = 45 °C (20) by 0.6 s" in text
    assert number(r"highest reading: (.*) °C", text) > 100.0
    # Full duty to one side and then the other, and wires that heat up to the limit.
    for bound in ("duty left = 1", "duty right = 1", "wire right = T_max"):
        assert re.search(rf"{bound} +at", text)


def check_calibrate_from_your_logger(text):
    assert text.count("Use with care") == 1
    assert "  * HystereticLaw" in text
    calibrated = number(r"calibrated: +mean tracking error (.*)°", text)
    assert calibrated < 0.7 * number(r"nominal: +mean tracking error (.*)°", text)


def check_feedback_and_learning(text):
    alone = number(r"\nfeedback: mean tracking error (.*)°", f"\n{text}")
    assert alone < number(r"open loop: mean tracking error (.*)°", text) / 2
    loaded = re.findall(r"(?:open loop: |feedback:  )mean tracking error (.*)°", text)
    open_loop, feedback = map(float, loaded[-2:])
    assert open_loop > 5.0
    assert feedback < open_loop / 4
    first, _, last = map(float, re.findall(r"repetition \d: (.*)° from the reference", text))
    assert last < first / 2


def check_limb_in_space(text):
    """The bend of one wire alone by (12), towards its own side; plans, and both ways to drive."""
    assert "3 wires, 10 joints, 2 bends" in text
    towards = [number(rf"wire_{wire} bends it towards (.*)° from E2", text) for wire in (1, 2, 3)]
    assert towards == [0.0, 120.0, -120.0]
    bend = 3 * 4.7e-4 * 20.0 * 0.25 / 0.07 / 0.1246 * (1 - np.exp(-0.07 * 60.0))
    along, across = (number(rf"(\S+)° towards E{axis}", text) for axis in (2, 3))
    assert np.hypot(along, across) == pytest.approx(np.rad2deg(bend), rel=0.02)
    assert number(r"simulated within (.*)°", text) < 0.3
    assert number(r"feedback: +(.*)° from", text) < number(r"open loop: +(.*)° from", text) / 3


def check_robot_that_walks(text):
    """It makes its stride within 1%, and another one on rougher ground."""
    assert "rear_left, rear_right, front_left, front_right" in text
    planned, simulated = (number(rf"{how} +(.*) mm", text) for how in ("planned", "simulated"))
    assert simulated == pytest.approx(planned, rel=0.01)
    assert number(r"friction of 0.4: (.*) mm", text) < 0.97 * planned


CHECKS = [
    check_limb_in_ten_minutes,
    check_plan_your_own_motion,
    check_calibrate_from_your_logger,
    check_feedback_and_learning,
    check_limb_in_space,
    check_robot_that_walks,
]


def test_notebooks_are_stored_without_outputs():
    import nbformat  # slow, as all that runs notebooks

    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        nbformat.validate(notebook)
        assert all(cell.metadata == {} for cell in notebook.cells), path.name
        for cell in code_cells(notebook):
            assert (cell.outputs, cell.execution_count) == ([], None), path.name
        assert notebook.metadata.keys() == {"kernelspec", "language_info"}
        assert notebook.metadata.language_info == {"name": "python"}
        texts = [cell.source for cell in notebook.cells if cell.cell_type == "markdown"]
        assert "**There is no robot here.**" in texts[0]
        assert texts[-1].startswith("## Now change something")


@pytest.mark.whole
@pytest.mark.parametrize(
    ("path", "check"),
    [
        pytest.param(path, check, id=path.stem)
        for path, check in zip(NOTEBOOKS, CHECKS, strict=True)
    ],
)
def test_notebook_runs(path, check, kernel, tmp_path):
    assert path.stem[2:] == check.__name__.removeprefix("check_")
    notebook = run(path, tmp_path, kernel)
    for cell in code_cells(notebook):
        kinds = [kind for output in cell.outputs for kind in output.get("data", ())]
        draws = re.search(r"^(?:\w+\.)?(?:plot_|draw[_(])|subplots\(", cell.source, re.MULTILINE)
        assert kinds.count("image/png") == bool(draws), cell.source
        assert ("text/html" in kinds) == bool(re.search("^HTML|^recordings\\[", cell.source, re.M))
        assert not [o for o in cell.outputs if o.get("name") == "stderr" and FAR not in o.text]
    check(said(notebook))
