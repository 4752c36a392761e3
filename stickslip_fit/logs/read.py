"""From files to a Log: read, check, put in order, add history."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.logs.cells import Cells, by_file
from stickslip_fit.logs.check import check_rows
from stickslip_fit.logs.columns import lay_out
from stickslip_fit.logs.covariates import read_covariates
from stickslip_fit.logs.csv_table import parse_csv
from stickslip_fit.logs.faults import Faults
from stickslip_fit.logs.history import add_session_history
from stickslip_fit.logs.identity import Identity, identify
from stickslip_fit.logs.log import Log
from stickslip_fit.logs.parquet_table import open_parquet
from stickslip_fit.logs.parse import Bools
from stickslip_fit.logs.sessions import Moment, alike, choose_sessions
from stickslip_fit.logs.table import Table
from stickslip_fit.logs.together import together
from stickslip_fit.machine import Machine, load_machine

Source = str | Path


def read_log(
    source: Source | Iterable[Source],
    *,
    machine: Machine | None = None,
    since: Moment | None = None,
    until: Moment | None = None,
) -> Log:
    """Read and check a campaign log, CSV or Parquet, in one file or many.

    Parameters
    ----------
    source : path or iterable of paths
        Files, or folders, which are searched for ``*.csv`` and ``*.parquet`` (hidden files left out).
    machine : Machine, optional
        The nominal one if not given.
    since, until : str, date or datetime, optional
        Select the sessions whose first traverse falls in [since, until); without a zone, they are UTC
        where the log has zones. Of the other sessions only session, time, joint and steps are read and
        checked (of Parquet files, nothing else leaves the disk's row groups), for the sake of history.

    Returns
    -------
    Log

    Raises
    ------
    InputError
        With every fault of every file: file, line, column, value and what to do.
    """
    machine = machine or load_machine()
    faults = Faults()
    opened = _open_all(source, faults)
    files = [_understand(table, faults) for table, _ in opened]
    if not files:
        faults.raise_if_any()
    whole = identity = identify(files)
    chosen = np.ones(len(whole.time), np.bool_)
    chosen_files = files
    if since is not None or until is not None:
        faults.raise_if_any()
        chosen = choose_sessions(whole, since, until)
        identity, chosen_files = whole.take(chosen), _take(files, chosen)
    rows, notes = _rows(chosen_files, identity, machine, faults)
    faults.raise_if_any()
    order = identity.order
    if (order[1:] < order[:-1]).any():
        rows = rows.take(order).reset_index(drop=True)
    return Log(
        rows=add_session_history(rows, identity.session[order]).assign(
            steps_before=whole.steps_before[chosen][order]
        ),
        sources=tuple((table.file, sha256) for table, sha256 in opened),
        sha256=_hash_of([sha256 for _, sha256 in opened]),
        machine=machine,
        notes=(*(note for cells in files for note in cells.layout.notes), *notes, *alike(whole)),
    )


def _open_all(source: Source | Iterable[Source], faults: Faults) -> list[tuple[Table, str]]:
    sources = [source] if isinstance(source, str | Path) else list(source)
    if not sources:
        raise InputError("no log was named; name a file or a folder")
    opened = [_open(path, faults) for given in sources for path in _files(Path(given), faults)]
    return [(table, sha256) for table, sha256 in opened if table is not None]


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


def _open(path: Path, faults: Faults) -> tuple[Table | None, str]:
    """A file's table, if there is one in it, and the hash of its bytes."""
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        faults.place(str(path), f"cannot be read ({reason}); name an existing log")
        return None, ""
    parse = open_parquet if path.suffix.lower() == ".parquet" or raw.startswith(b"PAR1") else parse_csv
    read = together(
        {
            "table": lambda: parse(raw, str(path), faults),
            "sha256": lambda: hashlib.sha256(raw).hexdigest(),
        }
    )
    return read["table"], read["sha256"]


def _understand(table: Table, faults: Faults) -> Cells:
    return Cells(table, lay_out(table.names, table.file, table.header_line, faults), faults)


def _take(files: list[Cells], chosen: Bools) -> list[Cells]:
    """Only the chosen rows, and only the files that have any."""
    return [
        replace(cells, table=cells.table.take(np.flatnonzero(mine)))
        for cells, mine in zip(files, by_file(files, chosen), strict=True)
        if mine.any()
    ]


def _rows(
    files: list[Cells], identity: Identity, machine: Machine, faults: Faults
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """All columns but history, in the files' order, and notes about the lab's own columns."""
    joints, steps = by_file(files, identity.joint), by_file(files, identity.steps)
    read = together(
        {
            "checked": lambda: [
                check_rows(cells, machine, joint, driven)
                for cells, joint, driven in zip(files, joints, steps, strict=True)
            ],
            "own": lambda: read_covariates(files),
        }
    )
    checked = read["checked"]
    own, notes = read["own"]
    named = {
        "session": identity.sessions(),
        "time": identity.times(),
        "joint": identity.joint,
        "steps": identity.steps,
    }
    # Without copies: a million rows are moved once, when they are sorted.
    described = pd.concat(checked, ignore_index=True) if len(checked) > 1 else checked[0]
    columns = named | dict(described.items()) | own
    first = ["session", "time", "joint", "direction", "steps"]
    names = first + [name for name in columns if name not in first]
    return pd.DataFrame({name: columns[name] for name in names}, copy=False), notes


def _hash_of(hashes: list[str]) -> str:
    """Take a single file's own hash; for several, one that doesn't depend on their names or order."""
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("\n".join(sorted(hashes)).encode()).hexdigest()
