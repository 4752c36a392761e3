"""The difference of two groups of sessions, for many quantities together.

Each quantity has an estimate in every session. These scatter about the mean of their group by what changes
from day to day and by the scatter of a day's traverses. The means are compared by Student's t with the
variance between sessions within the groups, so that the scatter from day to day is in it, whatever its size.
Two things are known beside that variance, which has few degrees of freedom:

- It is no smaller than the scatter of a day's traverses makes it.
- Quantities of one kind, such as the step sizes of all joints and directions, have similar scatter: their
  variances are shrunk towards each other by empirical Bayes (G. Smyth, Stat. Appl. Genet. Mol. Biol. 3:3,
  2004). As drives may differ more than that supposes, the others count at most as much as the own sessions.

The p-values are adjusted over all quantities by Holm's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, stdtr, stdtrit

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.anova.contrasts import adjust_holm
from stickslip_fit.strategies.statistics import MIN_VARIANCES, shrink_variances

MAX_SHARE_OF_OTHERS = 1.0  # degrees of freedom that the others add, at most, relative to the own ones
POWER = 0.8  # with which the least detectable difference is detected


@dataclass(frozen=True, eq=False)
class SessionEstimates:
    """A quantity's estimates in the sessions that determine it.

    Attributes
    ----------
    kind : str
        Quantities of one kind have similar scatter from session to session, once it is divided by `scale`.
    values : array, shape (n,)
    variances : array, shape (n,)
        Of each by the residual scatter; NaN where that is not known.
    is_new : array of bool, shape (n,)
        Which of the two groups a session belongs to.
    scale : float
        Of a standard deviation.
    """

    kind: str
    values: Array
    variances: Array
    is_new: BoolArray
    scale: float

    @property
    def counts(self) -> tuple[int, int]:
        """Sessions in the old and in the new group."""
        return int(np.sum(~self.is_new)), int(np.sum(self.is_new))

    @property
    def df(self) -> int:
        """Degrees of freedom of the variance between sessions; 0 with one session in each group."""
        return max(len(self.values) - 2, 0)


@dataclass(frozen=True)
class Difference:
    """New less old, of the means of the sessions.

    Attributes
    ----------
    standard_error : float
        Scatter from day to day included; that of a day's traverses alone where `df` is 0.
    df : float
        Degrees of freedom of `standard_error`; 0 where nothing is known of the scatter from day to day.
    low, high : float
        Holds the true difference, together with those of all other quantities, with probability 1 - alpha;
        NaN where `df` is 0.
    p_value, p_adjusted : float
        Of no difference, for it alone and for all quantities together; NaN where `df` is 0.
    detectable : float
        The least difference that would be detected with a probability of `POWER`; NaN where `df` is 0.
    p_within_days : float
        Of no difference if days did not differ, adjusted as `p_adjusted`; NaN where the residual scatter is
        not known.
    """

    old: float
    new: float
    estimate: float
    standard_error: float
    df: float
    low: float
    high: float
    p_value: float
    p_adjusted: float
    detectable: float
    p_within_days: float


def compare_means(estimates: Sequence[SessionEstimates], alpha: float) -> list[Difference]:
    """The difference of each quantity between the groups, with p-values over all of them together.

    Parameters
    ----------
    estimates : sequence of SessionEstimates
        Each with at least one session in either group.
    alpha : float
        Rate of false alarms, over all quantities.

    Examples
    --------
    >>> old_and_new = np.array([False, False, False, True, True, True])
    >>> values = np.array([1.00, 1.01, 0.99, 1.20, 1.21, 1.19])
    >>> quantity = SessionEstimates("step size", values, np.full(6, 1e-6), old_and_new, scale=1.0)
    >>> (difference,) = compare_means([quantity], alpha=0.01)
    >>> round(difference.estimate, 3), round(difference.p_adjusted, 5)
    (0.2, 2e-05)
    """
    if not estimates:
        return []
    old = np.array([one.values[~one.is_new].mean() for one in estimates])
    new = np.array([one.values[one.is_new].mean() for one in estimates])
    floor = np.array([_variance_of_days(one) for one in estimates])
    variance, df = _pool_variances(estimates)
    inverse = np.array([1 / one.counts[0] + 1 / one.counts[1] for one in estimates])
    known, difference = df > 0, new - old
    standard_error = np.sqrt(np.where(known, np.fmax(variance, floor), floor) * inverse)
    with np.errstate(divide="ignore", invalid="ignore"):
        p_value = 2 * stdtr(np.where(known, df, np.nan), -np.abs(difference) / standard_error)
        alone = 2 * ndtr(-np.abs(difference) / np.sqrt(floor * inverse))
    level = alpha / 2 / max(int(known.sum()), 1)
    reach = stdtrit(np.where(known, df, np.nan), 1 - level)
    least = (reach + stdtrit(np.where(known, df, np.nan), POWER)) * standard_error
    reach = reach * standard_error
    columns = (
        *(old, new, difference, standard_error, df, difference - reach, difference + reach),
        *(p_value, _adjust(p_value), least, _adjust(alone)),
    )
    return [Difference(*map(float, row)) for row in zip(*columns, strict=True)]


def _variance_of_days(one: SessionEstimates) -> float:
    """The variance of a session by the scatter of its traverses, as the means of the groups have it."""
    sides = [one.variances[subset] for subset in (one.is_new, ~one.is_new)]
    weights = [1 / len(side) for side in sides]
    means = [float(side.mean()) for side in sides]
    return float(np.dot(weights, means) / sum(weights))


def _pool_variances(estimates: Sequence[SessionEstimates]) -> tuple[Array, Array]:
    """Variance between sessions within the groups and its degrees of freedom, shape (m,) each."""
    own_df = np.array([one.df for one in estimates], float)
    variance = np.array([_variance_within(one) for one in estimates])
    df, scale2 = own_df.copy(), np.array([one.scale for one in estimates]) ** 2
    shrinkable = (own_df > 0) & (variance > 0) & np.isfinite(scale2) & (scale2 > 0)
    for kind in dict.fromkeys((one.kind, one.df) for one in estimates):
        same = np.array([(one.kind, one.df) == kind for one in estimates]) & shrinkable
        if same.sum() < MIN_VARIANCES:
            continue
        relative, own, n = variance[same] / scale2[same], float(kind[1]), int(same.sum())
        shrunk, total = shrink_variances(relative, kind[1], kind[1] * n)
        others = min(total - own, MAX_SHARE_OF_OTHERS * own)
        # What all have in common: where they differ by chance only, `shrunk` is that itself.
        common = shrunk if total >= own * n else (total * shrunk - own * relative) / (total - own)
        variance[same] = scale2[same] * (own * relative + others * common) / (own + others)
        df[same] = own + others
    return variance, df


def _variance_within(one: SessionEstimates) -> float:
    squares = sum(
        float(np.sum((one.values[subset] - one.values[subset].mean()) ** 2))
        for subset in (one.is_new, ~one.is_new)
    )
    return squares / one.df if one.df else np.nan


def _adjust(p_values: Array) -> Array:
    """Holm's adjustment over those that are known."""
    adjusted, known = np.full(len(p_values), np.nan), np.isfinite(p_values)
    adjusted[known] = adjust_holm(p_values[known])
    return adjusted
