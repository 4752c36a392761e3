"""Runs a study in chunks of campaigns, on local cores or a Dask cluster, and stores the results.

A stored chunk is complete or absent. Chunks are kept under a hash of the code and library versions, so
that results of different code are never mixed.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import pandas as pd

import stickslip_fit
from stickslip_fit._io import write_atomically
from stickslip_fit.errors import InputError, InputIssue, check_workers
from stickslip_fit.estimation.result import library_versions
from stickslip_fit.studies.calibration import (
    StudyDesign,
    calibrate_sessions,
    compute_cost,
    compute_step_size_errors,
    compute_tip_distributions,
)
from stickslip_fit.studies.plan import Scenario, StudyPlan
from stickslip_fit.studies.simulation import draw_campaigns, simulate_campaigns

TIP_JOINT = 0  # in place of a joint
LABEL_COLUMNS = ["scenario", "campaign", "strategy", "joint", "direction"]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Campaigns `first` to `last` - 1 of a scenario."""

    study: StudyPlan
    design: StudyDesign
    scenario: Scenario
    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first

    def __str__(self) -> str:
        return f"campaigns {self.first} to {self.last - 1} of {self.scenario.name!r}"

    def run(self) -> pd.DataFrame:
        """Simulate, calibrate, predict and move.

        Returns
        -------
        DataFrame
            A row for each campaign, strategy, joint and direction, see `compute_step_size_errors` and
            `compute_cost`; and one with `TIP_JOINT` for its joint, see `compute_tip_distributions`.

        Raises
        ------
        InputError
            If a joint stalls, or a session is not over when the next one begins.
        """
        numbers = range(self.first, self.last)
        campaigns = simulate_campaigns(
            self.study, self.scenario, draw_campaigns(self.study, self.scenario, numbers)
        )
        strategies = {strategy.name: strategy for strategy in self.study.strategies}
        tables, calibrations = [], {}
        for joint, direction, cells, names in self.design.drives():
            calibrations[joint, direction] = {
                name: calibrate_sessions(self.study, strategies[name], cells, campaigns) for name in names
            }
            errors = compute_step_size_errors(calibrations[joint, direction], cells, campaigns)
            cost = pd.concat(
                [compute_cost(name, cells, campaigns, self.design.handling_seconds) for name in names]
            )
            table = errors.merge(cost, on=["campaign", "strategy"])
            tables.append(table.assign(joint=joint, direction=direction))
        if self.design.paths is not None:
            tips = compute_tip_distributions(
                self.study, self.scenario, numbers, campaigns, calibrations, self.design.paths
            )
            tables.append(tips.assign(joint=TIP_JOINT, direction=""))
        results = pd.concat(tables, ignore_index=True)
        results["campaign"] += self.first
        results["scenario"] = self.scenario.name
        ordered = results[[*LABEL_COLUMNS, *(name for name in results if name not in LABEL_COLUMNS)]]
        # The types that a Parquet file gives back.
        return ordered.astype(dict.fromkeys(("scenario", "strategy", "direction"), "str"))


ChunkResults = Generator[tuple[int, pd.DataFrame]]
"""The index of each chunk and its table, in the order in which they are finished."""


class Backend(Protocol):
    """Runs chunks."""

    def run(self, chunks: Sequence[Chunk]) -> ChunkResults:
        """Run all chunks; closing the generator stops the work.

        Raises
        ------
        InputError
            If a chunk cannot be run.
        """
        ...


@dataclass(frozen=True)
class Cores(Backend):
    """Cores of this machine: `workers` processes, or as many as there are cores for -1."""

    workers: int = -1

    def run(self, chunks: Sequence[Chunk]) -> ChunkResults:
        from joblib import Parallel, delayed

        check_workers(self.workers)
        parallel = Parallel(n_jobs=self.workers, return_as="generator_unordered", batch_size=1)
        yield from parallel(delayed(_run_locally)(k, chunk) for k, chunk in enumerate(chunks))


def _run_locally(index: int, chunk: Chunk) -> tuple[int, pd.DataFrame]:
    return index, chunk.run()


HASHED_PACKAGES = (
    *("_toml", "units", "machine", "logs", "laws", "causes", "simulation", "estimation", "bayes", "moves"),
    *("strategies", "studies"),
)


@dataclass(frozen=True)
class CodeVersion:
    """Versions of the libraries, by name, and the hash of the code that computes a study's results."""

    versions: tuple[tuple[str, str], ...]
    code: str

    @property
    def sha256(self) -> str:
        """Of versions and code."""
        return hashlib.sha256(repr(self).encode()).hexdigest()

    def differences(self, other: CodeVersion) -> list[str]:
        """Differences from another, in words."""
        other_versions = dict(other.versions)
        changes = [
            f"{name} {version} here, {other_versions.get(name, 'none')} there"
            for name, version in self.versions
            if other_versions.get(name) != version
        ]
        return changes or ["the code of stickslip_fit is not the same"] * (self.code != other.code)


