"""The page of a folder: its list of results, and the links between them."""

import dataclasses
import os
import re
from pathlib import Path

import pytest

from limb_systems import LimbParameters
from limb_systems.views.replay_page import write_meshcat_replay
from soft_limb.command import main
from soft_limb.reports import page

from .test_results import MADE, make_plan, make_recording


def made(minute: int, command: str):
    time = f"2030-01-31T12:{minute:02}:00Z"
    return dataclasses.replace(MADE, command=f"soft-limb {command}", time=time)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder with a limb, plans, recordings, pages, and files that are no results."""
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


def linked(card: str, label: str) -> list[str]:
    """Return the files that a card links to under a label."""
    said = re.search(rf'<p class="soft">{label}\n(.*?)</p>', card, re.DOTALL)
    return re.findall(r">([^<]+)</a>", said[1]) if said else []


def test_runs_writes_a_page(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["runs", "-o", "day 1/all.html"]) == 0
    written = Path("day 1/all.html").read_text(encoding="utf-8")
    cards = dict(re.findall(r"<article id=.*?>([^<]+)</a></h2>(.*?)</article>", written, re.DOTALL))
    assert list(cards) == ["day 1/b.csv", "day 1/plan.csv", "day 1/a.csv", "plan.csv", "limb.yaml"]
    assert {key: linked(card, "from") for key, card in cards.items()} == {
        "day 1/b.csv": ["day 1/plan.csv"],  # of the same command, with no name in it
        "day 1/plan.csv": ["limb.yaml"],  # by its digest
        "day 1/a.csv": ["plan.csv"],  # and not b.csv, which the command wrote
        "plan.csv": ["limb.yaml"],
        "limb.yaml": [],
    }
    assert linked(cards["limb.yaml"], "led to") == ["day 1/plan.csv", "plan.csv"]
    assert re.findall(r'href="([^"#]+)"', cards["day 1/a.csv"]) == ["3d.html", "a.html"]
    for key in ("day 1/b.csv", "plan.csv"):
        assert not re.findall(r'href="([^"#]+)"', cards[key])  # no page was made with them
    assert '<a href="../plan.csv">plan.csv</a></h2>' in written
    assert 'aria-label="bend angle, -9 to 11°, over 4 s"' in cards["day 1/plan.csv"]
    assert written.count("<polyline") == 2 * 3 + 2 * 4  # plans have a reference
    troubles = written.partition("<details>")[2]
    for name in ("broken.csv", "&lt;script&gt;alert(1)&lt;.csv", "mine.html"):
        assert name in troubles
    for name in ("notes.txt", "secret", "<script>alert"):
        assert name not in written
    assert main(["runs", "-o", "day 1/all.html"]) == 1
    assert main(["runs", "-o", "day 1/all.html", "--force"]) == 0
    assert "all.html" not in Path("day 1/all.html").read_text().partition('id="provenance"')[0]
    assert main(["runs", "nowhere", "-o", "nowhere.html"]) == 1
    assert "Cannot list nowhere: there is no such folder" in capsys.readouterr().err
    assert main(["runs", "plan.csv", "-o", "nowhere.html"]) == 1
    assert "Cannot list plan.csv: it is a file" in capsys.readouterr().err
