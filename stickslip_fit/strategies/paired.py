"""Strategies against each other, session by session, with a verdict that respects noise."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import t as student_t

from stickslip_fit.anova.holm import holm
from stickslip_fit.strategies.accuracy import SCALES, SMALLEST_SHARE, reach
from stickslip_fit.strategies.moderated import moderate

Array = npt.NDArray[np.float64]

SIGNIFICANT = 0.05
BETTER, WORSE, INDISTINGUISHABLE = "better", "worse", "indistinguishable on this log"


def pair_up(errors: pd.DataFrame, unit: Sequence[str]) -> pd.DataFrame:
    """Differences of rms between every two strategies of one joint, over its units (sessions).

    Parameters
    ----------
    errors : DataFrame
        Of one joint, as `with_errors` returns it, the same traverses for every strategy.
    unit : sequence of str
        See `summarise`.

    Returns
    -------
    DataFrame
        strategy, other, units; difference, the mean over the units of the rms of `strategy` less that of
        `other`, with ``_low`` and ``_high`` (95 %, Student's t), absolute and under ``_relative``; p, of the
        paired t test on the log ratio of relative rms; p_adjusted, for all pairs of the joint (Holm); and
        verdict on `strategy`.
    """
    names = list(dict.fromkeys(errors["strategy"]))
    rms = {kind: _rms_by_unit(errors, kind, unit, names) for kind in SCALES.values()}
    pairs = list(combinations(range(len(names)), 2))
    if not pairs:
        return pd.DataFrame()
    first, second = np.array(pairs).T
    found = pd.DataFrame(
        {
            "strategy": np.array(names, object)[first],
            "other": np.array(names, object)[second],
            "units": len(rms["relative"]),
        }
    )
    for suffix, kind in SCALES.items():
        difference = rms[kind][:, first] - rms[kind][:, second]
        mean, error = _mean_and_error(difference)
        half = reach(len(difference)) * error
        found[f"difference{suffix}"] = mean
        found[f"difference{suffix}_low"], found[f"difference{suffix}_high"] = mean - half, mean + half
    # A strategy may be right to the last step by luck; its logarithm must not rule all others.
    log = np.log(np.maximum(rms["relative"], SMALLEST_SHARE * rms["relative"].mean(axis=0)))
    log_ratio = log[:, first] - log[:, second]
    found["p"] = p_values(log_ratio, most=(len(names) - 1) * (len(log) - 1))
    found["p_adjusted"] = holm(found["p"])
    less, more = (
        (sign * found["difference_relative"] < 0) & (sign * log_ratio.mean(axis=0) < 0) for sign in (1, -1)
    )
    seen = found["p_adjusted"] < SIGNIFICANT
    found["verdict"] = np.select([seen & less, seen & more], [BETTER, WORSE], INDISTINGUISHABLE)
    return found


def p_values(log_ratios: Array, most: int) -> Array:
    """Of the paired t test, shape (units, m) -> (m,); 1 where there is one unit or nothing differs.

    The variances are moderated: three sessions alone could hardly show any difference of many.

    Parameters
    ----------
    log_ratios : array, shape (units, m)
        Of what is compared, such as rms errors.
    most : int
        Degrees of freedom in all of them together.

    Examples
    --------
    >>> p_values(np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]]), most=2).round(3)
    array([0.074, 1.   ])
    """
    units, found = len(log_ratios), np.ones(log_ratios.shape[1])
    differ = np.flatnonzero(np.ptp(log_ratios, axis=0) > 0)
    if units > 1 and len(differ):
        mean, variance = log_ratios[:, differ].mean(axis=0), log_ratios[:, differ].var(axis=0, ddof=1)
        moderated = moderate(variance, units - 1, most)
        found[differ] = 2 * student_t.sf(
            np.abs(mean) / np.sqrt(moderated.variance / units), moderated.freedom
        )
    return found


def _mean_and_error(differences: Array) -> tuple[Array, Array]:
    if len(differences) < 2:
        return differences.mean(axis=0), np.full(differences.shape[1], np.nan)
    return differences.mean(axis=0), differences.std(axis=0, ddof=1) / np.sqrt(len(differences))


def _rms_by_unit(errors: pd.DataFrame, kind: str, unit: Sequence[str], names: list[str]) -> Array:
    """Shape (units, strategies)."""
    squares = errors.assign(square=errors[kind] ** 2)
    each = squares.groupby([*unit, "strategy"], dropna=False, observed=True, sort=False)["square"].mean()
    return np.sqrt(each.unstack("strategy")[names].to_numpy())
