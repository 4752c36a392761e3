"""Analysis of variance by formula, as in ``step_size ~ C(session) * direction``: types I, II and III.

`grammar` has what a formula may say. A term's sum of squares is the difference between two nested
least-squares models: type I after the terms before it, type II after all terms that do not contain it,
type III after all others with sum-to-zero coding. Degrees of freedom are ranks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import reduce
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._summary import Summarized
from stickslip_fit._threads import one_blas_thread
from stickslip_fit._typing import Array
from stickslip_fit.anova.analysis import RECORD_COLUMNS
from stickslip_fit.anova.contrasts import adjust_holm, indicator_columns, orthonormal_basis, subtract_median
from stickslip_fit.anova.designs import select_observations, step_size_observations
from stickslip_fit.anova.grammar import Factor, Term, parse_formula
from stickslip_fit.anova.position import POSITION, name_stretches
from stickslip_fit.errors import InputError
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.machine import Machine, load_machine

RESIDUAL_NAME = "residual"
TYPES = (1, 2, 3)
EXACT_FIT_TOL = 1e-12  # relative scatter that is the rounding of doubles
MAX_COLUMNS, MAX_CELLS = 2_000, 50_000_000  # of a design matrix
LAB_COLUMN_PREFIXES = (COVARIATE_PREFIX, "text:")


@dataclass(frozen=True)
class ModelTerm:
    """One term of a model, a product of factors; columns of the design matrix, shape (n, p)."""

    name: str
    factors: frozenset[str]
    columns: Array


@dataclass(frozen=True)
class AnovaRow:
    """Sum of squares and degrees of freedom of a term, or of the residual."""

    name: str
    sum_of_squares: float
    df: int


@dataclass(frozen=True, repr=False)
class FormulaTable(Summarized):
    """The table of one joint's model.

    Attributes
    ----------
    joint : int
    formula : str
    kind : {1, 2, 3}
        Type of the sums of squares.
    lines : tuple of AnovaRow
        The terms in the order of the formula, then the residual.
    count : int
        Number of observations.
    machine : Machine
    """

    joint: int
    formula: str
    kind: int
    lines: tuple[AnovaRow, ...]
    count: int
    machine: Machine = field(default_factory=load_machine)

    @property
    def table(self) -> pd.DataFrame:
        """term, ss, df, ms, F, p, p_holm, omega_squared (partial)."""
        from scipy.special import fdtrc

        table = pd.DataFrame([(line.name, line.sum_of_squares, line.df) for line in self.lines])
        table.columns = pd.Index(["term", "ss", "df"])
        table["ms"] = table["ss"] / table["df"].where(table["df"] > 0)
        error = self.lines[-1]
        table["F"] = (table["ms"] / (error.sum_of_squares / error.df)).where(table["term"] != RESIDUAL_NAME)
        table["p"] = fdtrc(table["df"].astype(float), float(error.df), table["F"])
        tested = table["p"].notna()
        table.loc[tested, "p_holm"] = adjust_holm(table.loc[tested, "p"])
        excess = table["df"] * (table["F"] - 1.0)
        return table.assign(omega_squared=np.maximum(0.0, excess / (excess + self.count)))

    def to_json(self) -> list[dict[str, object]]:
        """One object for each term, with the fields of `RECORD_COLUMNS`."""
        records = []
        for row in self.table[:-1].itertuples(index=False):
            record: dict[str, object] = dict.fromkeys(RECORD_COLUMNS)
            record |= {"analysis": f"formula: {row.term}", "joint": self.joint, "error_term": RESIDUAL_NAME}
            if row.df:
                record |= {"F": row.F, "df": [row.df, self.lines[-1].df], "p_value": row.p}
                record |= {"p_holm": row.p_holm, "omega_squared": row.omega_squared}
            records.append(record)
        return records


@one_blas_thread
def analyze_formula(
    log: Log, text: str, *, joint: int | None = None, session: str | None = None, kind: int = 2
) -> tuple[FormulaTable, ...]:
    """Analyse any columns of a log, each joint by itself.

    Factors are columns of `step_size_observations`, which has the log's own (``covariate:pressure`` may be
    called ``pressure``) and step_size, configuration and orientation; and ``position``, the stretch of the
    travel, and ``setting``, a label of all other positions, as `name_stretches` has them. A model with
    ``position`` is of the traverses that have one. Text is a factor, and ``C(name)`` makes
    one of numbers; ``log(name)`` is the logarithm, and ``Q("name")`` a name with spaces or signs. ``a / b``
    nests b in a, whether or not b's labels start anew in each a: degrees of freedom are ranks.

    Parameters
    ----------
    log : Log
    text : str
        See `stickslip_fit.anova.grammar`; it is never evaluated as code.
    joint : int, optional
        Of this joint only.
    session : str, optional
        Of this session only.
    kind : {1, 2, 3}, optional
        Type of the sums of squares: in order, each beside those that do not contain it, each beside all
        others.

    Raises
    ------
    InputError
        If the formula cannot be read, names a column that the log does not have, meets empty cells, leaves
        no residual scatter, or asks for type III where some combinations of levels are missing.
    """
    rows = add_plain_names(select_observations(step_size_observations(log), joint, session))
    return tuple(
        _analyze_joint(add_stretches(subset, text, log.machine), int(one), log.machine, text, kind)
        for one, subset in rows.groupby("joint")
    )


def add_stretches(rows: pd.DataFrame, text: str, machine: Machine) -> pd.DataFrame:
    """One joint's rows with position and setting, unless the lab has columns of these names.

    Where the formula has the position, rows without one are left out.
    """
    named = name_stretches(rows, machine)
    new = [name for name in (POSITION, "setting") if name not in rows.columns]
    rows = rows.assign(**{name: named[name] for name in new})
    formula = parse_formula(text, rows.columns)
    if POSITION not in new or not any(factor.column == POSITION for term in formula.terms for factor in term):
        return rows
    rows = rows[rows[POSITION].notna()]
    if rows.empty:
        raise InputError(
            "no stretch of the travel was driven often enough to be a position: leave position out of the "
            "formula, or drive stretches"
        )
    return rows


def add_plain_names(rows: pd.DataFrame) -> pd.DataFrame:
    """The lab's own columns also without their prefix, where that name is free."""
    plain = {
        name: name.removeprefix(prefix)
        for prefix in LAB_COLUMN_PREFIXES
        for name in rows.columns
        if name.startswith(prefix) and name.removeprefix(prefix) not in rows.columns
    }
    return rows.assign(**{short: rows[name] for name, short in plain.items()})


