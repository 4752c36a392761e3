"""The table of a formula as text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stickslip_fit._format import format_p_value, join_words
from stickslip_fit._summary import text_table
from stickslip_fit.anova.linear import RESIDUAL
from stickslip_fit.anova.verdict import LEVEL

if TYPE_CHECKING:
    import pandas as pd

    from stickslip_fit.anova.formula import FormulaTable


def formula_text(found: FormulaTable) -> str:
    """What matters in a sentence, then the table; sums of squares in SI units of the response."""
    table = found.table
    header = ["term", "sum of squares", "df", "mean square", "F", "p", "adjusted", "omega²"]
    rows = [_row(row) for _, row in table.iterrows()]
    total = sum(line.squares for line in found.lines)
    if found.kind == 1:
        rows.append(["total", f"{total:.6g}", str(found.count - 1), *[""] * 5])
    heading = f"{found.formula}, type {found.kind}, {found.count} readings"
    return f"Joint {found.joint}. {_sentence(table)}\n\n{heading}\n{text_table(header, rows)}"


def _sentence(table: pd.DataFrame) -> str:
    terms = table[table["term"] != RESIDUAL]
    shown = terms[terms["p_holm"] < LEVEL]
    untested = list(terms.loc[terms["df"] == 0, "term"])
    told = "Nothing in the formula shows an effect."
    if len(shown):
        worst = format_p_value(shown["p_holm"].max(), relation=True)
        told = f"What shows an effect: {join_words(list(shown['term']))} (adjusted p {worst})."
    if untested:
        told += f" Other terms say all that {join_words(untested)} could say."
    return told


def _row(row: pd.Series) -> list[str]:
    if row["term"] == RESIDUAL or not row["df"]:
        mean = f"{row['ms']:.6g}" if row["df"] else ""
        return [row["term"], f"{row['ss']:.6g}", str(row["df"]), mean, "", "", "", ""]
    probabilities = [format_p_value(row[name]) for name in ("p", "p_holm")]
    numbers = [f"{row['ss']:.6g}", str(row["df"]), f"{row['ms']:.6g}", f"{row['F']:.4g}"]
    return [row["term"], *numbers, *probabilities, f"{row['omega_squared']:.2f}"]
