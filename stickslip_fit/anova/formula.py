"""Any model over a log's columns, written as a formula: ``step_size ~ C(session) * direction``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._summary import Summary
from stickslip_fit.anova.holm import holm
from stickslip_fit.anova.linear import RESIDUAL, Line, Term, marginal, partial, sequential
from stickslip_fit.anova.readings import readings, selected
from stickslip_fit.anova.record import COLUMNS
from stickslip_fit.anova.terms import model_terms
from stickslip_fit.errors import InputError
from stickslip_fit.logs import Log
from stickslip_fit.logs.columns import COVARIATE

KINDS = {1: sequential, 2: marginal, 3: partial}
EXACT = 1e-12  # relative scatter that is the rounding of doubles
OWN_COLUMNS = (COVARIATE, "text:")


@dataclass(frozen=True)
class FormulaTable:
    """The table of one joint's model.

    Attributes
    ----------
    joint : int
    formula : str
    kind : {1, 2, 3}
        Type of the sums of squares.
    lines : tuple of Line
        The terms in the order of the formula, then the residual.
    count : int
        Readings.
    """

    joint: int
    formula: str
    kind: int
    lines: tuple[Line, ...]
    count: int

    def __repr__(self) -> str:
        return self.summary().as_text()

    def _repr_html_(self) -> str:
        return self.summary().as_html()

    def summary(self) -> Summary:
        """What shows an effect, then the table."""
        from stickslip_fit.anova.summary import summarize_formula

        return summarize_formula(self)

    @property
    def table(self) -> pd.DataFrame:
        """term, ss, df, ms, F, p, p_holm, omega_squared (partial)."""
        from scipy.special import fdtrc

        table = pd.DataFrame([(line.name, line.squares, line.freedom) for line in self.lines])
        table.columns = pd.Index(["term", "ss", "df"])
        table["ms"] = table["ss"] / table["df"].where(table["df"] > 0)
        error = self.lines[-1]
        table["F"] = (table["ms"] / (error.squares / error.freedom)).where(table["term"] != RESIDUAL)
        table["p"] = fdtrc(table["df"].astype(float), float(error.freedom), table["F"])
        tested = table["p"].notna()
        table.loc[tested, "p_holm"] = holm(table.loc[tested, "p"])
        excess = table["df"] * (table["F"] - 1.0)
        return table.assign(omega_squared=np.maximum(0.0, excess / (excess + self.count)))

    def to_json(self) -> list[dict[str, object]]:
        """One object for each term, with the fields of `record.COLUMNS`."""
        told = []
        for row in self.table[:-1].itertuples(index=False):
            tested = bool(row.df)
            found: dict[str, object] = dict.fromkeys(COLUMNS)
            found |= {"analysis": f"formula: {row.term}", "joint": self.joint, "error_term": RESIDUAL}
            if tested:
                found |= {"F": row.F, "df": [row.df, self.lines[-1].freedom], "p_value": row.p}
                found |= {"p_holm": row.p_holm, "omega_squared": row.omega_squared}
            told.append(found)
        return told


def formula(
    log: Log, text: str, *, joint: int | None = None, session: str | None = None, kind: int = 2
) -> tuple[FormulaTable, ...]:
    """Analyse any columns of a log, each joint by itself.

    Factors are columns of `readings.readings`, which has the log's own (``covariate:pressure`` may be called
    ``pressure``) and step_size, configuration and orientation; numpy is ``np``. Text is a factor, and
    ``C(...)`` makes one of numbers. ``a / b`` nests b in a, whether or not b's labels start anew in each a:
    degrees of freedom are counted from what the columns span.

    Parameters
    ----------
    log : Log
    text : str
        In the language of patsy and statsmodels.
    joint : {1, 2, 3}, optional
        Of this joint only.
    session : str, optional
        Of this session only.
    kind : {1, 2, 3}, optional
        Type of the sums of squares: in order, each beside those that do not contain it, each beside all
        others.

    Raises
    ------
    InputError
        If the formula cannot be read, names what the log does not have, meets empty cells, leaves no scatter
        to compare with, or asks for type III where some combinations of levels are missing.
    """
    rows = with_plain_names(selected(readings(log), joint, session))
    return tuple(_analysed(mine, int(one), text, kind) for one, mine in rows.groupby("joint"))


def with_plain_names(rows: pd.DataFrame) -> pd.DataFrame:
    """The lab's own columns also without their prefix, where that name is free."""
    plain = {
        name: name.removeprefix(prefix)
        for prefix in OWN_COLUMNS
        for name in rows.columns
        if name.startswith(prefix) and name.removeprefix(prefix) not in rows.columns
    }
    return rows.assign(**{short: rows[name] for name, short in plain.items()})


def _analysed(rows: pd.DataFrame, joint: int, text: str, kind: int) -> FormulaTable:
    if kind not in KINDS:
        raise InputError(f"type {kind} of sums of squares is none of 1, 2, 3")
    values, terms = model_terms(rows, text, sums_to_zero=kind == 3)
    lines = KINDS[kind](values, terms)
    rest, rounding = lines[-1], EXACT * float(np.abs(values).max())
    if rest.freedom < 1 or rest.squares <= rest.freedom * rounding**2:
        raise InputError(f"joint {joint}: {text!r} leaves no scatter to compare with; leave a term out")
    if kind == 3:
        _refuse_gaps(terms, lines)
    return FormulaTable(joint, text, kind, tuple(lines), len(values))


def _refuse_gaps(terms: Sequence[Term], lines: Sequence[Line]) -> None:
    for term, line in zip(terms, lines, strict=False):
        if line.freedom < term.columns.shape[1]:
            raise InputError(
                f"type 3 cannot separate {term.name} from the other terms, or lacks readings of some "
                "combination of its levels; ask for type 1 or 2 (--type)"
            )
