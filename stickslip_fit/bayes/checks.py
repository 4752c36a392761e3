"""Predictive checks of a posterior, PSIS-LOO, and predictions for fitted and for new sessions.

The p-values compare statistics of the residuals with those of replicated data from the posterior.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pandas as pd

from stickslip_fit._format import format_direction
from stickslip_fit._summary import Column, Section, Table
from stickslip_fit._typing import Array
from stickslip_fit.bayes.posterior import Posterior
from stickslip_fit.bayes.result import INTERVAL_QUANTILES


def check_predictive(
    posterior: Posterior, which: Literal["prior", "posterior"] = "posterior"
) -> pd.DataFrame:
    """Each count of the log among the counts that the model would have given.

    Parameters
    ----------
    posterior : Posterior
    which : {"prior", "posterior"}, optional
        The prior's counts say whether it allows for what was seen; the posterior's, whether the law and
        the noise describe it.

    Returns
    -------
    DataFrame, indexed as the log's usable rows
        joint, direction, steps as seen; low, median, high of the model's counts (95 %); rank: the share of
        them below the count seen, ties halved; and stalled: the share in which the joint comes to a halt.
    """
    tables = []
    for joint, direction in posterior.groups:
        branch = posterior.group_tree(joint, direction)
        seen = branch["observed_data"]["steps"]
        model = branch[f"{which}_predictive"]["steps"].to_numpy().reshape(-1, seen.size)
        stalled = np.isnan(model)
        endless = np.where(stalled, np.inf, model)
        low, median, high = np.quantile(
            endless, (INTERVAL_QUANTILES[0], 0.5, INTERVAL_QUANTILES[1]), axis=0, method="nearest"
        )
        steps = seen.to_numpy()
        rank = np.mean(endless < steps, axis=0) + 0.5 * np.mean(endless == steps, axis=0)
        table = pd.DataFrame(
            {
                "joint": joint, "direction": direction, "steps": steps, "low": low, "median": median,
                "high": high, "rank": rank, "stalled": stalled.mean(axis=0),
            },
            index=seen["traverse"].to_numpy(),
        )  # fmt: skip
        tables.append(table)
    return pd.concat(tables).sort_index()


def predictive_p_values(posterior: Posterior) -> pd.DataFrame:
    """Posterior predictive p-values of what a wrong law or noise would show.

    Each draw compares how the log departs from it with how counts of its own do (Gelman, Meng and Stern,
    Statistica Sinica 6:733, 1996).

    Returns
    -------
    DataFrame
        joint, direction and, each near 0 or 1 where the model fails: spread (more or less scatter than it
        allows), extreme (its largest departure) and memory (neighbours in time that depart alike).
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
        # A count stands for half a check less, in the model's as in the lab's.
        half = steps - np.exp(y)
        found, own = (_residual_statistics((each - law) / noise) for each in (y, np.log(counts - half)))
        rows.append(
            {"joint": joint, "direction": direction}
            | {name: float(np.mean(own[name] >= found[name])) for name in found}
        )
    return pd.DataFrame(rows)


def leave_one_out(posterior: Posterior) -> pd.DataFrame:
    """PSIS-LOO by ArviZ: how well each traverse is foretold by all the others.

    Returns
    -------
    DataFrame
        joint, direction, elpd and its standard_error, p (effective number of parameters), and
        untrusted: how many traverses have a k-hat too large to be judged so.
    """
    import warnings

    from arviz_stats import loo

    rows = []
    for joint, direction in posterior.groups:
        with warnings.catch_warnings():
            # What it warns of is counted in the last column.
            warnings.simplefilter("ignore", UserWarning)
            found = loo(posterior.group_tree(joint, direction), pointwise=True)
        untrusted = int(np.sum(found.pareto_k.to_numpy() > found.good_k))
        rows.append((joint, direction, float(found.elpd), float(found.se), float(found.p), untrusted))
    return pd.DataFrame(rows, columns=["joint", "direction", "elpd", "standard_error", "p", "untrusted"])


def _residual_statistics(departure: Array) -> dict[str, Array]:
    """Statistics of standardised departures, (d, n) -> (d,)."""
    return {
        "spread": np.mean(departure**2, axis=1),
        "extreme": np.max(np.abs(departure), axis=1),
        "memory": np.sum(departure[:, 1:] * departure[:, :-1], axis=1),
    }


EXTREME_P_VALUE = (
    0.002  # in either tail; one of the p-values of all joints is this odd in about one fit of thirty
)
# What a p-value near 0, and one near 1, says. A largest departure that is smaller than usual is no harm.
STATISTIC_MEANINGS = {
    "spread": ("counts scatter more than the model has it", "counts scatter less than the model has it"),
    "extreme": ("a count is further off than the model ever has it", ""),
    "memory": ("neighbours in time depart alike: something drifts", "neighbours in time depart oppositely"),
}


def checks_section(posterior: Posterior) -> Section:
    """Posterior predictive p-values and PSIS-LOO of each joint and direction, with what they say.

    What has not converged is left out.
    """
    groups = [group for group in posterior.groups if _has_converged(posterior, *group)]
    if not groups:
        said = "Nothing has converged, so there is nothing to check the counts against."
        return Section("Predictive checks", (said,))
    found = predictive_p_values(posterior).merge(leave_one_out(posterior), on=["joint", "direction"])
    found = found[[group in groups for group in zip(found["joint"], found["direction"], strict=True)]]
    columns = (
        Column("joint", text=True),
        *(Column(name, group="p-value") for name in STATISTIC_MEANINGS),
        *(Column(head) for head in ("elpd (LOO)", "its parameters", "counts it cannot judge")),
    )
    rows = tuple(
        (
            f"{row.joint} {format_direction(row.direction)}",
            *(f"{getattr(row, name):.2f}" for name in STATISTIC_MEANINGS),
            f"{row.elpd:.1f} ± {row.standard_error:.1f}",
            f"{row.p:.1f}",
            f"{row.untrusted} of {posterior.group_tree(row.joint, row.direction)['observed_data']['steps'].size}",
        )
        for row in found.itertuples(index=False)
    )
    note = "p-values: shares of the model's own logs that show more than this one."
    table = Table("Posterior predictive p-values, PSIS-LOO", columns, rows, note=note)
    return Section("Predictive checks", tuple(_conclude(found)), (table,))


def _has_converged(posterior: Posterior, joint: int, direction: str) -> bool:
    return not any(
        (flag.joint, flag.direction, flag.flag) == (joint, direction, "not_converged")
        for flag in posterior.result.flags
    )


def _conclude(found: pd.DataFrame) -> list[str]:
    lines = []
    for row in found.itertuples(index=False):
        for name, (small, large) in STATISTIC_MEANINGS.items():
            value = getattr(row, name)
            said = small if value < EXTREME_P_VALUE else large if value > 1 - EXTREME_P_VALUE else ""
            if said:
                lines.append(f"! joint {row.joint} {format_direction(row.direction)}: {said}")
    return lines or ["The counts look like the model's own."]
