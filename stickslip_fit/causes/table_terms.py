"""Terms without a cause, of a table: what the diagnosis adds to a law for structure that has no name.

As `proposed` has them for logs: a `SmoothTableTerm` is a smooth function of one column, of two, or of the
response as the law predicts it; a `PeriodicTableTerm` a wave in time; a `ProposedTableTerm` one number times
a short expression, such as k log(speed).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.polynomial.legendre import legvander

from stickslip_fit._format import format_duration
from stickslip_fit._typing import Array
from stickslip_fit.causes import carrier_function
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.carrier_function import write_expression, write_quotient
from stickslip_fit.causes.generic import AddedTerm, GenericCause, Term, linear_term
from stickslip_fit.causes.levels import name_levels
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.smooth import cosines, harmonics, wave_products
from stickslip_fit.causes.table_cause import Effect, Stage
from stickslip_fit.laws import Rows
from stickslip_fit.units import TableUnit

GROUP = "group"  # the carrier that is what belongs together
PREDICTION = "prediction"  # the carrier that is the response as the law predicts it


@dataclass(frozen=True, kw_only=True)
class SmoothTableTerm(GenericCause):
    """A sum of cosines over one carrier, or of their products over two.

    Attributes
    ----------
    carriers : tuple of str
        Columns; or `PREDICTION` alone.
    limits : tuple of (float, float)
        Range of each; beyond it the function is constant.
    orders : tuple of tuple of int
        Of each function, the order of its cosine in each carrier; 0 where it does not depend on it.
    sds : tuple of float
        Prior standard deviation of each function's coefficient, in the unit of the response.
    response : str
        Name of the response.
    sessions : tuple of str
        With a function of each; without, one function for all.
    share_of : float
        A size of the response, not 0: each function is a share of what the law predicts, and its coefficient
        what it adds where that is this size.
    """

    carriers: tuple[str, ...]
    limits: tuple[tuple[float, float], ...]
    orders: tuple[tuple[int, ...], ...]
    sds: tuple[float, ...]
    response: str = ""
    sessions: tuple[str, ...] = ()
    share_of: float = 0.0

    base_name = "smooth-term"
    base_phrase = "the response follows something smoothly that no cause describes"
    physics = "Whatever the carrier stands for: the table alone shows that the response follows it smoothly."
    shows_best = "one condition at the lowest and at the highest values of the carrier"
    combine_trials = True
    shape = "a smooth function"

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        own = [name for name in self.carriers if name != PREDICTION]
        own += [self.direction] if self.direction else []
        return (*own, "session") if self.sessions else tuple(own)

    @property
    def texts(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.direction,) if self.labels else ()

    @property
    def constant_beyond(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(name for name in self.carriers if name != PREDICTION)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        meaning = f"of {self.shape} of {' and '.join(self.carriers)}"
        unit = TableUnit(self.unit)
        return tuple(
            CauseParameter(
                f"c{number}", unit, f"coefficient {number} {meaning}", session=session, prior_sd=sd
            )
            for session in self.sessions or (None,)
            for number, sd in enumerate(self.sds, 1)
        )

    def with_amplitude(self, amplitude: float) -> Self:
        """The same with another size: all prior standard deviations times a number."""
        return replace(self, sds=tuple(amplitude * sd for sd in self.sds))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [(self, np.diag([parameter.prior_sd for parameter in self.parameters]))]

    def stage_in(self, response: str) -> Stage:
        """See `TableCause`: what follows the prediction is added to all else."""
        return "measurement" if self.needs_prediction else "term"

    @property
    def needs_prediction(self) -> bool:
        """Whether it depends on what the law predicts."""
        return PREDICTION in self.carriers or self.share_of != 0.0

    def functions(self, rows: Rows, prediction: Array | None = None) -> Array:
        """Each function in each row, session by session, shape (n, q)."""
        waves = self._waves(rows, prediction)
        if self.share_of:
            waves = waves * (np.asarray(prediction, float) / self.share_of)[:, None]
        if not self.sessions:
            return waves
        inside = np.asarray(rows["session"], object).astype(str)[:, None] == np.array(self.sessions)
        return np.asarray((inside[:, :, None] * waves[:, None]).reshape(len(waves), -1))

    def _waves(self, rows: Rows, prediction: Array | None) -> Array:
        """Each function in each row, as if all were of one session."""
        values = [
            np.asarray(prediction if name == PREDICTION else rows[name], float) for name in self.carriers
        ]
        waves = [
            cosines(one, low, high, max(order[place] for order in self.orders))
            for place, (one, (low, high)) in enumerate(zip(values, self.limits, strict=True))
        ]
        return wave_products(waves, self.orders)

    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        sign = self.sign(rows)
        if not self.needs_prediction:
            term = linear_term(sign[:, None] * self.functions(rows))
            return lambda state, values: (*term(values), {})

        def effect(state: Mapping[str, Array], values: Array) -> tuple[Array, Array, Mapping[str, Array]]:
            predicted = np.broadcast_to(state[self.response], len(values))
            columns = sign[:, None] * self.functions(rows, predicted)
            slopes = sign * np.sum(values * self._slopes(rows, predicted), axis=1)
            return np.sum(values * columns, axis=1), columns, {self.response: slopes}

        return effect

    def _slopes(self, rows: Rows, prediction: Array) -> Array:
        """Derivatives of the functions by the prediction, shape (n, q)."""
        if self.share_of:
            return self.functions(rows, np.full(len(prediction), self.share_of)) / self.share_of
        ((low, high),) = self.limits
        rate = np.pi * np.array([k for (k,) in self.orders]) / (high - low)
        inside = ((prediction > low) & (prediction < high))[:, None]
        return np.where(inside, -rate * np.sin(rate * (prediction[:, None] - low)), 0.0)

    def changes(self, law: Any, rows: Rows, values: Array, trials: Array) -> Array:
        """See `Cause`: all trials at once."""
        prediction = law.predict(rows, values) if self.needs_prediction else None
        return np.asarray(self.sign(rows)[:, None] * (self.functions(rows, prediction) @ trials.T))


@dataclass(frozen=True, kw_only=True)
class PeriodicTableTerm(SmoothTableTerm):
    """A wave in time, each session's its own.

    Attributes
    ----------
    period : float
        In the unit of the time.
    """

    period: float
    time_unit: str = "s"
    orders: tuple[tuple[int, ...], ...] = ((1,), (2,))  # the cosine and the sine of each harmonic
    carriers: tuple[str, ...] = ("session_seconds",)

    base_name = "periodic-term"
    base_phrase = "the response comes and goes with a period that no cause describes"
    physics = "Whatever has this period: the table alone shows that the response follows it."
    shows_best = "one condition again and again, at most a quarter of the period apart"
    columns = ("session", "session_seconds")
    constant_beyond = ()
    shape = "a wave"

    def __str__(self) -> str:
        """Its period in words.

        Examples
        --------
        >>> str(PeriodicTableTerm(period=1.25, sessions=("all",), limits=((0.0, 9.0),), sds=(1.0, 1.0)))
        'period of 1.25 s'
        """
        return f"period of {format_duration(self.period, self.time_unit)}"

    def _waves(self, rows: Rows, prediction: Array | None) -> Array:
        """Cosine and sine of each harmonic."""
        return harmonics(np.asarray(rows["session_seconds"], float), self.period, len(self.orders) // 2)


@dataclass(frozen=True, kw_only=True)
class CourseTerm(SmoothTableTerm):
    """Legendre polynomials in the time since each session began, `orders` being their degrees.

    What a law lacks of a session of a signal is as steep at its ends as anywhere, where cosines are level.
    """

    carriers: tuple[str, ...] = ("session_seconds",)

    @classmethod
    def of_degrees(cls, degrees: Sequence[int], **attributes: Any) -> Self:
        """Of some degrees; the higher one is, the smaller its coefficient is expected to be."""
        return cls(orders=tuple((k,) for k in degrees), sds=tuple(1.0 / k**2 for k in degrees), **attributes)

    def _waves(self, rows: Rows, prediction: Array | None) -> Array:
        """Each polynomial in each row."""
        ((low, high),), degrees = self.limits, [k for (k,) in self.orders]
        place = np.clip((np.asarray(rows["session_seconds"], float) - low) / (high - low), 0.0, 1.0)
        return np.asarray(legvander(2.0 * place - 1.0, max(degrees))[:, degrees])


@dataclass(frozen=True, kw_only=True)
class SettingsTerm(SmoothTableTerm):
    """A value of its own for each setting of some columns, of one size for all; 0 at any other setting.

    Attributes
    ----------
    levels : tuple of str
        The settings, as of `name_settings`.
    """

    levels: tuple[str, ...]

    base_name = "settings-term"
    base_phrase = "the response differs between settings as no cause describes"
    physics = "Whatever differs between them: replicates of a setting agree better than they do with the law."
    shows_best = "replicates of each setting"
    constant_beyond = ()

    @property
    def texts(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.carriers

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        unit, where = TableUnit(self.unit), f"offset where {', '.join(self.carriers)} are"
        return tuple(
            CauseParameter(f"c{number}", unit, f"{where} {level}", prior_sd=sd)
            for number, (level, sd) in enumerate(zip(self.levels, self.sds, strict=True), 1)
        )

    @classmethod
    def of(cls, carriers: tuple[str, ...], levels: Array, **attributes: Any) -> Self:
        """For the settings, shape (m,), of some columns."""
        return cls(
            carriers=carriers,
            levels=tuple(map(str, levels)),
            limits=(),
            orders=tuple((k,) for k in range(1, len(levels) + 1)),
            sds=(1.0,) * len(levels),
            **attributes,
        )

    def _waves(self, rows: Rows, prediction: Array | None) -> Array:
        """Whether each row has each setting."""
        return (name_settings(rows, self.carriers)[:, None] == np.array(self.levels)) * 1.0


def name_settings(rows: Rows, columns: Sequence[str]) -> Array:
    """What the columns are set to in each row, shape (n,).

    Examples
    --------
    >>> name_settings({"d": np.array([1.0, 2.5]), "tube": ["wide", "wide"]}, ["d", "tube"]).tolist()
    ['1, wide', '2.5, wide']
    """
    return np.array(list(map(", ".join, zip(*(name_levels(rows[name]) for name in columns), strict=True))))


@dataclass(frozen=True)
class ColumnFunction:
    """A short expression in (column - middle) / unit.

    Attributes
    ----------
    expression : str
        One of `EXPRESSIONS`.
    """

    expression: str
    column: str
    middle: float
    unit: float

    def values(self, column: Array) -> Array:
        """From the column, shape (n,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return EXPRESSIONS[self.expression]((column - self.middle) / self.unit)

    def __str__(self) -> str:
        """As a formula.

        Examples
        --------
        >>> str(ColumnFunction("x^2", "speed", 14.5, 10.5)), str(ColumnFunction("log(x)", "speed", 0.0, 12.0))
        ('((speed - 14.5) / 10.5)^2', 'log(speed / 12)')
        """
        return write_expression(self.expression, write_quotient(self.column, self.middle, self.unit))


EXPRESSIONS: dict[str, Callable[[Array], Array]] = {
    **{expression: carrier_function.EXPRESSIONS[expression] for expression in ("x", "x^2", "|x|")},
    "log(x)": np.log,
}


@dataclass(frozen=True, kw_only=True)
class ProposedTableTerm(AddedTerm):
    """k times a product of one or two functions of a column each.

    Attributes
    ----------
    factors : tuple of (str, str, float, float)
        Each a `ColumnFunction`.
    """

    factors: tuple[tuple[str, str, float, float], ...]

    base_name = "proposed-term"
    base_phrase = "the response follows a term that no cause describes"
    physics = "Whatever stands behind it: of all short expressions this one describes the table best."
    shows_best = "conditions in which the term is smallest and greatest"

    @property
    def carriers(self) -> tuple[str, ...]:
        """The column of each factor."""
        return tuple(factor[1] for factor in self.factors)

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(dict.fromkeys(self.carriers))

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return (CauseParameter("k", TableUnit(self.unit), f"size of the proposed term {self.formula}"),)

    @property
    def formula(self) -> str:
        """For people, such as ``k * ((speed - 14.5) / 10.5)^2``."""
        text = "k * " + " * ".join(str(ColumnFunction(*factor)) for factor in self.factors)
        return text + (", opposite sign in the two directions" if self.direction else "")

    def term(self, rows: Rows) -> Term:
        columns = [
            ColumnFunction(*factor).values(np.asarray(rows[factor[1]], float)) for factor in self.factors
        ]
        return linear_term(np.prod(columns, axis=0)[:, None])
