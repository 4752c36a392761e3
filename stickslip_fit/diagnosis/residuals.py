"""Residuals binned by covariate, before and after the diagnosis, with a bootstrap envelope.

The envelope contains the bin means of noise alone in 95 of 100 logs: signs flipped at random,
recalibrated, and binned in the same way. `find_carrier` chooses the covariate that explains an effect
best.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.hypotheses import AR1
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.misfit import MAX_LEVERAGE
from stickslip_fit.diagnosis.selection import SelectedCause, Selection

N_BOOTSTRAP = 200
ENVELOPE_COVERAGE = 0.95
MAX_BINS, ROWS_PER_BIN = 12, 12  # classes; rows that each should have
MIN_RELATIVE_SHARE = 0.85  # of the share that the best column explains; the first that has it is taken
ERROR_TOL = 1e-12


@dataclass(frozen=True, eq=False)
class BinnedResiduals:
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
class ResidualComparison:
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
    null_before: Array
    null_after: Array


def compare_residuals(selection: Selection, seed: int) -> ResidualComparison:
    """The residuals of a search, before and after, and what noise alone would have left.

    Parameters
    ----------
    searched : Search
    seed : int
    """
    first, last = selection.problem.study(), selection.study
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (len(last), N_BOOTSTRAP))
    noise = last.residual - sum(compute_shape(each, last) for each in selection.found if each.version is None)
    raw = (noise / np.sqrt(1.0 - np.minimum(last.leverage, MAX_LEVERAGE)))[:, None]
    return ResidualComparison(
        selection.problem.rows,
        first.residual * first.scale,
        last.residual * last.scale,
        first.project(signs * raw) * first.scale[:, None],
        last.project(signs * raw) * last.scale[:, None],
    )


def compute_shape(found: SelectedCause, linearized: LinearizedFit) -> Array:
    """What was found makes of a study's residuals, shape (n,); zeros for what has no shape."""
    if found.misfit is None:
        return np.zeros(len(linearized))
    best = found.misfit.best_hypothesis(found.cause)
    if isinstance(best, AR1):
        return best.shape(linearized.residual)
    return best.combine(best.along(linearized.residual))


def bin_values(values: Array) -> IntArray:
    """The class of each value: values that come again and again are classes of their own, shape (n,).

    Values that are not known (NaN) are in class -1.
    """
    known = np.isfinite(values)
    found = np.full(len(values), -1)
    if not known.any():
        return found
    single, place = np.unique(values[known].round(9), return_inverse=True)
    if len(single) > MAX_BINS:
        place = np.searchsorted(_bin_edges(single, place), single)[place]
    found[known] = place
    return found


def _bin_edges(single: Array, place: IntArray) -> Array:
    """Where to cut many values into classes of about as many rows: in the widest gap about there."""
    below = np.cumsum(np.bincount(place))[:-1]
    number = int(np.clip(len(place) // ROWS_PER_BIN, 2, MAX_BINS))
    size, gaps = len(place) / number, np.diff(single)
    cuts = set()
    for edge in range(1, number):
        near = np.flatnonzero(np.abs(below - edge * size) <= size / 2)
        if len(near):
            cuts.add(int(near[np.argmax(gaps[near])]))
    return np.array([single[cut] + gaps[cut] / 2 for cut in sorted(cuts)])


def bin_residuals(
    residual: Array, chance: Array, values: Array, place: IntArray, subset: npt.NDArray[np.bool_]
) -> BinnedResiduals:
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
    kept = subset & (place >= 0)
    kinds, where = np.unique(place[kept], return_inverse=True)
    number = np.bincount(where, minlength=len(kinds))
    share = (np.arange(len(kinds))[:, None] == where) / number[:, None]
    by_chance = share @ chance[kept]
    error = np.sqrt(np.mean(by_chance**2, axis=1))
    farthest = np.max(np.abs(by_chance) / np.maximum(error, ERROR_TOL)[:, None], axis=0, initial=0.0)
    envelope = error * np.quantile(farthest, ENVELOPE_COVERAGE)
    return BinnedResiduals(share @ values[kept], share @ residual[kept], error, envelope)


def find_carrier(shape: Array, columns: Mapping[str, Array], groups: IntArray) -> str:
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
    shares = {name: explained_share(shape, values, groups) for name, values in columns.items()}
    best = max(shares.values())
    return next(name for name, share in shares.items() if share >= MIN_RELATIVE_SHARE * best)


def explained_share(shape: Array, values: Array, groups: IntArray) -> float:
    """Share of a shape's square that classes of a column explain, for as many classes as it takes."""
    cells = pd.Series(shape).groupby([groups, bin_values(values)])
    means, number = cells.transform("mean").to_numpy(), cells.ngroups
    total = float(shape @ shape)
    if total == 0.0 or number >= len(shape):
        return 0.0
    left = float(np.sum((shape - means) ** 2)) / total
    return max(1.0 - left * len(shape) / (len(shape) - number), 0.0)
