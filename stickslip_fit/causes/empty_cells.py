"""Rows and columns of a table that are left out because cells are empty, with a sentence for each case.

Rows without a cell that the law or a role needs tell nothing. Those that lack a cell of another column are
left out where they are few; else the column is.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words, pluralize
from stickslip_fit._typing import BoolArray
from stickslip_fit.causes.levels import explain_unusable_levels
from stickslip_fit.causes.roles import ROW_NUMBER
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.logs._numbers import is_empty_number

# Of the rows, for the sake of a column that only might matter, and of all of these.
MAX_SHARE_LOST, MAX_SHARE_LOST_IN_ALL = 0.1, 0.2
MAX_ROWS_NAMED = 8
MIN_NINES = 3  # of a number that stands for a missing value; two where it comes more than once
OVERFLOW = 9e37  # and above: what instruments write for an overflow, SCPI 1999, 7.2.1.4


def leave_out_empty(
    frame: pd.DataFrame, numbers: Collection[str], others: Collection[str]
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """A table without rows in which something that is needed is empty, and without empty columns.

    Parameters
    ----------
    frame : DataFrame
        Its columns named by different texts.
    numbers, others : collection of str
        Needed columns: of numbers, and of anything.

    Returns
    -------
    rows : DataFrame
        With `ROW_NUMBER`, which is also its index.
    notes : tuple of str
        Sentences.

    Raises
    ------
    InputError
        If a needed column is empty, or no row has all that is needed.
    """
    frame = frame.set_axis(pd.RangeIndex(len(frame)), axis=0)
    needed = [name for name in dict.fromkeys([*numbers, *others]) if name in frame]
    frame, notes = _without_overflow(frame)
    frame, marks = _without_nines(frame)
    notes += marks
    empty = {name: _find_empty(frame[name], name in numbers) for name in needed}
    if issues := [InputIssue("is empty in every row", column=name) for name in needed if empty[name].all()]:
        raise InputError(issues)
    blank = frame.isna().all(axis=1).to_numpy()
    frame = frame.loc[:, [name in needed or not frame[name].isna().all() for name in frame]]
    lost = np.logical_or.reduce([*empty.values(), blank])
    if lost.all():
        raise InputError(f"no row of the table has all of {join_words(needed)}")
    notes += _describe_lost(lost & ~blank, [name for name in needed if (empty[name] & ~blank).any()])
    # A copy, as in `prepare_rows`, is one block.
    return frame[~lost].copy().assign(**{ROW_NUMBER: frame.index[~lost]}), notes


def leave_out_gaps(frame: pd.DataFrame, used: Collection[str]) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """A table without the rows in which a column is empty that the response may follow, where they are few.

    Columns with the fewest empty cells come first. A column stays as it is where too many rows would be lost,
    with its empty cells, so that it is no candidate.
    """
    others = {str(name): cells for name, cells in frame.items() if name not in used and name != ROW_NUMBER}
    gaps = {name: _find_gaps(cells) for name, cells in others.items() if _may_matter(cells)}
    lost, filled = np.zeros(len(frame), dtype=bool), list[str]()
    notes = [*filter(None, (_describe_text(cells) for name, cells in others.items() if name not in gaps))]
    for name in sorted((name for name in gaps if gaps[name].any()), key=lambda name: int(gaps[name].sum())):
        own, together = int(np.count_nonzero(gaps[name])), int(np.count_nonzero(lost | gaps[name]))
        is_few = own <= MAX_SHARE_LOST * len(frame)
        if is_few and together <= MAX_SHARE_LOST_IN_ALL * len(frame):
            lost |= gaps[name]
            filled.append(name)
        else:
            why = f", and with those of other columns {together:,} rows would be lost" * is_few
            cells = pluralize(own, "cell")
            notes.append(f"The column {name} is left out: {cells} of {len(frame):,} are empty{why}.")
    infinite = any(others[name].dtype.kind == "f" and np.isinf(others[name]).any() for name in filled)
    state = "is empty or infinite" if infinite else "is empty"
    return frame[~lost], (*_describe_lost(lost, filled, frame.index, state), *notes)


def _describe_lost(
    lost: BoolArray, names: Sequence[str], places: pd.Index | None = None, state: str = "is empty"
) -> tuple[str, ...]:
    """Which rows are left out, and why."""
    if not lost.any():
        return ()
    rows = np.flatnonzero(lost) if places is None else places[lost].to_numpy()
    shown = [f"{row + 1}" for row in rows[:MAX_ROWS_NAMED].tolist()]
    listed = join_words(
        [*shown, *([f"{len(rows) - MAX_ROWS_NAMED:,} more"] if len(rows) > len(shown) else [])]
    )
    is_are, row = ("is", "row") if len(rows) == 1 else ("are", "rows")
    return (
        f"{len(rows):,} of {len(lost):,} rows {is_are} left out, where {join_words(names, 'or')} {state}: "
        f"{row} {listed}.",
    )


def _describe_text(cells: pd.Series) -> str:
    """That a column is of numbers but for a few cells, and so no candidate; "" where it is not."""
    if not (cells.dtype == object or isinstance(cells.dtype, pd.StringDtype)):
        return ""
    filled = cells[~_find_empty(cells, is_number=True)]
    wrong = pd.to_numeric(filled, errors="coerce").isna()
    if not 0 < wrong.mean() <= MAX_SHARE_LOST:
        return ""
    row, value = wrong.idxmax(), shorten(str(filled[wrong].iloc[0]))
    return f"The column {cells.name} is left out: {value!r} in row {row + 1} is no number."


def _find_gaps(cells: pd.Series) -> BoolArray:
    """Cells of a column that are empty, or no finite numbers."""
    if cells.dtype.kind == "f":
        return ~np.isfinite(cells.to_numpy(dtype=float, na_value=np.nan))
    return _find_empty(cells, pd.api.types.is_numeric_dtype(cells))


def _find_empty(cells: pd.Series, is_number: bool) -> BoolArray:
    empty = cells.isna().to_numpy().copy()
    if cells.dtype == object or isinstance(cells.dtype, pd.StringDtype):
        is_empty = is_empty_number if is_number else _is_blank
        empty |= np.array([is_empty(cell) for cell in cells], dtype=bool)
    return empty


def _is_blank(cell: object) -> bool:
    return isinstance(cell, str) and not cell.strip()


def _may_matter(cells: pd.Series) -> bool:
    """Whether the response could be seen to follow a column, were its empty cells left out."""
    if pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells):
        return cells.nunique() > 1
    return explain_unusable_levels(cells.dropna()) is None


def _without_overflow(frame: pd.DataFrame) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Marks of an overflow as empty cells."""
    notes: tuple[str, ...] = ()
    for name in [name for name in frame if frame[name].dtype.kind == "f"]:
        size = frame[name].abs()
        marked = (size >= OVERFLOW) & np.isfinite(size)
        if marked.any() and size[~marked].max() < OVERFLOW / 1e6:
            value = frame.loc[marked, name].iloc[0]
            notes += (f"{value:g} in {name} is how instruments mark an overflow, and counts as empty.",)
            frame = frame.assign(**{name: frame[name].mask(marked)})
    return frame, notes


