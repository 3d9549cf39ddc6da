"""What the progress line shows, with a clock that the test turns."""

import io

import pytest

from limb_systems.progress import Progress, TimeLeft, progress_prefix


class Terminal(io.StringIO):
    def __init__(self, monkeypatch, live=True):
        super().__init__()
        self.isatty = lambda: live
        monkeypatch.setattr("sys.stderr", self)


@pytest.fixture
def clock(monkeypatch):
    """A list with the time in it, s."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(("live", "step"), [(True, 0.09), (False, 1.0)])
def test_nothing_is_shown_for_short_work_or_without_a_terminal(monkeypatch, clock, live, step):
    terminal = Terminal(monkeypatch, live)
    with Progress("simulating", None, "s") as progress:
        for done in range(10):
            clock[0] += step
            progress.update(done)
    assert terminal.getvalue() == ""


def test_the_remaining_time_is_estimated_from_the_elapsed_time(clock):
    """Half as fast from the second part on, of which nothing is known when it is said."""
    said = []
    time_left = TimeLeft(100.0, said.append)
    for seconds in (5.0, 4.0, 8.0, 8.0):
        clock[0] += seconds
        time_left.add(6.0)
    assert said == ["about 70 s are left"]  # 9 s for 12 of 100

    quick = TimeLeft(10.0, said.append)
    clock[0] += 1.0
    quick.add(5.0)
    assert len(said) == 1


def test_terminal_line_is_kept_up_to_date_and_cleared(monkeypatch, clock):
    terminal = Terminal(monkeypatch)
    with progress_prefix("sag_1, 1 of 24"), Progress("simulating", 60.0, "s") as progress:
        clock[0] += 1.1
        progress.update(12.0, "a long remark")
        clock[0] += 0.2
        progress.update(24.0)
    text = terminal.getvalue()
    assert "\n" not in text
    _, first, second, blank, after = text.split("\r")
    assert first == "sag_1, 1 of 24: simulating: 12 of 60 s a long remark"
    assert second.rstrip() == "sag_1, 1 of 24: simulating: 24 of 60 s"
    assert len(second) == len(first)  # nothing of the longer line is left
    assert blank.strip() == after == ""
