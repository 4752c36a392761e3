"""An existing Dask cluster as a backend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.strategies.study.backends import Results
from stickslip_fit.strategies.study.chunk import Chunk
from stickslip_fit.strategies.study.made_by import MadeBy, this_process

PATIENCE = 30  # s, for the scheduler to answer and for a first worker


@dataclass(frozen=True)
class Cluster:
    """Workers of a Dask scheduler.

    A chunk whose worker dies is worked on by another. Workers write nothing: what they return is stored by
    the process that asks, once.

    Attributes
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    """

    address: str

    def run(self, chunks: Sequence[Chunk]) -> Results:
        """See `Backend.run`."""
        distributed, made_by = _distributed(), this_process()
        with self._client(distributed) as client:
            waiting = {
                client.submit(work, k, chunk, made_by, pure=False): chunk for k, chunk in enumerate(chunks)
            }
            for future in distributed.as_completed(list(waiting)):
                yield self._result(distributed, future, waiting.pop(future))
                future.release()

    def _client(self, distributed: ModuleType) -> Any:
        try:
            client = distributed.Client(self.address, timeout=PATIENCE)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"no Dask scheduler answers at {self.address} ({error}); start one with `dask scheduler` and "
                "give the address that it prints"
            ) from None
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            client.close()
            raise InputError(
                f"the Dask cluster at {self.address} has no workers; start some with "
                f"`dask worker {self.address}`"
            ) from None
        try:
            client.run(this_process)
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


def work(place: int, chunk: Chunk, made_by: MadeBy) -> tuple[int, pd.DataFrame]:
    """Work on a chunk, if this process would do so as the one that asks.

    Raises
    ------
    InputError
        If it would not, or the chunk cannot be worked on.
    """
    if unlike := made_by.unlike(this_process()):
        raise InputError(
            "a worker is not like the machine that asks it, so that its numbers may differ: "
            f"{'; '.join(unlike)}; install the same versions on all machines"
        )
    return place, chunk.run()


def _distributed() -> ModuleType:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "--cluster needs Dask: pip install 'stickslip-fit[dask]'; without --cluster, a study runs on "
            "this machine's cores"
        ) from None
    return distributed
