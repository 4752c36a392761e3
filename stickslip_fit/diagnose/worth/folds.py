"""Which traverses are held out together, and from which the law is then fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.laid_out.study import Part, Study, places_of

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
    n = len(study)
    block, place = blocks_of(study.parts, n), _coordinates(study)
    shown = np.zeros((n, 0)) if effects is None else effects
    taken = [_Taken.nothing(int(block.max()) + 1, place.shape[1], shown) for _ in range(number)]
    fold_of, filled = np.full(n, -1), np.zeros(number, dtype=np.intp)
    members = places_of(kinds)
    for kind in rng.permutation(len(members)):
        rows = members[kind]
        for fold in np.argsort(filled, kind="stable"):
            if taken[fold].takes(block[rows], place[rows], shown[rows]):
                fold_of[rows], filled[fold] = fold, filled[fold] + len(rows)
                break
    return [_without(np.flatnonzero(fold_of == fold), n) for fold in range(number) if filled[fold]]


@dataclass(frozen=True, eq=False)
class _Taken:
    """What a fold's rows know of B blocks with up to w parameters, and of k causes.

    Attributes
    ----------
    own : array, shape (B, w, w)
        Products of the rows' coordinates.
    across : array, shape (B, w, k)
        Of the rows' coordinates and the causes' effects.
    effect : array, shape (B, k)
        Squared effects.
    left : array, shape (k,)
        Squared strength of each cause in the rest of the log, recalibrated by that rest.
    least : array, shape (k,)
    """

    own: Array
    across: Array
    effect: Array
    left: Array
    least: Array

    @classmethod
    def nothing(cls, blocks: int, width: int, effects: Array) -> _Taken:
        """No row yet."""
        k, whole = effects.shape[1], np.sum(effects**2, axis=0)
        empty = np.zeros((blocks, width, width)), np.zeros((blocks, width, k)), np.zeros((blocks, k))
        return cls(*empty, whole, np.minimum(KNOWN**2, whole / 2))

    def takes(self, block: Indices, place: Array, effect: Array) -> bool:
        """Hold these rows out, too, if every parameter stays known."""
        touched, at = np.unique(block, return_inverse=True)
        own, across, alone = self.own[touched], self.across[touched], self.effect[touched]
        before = _lost(own, across, alone)
        np.add.at(own, at, place[:, :, None] * place[:, None, :])
        np.add.at(across, at, place[:, :, None] * effect[:, None, :])
        np.add.at(alone, at, effect**2)
        if np.linalg.eigvalsh(own).max() >= OPEN:
            return False
        left = self.left + before - _lost(own, across, alone)
        if np.any(left < self.least):
            return False
        self.own[touched], self.across[touched], self.effect[touched] = own, across, alone
        self.left[:] = left
        return True


def _lost(own: Array, across: Array, alone: Array) -> Array:
    """Squared strength that goes with the rows held out, and with what the rest then absorbs; shape (k,)."""
    solved = np.linalg.solve(np.eye(own.shape[1]) - own, across)
    return np.sum(alone + np.sum(across * solved, axis=1), axis=0)


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


def _coordinates(study: Study) -> Array:
    """Each row's entries in its own block's columns of the basis, shape (n, most columns of a block)."""
    block, entries = blocks_of(study.parts, len(study)), study.basis.tocoo()
    first = np.full(block.max() + 1, study.basis.shape[1])
    np.minimum.at(first, block[entries.row], entries.col)
    column = entries.col - first[block[entries.row]]
    place = np.zeros((len(study), int(column.max(initial=0)) + 1))
    place[entries.row, column] = entries.data
    return place
