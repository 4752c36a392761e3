"""Where chunks are worked on: this machine's cores, or an existing Dask cluster."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Protocol

import pandas as pd

from stickslip_fit.strategies.study.chunk import Chunk

Results = Generator[tuple[int, pd.DataFrame]]
"""The place of each chunk and its table, in the order in which they are finished."""


class Backend(Protocol):
    """Anything that works on chunks."""

    def run(self, chunks: Sequence[Chunk]) -> Results:
        """Work on all of them; closing what is returned stops the work.

        Raises
        ------
        InputError
            If a chunk cannot be worked on.
        """
        ...


@dataclass(frozen=True)
class Cores:
    """Cores of this machine.

    Attributes
    ----------
    workers : int
        Processes; as many as there are cores where it is -1.
    """

    workers: int = -1

    def run(self, chunks: Sequence[Chunk]) -> Results:
        """See `Backend.run`."""
        from joblib import Parallel, delayed

        parallel = Parallel(n_jobs=self.workers, return_as="generator_unordered", batch_size=1)
        yield from parallel(delayed(_work)(k, chunk) for k, chunk in enumerate(chunks))


def _work(place: int, chunk: Chunk) -> tuple[int, pd.DataFrame]:
    return place, chunk.run()
