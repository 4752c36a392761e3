"""Whether the counts look like the model's own: prior and posterior predictive checks, and PSIS-LOO."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.bayes.means import BOUNDS
from stickslip_fit.fit.bayes.posterior import Posterior

Array = npt.NDArray[np.float64]


def predictive_check(
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
        branch = posterior.branch(joint, direction)
        seen = branch["observed_data"]["steps"]
        model = branch[f"{which}_predictive"]["steps"].to_numpy().reshape(-1, seen.size)
        stalled = np.isnan(model)
        endless = np.where(stalled, np.inf, model)
        low, median, high = np.quantile(endless, (BOUNDS[0], 0.5, BOUNDS[1]), axis=0, method="nearest")
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
        branch = posterior.branch(joint, direction)
        predictive, observed = branch["posterior_predictive"], branch["observed_data"]
        y, steps = observed["log_steps"].to_numpy(), observed["steps"].to_numpy()
        law, counts, noise = (
            predictive[name].to_numpy().reshape(-1, width)
            for name, width in (("law", len(y)), ("steps", len(y)), ("repeatability", 1))
        )
        # A count stands for half a check less, in the model's as in the lab's.
        half = steps - np.exp(y)
        found, own = (_statistics((each - law) / noise) for each in (y, np.log(counts - half)))
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
            found = loo(posterior.branch(joint, direction), pointwise=True)
        untrusted = int(np.sum(found.pareto_k.to_numpy() > found.good_k))
        rows.append((joint, direction, float(found.elpd), float(found.se), float(found.p), untrusted))
    return pd.DataFrame(rows, columns=["joint", "direction", "elpd", "standard_error", "p", "untrusted"])


def _statistics(departure: Array) -> dict[str, Array]:
    """Statistics of standardised departures, (d, n) -> (d,)."""
    return {
        "spread": np.mean(departure**2, axis=1),
        "extreme": np.max(np.abs(departure), axis=1),
        "memory": np.sum(departure[:, 1:] * departure[:, :-1], axis=1),
    }
