"""Many runs at once, on this machine and on others."""

import concurrent.futures
import functools
import os
import sys
import threading
from unittest import mock

import numpy as np
import pytest

from hardware import LimbTwin, replay
from limb_systems import LimbError
from soft_limb.runs.jobs import executor_of, load_module, local_executor, run_all, run_each


def _twice(number):
    return 2 * number


def _steps(start, told):
    (first,) = yield [functools.partial(_twice, start)]
    told.append(start)
    both = yield [functools.partial(_twice, first), functools.partial(_twice, first + 1)]
    return both


def test_evaluations_run_on_any_executor_a_few_at_once():
    told = []
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        many = [_steps(start, told) for start in range(20)]
        found = run_all(many, pool, at_once=2)
        assert next(found) in [(0, [0, 2]), (1, [4, 6])]
        assert max(told) <= 2
        rest = dict(found)
    assert len(rest) == 19
    assert all(values == [4 * start, 4 * start + 2] for start, values in rest.items())


def test_a_call_that_fails_ends_the_run_and_cancels_what_has_not_begun(monkeypatch):
    ran, cancelled, all_cancelled = [], [], threading.Event()
    cancel = concurrent.futures.Future.cancel

    def note(future):
        if cancel(future):
            cancelled.append(future)
        if len(cancelled) >= 18:  # but the one that runs
            all_cancelled.set()

    monkeypatch.setattr(concurrent.futures.Future, "cancel", note)

    def work(number):
        if number == 0:
            raise LimbError("this limb is broken")
        assert all_cancelled.wait(600.0)
        ran.append(number)

    def steps():
        yield [functools.partial(work, number) for number in range(20)]

    with (
        concurrent.futures.ThreadPoolExecutor(1) as pool,
        pytest.raises(LimbError, match="this limb is broken"),
    ):
        list(run_all([steps()], pool))
    assert ran in ([], [1])


def _driven(plan):
    return replay(plan, LimbTwin(seed=0))


def _loaded(name):
    return name in sys.modules


@pytest.fixture
def module_of_ones_own(tmp_path, monkeypatch):
    """The name of a module that this process has loaded from a folder."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("soft_limb.runs.jobs._folders", {})
    (tmp_path / "limb_of_ones_own.py").touch()
    load_module("limb_of_ones_own", tmp_path)
    yield "limb_of_ones_own"
    del sys.modules["limb_of_ones_own"]


def test_processes_load_what_import_names_and_keep_off_the_terminal(module_of_ones_own):
    with local_executor(1) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()
        assert pool.submit(os.readlink, "/proc/self/fd/2").result() == os.devnull
        assert pool.submit(_loaded, module_of_ones_own).result()


def test_runs_on_a_cluster_are_those_of_this_process(fig5_plan, module_of_ones_own):
    distributed = pytest.importorskip(
        "distributed", reason="Dask is not installed: pip install -e '.[cluster]'"
    )
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        executor_of(cluster.scheduler_address, 1) as executor,
    ):
        (there,) = run_each(_driven, [fig5_plan], executor)
        assert executor.submit(_loaded, module_of_ones_own).result()
    np.testing.assert_array_equal(there.bend_angle, _driven(fig5_plan).bend_angle)


def test_a_cluster_needs_dask():
    with (
        mock.patch.dict(sys.modules, {"distributed": None}),
        pytest.raises(LimbError, match="needs Dask, which is not installed"),
        executor_of("tcp://somewhere:8786", 1),
    ):
        pass
