"""Repeat a plan on a limb, and learn from each repetition to follow it."""

import itertools
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from controllers import Learner
from controllers.learner import Repetition
from hardware.board.journal import closing
from hardware.board.link import HardwareError, present_temperature
from hardware.board.serial_limb import SerialLimb
from hardware.board.several_boards import Ports, open_link
from hardware.emulation.twin import LimbTwin
from hardware.live_feed import LiveView
from hardware.replaying import ReplayError
from limb_systems import LimbSystem, Recording, Trajectory
from limb_systems.files.output import OutputError, check_folder
from limb_systems.files.table_writer import unfinished_files
from limb_systems.limb_system import check_limb
from limb_systems.progress import Progress
from soft_limb.reports.plan_report import write_learning_report
from soft_limb.runs.rollout import record_replay

STATE_FILE, LEARNED_FILE = "learning.txt", "learned.csv"
REPORT_FILE = "learning.html"
REST_TIME = 300.0  # s without heat between two repetitions on an emulated limb
MAX_REST_TIME = 1200.0  # s
READ_PERIOD = 1.0  # s
COOL_TOLERANCE = 3.0  # °C; a wire that is warmer than at the start by less is cool
MAX_LISTED = 10  # earlier repetitions that the live page lists
_NAME = re.compile(r"repetition_[0-9]+\.csv")


def repeat(
    learner: Learner,
    limb_of_repetition: Callable[[], LimbSystem],
    repetitions: int,
    folder: str | Path,
    *,
    announce: Callable[[int, Repetition], object] = lambda number, repetition: None,
    live: LiveView | None = None,
) -> None:
    """Repeat a plan a number of times, or until further repetitions would bring no improvement.

    The folder gets ``learning.txt``, which `Learner.load` reads; ``learned.csv``, a trajectory
    with the best repetition's duty; and a recording of each repetition, ``repetition_1.csv`` etc.
    An interruption loses nothing: when started again, it learns from complete recordings. If a
    robot fails, its unfinished recording is kept and learned from, as an interrupted repetition.

    Args:
        limb_of_repetition: function that returns a limb that is ready for the next repetition.
        repetitions: number of repetitions in total, including the learner's earlier ones.
        announce: function that is called with each repetition and its number, from 1 on.
        live: as for `replay`, whose errors are raised.
    """
    folder = Path(folder)
    learner.save(folder / STATE_FILE)
    while len(learner.repetitions) < repetitions and not learner.finished:
        number = len(learner.repetitions) + 1
        path = recording_path(folder, number)
        failure = None
        # Take a recording that an earlier run completed, or else record a repetition.
        if path.exists():
            recording = Recording.load(path)
        else:
            limb = check_limb(limb_of_repetition())
            with closing(limb):  # a robot, also if something fails before its replay
                if live:
                    live.say(_title(learner, repetitions))
                before = unfinished_files(path)
                try:
                    recording = record_replay(
                        learner.trajectory, limb, path, controller=learner.source(), live=live
                    )
                except HardwareError as error:
                    new = unfinished_files(path) - before
                    if not new:
                        raise
                    failure = error
                    recording = Recording.load(new.pop(), unfinished=True)
        # Learn from it, and save the state before the next one begins.
        repetition = learner.update(recording)
        learner.save(folder / STATE_FILE)
        learner.learned_trajectory().save(folder / LEARNED_FILE)
        announce(number, repetition)
        # Raise the robot's failure, which has been learned from.
        if failure:
            raise failure


def _title(learner: Learner, repetitions: int) -> str:
    """Return the live page's sentence on a learner's next repetition and the latest ones."""
    sentence = f"Repetition {len(learner.repetitions) + 1} of {repetitions}"
    latest = learner.repetitions[-MAX_LISTED:]
    if latest:
        distances = ", ".join(f"{np.rad2deg(each.reference_distance):.2f}°" for each in latest)
        sentence += f"; mean distances from the reference so far, as read: {distances}"
    return sentence


def recording_path(folder: Path, number: int) -> Path:
    """Return the path of a repetition's recording."""
    return folder / f"repetition_{number}.csv"