def _analyze_joint(rows: pd.DataFrame, joint: int, machine: Machine, text: str, kind: int) -> FormulaTable:
    if kind not in TYPES:
        raise InputError(f"type {kind} of sums of squares is none of 1, 2, 3")
    values, terms = model_terms(rows, text, sums_to_zero=kind == 3)
    lines = anova_rows(values, terms, kind)
    rest, rounding = lines[-1], EXACT_FIT_TOL * float(np.abs(values).max())
    if rest.df < 1 or rest.sum_of_squares <= rest.df * rounding**2:
        raise InputError(f"joint {joint}: {text!r} leaves no scatter to compare with; leave a term out")
    if kind == 3:
        _check_estimable(terms, lines)
    return FormulaTable(joint, text, kind, tuple(lines), len(values), machine)


def _check_estimable(terms: Sequence[ModelTerm], lines: Sequence[AnovaRow]) -> None:
    for term, line in zip(terms, lines, strict=False):
        if line.df < term.columns.shape[1]:
            raise InputError(
                f"type 3 cannot separate {term.name} from the other terms, or lacks traverses of some "
                "combination of its levels; ask for type 1 or 2 (--type)"
            )


def anova_rows(values: Array, terms: Sequence[ModelTerm], kind: int) -> list[AnovaRow]:
    """The terms' sums of squares, each from the model with it and the model without it, and the residual's.

    Parameters
    ----------
    values : array, shape (n,)
    terms : sequence of ModelTerm
        Without the intercept, which is always there.
    kind : {1, 2, 3}
        What a term is added to: the terms before it; all that do not contain it; all others, which needs
        columns that are coded by sum-to-zero contrasts.

    Examples
    --------
    >>> session = ModelTerm("session", frozenset({"session"}), np.array([[1.0], [1], [0], [0]]))
    >>> rows = anova_rows(np.array([1.0, 2, 3, 4]), [session], kind=1)
    >>> [(row.name, round(row.sum_of_squares, 9), row.df) for row in rows]
    [('session', 4.0, 1), ('residual', 1.0, 2)]
    """
    values, rows = subtract_median(values), []
    for index, term in enumerate(terms):
        if kind == 1:
            others = list(terms[:index])
        elif kind == 2:
            others = [other for other in terms if not term.factors <= other.factors]
        else:
            others = [other for other in terms if other is not term]
        smaller, larger = _least_squares(values, others), _least_squares(values, [*others, term])
        df = int(smaller.df_resid - larger.df_resid)
        # What the residual sums of squares differ by, without the digits that their difference would lose.
        squares = float(np.sum((smaller.resid - larger.resid) ** 2)) if df else 0.0
        rows.append(AnovaRow(term.name, squares, df))
    full = _least_squares(values, terms)
    return [*rows, AnovaRow(RESIDUAL_NAME, float(full.ssr), int(full.df_resid))]


