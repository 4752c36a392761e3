"""Strategies against each other, session by session, with a verdict that respects noise."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import t as student_t

from stickslip_fit.anova.holm import holm
from stickslip_fit.strategies.accuracy import SCALES, reach

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
        paired t test on the relative difference; p_adjusted, for all pairs of the joint (Holm); and verdict
        on `strategy`.
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
    found["p"] = p_values(rms["relative"][:, first] - rms["relative"][:, second])
    found["p_adjusted"] = holm(found["p"])
    seen, less = found["p_adjusted"] < SIGNIFICANT, found["difference_relative"] < 0
    found["verdict"] = np.where(seen, np.where(less, BETTER, WORSE), INDISTINGUISHABLE)
    return found


def p_values(differences: Array) -> Array:
    """Of the paired t test, shape (units, m) -> (m,); 1 where there is one unit or nothing differs.

    Examples
    --------
    >>> p_values(np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])).round(3)
    array([0.074, 1.   ])
    """
    if len(differences) < 2:
        return np.ones(differences.shape[1])
    mean, error = _mean_and_error(differences)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2 * student_t.sf(np.abs(mean) / error, len(differences) - 1)
    return np.where(mean == 0, 1.0, p)


def _mean_and_error(differences: Array) -> tuple[Array, Array]:
    if len(differences) < 2:
        return differences.mean(axis=0), np.full(differences.shape[1], np.nan)
    return differences.mean(axis=0), differences.std(axis=0, ddof=1) / np.sqrt(len(differences))


def _rms_by_unit(errors: pd.DataFrame, kind: str, unit: Sequence[str], names: list[str]) -> Array:
    """Shape (units, strategies)."""
    squares = errors.assign(square=errors[kind] ** 2)
    each = squares.groupby([*unit, "strategy"], dropna=False, observed=True, sort=False)["square"].mean()
    return np.sqrt(each.unstack("strategy")[names].to_numpy())
