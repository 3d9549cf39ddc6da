"""Many runs at once, in calls that any of Python's executors can run."""

import concurrent.futures
import contextlib
import functools
import importlib
import itertools
import multiprocessing
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path
from typing import Any

from hardware.emulation.twin import SPECIMENS
from limb_systems.errors import LimbError

# Yields calls that do not need each other, gets their results, and returns its own.
Evaluation = Generator[list[Callable[[], Any]], Any, Any]


def run_all(
    evaluations: Iterable[Evaluation],
    executor: concurrent.futures.Executor,
    at_once: int | None = None,
) -> Iterator[tuple[int, Any]]:
    """Runs evaluations whose calls an executor runs, and yields results as they come.

    The calls and what they return are pickled if the executor has other processes or other
    machines, as have `concurrent.futures.ProcessPoolExecutor`, Dask's
    ``Client.get_executor()`` and mpi4py's ``MPIPoolExecutor``; these need the modules of
    the calls on their path. Between calls, evaluations run where this is called.

    Args:
        evaluations: generators, each of which yields lists of calls without arguments.
        executor: runs the calls; it is not shut down.
        at_once: how many evaluations are begun before one has ended; all if None. With
            few, the first results come early.

    Yields:
        The number of an evaluation, and what it returned.

    Raises:
        Exception: of the first call that fails; calls that have not begun are cancelled
            then, as when the generator is closed.
    """
    waiting = enumerate(evaluations)
    # By the number of an evaluation: itself, and what its calls return.
    running: dict[int, tuple[Evaluation, list[concurrent.futures.Future]]] = {}
    pending: set[concurrent.futures.Future] = set()

    def proceed(number: int, evaluation: Evaluation, results: list[Any] | None = None) -> None:
        futures = [executor.submit(call) for call in evaluation.send(results)]
        running[number] = evaluation, futures
        pending.update(futures)

    try:
        while True:
            free = None if at_once is None else at_once - len(running)
            for number, evaluation in itertools.islice(waiting, free):
                proceed(number, evaluation)
            if not running:
                return
            first = concurrent.futures.FIRST_COMPLETED
            done, pending = concurrent.futures.wait(pending, return_when=first)
            for future in done:
                future.result()  # raises what the call has raised, before others end
            for number, (evaluation, futures) in list(running.items()):
                if pending.isdisjoint(futures):
                    del running[number]
                    try:
                        proceed(number, evaluation, [future.result() for future in futures])
                    except StopIteration as end:
                        yield number, end.value
    finally:
        for future in pending:
            future.cancel()


def run_each(
    function: Callable[[Any], Any], arguments: Iterable[Any], executor: concurrent.futures.Executor
) -> Iterator[Any]:
    """Calls a function with each of some arguments on an executor, and yields results as they come.

    Raises:
        Exception: as `run_all` does.
    """
    futures = [executor.submit(function, argument) for argument in arguments]
    try:
        for future in concurrent.futures.as_completed(futures):
            yield future.result()
    finally:
        for future in futures:
            future.cancel()


@contextlib.contextmanager
def executor_of(cluster: str | None, num_processes: int) -> Iterator[concurrent.futures.Executor]:
    """The executor of a command: Dask's at an address, or processes on this machine if None.

    Its processes load the modules that `load_module` has loaded here. A worker of a cluster finds
    such a module if it is installed there, or in the folder in which it is here.

    Raises:
        LimbError: if Dask is not installed, its scheduler does not answer, or a worker cannot load
            a module.
    """
    if cluster is None:
        with local_executor(num_processes) as executor:
            yield executor
        return
    try:
        from distributed import Client
    except ImportError:
        raise LimbError(
            "A cluster needs Dask, which is not installed: pip install 'soft-limb[cluster]'"
        ) from None
    try:
        client = Client(cluster)
    except (OSError, ValueError) as error:
        raise LimbError(f"There is no Dask scheduler at {cluster}: {error}") from error
    with client:
        try:
            # Also for workers that join later.
            client.register_worker_callbacks(functools.partial(_load, dict(_folders)))
        except ImportError as error:
            raise LimbError(f"A worker of the cluster cannot load a module: {error}") from error
        yield client.get_executor()


@contextlib.contextmanager
def local_executor(num_processes: int) -> Iterator[concurrent.futures.Executor]:
    """Processes on this machine, which end at once if something fails or Ctrl-C is pressed."""
    # Copies of a process that has imported the package, which takes seconds, and done nothing else:
    # copies of this one might wait for ever for threads that only this one has.
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    if method == "forkserver":
        context.set_forkserver_preload(["calibration", "soft_limb.runs.rollout"])
        _start_quietly()
    folders = {specimen.__module__: "" for specimen in SPECIMENS.values()} | _folders
    with concurrent.futures.ProcessPoolExecutor(
        num_processes, mp_context=context, initializer=_begin, initargs=(folders,)
    ) as pool:
        try:
            yield pool
        except BaseException:
            for process in multiprocessing.active_children():
                process.terminate()  # or the pool would wait for what they are at
            raise


def _start_quietly() -> None:
    """Start the process that is copied; whatever ends it, only this one has something to say."""
    from multiprocessing import forkserver  # which not all systems have

    errors, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        forkserver.ensure_running()
    finally:
        os.dup2(errors, 2)
        os.close(errors)
        os.close(nowhere)


def load_module(name: str, folder: str | Path) -> None:
    """Import a module that defines a wire law, a bend sensor or an emulated limb of one's own.

    Processes of `executor_of` import it, too.

    Args:
        name: its name, with dots.
        folder: folder where it is found if it is not installed.
    """
    _load({name: str(Path(folder).resolve())})


_folders: dict[str, str] = {}  # of the modules that `load_module` has loaded, by their names


def _load(folders: dict[str, str]) -> None:
    for name, folder in folders.items():
        if folder and folder not in sys.path:
            sys.path.append(folder)  # last, so that its modules take no other's place
        importlib.import_module(name)
        _folders[name] = folder


def _begin(folders: dict[str, str]) -> None:
    """Load modules in a new process, and keep its progress off the terminal of the others."""
    _load(folders)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
