"""Residuals binned by covariate, before and after the diagnosis, with a bootstrap envelope.

The envelope contains the bin means of noise alone in 95 of 100 logs: signs flipped at random,
recalibrated, and binned in the same way. `find_carrier` chooses the covariate that explains an effect
best.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.extension import SelectedCause
from stickslip_fit.diagnosis.hypotheses import compute_changes
from stickslip_fit.diagnosis.linearized import MAX_LEVERAGE, LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.laws import expected_steps
from stickslip_fit.logs import Log

N_BOOTSTRAP = 200
ENVELOPE_COVERAGE = 0.95
MAX_BINS, ROWS_PER_BIN, FEW_BINS = 12, 12, 6
MIN_RELATIVE_SHARE = 0.85  # of the share that the best column explains; the first above it is taken
ERROR_TOL = 1e-12


@dataclass(frozen=True, eq=False)
class BinnedResiduals:
    """Residuals in K bins of one variable.

    Attributes
    ----------
    centre : array, shape (K,)
        Mean of the variable in each bin.
    mean, error : array, shape (K,)
        Of the residuals, relative; the bootstrap standard error of the mean.
    envelope : array, shape (K,)
        Half-width of the simultaneous 95 % band of noise alone.
    """

    centre: Array
    mean: Array
    error: Array
    envelope: Array


@dataclass(frozen=True, eq=False)
class ResidualComparison:
    """Relative residuals before and after the diagnosis, with bootstrap samples.

    Attributes
    ----------
    rows : DataFrame
        n rows, without outlying counts.
    before, after : array, shape (n,)
        Under the published law, and under the extended law.
    null_before, null_after : array, shape (n, N_BOOTSTRAP)
        Of noise alone.
    """

    rows: pd.DataFrame
    before: Array
    after: Array
    null_before: Array
    null_after: Array


def compare_residuals(selection: Selection, seed: int) -> ResidualComparison:
    """The residuals of a selection before and after, and those of noise alone."""
    first, last = selection.problem.linearize(), selection.linearized
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (len(last), N_BOOTSTRAP))
    unknown = sum(compute_shape(one, last) for one in selection.selected if one.version is None)
    raw = ((last.residual - unknown) / np.sqrt(1.0 - np.minimum(last.leverage, MAX_LEVERAGE)))[:, None]
    return ResidualComparison(
        selection.problem.rows,
        first.unwhiten(first.residual),
        last.unwhiten(last.residual),
        first.unwhiten(first.project(signs * raw)),
        last.unwhiten(last.project(signs * raw)),
    )


def compute_shape(selected: SelectedCause, linearized: LinearizedFit) -> Array:
    """The part of the residuals that a selected cause explains, shape (n,); zeros for outlying counts."""
    if selected.misfit is None:
        return np.zeros(len(linearized))
    best = selected.misfit.best_hypothesis(selected.cause)
    if isinstance(best, AR1):
        return best.shape(linearized.residual)
    return best.explain(linearized.residual)


def term_change(selection: Selection, version: Any) -> Array:
    """What a fitted cause or proposed term does to the logarithm of each count, shape (n,)."""
    values = selection.fit.values[selection.place_of(version)][None]
    return compute_changes(selection.problem.linearize(), version, values)[:, 0]


def fitted_effect(selection: Selection, version: Any) -> Array:
    """The same beyond what calibration absorbs, shape (n,)."""
    linearized, change = selection.problem.linearize(), term_change(selection, version)[:, None]
    return linearized.unwhiten(linearized.project(linearized.whiten(change))[:, 0])


def remove_effects(log: Log, selection: Selection, causes: Collection[str]) -> Log:
    """The log with counts as they would be without some of the causes of a selection.

    Outlying counts are excluded.
    """
    usable, outlying = log.rows.index[log.rows["status"] == "ok"], selection.outliers
    kept, steps = np.delete(usable, outlying), log.rows["steps"].astype(float)
    changes = [term_change(selection, one.version) for one in selection.law_causes if one.cause in causes]
    change = sum(changes, np.zeros(len(kept)))
    expected = expected_steps(steps[kept], log.rows.loc[kept, "check_every"])
    steps[kept] += np.asarray(expected) * np.expm1(-change)
    corrected = log.exclude(usable[outlying])
    return replace(corrected, rows=corrected.rows.assign(steps=steps))


def finding_shape(selection: Selection, selected: SelectedCause) -> Array:
    """What carries a finding, shape (n,): the structure that selected it, whitened.

    Of a proposed term or smooth function its relative effect, beyond what calibration absorbs.
    """
    linearized = selection.problem.linearize()
    if selected.cause != UNKNOWN or selected.version is None:
        return compute_shape(selected, linearized)
    return fitted_effect(selection, selected.version)


def bin_values(values: Array) -> IntArray:
    """The bin of each value, shape (n,); up to `MAX_BINS` distinct values have their own, NaN has -1."""
    known = np.isfinite(values)
    bins = np.full(len(values), -1)
    if not known.any():
        return bins
    distinct, place = np.unique(values[known].round(9), return_inverse=True)
    if len(distinct) > MAX_BINS:
        place = np.searchsorted(_bin_edges(distinct, place), distinct)[place]
    bins[known] = place
    return bins


def _bin_edges(distinct: Array, place: IntArray) -> Array:
    """Edges of bins with about as many rows each, in the widest gap near each quantile."""
    below = np.cumsum(np.bincount(place))[:-1]
    number = int(np.clip(len(place) // ROWS_PER_BIN, np.clip(len(place) // 5, 2, FEW_BINS), MAX_BINS))
    size, gaps = len(place) / number, np.diff(distinct)
    cuts = set()
    for edge in range(1, number):
        near = np.flatnonzero(np.abs(below - edge * size) <= size / 2)
        if len(near):
            cuts.add(int(near[np.argmax(gaps[near])]))
    return np.array([distinct[cut] + gaps[cut] / 2 for cut in sorted(cuts)])


def bin_residuals(
    residual: Array, null: Array, values: Array, bins: IntArray, subset: BoolArray
) -> BinnedResiduals:
    """Means by bin of the residuals of a subset of rows.

    `null`, shape (n, number of samples), are residuals of noise alone; `bins` are those of `bin_values`.
    """
    kept = subset & (bins >= 0)
    labels, place = np.unique(bins[kept], return_inverse=True)
    averaging = (np.arange(len(labels))[:, None] == place) / np.bincount(place)[:, None]
    null_means = averaging @ null[kept]
    error = np.sqrt(np.mean(null_means**2, axis=1))
    maxima = np.max(np.abs(null_means) / np.maximum(error, ERROR_TOL)[:, None], axis=0, initial=0.0)
    envelope = error * np.quantile(maxima, ENVELOPE_COVERAGE)
    return BinnedResiduals(averaging @ values[kept], averaging @ residual[kept], error, envelope)


def find_carrier(shape: Array, columns: Mapping[str, Array], groups: IntArray) -> str:
    """The column that explains a shape: the first with nearly the largest share of its square.

    `columns` are in order of preference; rows of different `groups` may depend on them differently.
    """
    shares = {name: explained_share(shape, values, groups) for name, values in columns.items()}
    best = max(shares.values())
    return next(name for name, share in shares.items() if share >= MIN_RELATIVE_SHARE * best)


def explained_share(shape: Array, values: Array, groups: IntArray) -> float:
    """Share of a shape's square that bins of a column explain, adjusted for their number."""
    cells = pd.Series(shape).groupby([groups, bin_values(values)])
    means, number = cells.transform("mean").to_numpy(), cells.ngroups
    total = float(shape @ shape)
    if total == 0.0 or number >= len(shape):
        return 0.0
    left = float(np.sum((shape - means) ** 2)) / total
    return max(1.0 - left * len(shape) / (len(shape) - number), 0.0)
