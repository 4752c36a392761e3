"""Joint 2's load coefficient d three ways, as a table."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import format_direction, format_length, format_number, format_uncertain
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.report.figures.traverses import recent
from stickslip_fit.report.load_coefficient import ITERATIONS


def d_table(table: pd.DataFrame) -> Table:
    """The table of `load_coefficients`, the latest sessions."""
    columns = (
        *words("session", "direction", "q3"),
        *numbers("gamma0", "delta", unit="µrad"),
        *numbers("exact", "±", "Eq. 6.6", unit="µrad", group="d"),
        *(
            Column("first guess" if k == 0 else f"pass {k}", "µrad", "d by the thesis's iteration")
            for k in range(ITERATIONS + 1)
        ),
    )
    shown = recent(table)
    body = tuple(
        (
            str(row["session"]),
            format_direction(row["direction"]),
            format_length(row["q3"]),
            format_uncertain(row["gamma0"], row["gamma0_error"], "µrad", with_unit=False),
            format_number(row["delta"], "µrad"),
            format_number(row["d"], "µrad"),
            format_number(row["d_error"], "µrad"),
            format_number(row["quadratic"], "µrad"),
            *(format_number(row[f"iteration_{k}"], "µrad") for k in range(ITERATIONS + 1)),
        )
        for _, row in shown.iterrows()
    )
    note = (
        "delta: change of the mean step under the full load (theta = 0, psi = 0) against none (theta = "
        "−90°). Exact: the integral of dq2 / (gamma0 + d sin zeta) solved for the steps counted; ± one "
        "standard error of it, from the counts. The iteration is the thesis's way to the same value, Eq. "
        "6.6 its quadratic in delta for any gamma0 (x in units of 0.01 rad, the only reading that makes "
        "sense)."
    )
    if len(shown) < len(table):
        note += f" The latest {shown['session'].nunique()} of {table['session'].nunique()} sessions."
    return Table(
        "Joint 2's d by exact solving, by the thesis's iteration, by its Eq. 6.6",
        columns,
        body,
        stubs=3,
        note=note,
    )