def _without_nines(frame: pd.DataFrame) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Numbers of nines, such as -999, that are farther from all others than those are from each other."""
    notes: tuple[str, ...] = ()
    for name in [name for name in frame if frame[name].dtype.kind in "fiu"]:
        cells = frame[name].to_numpy(float, na_value=np.nan)
        ends = np.array([np.nanmin(cells), np.nanmax(cells)]) if np.isfinite(cells).any() else np.zeros(0)
        for mark in dict.fromkeys(ends.tolist()):
            marked = cells == mark
            others = cells[np.isfinite(cells) & ~marked]
            least = MIN_NINES - 1 if np.count_nonzero(marked) > 1 else MIN_NINES
            if _count_nines(mark) < least or not len(np.unique(others)) > 2:
                continue
            if np.abs(others - mark).min() > np.ptp(others):
                count = pluralize(int(np.count_nonzero(marked)), "cell")
                notes += (
                    f"{mark:.15g} in {name}, {count} far from all others, is how files mark what was not "
                    "measured, and counts as empty: check that none of them was measured.",
                )
                cells = np.where(marked, np.nan, cells)
                frame = frame.assign(**{name: cells})
    return frame, notes


def _count_nines(value: float) -> int:
    """How many nines a number consists of, whatever its sign and point; 0 where it has another digit.

    Examples
    --------
    >>> _count_nines(-999.0), _count_nines(99.9), _count_nines(909.0)
    (3, 3, 0)
    """
    digits = f"{abs(value):.15g}".replace(".", "")
    return len(digits) if set(digits) == {"9"} else 0