def _least_squares(values: Array, terms: Sequence[ModelTerm]) -> Any:
    """The fit of ordinary least squares with these terms and an intercept.

    Columns that others span are taken out first: OLS's pseudo-inverse keeps singular values down to 1e-15
    of the largest, and what rounding leaves of such columns is often more. The fit then follows noise.
    """
    from statsmodels.regression.linear_model import OLS

    intercept = np.full((len(values), 1), len(values) ** -0.5)
    columns = np.hstack([np.empty((len(values), 0)), *(term.columns for term in terms)])
    design = np.hstack([intercept, orthonormal_basis(columns, beyond=intercept)])
    return OLS(values, design).fit(method="pinv")


def model_terms(rows: pd.DataFrame, text: str, *, sums_to_zero: bool) -> tuple[Array, list[ModelTerm]]:
    """The response and the terms, main effects first, else in the order of the formula, as R has them.

    Parameters
    ----------
    sums_to_zero : bool
        Code factors by contrasts that sum to zero, which type III needs; else by one column for each level,
        of which only what they span matters.

    Raises
    ------
    InputError
        If the formula cannot be read or evaluated.
    """
    formula = parse_formula(text, rows.columns)
    response = _factor_values(formula.response, rows)
    if response.labels:
        raise InputError(f"the formula {text!r} must have one numeric response before its ~, e.g. step_size")
    factors = dict.fromkeys(factor for term in formula.terms for factor in term)
    known = {factor: _factor_values(factor, rows) for factor in factors}
    asked = {frozenset(), *map(frozenset, formula.terms)}
    terms = []
    for term in formula.terms:
        names = [factor.name for factor in term]
        columns = _product_columns(term, known, asked, sums_to_zero)
        terms.append(ModelTerm(":".join(names), frozenset(names), columns))
    _check_size(factors, sum(term.columns.shape[1] for term in terms), len(rows))
    return response.values, terms


@dataclass(frozen=True)
class FactorValues:
    """Numbers of a factor, shape (n,); or codes from 0 of `labels` labels, which is 0 for numbers."""

    values: npt.NDArray[Any]
    labels: int = 0


def _factor_values(factor: Factor, rows: pd.DataFrame) -> FactorValues:
    """Numbers as they are; everything else, and what is in ``C``, as labels."""
    column = rows[factor.column]
    numeric = pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column)
    if numeric:
        values = column.to_numpy(float)
        if not np.isfinite(values).all():
            raise InputError(f"{factor.name} has empty cells or no numbers for this joint; leave it out")
        if factor.function == "log" and not (values > 0).all():
            raise InputError(f"{factor.name} is of numbers that are not above 0; leave log out")
        if factor.function != "C":
            return FactorValues(np.log(values) if factor.function == "log" else values)
    elif factor.function == "log":
        raise InputError(f"{factor.name} is of text; log takes numbers")
    codes, labels = pd.factorize(column if numeric else column.astype(str), sort=True)
    return FactorValues(codes, len(labels))


def _product_columns(
    product: Term, known: Mapping[Factor, FactorValues], asked: Set[frozenset[Factor]], sums_to_zero: bool
) -> Array:
    """Products of the factors' columns, shape (n, p).

    A factor is coded by contrasts where the term without it is in the model too; where it is not, the factor
    is nested, and has a column for each level. Without contrasts, a column is of a combination that occurs.
    """
    numbers = [known[factor].values for factor in product if not known[factor].labels]
    labelled = [factor for factor in product if known[factor].labels]
    n = len(next(iter(known.values())).values)
    columns = reduce(np.multiply, numbers, np.ones(n))[:, None]
    if not sums_to_zero:
        cells = np.zeros(n, dtype=np.intp)
        for factor in labelled:
            cells = pd.factorize(cells * known[factor].labels + known[factor].values)[0]
        _check_size(product, int(cells.max()) + 1, n)
        return columns * indicator_columns(cells)
    nested = {factor: frozenset(product) - {factor} not in asked for factor in labelled}
    _check_size(product, prod(known[factor].labels - (not nested[factor]) for factor in labelled), n)
    for factor in labelled:
        values = indicator_columns(known[factor].values)
        values = values if nested[factor] else values[:, :-1] - values[:, -1:]
        columns = (columns[:, :, None] * values[:, None, :]).reshape(n, -1)
    return columns


def _check_size(terms: Iterable[Factor], columns: int, rows: int) -> None:
    """Refuse what would take minutes and gigabytes."""
    if columns > min(MAX_COLUMNS, MAX_CELLS // rows):
        names = ", ".join(factor.name for factor in terms)
        raise InputError(f"{names} would take {columns:,} parameters, too many to compute; leave some out")
