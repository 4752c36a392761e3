"""The checks of a posterior in words: whether the counts look like the model's own."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import format_direction
from stickslip_fit._summary import Column, Section, Table
from stickslip_fit.fit.bayes.checks import leave_one_out, predictive_p_values
from stickslip_fit.fit.bayes.posterior import Posterior

ODD = 0.002  # in either tail; one of the p-values of all joints is this odd in about one fit of thirty
# What a p-value near 0, and one near 1, says. A largest departure that is smaller than usual is no harm.
MEANINGS = {
    "spread": ("counts scatter more than the model has it", "counts scatter less than the model has it"),
    "extreme": ("a count is further off than the model ever has it", ""),
    "memory": ("neighbours in time depart alike: something drifts", "neighbours in time depart oppositely"),
}


def checks_section(posterior: Posterior) -> Section:
    """Posterior predictive p-values and PSIS-LOO of each joint and direction, with what they say.

    What has not converged is left out.
    """
    groups = [group for group in posterior.groups if _converged(posterior, *group)]
    if not groups:
        said = "Nothing has converged, so there is nothing to check the counts against."
        return Section("Predictive checks", (said,))
    found = predictive_p_values(posterior).merge(leave_one_out(posterior), on=["joint", "direction"])
    found = found[[group in groups for group in zip(found["joint"], found["direction"], strict=True)]]
    columns = (
        Column("joint", text=True),
        *(Column(name, group="p-value") for name in MEANINGS),
        *(Column(head) for head in ("elpd (LOO)", "its parameters", "counts it cannot judge")),
    )
    rows = tuple(
        (
            f"{row.joint} {format_direction(row.direction)}",
            *(f"{getattr(row, name):.2f}" for name in MEANINGS),
            f"{row.elpd:.1f} ± {row.standard_error:.1f}",
            f"{row.p:.1f}",
            f"{row.untrusted} of {posterior.branch(row.joint, row.direction)['observed_data']['steps'].size}",
        )
        for row in found.itertuples(index=False)
    )
    note = "p-values: shares of the model's own logs that show more than this one."
    table = Table("Posterior predictive p-values, PSIS-LOO", columns, rows, note=note)
    return Section("Predictive checks", tuple(_verdict(found)), (table,))


def _converged(posterior: Posterior, joint: int, direction: str) -> bool:
    return not any(
        (remark.joint, remark.direction, remark.flag) == (joint, direction, "not_converged")
        for remark in posterior.result.remarks
    )


def _verdict(found: pd.DataFrame) -> list[str]:
    lines = []
    for row in found.itertuples(index=False):
        for name, (small, large) in MEANINGS.items():
            value = getattr(row, name)
            said = small if value < ODD else large if value > 1 - ODD else ""
            if said:
                lines.append(f"! joint {row.joint} {format_direction(row.direction)}: {said}")
    return lines or ["The counts look like the model's own."]
