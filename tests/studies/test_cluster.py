"""On a real Dask cluster whose workers are processes of their own, and die."""

import os
import signal
import sys
import threading
import time
import warnings
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.studies import Cluster, Cores, Scenario, run_study
from stickslip_fit.studies import execution as clusters
from stickslip_fit.studies import study as study_module
from stickslip_fit.studies.calibration import design_study
from stickslip_fit.studies.execution import CodeVersion, ResultStore, current_code_version
from tests.studies.test_run import same

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")


@contextmanager
def start_cluster(workers, processes=True):
    dask = pytest.importorskip("dask", reason="the extra dask is not installed")
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    with (
        warnings.catch_warnings(action="ignore"),
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=processes,
            dashboard_address=None,
            silence_logs=50,
        ) as started,
    ):
        yield started


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no signal that kills a worker")
@pytest.mark.nightly
def test_a_killed_worker_loses_nothing_and_counts_nothing_twice(study, tmp_path, monkeypatch):
    monkeypatch.setattr(study_module, "CHUNK_CAMPAIGNS", 10)
    plan = study(campaigns=80)
    written, killed = [], []
    write = ResultStore.write

    def watched(self, chunk, table):
        written.append(chunk.first)
        write(self, chunk, table)

    def kill():
        while len(written) < 2:
            time.sleep(0.02)
        killed.append(next(iter(cluster.workers.values())).pid)
        os.kill(killed[0], signal.SIGKILL)

    monkeypatch.setattr(ResultStore, "write", watched)
    with start_cluster(2) as cluster:
        killer = threading.Thread(target=kill)
        killer.start()
        found = run_study(plan, tmp_path, Cluster(cluster.scheduler_address))
        killer.join()
    assert len(killed) == 1
    assert sorted(written) == list(range(0, 80, 10))
    same(found, run_study(plan, backend=Cores(1)))


class Deadly(study_module.Chunk):
    """Ends as on a scheduler that has given up sending it to workers."""

    def run(self):
        from distributed import KilledWorker

        raise KilledWorker("a chunk", SimpleNamespace(address="tcp://10.0.0.1:1"), 1)


def test_a_worker_gives_what_a_core_gives_and_a_chunk_that_kills_it_is_named(study):
    plan = study(campaigns=3)
    deadly = Deadly(plan, None, Scenario("too much"), 0, 3)
    with start_cluster(1, processes=False) as cluster:
        backend = Cluster(cluster.scheduler_address)
        same(run_study(plan, backend=backend), run_study(plan, backend=Cores(1)))
        with pytest.raises(InputError, match=r"died one after the other on campaigns 0 to 2 of 'too much'"):
            list(backend.run([deadly]))


@pytest.mark.nightly
def test_a_chunk_that_kills_every_worker_is_named(study):
    """Also the one that takes the place of the first."""
    plan = study()
    end = SimpleNamespace(drives=partial(os._exit, 1), paths=None)
    deadly = study_module.Chunk(plan, end, Scenario("too much"), 0, 20)
    with (
        start_cluster(1) as cluster,
        pytest.raises(InputError, match=r"died one after the other on campaigns 0 to 19 of 'too much'"),
    ):
        list(Cluster(cluster.scheduler_address).run([deadly]))


def test_a_worker_with_other_versions_is_refused(study):
    plan = study()
    chunk = study_module.Chunk(plan, design_study(plan), plan.scenarios[0], 0, 2)
    subset = current_code_version()
    assert clusters.run_on_worker(5, chunk, subset)[0] == 5
    other = CodeVersion((("stickslip_fit", "9.9"), *subset.versions[1:]), subset.code)
    with pytest.raises(InputError, match=r"stickslip_fit 9\.9 here, .* there.*install the same versions"):
        clusters.run_on_worker(5, chunk, other)
    with pytest.raises(InputError, match="the code of stickslip_fit is not the same"):
        clusters.run_on_worker(5, chunk, replace(subset, code="another"))


def test_no_scheduler_and_no_dask_are_said(monkeypatch, study):
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    monkeypatch.setattr(clusters, "TIMEOUT", 0.3)
    with warnings.catch_warnings(action="ignore"):
        for address in ("tcp://127.0.0.1:1", "nowhere://x"):
            with pytest.raises(InputError, match=f"no Dask scheduler answers at {address}"):
                run_study(study(), backend=Cluster(address))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'stickslip-fit\[dask\]'"):
        run_study(study(), backend=Cluster("tcp://127.0.0.1:1"))
