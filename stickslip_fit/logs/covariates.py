"""The lab's own columns: numbers become covariates, text is kept."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow as pa

from stickslip_fit.logs.cells import Cells, place_of
from stickslip_fit.logs.columns import COVARIATE
from stickslip_fit.logs.parse import parse_numbers, text_of


def read_covariates(files: list[Cells]) -> tuple[dict[str, pd.Series], tuple[str, ...]]:
    """Read the columns that the format doesn't know, over all files.

    A column is numeric if every cell that isn't empty holds a finite number, in whichever file.

    Returns
    -------
    columns : dict of str to Series
        ``covariate:<column>`` (NaN where empty) and ``text:<column>``.
    notes : tuple of str
        Columns that are text because of a few cells.
    """
    columns: dict[str, pd.Series] = {}
    notes: list[str] = []
    for name in dict.fromkeys(name for cells in files for name in cells.layout.others):
        parts = [_cells(cells, name) for cells in files]
        numbers = [parse_numbers(part) for part in parts]
        empty = np.concatenate([part.empty for part in numbers])
        bad = np.concatenate([part.bad for part in numbers])
        if not bad.any() and not empty.all():
            columns[COVARIATE + name] = pd.Series(
                np.concatenate([part.values for part in numbers]), copy=False
            )
            continue
        text = pa.concat_arrays([_text(cells, name) for cells in files]).to_pandas()
        columns[f"text:{name}"] = text
        if 0 < 2 * bad.sum() < len(empty) - empty.sum():
            first = int(np.argmax(bad))
            count = f"{bad.sum():,} of {len(bad):,} cells {'is' if bad.sum() == 1 else 'are'} no number"
            example = f"{text.iloc[first]!r} in {place_of(files, first)}"
            notes.append(f"column {name}: {count} ({example}), so the column is kept as text")
    return columns, tuple(notes)


def _text(cells: Cells, name: str) -> pa.Array:
    return cells.table.text(name) if name in cells.layout.others else text_of(_cells(cells, name))


def _cells(cells: Cells, name: str) -> pa.Array:
    if name in cells.layout.others:
        return cells.table.column(name)
    return pa.nulls(cells.table.count, pa.large_string())
