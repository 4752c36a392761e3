"""Chunks of a study on disk: whole or not there, and never mixed with those of another study."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import write_atomically
from stickslip_fit.strategies.study.chunk import Chunk
from stickslip_fit.strategies.study.made_by import MadeBy


@dataclass(frozen=True)
class Store:
    """Where a study keeps what is finished.

    Attributes
    ----------
    folder : Path
        Has, or gets, a folder ``chunks`` with one folder for each scenario, named after the hash of all that
        its numbers depend on: the study, the code and the versions.
    made_by : MadeBy
    """

    folder: Path
    made_by: MadeBy

    def has(self, chunk: Chunk) -> bool:
        """Whether a chunk is finished."""
        return self.path_of(chunk).exists()

    def path_of(self, chunk: Chunk) -> Path:
        """The chunk's file."""
        told = f"{chunk.study.sha256(chunk.scenario)} {self.made_by.sha256}"
        name = f"{chunk.first:06d}-{chunk.last - 1:06d}.parquet"
        return self.folder / "chunks" / hashlib.sha256(told.encode()).hexdigest()[:16] / name

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
            raise InputError(Problem(message, str(path.parent))) from None
        table.to_parquet(stream, index=False)
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
            return pd.read_parquet(path)
        except (OSError, ValueError) as error:
            message = f"cannot be read ({error}); delete it, and run the study again"
            raise InputError(Problem(message, str(path))) from None
