"""What no fit can use: units that do not agree, numbers that are none, parameters that look alike.

Parameters that the rows cannot tell apart span the null space of the Jacobian, each session's own parameters
projected out of the shared ones. Where the direction is the same at two points of parameter space, a sum
alone is determined; where that of the logarithms is, a product.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._expression import Expression
from stickslip_fit._format import join_words
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.laws.base import Rows
from stickslip_fit.laws.dimensions import check_dimensions
from stickslip_fit.laws.table import (
    TableLaw,
    as_written,
    count_rows,
    mistyped_column,
    number_column,
    similar_name,
)

RANK_TOL = 1e-7  # singular values relative to the largest, columns of length 1
SAME_TOL = 1e-4  # between two points, and of a coefficient that is 0
MAX_ROWS = 20_000  # that are looked at
MAX_NAMES_SHOWN = 40
MIN_NAME = 4  # letters; a shorter one is seldom a mistyped column


def check_table_law(law: TableLaw, frame: pd.DataFrame, session: str | None) -> None:
    """Refuse a law that no fit can use in a table.

    Raises
    ------
    InputError
        See `Law.bind_table`.
    """
    _check_units(law)
    if len(frame) == 0:
        raise InputError("the table has no rows")
    if issues := list(filter(None, (_empty_cells(frame, name) for name in law.columns))):
        raise InputError(issues)
    y = law.response(frame)[0]
    if not np.isfinite(y).all():
        bad = ~np.isfinite(y)
        raise InputError(
            f"the response {law.response_name} is no number in row {_row_number(frame, bad)} of the table "
            f"({_values_in(law.left.names, frame, bad)})"
        )
    start = law.start_values(frame, y)
    _check_start(law, frame, start)
    if len(law.parameters) == 0:
        raise InputError(f"the law {law.name!r} has no parameters, so that there is nothing to fit")
    if len(frame) > MAX_ROWS:
        frame = frame.iloc[np.linspace(0, len(frame) - 1, MAX_ROWS).astype(int)]
    check_identifiable(law, frame, None if session is None else frame[session].tolist(), start)


def _check_units(law: TableLaw) -> None:
    units = {name: str(unit) for name, unit in law.source.units.items()}
    if isinstance(law.right, Expression) and law.response_name in units:
        expected = units[law.response_name]
        check_dimensions(law.right, units, expected, law.response_name, law.source.text)


def _empty_cells(frame: pd.DataFrame, name: str) -> InputIssue | None:
    bad = ~np.isfinite(number_column(frame, name))
    if not bad.any():
        return None
    return InputIssue(
        f"{np.count_nonzero(bad):,} of {len(bad):,} rows have no number here, first row "
        f"{_row_number(frame, bad)} of the table; leave them out or fill them in",
        column=name,
    )


def _check_start(law: TableLaw, frame: pd.DataFrame, start: Array) -> None:
    predicted, slopes = law.model(frame)(start)
    bad = ~(np.isfinite(predicted) & np.isfinite(slopes).all(axis=1))
    if not bad.any():
        return
    values = ", ".join(f"{one.name} = {value:.4g}" for one, value in zip(law.parameters, start, strict=True))
    what = "is no number" if not np.isfinite(predicted[bad][0]) else "has a derivative that is no number"
    columns = [name for name in law.columns if name in law.right.names]
    raise InputError(
        f"the law {law.name!r} {what} in {np.count_nonzero(bad):,} rows, first in row "
        f"{_row_number(frame, bad)} of the table ({_values_in(columns, frame, bad)}), "
        f"at the start values {values}; give start= or bounds= "
        "where it is one"
    )


def _values_in(names: Sequence[str], frame: pd.DataFrame, bad: BoolArray) -> str:
    row = int(np.argmax(bad))
    return ", ".join(f"{name} = {number_column(frame, name)[row]:.6g}" for name in names)


def _row_number(frame: pd.DataFrame, rows: BoolArray) -> int:
    """The number, from 1, of the first row that is true: its index, where rows have been left out."""
    first = int(np.argmax(rows))
    return 1 + (int(frame.index[first]) if pd.api.types.is_integer_dtype(frame.index) else first)


def check_identifiable(law: TableLaw, frame: Rows, labels: Sequence[Any] | None, start: Array) -> None:
    """Refuse parameters that the rows cannot tell apart in any session; `labels` name each row's.

    Raises
    ------
    InputError
        With what is determined of them.
    """
    n = count_rows(frame)
    places = [np.arange(n)]
    if labels is not None:
        places = list(
            pd.Series(range(n)).groupby(pd.factorize(np.asarray(labels, object))[0]).indices.values()
        )
    points = _generic_points(law, frame, start)
    jacobians = [law.jacobian(frame, point) for point in points]
    idle = [
        name for name, column in zip(law.parameter_names, jacobians[0].T, strict=True) if not column.any()
    ]
    if idle:
        have, them = ("has", "it") if len(idle) == 1 else ("have", "them")
        found = dict(zip(law.parameter_names, start, strict=True))
        values = join_words([f"{name} = {found[name]:.3g}" for name in idle])
        raise InputError(
            f"{join_words(idle)} {have} no effect on any row of this table, under the law {law.name!r}, near "
            f"{values}, with which it fits best; leave {them} out, give {them} bounds=, or take rows that "
            f"show {them}"
        )
    first, second = (_null_space(jacobian, places, law.n_shared) for jacobian in jacobians)
    if len(first) == 0 or len(first) != len(second):
        return
    if mistyped := _find_mistyped(law, frame, first):
        raise InputError(mistyped)
    reasons = [
        _explain(law.parameter_names, (one, other), jacobians, points)
        for one, other in zip(first, second, strict=True)
    ]
    within = ", within each session" if len(places) > 1 else ""
    advice = "; leave one of them out, or give it a value in the formula"
    if len(places) > 1 and law.n_shared < len(law.parameters):
        advice += ", or name what is the same in all sessions in shared="
    raise InputError(
        f"the parameters of {law.name!r} cannot be told apart{within}: {'; '.join(reasons)}{advice}"
        f"{_hints(law, frame, first)}"
    )


def _generic_points(law: TableLaw, frame: Rows, start: Array) -> tuple[Array, Array]:
    """Two points near the start values, within bounds, at which no parameter is 0."""
    predicted, slopes = law.model(frame)(start)
    moved = np.sqrt(np.mean(slopes**2, axis=0))
    size = 0.5 * (float(np.sqrt(np.mean(predicted**2))) or 1.0)
    natural = np.where(moved > 0, size / np.where(moved > 0, moved, 1.0), 1.0)
    centre = np.where(np.abs(start) < 1e-3 * natural, natural, start)
    low, high = np.array([(one.lower, one.upper) for one in law.parameters]).T
    wave = np.sin(1.0 + np.arange(len(start)))
    for share in (0.2, 0.05, 0.01):
        points = [np.clip(centre * (1.0 + share * sign * wave + share / 3), low, high) for sign in (1, -1)]
        if all(np.isfinite(law.jacobian(frame, point)).all() for point in points):
            return points[0], points[1]
    return start, start


def _null_space(jacobian: Array, places: Sequence[IntArray], n_shared: int) -> Array:
    """Directions of parameter space that no row shows in any session, shape (d, p), in echelon form.

    In units of each parameter's effect, the length of its column.
    """
    length = np.linalg.norm(jacobian, axis=0)
    scaled, p = jacobian / length, jacobian.shape[1]
    own = p - n_shared
    largest = max(places, key=len)
    nulls = [_kernel(scaled[rows, :own]) for rows in places]
    if own and all(len(null) for null in nulls):
        null = np.hstack([min(nulls, key=len), np.zeros((len(min(nulls, key=len)), n_shared))])
    else:
        remaining = np.empty((len(jacobian), n_shared))
        for rows in places:
            follow = np.linalg.lstsq(scaled[rows, :own], scaled[rows, own:], rcond=RANK_TOL)[0]
            remaining[rows] = scaled[rows, own:] - scaled[rows, :own] @ follow
        shared = _kernel(remaining)
        follow = np.linalg.lstsq(scaled[largest, :own], scaled[largest, own:] @ shared.T, rcond=RANK_TOL)[0]
        null = np.hstack([-follow.T, shared])
    return _echelon(null)


def _kernel(columns: Array) -> Array:
    """An orthonormal basis of what the columns map to 0, shape (d, p)."""
    if columns.shape[1] == 0:
        return np.zeros((0, 0))
    _, singular, right = np.linalg.svd(np.linalg.qr(columns, mode="r"), full_matrices=True)
    singular = np.pad(singular, (0, columns.shape[1] - len(singular)))
    return right[singular <= RANK_TOL]


def _echelon(rows: Array) -> Array:
    """Combinations of the rows with as many zeros as there are rows less one, each of length 1."""
    rows, used = rows.copy(), list[int]()
    for k in range(len(rows)):
        weight = np.abs(rows[k]) / np.abs(rows).max(axis=0).clip(min=np.finfo(float).tiny)
        weight[used] = 0.0
        pivot = int(np.argmax(weight))
        used.append(pivot)
        rows[k] /= rows[k, pivot]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, pivot] * rows[k]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _explain(
    names: Sequence[str], nulls: tuple[Array, Array], jacobians: Sequence[Array], points: tuple[Array, Array]
) -> str:
    """What is determined of the parameters that a direction changes together; all at two points."""
    first, second = (
        null / np.linalg.norm(jacobian, axis=0) for null, jacobian in zip(nulls, jacobians, strict=True)
    )
    acts = np.flatnonzero(np.abs(nulls[0]) > SAME_TOL * np.abs(nulls[0]).max()).tolist()
    together = sorted(acts, key=lambda k: -abs(first[k]))
    changed = [names[k] for k in together]
    one, other = first[together], second[together]
    if _are_parallel(one, other):
        return f"only {join_words(_sums(changed, one))} {_is(changed)} determined"
    one, other = one / points[0][together], other / points[1][together]
    if _are_parallel(one, other):
        if len(one) == 2 and np.isclose(one[0], -one[1], rtol=SAME_TOL):
            return f"{join_words(changed)} occur only as a product"
        if len(one) == 2 and np.isclose(one[0], one[1], rtol=SAME_TOL):
            return f"{join_words(changed)} occur only as a ratio"
        return f"only {join_words(_products(changed, one))} {_is(changed)} determined"
    return f"a change of {join_words(changed)} together leaves every row as it is"


def _are_parallel(one: Array, other: Array) -> bool:
    ratio = other / one
    return bool(np.all(np.abs(ratio - ratio[0]) <= SAME_TOL * abs(ratio[0])))


def _is(changed: Sequence[str]) -> str:
    return "is" if len(changed) == 2 else "are"


def _sums(names: Sequence[str], direction: Array) -> list[str]:
    """The sums of parameters that a direction leaves as they are."""
    sums = []
    for name, share in zip(names[:-1], direction[:-1], strict=True):
        factor = -share / direction[-1]
        size = "" if abs(abs(factor) - 1.0) < SAME_TOL else f"{abs(factor):.4g}*"
        sums.append(f"{name} {'+' if factor > 0 else '-'} {size}{names[-1]}")
    return sums


def _products(names: Sequence[str], direction: Array) -> list[str]:
    """The products of powers of parameters that a direction of their logarithms leaves as they are."""
    products = []
    for name, share in zip(names[:-1], direction[:-1], strict=True):
        power = -share / direction[-1]
        exponent = "" if abs(abs(power) - 1.0) < SAME_TOL else f"**{abs(power):.4g}"
        products.append(f"{name}{'*' if power > 0 else '/'}{names[-1]}{exponent}")
    return products


def _find_mistyped(law: TableLaw, frame: Rows, null: Array) -> list[InputIssue]:
    """Parameters that cannot be told from others and are columns but for their case or a letter."""
    columns = [str(column) for column in frame]
    names = {name: mistyped_column(name, columns) for name in _undeclared(law, null)}
    return [explain_mistyped(name, other, columns) for name, other in names.items() if other]


def explain_mistyped(name: str, other: str, columns: Sequence[str]) -> InputIssue:
    """A name of a law that is almost a column."""
    return InputIssue(
        f"no column {name}; the table has {as_written(other)} (columns: {list_names(columns)}). If {name} is "
        "a parameter, name it in the law's units, bounds or start"
    )


def list_names(names: Sequence[str]) -> str:
    """Columns of a table, the first of them where there are many."""
    shown = ", ".join(shorten(name) for name in names[:MAX_NAMES_SHOWN])
    return shown + (f" and {len(names) - MAX_NAMES_SHOWN:,} more" if len(names) > MAX_NAMES_SHOWN else "")


def _hints(law: TableLaw, frame: Rows, null: Array) -> str:
    """Parameters that may be mistyped columns."""
    names = _undeclared(law, null)
    for name in names:
        similar = similar_name(name, [str(column) for column in frame])
        if similar and len(name) >= MIN_NAME:
            return f". {name} is no column and so taken for a parameter; did you mean {similar}?"
    return f". Names that are no column are parameters, here {join_words(names)}" if names else ""


def _undeclared(law: TableLaw, null: Array) -> list[str]:
    """Parameters that directions change, and of which the law says nothing but their names."""
    declared = {*law.source.units, *law.source.bounds, *law.source.start, *law.source.shared}
    changed = np.flatnonzero(np.abs(null).max(axis=0) > 0).tolist()
    return [name for name in (law.parameter_names[k] for k in changed) if name not in declared]
