"""Repeats a plan on a limb that learns to follow it."""

import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from controllers import Learner
from controllers.learner import Repetition
from hardware.board.link import HardwareError, present_temperature
from hardware.board.serial_limb import SerialLimb
from hardware.board.several_boards import Ports, open_link
from hardware.emulation.twin import LimbTwin
from hardware.live_feed import LiveView
from hardware.replaying import ReplayError
from limb_systems import LimbSystem, Recording, Trajectory
from limb_systems.files.output import OutputError, check_folder
from limb_systems.files.table_writer import unfinished_files
from limb_systems.progress import Progress
from soft_limb.reports.plan_report import write_learning_report
from soft_limb.runs.cooling import COOL
from soft_limb.runs.rollout import record_replay

STATE, LEARNED = "learning.txt", "learned.csv"
PICTURE, REPORT = "learning.png", "learning.html"
PAUSE = 300.0  # s, without heat, between two repetitions on an emulated limb
LONGEST_REST = 1200.0  # s
LOOK_PERIOD = 1.0  # s
_NAME = re.compile(r"repetition_[0-9]+\.csv")


def repeat(
    learner: Learner,
    limb_of_repetition: Callable[[], LimbSystem],
    repetitions: int,
    folder: str | Path,
    *,
    tell: Callable[[int, Repetition], object] = lambda number, repetition: None,
    live: LiveView | None = None,
) -> None:
    """Repeats a plan until a number of repetitions is reached, or another does not pay.

    The folder has ``learning.txt``, which `Learner.load` reads, ``learned.csv``, a trajectory with
    the best repetition's duty, and a recording of each repetition, ``repetition_1.csv`` and so on.
    Nothing is lost whenever this ends: a recording that is complete is learned from the next time.
    If a robot fails, its repetition is kept as an unfinished recording and counts as interrupted.

    Args:
        learner: learner of the plan, also with repetitions before.
        limb_of_repetition: function that gives a limb that is ready for the next repetition.
        repetitions: number of repetitions in all, those before included.
        tell: function that is told of each repetition, with its number from 1 on.
        live: page on which the limb is shown, as for `replay`.

    Raises:
        ReplayError: if the plan must not be replayed on the limb.
        HardwareError: if the robot fails; the repetition was learned from, as far as it came.
        OutputError: if a file cannot be written.
    """
    folder = Path(folder)
    learner.save(folder / STATE)
    while len(learner.repetitions) < repetitions and not learner.finished:
        number = len(learner.repetitions) + 1
        path = recording_of(folder, number)
        failure = None
        if path.exists():
            recording = Recording.load(path)
        else:
            limb = limb_of_repetition()
            if live:
                live.say(f"Repetition {number} of {repetitions}{_errors_so_far(learner)}")
            before = unfinished_files(path)
            try:
                recording = record_replay(
                    learner.trajectory, limb, path, controller=learner.source(), live=live
                )
            except HardwareError as error:
                new = unfinished_files(path) - before
                if not new:
                    raise
                failure, recording = error, Recording.load(new.pop(), unfinished=True)
        repetition = learner.update(recording)
        learner.save(folder / STATE)
        learner.learned_trajectory().save(folder / LEARNED)
        tell(number, repetition)
        if failure:
            raise failure


def recording_of(folder: Path, number: int) -> Path:
    """The file of a repetition's recording."""
    return folder / f"repetition_{number}.csv"


def _errors_so_far(learner: Learner) -> str:
    errors = [f"{np.rad2deg(repetition.mean_error):.2f}°" for repetition in learner.repetitions]
    return f"; mean |φ* - φ| so far {', '.join(errors)}" if errors else ""


def rested_twins(
    twin: LimbTwin, trajectory: Trajectory, learner: Learner
) -> Callable[[], LimbSystem]:
    """An emulated limb for `repeat`, `PAUSE` after each repetition.

    The time of repetitions before, in a program that ended, passes first: its
    sensors do not have the same noise again.
    """
    pause = len(learner.repetitions) * (trajectory.duration + PAUSE)

    def rested() -> LimbSystem:
        nonlocal pause
        limb, pause = twin.after_rest(pause), PAUSE
        return limb

    return rested


def rested_robots(
    port: Ports,
    trajectory: Trajectory,
    live: LiveView | None = None,
) -> Callable[[], LimbSystem]:
    """The robot on a port for `repeat`, when its wires have cooled; a page says so.

    Args:
        port, trajectory, live: as for `repeat` and `SerialLimb`.
    """
    tell = live.say if live else lambda _: None

    def rested() -> LimbSystem:
        with open_link(port, trajectory.parameters) as link:
            wait_until_cool(lambda: present_temperature(link), trajectory, tell=tell)
        return SerialLimb(port, trajectory.parameters)

    return rested


def wait_until_cool(
    read: Callable[[], np.ndarray],
    trajectory: Trajectory,
    *,
    longest: float = LONGEST_REST,
    period: float = LOOK_PERIOD,
    tell: Callable[[str], object] = lambda what: None,
) -> None:
    """Waits until no wire is read more than 3 °C warmer than where a plan starts.

    Args:
        read: function that gives V of the wires (W,), °C.
        longest: time to wait, s.
        period: time between two looks, s.
        tell: function that is told at each look what is waited for.

    Raises:
        ReplayError: if a wire is too warm after that.
    """
    start, names = trajectory.measured_temperature[:, 0], trajectory.parameters.wire_names
    begin = time.monotonic()
    with Progress("resting until the wires are cool", longest, "s") as progress:
        while True:
            above = read() - start
            warmest = int(np.argmax(above))
            if above[warmest] <= COOL:
                return
            waited = time.monotonic() - begin
            now = start[warmest] + above[warmest]
            if waited > longest:
                raise ReplayError(
                    f"After {waited:.0f} s of rest the {names[warmest]} wire is still at "
                    f"{now:.1f} °C, but the trajectory starts at {start[warmest]:.1f} °C; cool the "
                    "limb, or plan from where it is."
                )
            remark = f"{names[warmest]} {now:.1f} °C"
            progress.update(waited, remark)
            tell(f"Resting until the wires are cool: {remark}")
            time.sleep(period)


def learner_in(folder: Path, trajectory: Trajectory, *, force: bool = False) -> Learner:
    """The learner of a plan in a folder, or a new one.

    Args:
        force: whether to start anew where there are repetitions.

    Raises:
        OutputError: if the folder cannot be written to, or has repetitions of another plan.
        FileFormatError: if what is there is damaged.
    """
    check_folder(folder)
    state = folder / STATE
    if state.exists() and not force:
        learner = Learner.load(state)
        if not learner.trajectory.is_same_plan(trajectory):
            raise OutputError(
                f"{state} is of another plan; give another folder, or --force to start anew."
            )
        return learner
    made = [path for path in folder.glob("repetition_*.csv") if _NAME.fullmatch(path.name)]
    if made and not force:
        raise OutputError(
            f"{folder} holds repetitions without {STATE}; give another folder, or --force to "
            "replace them."
        )
    learner = Learner(trajectory)
    if force:
        learner.save(state)  # before, so that they are never taken for this learner's
        for path in made:
            path.unlink()
    return learner


def draw_repetitions(learner: Learner, folder: Path) -> list[Path]:
    """Writes picture and report of all repetitions, if there are recordings; their paths."""
    complete = {
        number: path
        for number in range(1, len(learner.repetitions) + 1)
        if (path := recording_of(folder, number)).exists()
    }
    if not complete:
        return []
    write_learning_report(learner, complete, folder / STATE, folder / PICTURE, folder / REPORT)
    return [folder / PICTURE, folder / REPORT]
