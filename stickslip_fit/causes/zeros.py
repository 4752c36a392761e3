"""Generic causes of a wrong zero: of the response, or of a column that the law uses.

A law through the origin, or one that diverges at it, is only as good as the zeros of the instruments. Where
the law has a parameter that absorbs such a zero there is no candidate for it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array
from stickslip_fit.causes.generic import AddedTerm, GenericCause, Term, linear_term
from stickslip_fit.causes.parameters import CauseParameter, Sizes
from stickslip_fit.causes.table_cause import Effect
from stickslip_fit.laws import Rows, TableLaw
from stickslip_fit.laws.table import count_rows, number_column
from stickslip_fit.units import TableUnit

MIN_LEFT = 0.01  # of a zero's effect, that the law's parameters and other zeros do not absorb
RANK_TOL = 1e-9  # of singular values


@dataclass(frozen=True, kw_only=True)
class ResponseZero(AddedTerm):
    """d in every row."""

    base_name = "offset"
    base_phrase = "the response has an offset"
    physics = (
        "A zero that was not adjusted, a background, or a part that acts without what the law describes."
    )
    shows_best = "the response where the law says that there is none"
    sentence = "The response is {d:higher|lower} by {d} in every row"
    remedy = "measuring the zero"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return (CauseParameter("d", TableUnit(self.unit), "offset of the response"),)

    def term(self, rows: Rows) -> Term:
        return linear_term(np.ones((count_rows(rows), 1)))


@dataclass(frozen=True, kw_only=True)
class ColumnZero(GenericCause):
    """column + d in place of a column.

    Attributes
    ----------
    slope : float
        Rms derivative of the response by the column.
    span : float
        The column's range.
    """

    column: str
    column_unit: str = ""
    slope: float = 1.0
    span: float = np.inf

    stage = "column"
    physics = (
        "A scale that does not begin where it is taken to begin, or a length that is taken to another end."
    )
    shows_best = "the smallest values of the column, where its zero matters most"
    sentence = "The law holds where {column} is taken to be {d:larger|smaller} by {d}"

    @property
    def base_name(self) -> str:  # type: ignore[override]
        return f"zero-of:{self.column}"

    @property
    def base_phrase(self) -> str:  # type: ignore[override]
        return f"the zero of {self.column} is off"

    @property
    def remedy(self) -> str:  # type: ignore[override]
        return f"measuring the zero of {self.column}"

    @property
    def target(self) -> str:  # type: ignore[override]
        return self.column

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.column,)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (self.size / self.slope,)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        meaning = f"to be added to {self.column}"
        return (CauseParameter("d", TableUnit(self.column_unit), meaning, -self.span, self.span),)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        return {**super().quantities(sizes), "column": self.column}

    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        ones = np.ones(count_rows(rows))

        def effect(state: Mapping[str, Array], values: Array) -> tuple[Array, Array, Mapping[str, Array]]:
            return state[self.column] + values[:, 0], ones[:, None], {self.column: ones}

        return effect


def zero_causes(rows: pd.DataFrame, law: TableLaw, y: Array, unit: str, size: float) -> list[GenericCause]:
    """The zeros that the law's parameters do not absorb; `size` as of a `GenericCause`."""
    values, n = law.start_values(rows, y), len(rows)
    known, found = law.jacobian(rows, np.tile(values, (n, 1))), list[GenericCause]()
    if not np.isfinite(known).all():
        return []
    if is_left(ones := np.ones((n, 1)), known):
        found.append(ResponseZero(unit=unit, size=size))
    known = np.concatenate([known, ones], axis=1)
    state = law.quantities(rows) | {
        name: np.full(n, value) for name, value in zip(law.parameter_names, values, strict=True)
    }
    for name in law.columns:
        if name not in law.right.names or name in law.left.names:
            continue
        slopes = np.broadcast_to(law.right.function((name,))(state)[1], (n, 1))
        if np.isfinite(slopes).all() and is_left(slopes, known):
            slope, cells = float(np.sqrt(np.mean(slopes**2))), number_column(rows, name)
            column_unit = str(law.source.units.get(name, ""))
            found.append(
                ColumnZero(
                    unit=unit,
                    size=size,
                    column=name,
                    column_unit=column_unit,
                    slope=slope,
                    span=float(np.ptp(cells)),
                )
            )
            known = np.concatenate([known, slopes], axis=1)
    return found


def leaves_session_offsets(rows: pd.DataFrame, law: TableLaw) -> bool:
    """Whether an offset of a session is left in one by the parameters that each session has of its own."""
    slopes = law.slopes_at_start(rows, law.response(rows)[0])
    slopes = slopes[:, : slopes.shape[1] - law.n_shared]
    places = rows.groupby("session", sort=False, observed=True).indices.values()
    return bool(np.isfinite(slopes).all()) and any(
        is_left(np.ones((len(own), 1)), slopes[own]) for own in places
    )


def is_left(column: Array, known: Array) -> bool:
    """Whether other columns, shape (n, p), leave something of a column, shape (n, 1)."""
    length = np.linalg.norm(known, axis=0)
    left, singular, _ = svd(known / np.where(length > 0, length, 1.0))
    basis = left[:, singular > RANK_TOL * singular.max(initial=0.0)]
    rest = column - basis @ (basis.T @ column)
    return bool(np.linalg.norm(rest) > MIN_LEFT * np.linalg.norm(column))
