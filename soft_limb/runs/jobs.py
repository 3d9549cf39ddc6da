"""Calls of one function in processes of this machine, or on a Dask cluster, by joblib."""

import contextlib
import functools
import importlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import joblib

from hardware.emulation.twin import SPECIMENS
from limb_systems.errors import LimbError


def run_each(
    function: Callable[[Any], Any],
    arguments: Iterable[Any],
    num_processes: int,
    *,
    cluster: str | None = None,
    in_order: bool = False,
) -> Iterator[Any]:
    """Call a function with each of some arguments, and yield the results as they come.

    Its processes load the modules that `load_module` has loaded here. A worker of a cluster finds
    such a module if it is installed there, or in the folder in which it is here.

    Args:
        function: is pickled by name, as are the classes of arguments and results.
        arguments: one for each call.
        num_processes: processes on this machine; 1 makes the calls in this process.
        cluster: address of a Dask scheduler, whose workers make the calls instead.
        in_order: whether results come in the order of the arguments.

    Raises:
        Exception: of the first call that fails; calls that have not begun are dropped then.
        LimbError: if Dask is not installed, its scheduler does not answer, or a worker cannot load
            a module.
    """
    returned = "generator" if in_order else "generator_unordered"
    with _backend(num_processes, cluster) as backend:
        with joblib.parallel_config(**backend):
            # Small batches, as each call takes seconds; no files in place of large arrays.
            parallel = joblib.Parallel(return_as=returned, batch_size=1, max_nbytes=None)
        results = parallel(joblib.delayed(function)(argument) for argument in arguments)
        with contextlib.closing(results):
            yield from results


@contextlib.contextmanager
def _backend(num_processes: int, cluster: str | None) -> Iterator[dict[str, Any]]:
    """Yield the options of joblib's backend."""
    if cluster is None:
        folders = {specimen.__module__: "" for specimen in SPECIMENS.values()} | _module_folders
        begin = (
            {"initializer": _initialize_process, "initargs": (folders,)}
            if num_processes > 1
            else {}
        )
        yield {"n_jobs": num_processes, "backend": "loky", **begin}
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
            client.register_worker_callbacks(
                functools.partial(_import_modules, dict(_module_folders))
            )
        except ImportError as error:
            raise LimbError(f"A worker of the cluster cannot load a module: {error}") from error
        yield {"n_jobs": -1, "backend": "dask", "client": client}


def load_module(name: str, folder: str | Path) -> None:
    """Import a module that defines a wire law, a bend sensor or an emulated limb of one's own.

    Processes of `run_each` import it, too.

    Args:
        name: its name, with dots.
        folder: folder where it is found if it is not installed.
    """
    _import_modules({name: str(Path(folder).resolve())})


_module_folders: dict[str, str] = {}  # of the modules that `load_module` has loaded, by their names


def _import_modules(folders: dict[str, str]) -> None:
    for name, folder in folders.items():
        if folder and folder not in sys.path:
            sys.path.append(folder)  # last, so that its modules take no other's place
        importlib.import_module(name)
        _module_folders[name] = folder


def _initialize_process(folders: dict[str, str]) -> None:
    """Load modules in a new process, and keep its progress off the terminal of the others."""
    _import_modules(folders)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
