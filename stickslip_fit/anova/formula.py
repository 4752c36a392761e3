"""Analysis of variance by formula, as in ``step_size ~ C(session) * direction``: types I, II and III.

patsy reads the formula. A term's sum of squares is the difference between two nested least-squares
models: type I after the terms before it, type II after all terms that do not contain it, type III after
all others with sum-to-zero coding. Degrees of freedom are ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._summary import Summarized
from stickslip_fit._typing import Array
from stickslip_fit.anova.analysis import RECORD_COLUMNS
from stickslip_fit.anova.contrasts import adjust_holm, indicator_columns, orthonormal_basis, subtract_median
from stickslip_fit.anova.designs import select_observations, step_size_observations
from stickslip_fit.errors import InputError
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import COVARIATE_PREFIX

RESIDUAL_NAME = "residual"
TYPES = (1, 2, 3)
EXACT_FIT_TOL = 1e-12  # relative scatter that is the rounding of doubles
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
    """

    joint: int
    formula: str
    kind: int
    lines: tuple[AnovaRow, ...]
    count: int

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


def analyze_formula(
    log: Log, text: str, *, joint: int | None = None, session: str | None = None, kind: int = 2
) -> tuple[FormulaTable, ...]:
    """Analyse any columns of a log, each joint by itself.

    Factors are columns of `step_size_observations`, which has the log's own (``covariate:pressure`` may be
    called ``pressure``) and step_size, configuration and orientation; numpy is ``np``. Text is a factor, and
    ``C(...)`` makes one of numbers. ``a / b`` nests b in a, whether or not b's labels start anew in each a:
    degrees of freedom are ranks.

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
        If the formula cannot be read, names a column that the log does not have, meets empty cells, leaves
        no residual scatter, or asks for type III where some combinations of levels are missing.
    """
    rows = add_plain_names(select_observations(step_size_observations(log), joint, session))
    return tuple(_analyze_joint(subset, int(one), text, kind) for one, subset in rows.groupby("joint"))


def add_plain_names(rows: pd.DataFrame) -> pd.DataFrame:
    """The lab's own columns also without their prefix, where that name is free."""
    plain = {
        name: name.removeprefix(prefix)
        for prefix in LAB_COLUMN_PREFIXES
        for name in rows.columns
        if name.startswith(prefix) and name.removeprefix(prefix) not in rows.columns
    }
    return rows.assign(**{short: rows[name] for name, short in plain.items()})


def _analyze_joint(rows: pd.DataFrame, joint: int, text: str, kind: int) -> FormulaTable:
    if kind not in TYPES:
        raise InputError(f"type {kind} of sums of squares is none of 1, 2, 3")
    values, terms = model_terms(rows, text, sums_to_zero=kind == 3)
    lines = anova_rows(values, terms, kind)
    rest, rounding = lines[-1], EXACT_FIT_TOL * float(np.abs(values).max())
    if rest.df < 1 or rest.sum_of_squares <= rest.df * rounding**2:
        raise InputError(f"joint {joint}: {text!r} leaves no scatter to compare with; leave a term out")
    if kind == 3:
        _check_estimable(terms, lines)
    return FormulaTable(joint, text, kind, tuple(lines), len(values))


def _check_estimable(terms: Sequence[ModelTerm], lines: Sequence[AnovaRow]) -> None:
    for term, line in zip(terms, lines, strict=False):
        if line.df < term.columns.shape[1]:
            raise InputError(
                f"type 3 cannot separate {term.name} from the other terms, or lacks readings of some "
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
    rows : DataFrame
    text : str
    sums_to_zero : bool
        Code factors by contrasts that sum to zero, which type III needs; else by one column for each level,
        of which only what they span matters.

    Raises
    ------
    InputError
        If the formula cannot be read or evaluated.
    """
    import patsy

    environment = patsy.EvalEnvironment([{"np": np}])
    data = {name: _plain_column(rows[name]) for name in rows.columns}
    try:
        wanted = patsy.ModelDesc.from_formula(text)
        response, design = patsy.dmatrices(wanted, data, environment, NA_action="raise")
        known = {
            factor.name(): _factor_values(info, data)
            for factor, info in design.design_info.factor_infos.items()
        }
    except Exception as error:  # a formula is code, and may fail in any way
        raise InputError(f"the formula {text!r} cannot be used: {_error_reason(error)}") from None
    products = [tuple(factor.name() for factor in term.factors) for term in wanted.rhs_termlist]
    products.sort(key=len)
    _check_formula(text, response.shape[1], products)
    asked = {frozenset(product) for product in products}
    return np.asarray(response)[:, 0], [
        ModelTerm(
            ":".join(product), frozenset(product), _product_columns(product, known, asked, sums_to_zero)
        )
        for product in products
        if product
    ]


def _check_formula(text: str, responses: int, products: list[tuple[str, ...]]) -> None:
    if responses != 1:
        raise InputError(f"the formula {text!r} must have one numeric response before its ~, e.g. step_size")
    if () not in products:
        raise InputError(f"the formula {text!r} leaves out the general mean; drop the 0 or -1")
    if len(products) == 1:
        raise InputError(f"the formula {text!r} has nothing after its ~ to look at, e.g. C(session)")


def _plain_column(column: pd.Series) -> Any:
    """Numbers as they are and everything else as text: what patsy takes for covariates and for factors."""
    if pd.api.types.is_numeric_dtype(column):
        return column.to_numpy()
    return column.astype(str).to_numpy(object)


def _factor_values(info: Any, data: dict[str, Any]) -> tuple[bool, npt.NDArray[Any]]:
    """Whether a factor is categorical, and its codes or its numbers, shape (n,) or (n, p)."""
    from patsy import NAAction
    from patsy.categorical import categorical_to_int

    found = info.factor.eval(info.state, data)
    if info.type == "categorical":
        return True, np.asarray(categorical_to_int(found, info.categories, NAAction()), dtype=np.intp)
    return False, np.asarray(found, float).reshape(len(found), -1)


def _product_columns(
    product: tuple[str, ...],
    known: dict[str, tuple[bool, npt.NDArray[Any]]],
    asked: set[frozenset[str]],
    sums_to_zero: bool,
) -> Array:
    """Products of the factors' columns, shape (n, p).

    A factor is coded by contrasts where the term without it is in the model too; where it is not, the factor
    is nested, and has a column for each level.
    """
    parts = []
    for name in product:
        categorical, values = known[name]
        if categorical:
            nested = frozenset(product) - {name} not in asked
            values = indicator_columns(values)
            values = values if nested or not sums_to_zero else values[:, :-1] - values[:, -1:]
        parts.append(values)
    return reduce(lambda one, other: (one[:, :, None] * other[:, None, :]).reshape(len(one), -1), parts)


def _error_reason(error: Exception) -> str:
    """The first line of what went wrong, without patsy's drawing of where."""
    line = str(error).splitlines()[0] if str(error) else type(error).__name__
    if "NaN" in line or "missing values" in line:
        return f"a column has empty cells or no numbers for this joint ({line}); leave it out"
    return line
