"""From a formula to the columns of its terms; patsy, the language that statsmodels speaks, reads it."""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.anova.linear import Term
from stickslip_fit.anova.projection import indicator
from stickslip_fit.errors import InputError

Array = npt.NDArray[np.float64]


def model_terms(rows: pd.DataFrame, text: str, *, sums_to_zero: bool) -> tuple[Array, list[Term]]:
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
    data = {name: _plain(rows[name]) for name in rows.columns}
    try:
        wanted = patsy.ModelDesc.from_formula(text)
        response, design = patsy.dmatrices(wanted, data, environment, NA_action="raise")
        known = {
            factor.name(): _values(info, data) for factor, info in design.design_info.factor_infos.items()
        }
    except Exception as error:  # a formula is code, and may fail in any way
        raise InputError(f"the formula {text!r} cannot be used: {_reason(error)}") from None
    products = [tuple(factor.name() for factor in term.factors) for term in wanted.rhs_termlist]
    products.sort(key=len)
    _refuse(text, response.shape[1], products)
    asked = {frozenset(product) for product in products}
    return np.asarray(response)[:, 0], [
        Term(":".join(product), frozenset(product), _columns(product, known, asked, sums_to_zero))
        for product in products
        if product
    ]


def _refuse(text: str, responses: int, products: list[tuple[str, ...]]) -> None:
    if responses != 1:
        raise InputError(f"the formula {text!r} must have one numeric response before its ~, e.g. step_size")
    if () not in products:
        raise InputError(f"the formula {text!r} leaves out the general mean; drop the 0 or -1")
    if len(products) == 1:
        raise InputError(f"the formula {text!r} has nothing after its ~ to look at, e.g. C(session)")


def _plain(column: pd.Series) -> Any:
    """Numbers as they are and everything else as text: what patsy takes for covariates and for factors."""
    if pd.api.types.is_numeric_dtype(column):
        return column.to_numpy()
    return column.astype(str).to_numpy(object)


def _values(info: Any, data: dict[str, Any]) -> tuple[bool, npt.NDArray[Any]]:
    """Whether a factor is categorical, and its codes or its numbers, shape (n,) or (n, p)."""
    from patsy import NAAction
    from patsy.categorical import categorical_to_int

    found = info.factor.eval(info.state, data)
    if info.type == "categorical":
        return True, np.asarray(categorical_to_int(found, info.categories, NAAction()), dtype=np.intp)
    return False, np.asarray(found, float).reshape(len(found), -1)


def _columns(
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
            values = indicator(values)
            values = values if nested or not sums_to_zero else values[:, :-1] - values[:, -1:]
        parts.append(values)
    return reduce(lambda one, other: (one[:, :, None] * other[:, None, :]).reshape(len(one), -1), parts)


def _reason(error: Exception) -> str:
    """The first line of what went wrong, without patsy's drawing of where."""
    line = str(error).splitlines()[0] if str(error) else type(error).__name__
    if "NaN" in line or "missing values" in line:
        return f"a column has empty cells or no numbers for this joint ({line}); leave it out"
    return line
