"""Call a function many times in processes of this machine, or on a Dask cluster, by joblib."""

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
    """Call a function once for each argument, and yield the results as they come.

    The processes import the modules that `load_module` has imported here. A worker of a cluster
    finds such a module if it is installed there, or is in the same folder as here.

    Args:
        function: function at the top level of a module, as it is pickled by name.
        num_processes: processes on this machine; 1 makes the calls in this process.
        cluster: address of a Dask scheduler; its workers make the calls instead.
        in_order: whether results come in the order of the arguments.

    Raises:
        Exception: of the first call that fails; calls that have not begun are dropped then.
        LimbError: if the cluster is not there, or cannot load a module.
    """
    return_as = "generator" if in_order else "generator_unordered"
    with _backend(num_processes, cluster) as backend:
        with joblib.parallel_config(**backend):
            # Each call takes seconds: send them one by one, and arrays not by files.
            parallel = joblib.Parallel(return_as=return_as, batch_size=1, max_nbytes=None)
        results = parallel(joblib.delayed(function)(argument) for argument in arguments)
        with contextlib.closing(results):
            yield from results


@contextlib.contextmanager
def _backend(num_processes: int, cluster: str | None) -> Iterator[dict[str, Any]]:
    """Yield the options of joblib's backend: processes of this machine, or a cluster."""
    # New processes import the modules of all emulated limbs, and the user's modules.
    if cluster is None:
        folders = {specimen.__module__: "" for specimen in SPECIMENS.values()} | _module_folders
        begin = (
            {"initializer": _initialize_process, "initargs": (folders,)}
            if num_processes > 1
            else {}
        )
        yield {"n_jobs": num_processes, "backend": "loky", **begin}
        return
    # Connect to the cluster.
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
            # Let all workers import the user's modules, also workers that join later.
            client.register_worker_callbacks(
                functools.partial(_import_modules, dict(_module_folders))
            )
        except ImportError as error:
            raise LimbError(f"A worker of the cluster cannot load a module: {error}") from error
        yield {"n_jobs": -1, "backend": "dask", "client": client}


def load_module(name: str, folder: str | Path) -> None:
    """Import a user's module, which the processes of `run_each` import, too.

    It defines a wire law, a bend sensor or an emulated limb, and is in the folder or installed.
    """
    _import_modules({name: str(Path(folder).resolve())})


_module_folders: dict[str, str] = {}  # by the names of the modules that `load_module` has imported


def _import_modules(folders: dict[str, str]) -> None:
    for name, folder in folders.items():
        if folder and folder not in sys.path:
            sys.path.append(folder)  # last, so that it hides no other module
        importlib.import_module(name)
        _module_folders[name] = folder


def _initialize_process(folders: dict[str, str]) -> None:
    """Import modules in a new process, and send its progress messages to /dev/null."""
    _import_modules(folders)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
