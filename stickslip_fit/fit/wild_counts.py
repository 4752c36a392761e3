"""Counts wildly off, named whatever the estimator."""

from __future__ import annotations

from dataclasses import replace

from stickslip_fit.fit.bayes.priors import weak_prior
from stickslip_fit.fit.bayes.traverses import each_group
from stickslip_fit.fit.bayes.wild_counts import wild_counts
from stickslip_fit.fit.result import Result
from stickslip_fit.logs import Log


def name_wild_counts(result: Result, log: Log) -> Result:
    """The result with a remark on each count that is wildly off by what the log's other counts say."""
    said = [
        remark
        for _, _, traverses in each_group(log)
        for remark in wild_counts(
            traverses,
            weak_prior(traverses.law, traverses.rows),
            result.residuals.loc[traverses.rows.index, "residual"].to_numpy(),
        )
    ]
    return replace(result, remarks=(*result.remarks, *said))
