"""Predictive checks of a posterior, and PSIS-LOO.

The p-values compare statistics of the residuals with those of replicated data from the posterior (A. Gelman,
X.-L. Meng and H. Stern, Statistica Sinica 6:733, 1996).
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import format_direction
from stickslip_fit._summary import Section, Table, numbers, words
from stickslip_fit._typing import Array
from stickslip_fit.bayes.posterior import Posterior


def predictive_p_values(posterior: Posterior) -> pd.DataFrame:
    """Posterior predictive p-values of statistics of the residuals.

    Returns
    -------
    DataFrame
        joint, direction and, each near 0 or 1 where the model fails: spread (mean square of the residuals),
        extreme (the largest) and memory (autocorrelation of neighbours in time).
    """
    rows = []
    for joint, direction in posterior.groups:
        branch = posterior.group_tree(joint, direction)
        predictive, observed = branch["posterior_predictive"], branch["observed_data"]
        y, steps = observed["log_steps"].to_numpy(), observed["steps"].to_numpy()
        law, counts, noise = (
            predictive[name].to_numpy().reshape(-1, width)
            for name, width in (("law", len(y)), ("steps", len(y)), ("repeatability", 1))
        )
        # A count is on average half a check too high, replicated or observed.
        half_check = steps - np.exp(y)
        of_log, replicated = (
            _residual_statistics((log_steps - law) / noise) for log_steps in (y, np.log(counts - half_check))
        )
        rows.append(
            {"joint": joint, "direction": direction}
            | {name: float(np.mean(replicated[name] >= of_log[name])) for name in of_log}
        )
    return pd.DataFrame(rows)


def leave_one_out(posterior: Posterior) -> pd.DataFrame:
    """PSIS-LOO by ArviZ: expected log predictive density of each traverse given all the others.

    Returns
    -------
    DataFrame
        joint, direction, elpd and its standard_error, p (effective number of parameters), and
        untrusted: the number of traverses with too large a k-hat.
    """
    import warnings

    from arviz_stats import loo

    rows = []
    for joint, direction in posterior.groups:
        with warnings.catch_warnings():
            # What it warns of is counted in the last column.
            warnings.simplefilter("ignore", UserWarning)
            result = loo(posterior.group_tree(joint, direction), pointwise=True)
        untrusted = int(np.sum(result.pareto_k.to_numpy() > result.good_k))
        rows.append((joint, direction, float(result.elpd), float(result.se), float(result.p), untrusted))
    return pd.DataFrame(rows, columns=["joint", "direction", "elpd", "standard_error", "p", "untrusted"])


def _residual_statistics(residual: Array) -> dict[str, Array]:
    """Statistics of standardized residuals, (d, n) -> (d,)."""
    return {
        "spread": np.mean(residual**2, axis=1),
        "extreme": np.max(np.abs(residual), axis=1),
        "memory": np.sum(residual[:, 1:] * residual[:, :-1], axis=1),
    }


EXTREME_P_VALUE = 0.002  # in either tail; one of all p-values is as extreme in about one fit of thirty
# Of a p-value near 0, and of one near 1. A largest residual smaller than usual is harmless.
STATISTIC_MEANINGS = {
    "spread": ("counts scatter more than the model has it", "counts scatter less than the model has it"),
    "extreme": ("a count is further off than the model ever has it", ""),
    "memory": (
        "neighbours in time have residuals of one sign: something drifts",
        "neighbours in time have residuals of opposite signs",
    ),
}


def checks_section(posterior: Posterior) -> Section:
    """Posterior predictive p-values and PSIS-LOO of each joint and direction, with what they say.

    What has not converged is left out.
    """
    failed = {(flag.joint, flag.direction) for flag in posterior.flags if flag.flag == "not_converged"}
    groups = [group for group in posterior.groups if group not in failed]
    if not groups:
        text = "Nothing has converged, so there is nothing to check the counts against."
        return Section("Predictive checks", (text,))
    checks = predictive_p_values(posterior).merge(leave_one_out(posterior), on=["joint", "direction"])
    checks = checks[[group in groups for group in zip(checks["joint"], checks["direction"], strict=True)]]
    trees = [posterior.group_tree(*group) for group in groups]
    checks["traverses"] = [tree["observed_data"]["steps"].size for tree in trees]
    columns = (
        *words("joint"),
        *numbers(*STATISTIC_MEANINGS, group="p-value"),
        *numbers("elpd (LOO)", "its parameters", "counts it cannot judge"),
    )
    rows = tuple(
        (
            f"{row.joint} {format_direction(row.direction)}",
            *(f"{getattr(row, name):.2f}" for name in STATISTIC_MEANINGS),
            f"{row.elpd:.1f} ± {row.standard_error:.1f}",
            f"{row.p:.1f}",
            f"{row.untrusted} of {row.traverses}",
        )
        for row in checks.itertuples(index=False)
    )
    note = "p-values: shares of the model's own logs that show more than this one."
    table = Table("Posterior predictive p-values, PSIS-LOO", columns, rows, note=note)
    return Section("Predictive checks", tuple(_conclude(checks)), (table,))


def _conclude(checks: pd.DataFrame) -> list[str]:
    lines = []
    for row in checks.itertuples(index=False):
        for name, (small, large) in STATISTIC_MEANINGS.items():
            value = getattr(row, name)
            text = small if value < EXTREME_P_VALUE else large if value > 1 - EXTREME_P_VALUE else ""
            if text:
                lines.append(f"! joint {row.joint} {format_direction(row.direction)}: {text}")
    return lines or ["The counts look like the model's own."]
