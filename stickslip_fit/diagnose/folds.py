"""Which traverses are held out together, and from which the law is then fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.study import Part, Study

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

FOLDS = 10
# What the rest of a session leaves open by more than this share counts as not known without a configuration:
# a prediction would be off by 1 / sqrt(1 - share), here four and a half times, what a traverse repeats to.
OPEN = 0.95
KNOWN = 5.0  # strength below which the search would more often than not miss a cause in what is left


@dataclass(frozen=True, eq=False)
class Split:
    """Rows of a log by what they are used for.

    Attributes
    ----------
    training : array of int
        By which causes are chosen and sized.
    calibrating : array of int
        By which the laws' own parameters are fitted.
    held : array of int
        That are predicted.
    """

    training: Indices
    calibrating: Indices
    held: Indices


def folds(
    study: Study, kinds: Indices, rng: np.random.Generator, effects: Array | None = None, number: int = FOLDS
) -> list[Split]:
    """Hold out every configuration once, but for those without which a parameter cannot be known.

    Parameters
    ----------
    study : Study
        Of the baseline; n rows.
    kinds : array of int, shape (n,)
        Configuration of each row; all of its rows are held out together.
    rng : Generator
    effects : array, shape (n, k), optional
        Of the causes found, in units of the noise, recalibration taken out: they, too, have to stay known.
    number : int, optional
        Of folds; those in which nothing can be held out are left out.
    """
    block, place = blocks_of(study.parts, len(study)), _coordinates(study)
    width = place.shape[1]
    taken = np.zeros((number, block.max() + 1, width, width))
    shown = np.zeros((len(study), 0)) if effects is None else effects**2
    left = np.tile(shown.sum(axis=0), (number, 1))
    least = np.minimum(KNOWN**2, left[0] / 2)
    fold_of, filled = np.full(len(study), -1), np.zeros(number, dtype=np.intp)
    members = _members(kinds)
    for kind in rng.permutation(len(members)):
        rows = members[kind]
        touched, own = np.unique(block[rows], return_inverse=True)
        share = np.zeros((len(touched), width, width))
        np.add.at(share, own, place[rows, :, None] * place[rows, None, :])
        for fold in np.argsort(filled, kind="stable"):
            together, rest = taken[fold, touched] + share, left[fold] - shown[rows].sum(axis=0)
            if np.linalg.eigvalsh(together).max() < OPEN and np.all(rest >= least):
                taken[fold, touched], left[fold] = together, rest
                fold_of[rows], filled[fold] = fold, filled[fold] + len(rows)
                break
    return [_without(np.flatnonzero(fold_of == fold), len(study)) for fold in range(number) if filled[fold]]


def blocks_of(parts: Sequence[Part], n: int) -> Indices:
    """Which set of own parameters each row uses, over all parts, shape (n,)."""
    found, first = np.zeros(n, dtype=np.intp), 0
    for part in parts:
        found[part.rows] = first + part.block
        first += int(part.block.max(initial=-1)) + 1
    return found


def _without(held: Indices, n: int) -> Split:
    rest = np.setdiff1d(np.arange(n), held)
    return Split(rest, rest, held)


def _members(kinds: Indices) -> list[Indices]:
    order = np.argsort(kinds, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(kinds[order])) + 1)


def _coordinates(study: Study) -> Array:
    """Each row's entries in its own block's columns of the basis, shape (n, most columns of a block)."""
    block, entries = blocks_of(study.parts, len(study)), study.basis.tocoo()
    first = np.full(block.max() + 1, study.basis.shape[1])
    np.minimum.at(first, block[entries.row], entries.col)
    column = entries.col - first[block[entries.row]]
    place = np.zeros((len(study), int(column.max(initial=0)) + 1))
    place[entries.row, column] = entries.data
    return place