def make_rested_twins(
    twin: LimbTwin, trajectory: Trajectory, learner: Learner
) -> Callable[[], LimbSystem]:
    """Return a function for `repeat` that returns an emulated limb after a rest of `REST_TIME`.

    If there are repetitions of earlier programs, their time passes first, so that the noise of
    the sensors is not the same again.
    """
    passed = len(learner.repetitions) * (trajectory.duration + REST_TIME)
    pauses = itertools.chain([passed], itertools.repeat(REST_TIME))
    return lambda: twin.after_rest(next(pauses))


def make_rested_robots(
    port: Ports,
    trajectory: Trajectory,
    live: LiveView | None = None,
) -> Callable[[], LimbSystem]:
    """Return a function for `repeat` that waits for cool wires and returns the robot on a port."""

    def rested_robot() -> LimbSystem:
        with open_link(port, trajectory.parameters) as link:
            wait_for_cool_wires(lambda: present_temperature(link), trajectory, live)
        return SerialLimb(port, trajectory.parameters)

    return rested_robot


def wait_for_cool_wires(
    read: Callable[[], np.ndarray], trajectory: Trajectory, live: LiveView | None = None
) -> None:
    """Wait until no wire is read more than `COOL_TOLERANCE` above the start of a plan.

    Args:
        read: function that returns V of the wires (W,), °C.
        live: page that shows the reading of the warmest wire.

    Raises:
        ReplayError: if a wire is too warm after `MAX_REST_TIME`.
    """
    start = trajectory.measured_temperature[:, 0]
    names = trajectory.parameters.wire_names
    begin = time.monotonic()
    with Progress("resting until the wires are cool", MAX_REST_TIME, "s") as progress:
        while True:
            # Find the wire that is farthest above its start.
            excess = read() - start
            warmest = int(np.argmax(excess))
            if excess[warmest] <= COOL_TOLERANCE:
                return
            # Give up, or wait.
            waited = time.monotonic() - begin
            reading = start[warmest] + excess[warmest]
            if waited > MAX_REST_TIME:
                raise ReplayError(
                    f"After {waited:.0f} s of rest the {names[warmest]} wire is still at "
                    f"{reading:.1f} °C, but the trajectory starts at {start[warmest]:.1f} °C; cool "
                    "the limb, or plan from its present temperature."
                )
            remark = f"{names[warmest]} {reading:.1f} °C"
            progress.update(waited, remark)
            if live:
                live.say(f"Resting until the wires are cool: {remark}")
            time.sleep(READ_PERIOD)


def load_or_create_learner(folder: Path, trajectory: Trajectory, *, force: bool = False) -> Learner:
    """Return the learner of a plan that a folder has, or a new learner; a new one by ``force``.

    Raises:
        OutputError: if the folder cannot be written to, or has repetitions of another plan.
        FileFormatError: if the state in the folder is damaged.
    """
    # Continue with the learner in the folder.
    check_folder(folder)
    state = folder / STATE_FILE
    if state.exists() and not force:
        learner = Learner.load(state)
        if not learner.trajectory.is_same_plan(trajectory):
            raise OutputError(
                f"{state} belongs to another plan; give another folder, or --force to start anew."
            )
        return learner
    # Begin anew, and replace recordings only by --force.
    made = [path for path in folder.glob("repetition_*.csv") if _NAME.fullmatch(path.name)]
    if made and not force:
        raise OutputError(
            f"{folder} holds repetitions without {STATE_FILE}; give another folder, or --force to "
            "replace them."
        )
    learner = Learner(trajectory)
    if force:
        learner.save(state)  # first, so that no old recording is ever taken for a new one
        for path in made:
            path.unlink()
    return learner


def report_repetitions(learner: Learner, folder: Path) -> list[Path]:
    """Write the report of all repetitions, if there are recordings; return its path."""
    complete = {}
    for number in range(1, len(learner.repetitions) + 1):
        path = recording_path(folder, number)
        if path.exists():
            complete[number] = path
    if not complete:
        return []
    write_learning_report(learner, complete, folder / STATE_FILE, folder / REPORT_FILE)
    return [folder / REPORT_FILE]
