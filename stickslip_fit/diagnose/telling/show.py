"""What a law leaves over, against whatever varied: structure here is what the law lacks.

Residuals are those of a study: whatever recalibration could have absorbed is taken out. The envelope is what
noise alone gives: signs flipped at random, recalibrated, put into the same classes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.searching.misfit import LARGEST_LEVERAGE
from stickslip_fit.diagnose.searching.search import Found, Search
from stickslip_fit.diagnose.shapes.memory import Memory

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

FLIPS = 200
INSIDE = 0.95
MOST_CLASSES, A_CLASS = 12, 12  # classes; rows that each should have
AS_GOOD = 0.85  # of the share that the best column explains; the first that has it is taken
NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Classes:
    """Residuals by classes of one quantity; K classes.

    Attributes
    ----------
    place : array, shape (K,)
        Mean of the quantity in each.
    mean, error : array, shape (K,)
        Of the residuals, relative; the error is one standard error by the envelope's noise.
    envelope : array, shape (K,)
        All K means of noise alone lie within plus and minus this in 95 of 100 logs.
    """

    place: Array
    mean: Array
    error: Array
    envelope: Array


@dataclass(frozen=True, eq=False)
class Shown:
    """What is left of a log's counts; all relative.

    Attributes
    ----------
    rows : DataFrame
        n rows; those that misfired are not among them.
    before, after : array, shape (n,)
        Under the published law, and with all that was found in it.
    chance_before, chance_after : array, shape (n, flips)
        What noise alone would have left.
    """

    rows: pd.DataFrame
    before: Array
    after: Array
    chance_before: Array
    chance_after: Array


def shown(searched: Search, seed: int) -> Shown:
    """The residuals of a search, before and after, and what noise alone would have left.

    Parameters
    ----------
    searched : Search
    seed : int
    """
    first, last = searched.bench.study(), searched.study
    flips = np.random.default_rng(seed).choice([-1.0, 1.0], (len(last), FLIPS))
    noise = last.residual - sum(shape_of(each, last) for each in searched.found if each.version is None)
    raw = (noise / np.sqrt(1.0 - np.minimum(last.leverage, LARGEST_LEVERAGE)))[:, None]
    return Shown(
        searched.bench.rows,
        first.residual * first.scale,
        last.residual * last.scale,
        first.project(flips * raw) * first.scale[:, None],
        last.project(flips * raw) * last.scale[:, None],
    )


def shape_of(found: Found, study: Study) -> Array:
    """What was found makes of a study's residuals, shape (n,); zeros for what has no shape."""
    if found.misfit is None:
        return np.zeros(len(study))
    best = found.misfit.best_of(found.cause)
    if isinstance(best, Memory):
        return best.shape(study.residual)
    return best.sum_of(best.along(study.residual))


def classes_of(values: Array) -> Indices:
    """The class of each value: values that come again and again are classes of their own, shape (n,).

    Values that are not known (NaN) are in class -1.
    """
    known = np.isfinite(values)
    found = np.full(len(values), -1)
    if not known.any():
        return found
    single, place = np.unique(values[known].round(9), return_inverse=True)
    if len(single) > MOST_CLASSES:
        place = np.searchsorted(_edges(single, place), single)[place]
    found[known] = place
    return found


def _edges(single: Array, place: Indices) -> Array:
    """Where to cut many values into classes of about as many rows: in the widest gap about there."""
    below = np.cumsum(np.bincount(place))[:-1]
    number = int(np.clip(len(place) // A_CLASS, 2, MOST_CLASSES))
    size, gaps = len(place) / number, np.diff(single)
    cuts = set()
    for edge in range(1, number):
        near = np.flatnonzero(np.abs(below - edge * size) <= size / 2)
        if len(near):
            cuts.add(int(near[np.argmax(gaps[near])]))
    return np.array([single[cut] + gaps[cut] / 2 for cut in sorted(cuts)])


def by_class(
    residual: Array, chance: Array, values: Array, place: Indices, mine: npt.NDArray[np.bool_]
) -> Classes:
    """Means of some rows' residuals by class.

    Parameters
    ----------
    residual : array, shape (n,)
    chance : array, shape (n, flips)
        Residuals of noise alone.
    values : array, shape (n,)
    place : array of int, shape (n,)
        As of `classes_of`.
    mine : array of bool, shape (n,)
        Which rows.
    """
    kept = mine & (place >= 0)
    kinds, where = np.unique(place[kept], return_inverse=True)
    number = np.bincount(where, minlength=len(kinds))
    share = (np.arange(len(kinds))[:, None] == where) / number[:, None]
    by_chance = share @ chance[kept]
    error = np.sqrt(np.mean(by_chance**2, axis=1))
    farthest = np.max(np.abs(by_chance) / np.maximum(error, NOTHING)[:, None], axis=0, initial=0.0)
    envelope = error * np.quantile(farthest, INSIDE)
    return Classes(share @ values[kept], share @ residual[kept], error, envelope)


def carrier(shape: Array, columns: Mapping[str, Array], groups: Indices) -> str:
    """The column along which a shape runs: the first one that explains nearly as much of it as any.

    Parameters
    ----------
    shape : array, shape (n,)
        Any effect, recalibration taken out.
    columns : mapping of str to array, shape (n,)
        In order of preference.
    groups : array of int, shape (n,)
        Rows in which it may run differently.
    """
    shares = {name: explained(shape, values, groups) for name, values in columns.items()}
    best = max(shares.values())
    return next(name for name, share in shares.items() if share >= AS_GOOD * best)


def explained(shape: Array, values: Array, groups: Indices) -> float:
    """Share of a shape's square that classes of a column explain, for as many classes as it takes."""
    cells = pd.Series(shape).groupby([groups, classes_of(values)])
    means, number = cells.transform("mean").to_numpy(), cells.ngroups
    total = float(shape @ shape)
    if total == 0.0 or number >= len(shape):
        return 0.0
    left = float(np.sum((shape - means) ** 2)) / total
    return max(1.0 - left * len(shape) / (len(shape) - number), 0.0)