@cache
def current_code_version() -> CodeVersion:
    """The version that computes results in this process."""
    package, code = Path(stickslip_fit.__file__).parent, hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0].removesuffix(".py") in HASHED_PACKAGES:
            code.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return CodeVersion(tuple(library_versions().items()), code.hexdigest())


@dataclass(frozen=True)
class ResultStore:
    """A study's finished chunks on disk.

    Attributes
    ----------
    folder : Path
        With a folder ``chunks``, in it one folder for each scenario, named by the hash of all that its
        results depend on: the study, the code and the versions.
    """

    folder: Path
    code_version: CodeVersion

    def has(self, chunk: Chunk) -> bool:
        """Whether a chunk is finished."""
        return self.path_of(chunk).exists()

    def path_of(self, chunk: Chunk) -> Path:
        """The chunk's file."""
        key = f"{chunk.study.sha256(chunk.scenario)} {self.code_version.sha256}"
        name = f"{chunk.first:06d}-{chunk.last - 1:06d}.parquet"
        return self.folder / "chunks" / hashlib.sha256(key.encode()).hexdigest()[:16] / name

    def write(self, chunk: Chunk, table: pd.DataFrame) -> None:
        """Keep a finished chunk.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        path, stream = self.path_of(chunk), io.BytesIO()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"cannot be made ({error.strerror}); name another folder"
            raise InputError(InputIssue(message, str(path.parent))) from None
        table.to_parquet(stream, index=False)
        # The hash first: a chunk counts as finished as soon as its table is there.
        write_atomically(path.with_suffix(".sha256"), hashlib.sha256(stream.getvalue()).hexdigest())
        write_atomically(path, stream.getvalue())

    def read(self, chunk: Chunk) -> pd.DataFrame:
        """A finished chunk.

        Raises
        ------
        InputError
            If its file is damaged.
        """
        path = self.path_of(chunk)
        try:
            raw, digest = path.read_bytes(), path.with_suffix(".sha256").read_bytes()
            if digest != hashlib.sha256(raw).hexdigest().encode():
                raise ValueError("its hash is another")
            return pd.read_parquet(io.BytesIO(raw))
        except (OSError, ValueError) as error:
            message = f"cannot be read ({error}); delete it, and run the study again"
            raise InputError(InputIssue(message, str(path))) from None


TIMEOUT = 30  # s, for the scheduler to answer and for a first worker


@dataclass(frozen=True)
class Cluster(Backend):
    """Workers of the Dask scheduler at an address such as ``tcp://10.0.0.1:8786``.

    A chunk whose worker dies is run by another. Workers write nothing: the calling process stores each
    result once.
    """

    address: str

    def run(self, chunks: Sequence[Chunk]) -> ChunkResults:
        distributed, code_version = _import_distributed(), current_code_version()
        with self._client(distributed) as client:
            waiting = {
                client.submit(run_on_worker, k, chunk, code_version, pure=False): chunk
                for k, chunk in enumerate(chunks)
            }
            for future in distributed.as_completed(list(waiting)):
                yield self._result(distributed, future, waiting.pop(future))
                future.release()

    def _client(self, distributed: ModuleType) -> Any:
        try:
            client = distributed.Client(self.address, timeout=TIMEOUT)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"no Dask scheduler answers at {self.address} ({error}); start one with `dask scheduler` and "
                "give the address that it prints"
            ) from None
        try:
            client.wait_for_workers(1, timeout=TIMEOUT)
        except TimeoutError:
            client.close()
            raise InputError(
                f"the Dask cluster at {self.address} has no workers; start some with "
                f"`dask worker {self.address}`"
            ) from None
        try:
            client.run(current_code_version)
        except (ImportError, AttributeError) as error:
            client.close()
            raise InputError(
                f"a worker at {self.address} cannot load this version of stickslip_fit ({error}); install "
                "the same on all machines"
            ) from None
        return client

    def _result(self, distributed: ModuleType, future: Any, chunk: Chunk) -> tuple[int, pd.DataFrame]:
        try:
            return future.result()
        except distributed.KilledWorker:
            raise InputError(
                f"workers died one after the other on {chunk}, for want of memory as a rule; give them more "
                "(dask worker --memory-limit), then run the study again: what is finished is kept"
            ) from None
        except (OSError, distributed.CancelledError) as error:
            raise InputError(
                f"the Dask cluster at {self.address} went away ({type(error).__name__}); run the study again "
                "when it is back, or without --cluster: what is finished is kept"
            ) from None


def run_on_worker(index: int, chunk: Chunk, code_version: CodeVersion) -> tuple[int, pd.DataFrame]:
    """Run a chunk, if the versions in this process are those of the calling one.

    Raises
    ------
    InputError
        If they are not, or the chunk cannot be run.
    """
    if differences := code_version.differences(current_code_version()):
        raise InputError(
            "a worker has other versions than the machine that uses it, so that its results may differ: "
            f"{'; '.join(differences)}; install the same versions on all machines"
        )
    return index, chunk.run()


def _import_distributed() -> ModuleType:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "--cluster needs Dask: pip install 'stickslip-fit[dask]'; without --cluster, a study runs on "
            "this machine's cores"
        ) from None
    return distributed
