"""From files to a Log: read, check, put in order, add history."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import repeat

import numpy as np
import pandas as pd

from stickslip_fit.logs.cells import Cells, by_file
from stickslip_fit.logs.check import check_rows
from stickslip_fit.logs.columns import lay_out
from stickslip_fit.logs.covariates import read_covariates
from stickslip_fit.logs.faults import Faults
from stickslip_fit.logs.history import add_session_history
from stickslip_fit.logs.identity import Identity, identify
from stickslip_fit.logs.log import Log
from stickslip_fit.logs.parse import Bools, Ints
from stickslip_fit.logs.sessions import Moment, alike, choose_sessions
from stickslip_fit.logs.sources import Name, hash_of, open_sources
from stickslip_fit.logs.table import Table
from stickslip_fit.logs.together import together
from stickslip_fit.machine import Machine, load_machine

_FIRST = ["session", "time", "joint", "direction", "steps"]


def read_log(
    source: Name | Iterable[Name],
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
        where the log has zones. Of the other sessions only session, time, joint and steps are looked at,
        which history needs; of a Parquet file, no other column of their row groups is read.

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
    sources = open_sources(source, faults)
    files = [_understand(each.table, faults) for each in sources]
    if not files:
        faults.raise_if_any()
    identity = kept = identify(files)
    chosen = np.ones(len(identity.time), np.bool_)
    if since is not None or until is not None:
        faults.raise_if_any()
        chosen = choose_sessions(identity, since, until)
        files, kept = _take(files, chosen), identity.take(chosen)
    columns, notes = _columns(files, kept, machine)
    faults.raise_if_any()
    rows = add_session_history(_in_order(columns, kept.order), kept.session[kept.order])
    return Log(
        rows=rows.assign(steps_before=identity.steps_before[chosen[identity.order]]),
        sources=tuple((each.table.file, each.sha256) for each in sources),
        sha256=hash_of(sources),
        machine=machine,
        notes=(*(note for cells in files for note in cells.layout.notes), *notes, *alike(identity)),
    )


def _understand(table: Table, faults: Faults) -> Cells:
    return Cells(table, lay_out(table.names, table.file, table.header_line, faults), faults)


def _take(files: list[Cells], chosen: Bools) -> list[Cells]:
    """Only the chosen rows, and only the files that have any."""
    return [
        replace(cells, table=cells.table.take(np.flatnonzero(mine)))
        for cells, mine in zip(files, by_file(files, chosen), strict=True)
        if mine.any()
    ]


def _columns(
    files: list[Cells], identity: Identity, machine: Machine
) -> tuple[dict[str, pd.Series], tuple[str, ...]]:
    """All columns but history, in the files' order, and notes about the lab's own columns."""
    joints, steps = by_file(files, identity.joint), by_file(files, identity.steps)
    read = together(
        {
            "checked": lambda: list(map(check_rows, files, repeat(machine), joints, steps)),
            "own": lambda: read_covariates(files),
        }
    )
    own, notes = read["own"]
    # A single file's columns are not copied: a million rows take their time.
    checked = read["checked"][0] if len(files) == 1 else pd.concat(read["checked"], ignore_index=True)
    return {**identity.columns(), **dict(checked.items()), **own}, notes


def _in_order(columns: dict[str, pd.Series], order: Ints) -> pd.DataFrame:
    names = _FIRST + [name for name in columns if name not in _FIRST]
    rows = pd.DataFrame({name: columns[name] for name in names}, copy=False)
    if np.all(order[1:] > order[:-1]):
        return rows
    return rows.take(order).reset_index(drop=True)
