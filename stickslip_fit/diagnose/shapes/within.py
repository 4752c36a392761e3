"""Shapes that are nothing outside one session, or that each session has by itself.

Recalibration works session by session, so that they are made there, and take no more room than they fill.
What all sessions share is taken out of their lengths, but for what that does across sessions: little, where
there are many, and nothing, where there is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csc_array

from stickslip_fit.diagnose.laid_out.study import Part, Study, places_of
from stickslip_fit.diagnose.shapes.hypothesis import NEGLIGIBLE, NOTHING, Hypothesis

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

SPARSE = 0.1  # share of numbers that are not 0; above, arithmetic is faster with all of them


@dataclass(frozen=True, eq=False)
class Session:
    """One session of a study, s rows.

    Attributes
    ----------
    rows : array of int, shape (s,)
    parts : tuple of Part
        With rows that are places in the session.
    tables : tuple of dict of str to array
        Columns of each part's rows.
    blocks : tuple of (array of int, shape (m,), array, shape (m, p))
        Places in the session, and what recalibration can do there.
    together : array, shape (s, k)
        What all sessions can only do together.
    """

    rows: Indices
    parts: tuple[Part, ...]
    tables: tuple[dict[str, npt.NDArray[Any]], ...]
    blocks: tuple[tuple[Indices, Array], ...]
    together: Array

    def __len__(self) -> int:
        return len(self.rows)

    def project(self, columns: Array) -> Array:
        """Take out what the session's own recalibration would absorb, shape (s, m)."""
        left = columns.copy()
        for mine, basis in self.blocks:
            left[mine] -= basis @ (basis.T @ columns[mine])
        return left


def sessions(study: Study) -> dict[str, Session]:
    """The sessions of a study by name; each has its own blocks."""
    number, names = pd.factorize(study.rows["session"].astype(object))
    place, rows = np.empty(len(study), dtype=np.intp), places_of(number)
    for mine in rows:
        place[mine] = np.arange(len(mine))
    blocks: list[list[tuple[Indices, Array]]] = [[] for _ in names]
    for mine, basis in study.blocks:
        blocks[number[mine[0]]].append((place[mine], basis))
    parts: list[list[tuple[Part, dict[str, npt.NDArray[Any]]]]] = [[] for _ in names]
    for part, table in zip(study.parts, study.tables, strict=True):
        for mine in places_of(number[part.rows]):
            at = part.rows[mine]
            own = replace(part, rows=place[at], block=part.block[mine], values=part.values[mine])
            parts[number[at[0]]].append((own, {name: values[mine] for name, values in table.items()}))
    return {
        str(name): Session(
            mine,
            tuple(part for part, _ in parts[k]),
            tuple(table for _, table in parts[k]),
            tuple(blocks[k]),
            study.together[mine],
        )
        for k, (name, mine) in enumerate(zip(names, rows, strict=True))
    }


def of_one(
    cause: str, version: Any, values: Array, n: int, session: Session, effects: Array
) -> list[Hypothesis]:
    """A hypothesis of each column, shape (s, m): effects in units of the noise, recalibration taken out."""
    squares = np.sum(effects**2, axis=0) - np.sum((session.together.T @ effects) ** 2, axis=0)
    lengths = np.sqrt(np.maximum(squares, NOTHING**2))
    directions = effects / lengths
    if few := len(session) > SPARSE * n:
        everywhere = np.zeros((n, effects.shape[1]))
        everywhere[session.rows] = directions

    def stored(k: int) -> Array | csc_array:
        if few:
            return everywhere[:, k : k + 1]
        return csc_array((directions[:, k], session.rows, [0, len(session)]), shape=(n, 1))

    shown = np.flatnonzero(lengths > NOTHING)
    return [
        Hypothesis(cause, version, values[k], stored(int(k)), np.ones(1), float(lengths[k])) for k in shown
    ]


def of_each(names: Sequence[str], n: int, every: Sequence[Session], effects: Array) -> list[Hypothesis]:
    """A hypothesis of each name, whose effects every session has in sizes of its own.

    Parameters
    ----------
    names : sequence of str
    n : int
        Rows of the study.
    every : sequence of Session
    effects : array, shape (n, number of names, w)
        In units of the noise; each session's rows are its own effects.
    """
    width = effects.shape[2]
    directions, variances = np.zeros_like(effects), []
    for session in every:
        flat = effects[session.rows].reshape(len(session.rows), -1)
        own = session.project(flat).reshape(len(session.rows), len(names), width).transpose(1, 0, 2)
        shared = np.einsum("sk,psw->pkw", session.together, own)
        products = own.transpose(0, 2, 1) @ own - shared.transpose(0, 2, 1) @ shared
        variance, right = np.linalg.eigh(products)
        length = np.sqrt(np.maximum(variance, NOTHING**2))[:, None, :]
        directions[session.rows] = (own @ (right / length)).transpose(1, 0, 2)
        variances.append(np.maximum(variance, 0.0))
    order = np.concatenate([session.rows for session in every])
    ends = np.cumsum([0, *(len(session.rows) for session in every)])
    starts = (n * np.arange(width)[:, None] + ends[:-1]).ravel()
    found = []
    for k, name in enumerate(names):
        variance = np.stack([each[k] for each in variances], axis=1).ravel()
        if (total := float(variance.sum())) < NOTHING**2:
            continue
        filled = directions[order, k].T.ravel()
        columns = csc_array((filled, np.tile(order, width), [*starts, n * width]), shape=(n, len(starts)))
        kept = variance > NEGLIGIBLE * total
        columns = columns if kept.all() else csc_array(columns[:, np.flatnonzero(kept)])
        few = columns.nnz > SPARSE * n * columns.shape[1]
        found.append(
            Hypothesis(
                name, None, None, columns.toarray() if few else columns, variance[kept] / total, total**0.5
            )
        )
    return found
