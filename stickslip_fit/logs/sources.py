"""From paths to tables: files and folders, CSV and Parquet, and the hash of what was read."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from stickslip_fit.errors import InputError
from stickslip_fit.logs.csv_table import parse_csv
from stickslip_fit.logs.faults import Faults
from stickslip_fit.logs.parquet_table import open_parquet
from stickslip_fit.logs.table import Table
from stickslip_fit.logs.together import together

Name = str | Path


@dataclass(frozen=True)
class Source:
    """A file that was read: its table and the hash of its bytes."""

    table: Table
    sha256: str


def open_sources(source: Name | Iterable[Name], faults: Faults) -> list[Source]:
    """Open files, and the ``*.csv`` and ``*.parquet`` in folders, hidden ones left out.

    Raises
    ------
    InputError
        If nothing was named; what is wrong with a file is told to `faults`.
    """
    named = [source] if isinstance(source, str | Path) else list(source)
    if not named:
        raise InputError("no log was named; name a file or a folder")
    opened = [_open(path, faults) for given in named for path in _files(Path(given), faults)]
    return [found for found in opened if found is not None]


def hash_of(sources: Sequence[Source]) -> str:
    """Take a single file's own hash; for several, one that doesn't depend on their names or order."""
    hashes = sorted(source.sha256 for source in sources)
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def _files(path: Path, faults: Faults) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = [
        file
        for file in sorted(path.rglob("*"))
        if file.suffix.lower() in (".csv", ".parquet")
        and file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(path).parts)
    ]
    if not found:
        faults.place(str(path), "is a folder without logs; put .csv or .parquet files there, or name another")
    return found


def _open(path: Path, faults: Faults) -> Source | None:
    file = str(path)
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        faults.place(file, f"cannot be read ({reason}); name an existing log")
        return None
    parquet = path.suffix.lower() == ".parquet" or raw.startswith(b"PAR1")
    parse = open_parquet if parquet else parse_csv
    read = together(
        {
            "table": lambda: parse(raw, file, faults),
            "sha256": lambda: hashlib.sha256(raw).hexdigest(),
        }
    )
    return None if read["table"] is None else Source(**read)
