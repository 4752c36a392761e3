"""Generic causes: what may be wrong with any law of a table, built from the table's columns.

Each adds to the response. Drift, warm-up, a sudden change, each further column, and the position, smooth or
periodic: each may act in both directions alike, or, as a candidate of its own, with the opposite sign in
either direction. An effect in one direction only is the sum of the two. Three candidates for each effect, one
with a size of its own in either direction, would tell no more, and could not be told from the other two.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd

from stickslip_fit._format import choose_time_unit
from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.parameters import (
    CauseParameter,
    SizedParameter,
    Sizes,
    candidate_moments,
    show_time,
)
from stickslip_fit.causes.roles import ONE_SESSION, direction_sign
from stickslip_fit.causes.smooth import cosines
from stickslip_fit.causes.table_cause import Effect, TableCause
from stickslip_fit.laws import Rows
from stickslip_fit.laws.table import count_rows
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.units import TableUnit

BY_DIRECTION = "-by-direction"
TRIAL_SHARE = 0.1  # of the response's standard deviation, in trials
COVARIATE_ORDER, POSITION_ORDER = 3, 6  # of polynomials
FINE_ORDER = 8  # of a polynomial over a column, where the simple one does not do
MAX_MOMENTS = 2000  # of a sudden change, each tried; with more rows some are left out
# Of the longest session; what takes longer is a drift.
TIME_CONSTANT_SHARES = np.array([0.02, 0.05, 0.1, 0.2, 0.35])

Term = Callable[[Array], tuple[Array, Array]]
"""Values of a cause's parameters, (n, q), to what is added, (n,), and its derivatives, (n, q)."""


@dataclass(frozen=True, kw_only=True)
class GenericCause(TableCause):
    """Adds a term to the response of a table.

    Attributes
    ----------
    unit : str
        Of the response.
    size : float
        Of an effect in trials, in that unit.
    direction : str
        Column of the direction, where the effect has the opposite sign in either; else empty.
    labels : tuple of str
        As of `direction_sign`.
    """

    unit: str = ""
    size: float = 1.0
    direction: str = ""
    labels: tuple[str, ...] = ()

    base_name: ClassVar[str]
    base_phrase: ClassVar[str]
    # What the law lacks may be nearly all of the response, and from end to end several standard deviations.
    max_trial_factor = 10.0 / TRIAL_SHARE
    # Autocorrelation is known within an error: slow effects no larger than noise that persists may be noise.
    share_where_noise_persists = 0.1

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.base_name + (BY_DIRECTION if self.direction else "")

    @property
    def phrase(self) -> str:  # type: ignore[override]
        return self.base_phrase + (", oppositely in the two directions" if self.direction else "")

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (self.size,) * len(self.parameters)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        opposite = ", oppositely in the two directions" if self.direction else ""
        return {**super().quantities(sizes), "opposite": opposite}

    def sign(self, rows: Rows) -> Array:
        """-1 in the backward direction where the effect has the opposite sign in either, else 1; (n,)."""
        if not self.direction:
            return np.ones(count_rows(rows))
        return direction_sign(rows, self.direction, self.labels)

    def bind_table(self, law: Any, frame: pd.DataFrame) -> GenericCause:
        """The same: it is bound to a table already."""
        return self


@dataclass(frozen=True, kw_only=True)
class AddedTerm(GenericCause):
    """Adds the same to the response whatever the law's parameters."""

    @abstractmethod
    def term(self, rows: Rows) -> Term:
        """What is added to the response of these rows, the direction left out."""

    def signed_term(self, rows: Rows) -> Term:
        """What is added to the response of these rows."""
        term = self.term(rows)
        if not self.direction:
            return term
        sign = self.sign(rows)

        def signed(values: Array) -> tuple[Array, Array]:
            added, slopes = term(values)
            return sign * added, sign[:, None] * slopes

        return signed

    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        term = self.signed_term(rows)
        return lambda state, values: (*term(values), {})

    def changes(self, law: Any, rows: Rows, values: Array, trials: Array) -> Array:
        """See `Cause`: whatever the law."""
        term, n = self.signed_term(rows), len(values)
        return np.stack([term(np.broadcast_to(trial, (n, len(trial))))[0] for trial in trials], axis=1)


def linear_term(basis: Array) -> Term:
    """The term of a linear combination of columns, shape (n, q)."""

    def term(values: Array) -> tuple[Array, Array]:
        return np.asarray(np.sum(values * basis, axis=1)), basis

    return term


@dataclass(frozen=True, kw_only=True)
class SteadyDrift(AddedTerm):
    """k t, t from the session's first row."""

    longest: float = 1.0
    time_unit: str = "s"

    base_name = "drift"
    base_phrase = "the response drifts"
    physics = (
        "Whatever changes slowly and steadily, such as a temperature, a battery or a relaxing clamp, changes "
        "the response in proportion to time."
    )
    shows_best = "the same condition at the beginning, in the middle and at the end"
    sentence = "The response {k:rises|falls} steadily, by {k}{opposite}"
    remedy = "recalibrating within the session"
    columns = ("session_seconds",)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        per = self._name_one(self.time_unit)
        return (CauseParameter("k", self._unit_per(per), f"change of the response per {per}"),)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (self.size / self.longest,)

    def readable(self, parameters: Sequence[SizedParameter]) -> tuple[SizedParameter, ...]:
        """See `Cause`: the change per hour or day, where the table is that long."""
        name, size = choose_time_unit(self.longest, self.time_unit)
        if size == 1.0:
            return tuple(parameters)
        unit = self._unit_per(self._name_one(name))
        return tuple(one.times(size, unit) for one in parameters)

    @staticmethod
    def _name_one(time_unit: str) -> str:
        is_word = len(time_unit) > len("ms")  # and no symbol
        return time_unit.removesuffix("s") if is_word else time_unit

    def _unit_per(self, time: str) -> TableUnit:
        return TableUnit(f"{self.unit}/{time}" if self.unit else f"per {time}")

    def term(self, rows: Rows) -> Term:
        return linear_term(np.asarray(rows["session_seconds"], float)[:, None])


@dataclass(frozen=True, kw_only=True)
class WarmUp(SteadyDrift):
    """A (1 - exp(-t / tau)), t from the session's first row."""

    base_name = "warm-up"
    base_phrase = "something warms up"
    physics = (
        "What is switched on warms towards a balance with its surroundings, exponentially with the time "
        "constant of its heat capacity, and takes the response with it."
    )
    shows_best = "the same condition, again and again from the first minute on"
    sentence = (
        "The response {A:rises|falls} by {A} towards a steady value, with a time constant of {tau}{opposite}"
    )
    remedy = "waiting until it is warm"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        low, high = 0.2 * TIME_CONSTANT_SHARES[0] * self.longest, 3.0 * self.longest
        return (
            CauseParameter("A", TableUnit(self.unit), "change of the response once warm"),
            CauseParameter("tau", TableUnit(self.time_unit), "time constant of warming up", low, high),
        )

    @property
    def null_values(self) -> tuple[float, ...]:
        return (0.0, self.scale[1])

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (self.size, 0.2 * self.longest)

    def readable(self, parameters: Sequence[SizedParameter]) -> tuple[SizedParameter, ...]:
        return show_time(parameters, "tau", self.time_unit)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        tau = TIME_CONSTANT_SHARES * self.longest
        return [(self, np.column_stack([np.full(len(tau), self.size), tau]))]

    def term(self, rows: Rows) -> Term:
        seconds = np.asarray(rows["session_seconds"], float)

        def term(values: Array) -> tuple[Array, Array]:
            size, tau = values.T
            left = np.exp(-seconds / tau)
            return size * (1.0 - left), np.column_stack([1.0 - left, -size * left * seconds / tau**2])

        return term


@dataclass(frozen=True, kw_only=True)
class SuddenChange(AddedTerm):
    """A from one moment of one session on."""

    session: str = ""
    time_unit: str = "s"

    base_name = "sudden-change"
    base_phrase = "something changed at one moment"
    physics = (
        "A knock, a cable that is moved, a screw that gives or a setting that is changed: from one row to "
        "the next the response is another, and stays so until the session's end."
    )
    shows_best = "the conditions of before the change, measured once more after it"
    remedy = "calibrating anew after it"
    columns = ("session", "session_seconds")

    @property
    def sentence(self) -> str:  # type: ignore[override]
        where = "after the first row" if self.session == ONE_SESSION else "into session {session}"
        return "The response {A:rises|falls} by {A}, {moment} " + where + ", and stays so{opposite}"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        label = None if self.session == ONE_SESSION else self.session
        when = ("moment", TableUnit(self.time_unit), "when, from the first row on")
        moment = CauseParameter(*when, lower=0.0, session=label, sudden=True)
        return CauseParameter("A", TableUnit(self.unit), "change of the response", session=label), moment

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (self.size, 1.0)

    def readable(self, parameters: Sequence[SizedParameter]) -> tuple[SizedParameter, ...]:
        return show_time(parameters, "moment", self.time_unit)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [
            (replace(self, session=session), np.column_stack([np.full(len(moments), self.size), moments]))
            for session, moments in self._moments(rows)
            if self.session in ("", session)
        ]

    def _moments(self, rows: pd.DataFrame) -> list[tuple[str, Array]]:
        """In autocorrelated noise a change shows most where it begins, so that every row may be its first."""
        if self.direction or len(rows) > MAX_MOMENTS:
            return candidate_moments(rows)
        seconds = rows.groupby("session", sort=False)["session_seconds"].unique()
        between = {name: ((times[1:] + times[:-1]) / 2)[2:-2] for name, times in seconds.items()}
        return [(str(name), moments) for name, moments in between.items() if len(moments)]

    def changes(self, law: Any, rows: Rows, values: Array, trials: Array) -> Array:
        """See `GenericCause`: all moments at once."""
        inside = np.asarray(rows["session"], dtype=object) == self.session
        sign = self.sign(rows)
        seconds = np.asarray(rows["session_seconds"], float)
        return trials[:, 0] * (inside * sign)[:, None] * (seconds[:, None] >= trials[:, 1])

    def term(self, rows: Rows) -> Term:
        inside = np.asarray(rows["session"], dtype=object) == self.session
        seconds = np.asarray(rows["session_seconds"], float)

        def term(values: Array) -> tuple[Array, Array]:
            after = (inside & (seconds >= values[:, 1])).astype(float)
            return values[:, 0] * after, np.column_stack([after, np.zeros(len(after))])

        return term


@dataclass(frozen=True, kw_only=True)
class CovariateCause(GenericCause):
    """The response depends on a column that the law does not use."""

    column: str = ""

    combine_trials = True

    @property
    def base_name(self) -> str:  # type: ignore[override]
        return COVARIATE_PREFIX + self.column

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.column,)


@dataclass(frozen=True, kw_only=True)
class ColumnDependence(CovariateCause, AddedTerm):
    """f(column), f a polynomial over the table's range and constant beyond.

    Of one that bends more than the simple one does, `amplitude` is the prior standard deviation of the
    coefficients, in units of those that are tried; None without a prior.
    """

    low: float = -1.0
    high: float = 1.0
    order: int = COVARIATE_ORDER
    amplitude: float | None = None

    takes_functions = True
    base_phrase = "the response follows a column of the table"
    physics = "Whatever the column stands for; the table alone shows that the response follows it smoothly."
    shows_best = "one condition at the lowest and at the highest values of the column"
    sentence = "The response follows the column {column}{opposite}"

    @property
    def constant_beyond(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.column,)

    @property
    def remedy(self) -> str:  # type: ignore[override]
        return f"keeping {self.column} steady"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        unit, meaning = TableUnit(self.unit), "over the column's range"
        amplitude = np.inf if self.amplitude is None else self.amplitude
        return tuple(
            CauseParameter(f"f{k}", unit, f"Chebyshev coefficient {k} {meaning}", prior_sd=float(sd))
            for k, sd in enumerate(amplitude * self._sizes, 1)
        )

    @property
    def _sizes(self) -> Array:
        """Of the coefficients that are tried: the higher the order, the smaller."""
        return np.asarray(self.size / np.arange(1, self.order + 1))

    def with_amplitude(self, amplitude: float) -> Self:
        """A curve that bends much, as likely beforehand as the test has it; a simple one as it is."""
        return replace(self, amplitude=float(amplitude)) if self.order > type(self).order else self

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `GenericCause`: the coefficients of a curve are left out."""
        return {"column": self.column, "opposite": super().quantities({})["opposite"]}

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `GenericCause`: a straight line, a simple curve, and one that bends more."""
        most = min(FINE_ORDER, rows[self.column].nunique() - 1)
        orders = sorted({1, self.order, max(self.order, most)})
        versions = [replace(self, order=order) for order in orders]
        return [(one, np.diag(one._sizes)) for one in versions]

    def with_functions(self, term: Any) -> Cause | None:
        own = {one.name: getattr(self, one.name) for one in fields(ColumnDependence)}
        return SmoothColumnDependence(**own, sds=term.sds)

    def term(self, rows: Rows) -> Term:
        x = (2.0 * np.asarray(rows[self.column], float) - self.low - self.high) / (self.high - self.low)
        angle = np.arccos(np.clip(x, -1.0, 1.0))
        return linear_term(np.cos(angle[:, None] * np.arange(1, self.order + 1)))


@dataclass(frozen=True, kw_only=True)
class SmoothColumnDependence(ColumnDependence):
    """As `ColumnDependence`, of cosines in place of polynomials, as flexible as their Gaussian-process prior.

    Attributes
    ----------
    sds : tuple of float
        Prior standard deviation of each cosine's coefficient.
    """

    sds: tuple[float, ...] = ()

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        meaning = "of a smooth function of the column"
        return tuple(
            CauseParameter(f"c{k}", TableUnit(self.unit), f"coefficient {k} {meaning}", prior_sd=sd)
            for k, sd in enumerate(self.sds, 1)
        )

    def with_amplitude(self, amplitude: float) -> Self:
        """The same with another size: all prior standard deviations times a number."""
        return replace(self, sds=tuple(amplitude * sd for sd in self.sds))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [(self, np.diag(self.sds))]

    def term(self, rows: Rows) -> Term:
        return linear_term(cosines(np.asarray(rows[self.column], float), self.low, self.high, len(self.sds)))


@dataclass(frozen=True, kw_only=True)
class PositionDependence(ColumnDependence):
    """As `ColumnDependence`, of the position, and less smooth."""

    order: int = POSITION_ORDER

    base_phrase = "the response depends on the position"
    physics = (
        "Guides, bearings and magnets are not the same everywhere: friction, play and stiffness change along "
        "the way, and with them the response."
    )
    shows_best = "one slow sweep over the whole range, there and back"
    sentence = "The response depends on the position {column}{opposite}"
    base_name = "position"
    remedy = "staying in one part of the range"
    with_functions = Cause.with_functions


@dataclass(frozen=True, kw_only=True)
class DirectionOffset(AddedTerm):
    """d in one direction, -d in the other."""

    base_name = "offset"
    base_phrase = "the response is not the same in both directions"
    physics = "Friction, play and hysteresis change their sign with the direction of motion."
    shows_best = "one condition in both directions, again and again"
    sentence = (
        "The response is {d:higher|lower} by {d} where {column} is {forward}, and {d:lower|higher} by as "
        "much where it is {backward}"
    )
    remedy = "always coming from the same side"

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.direction,)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return (CauseParameter("d", TableUnit(self.unit), "half the difference of the two directions"),)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        backward, forward = self.labels or ("below 0", "above 0")
        names = {"column": self.direction, "forward": forward, "backward": backward}
        return {**super().quantities(sizes), **names}

    def term(self, rows: Rows) -> Term:
        return linear_term(np.ones((len(np.asarray(rows[self.direction])), 1)))


@dataclass(frozen=True, kw_only=True)
class SessionOffset(AddedTerm):
    """Each session has an offset of its own."""

    sessions: tuple[str, ...] = ()

    base_name = "offset-by-session"
    base_phrase = "the response is not the same in every session"
    physics = "What is mounted, charged or set anew before a session is never quite as it was before."
    shows_best = "one condition in every session"
    sentence = "The response is higher in some sessions than in others"
    remedy = "calibrating each session"
    combine_trials = True
    columns = ("session",)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `GenericCause`: the first session has none."""
        unit = TableUnit(self.unit)
        meaning = f"offset beside session {self.sessions[0]}" if self.sessions else ""
        return tuple(CauseParameter("d", unit, meaning, session=one) for one in self.sessions[1:])

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        return {}

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [(self, self.size * np.eye(len(self.parameters)))]

    def term(self, rows: Rows) -> Term:
        session = np.asarray(rows["session"], dtype=object).astype(str)
        return linear_term((session[:, None] == np.array(self.sessions[1:])).astype(float))


@dataclass(frozen=True, kw_only=True)
class OutlyingValues(AddedTerm):
    """A few responses are off by a lot; the rest are right."""

    base_name = "outliers"
    base_phrase = "a few values are far off"
    physics = (
        "A slip of the pen, a disturbance from outside or a sensor that loses its signal for a moment. Such "
        "values say nothing about the law."
    )
    shows_best = "replicates: an outlier does not come back"
    sentence = "About one value in {one_in} is off by {size} or so"
    remedy = "measuring those values again"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return (
            CauseParameter("share", "%", "of the values", lower=0.0, upper=1.0),
            CauseParameter("size", TableUnit(self.unit), "typical departure of such a value", lower=0.0),
        )

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        return {"one_in": f"{round(1 / sizes['share'].size.estimate):,}", "size": sizes["size"]}

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `GenericCause`: none, as such values deviate independently."""
        return []

    def term(self, rows: Rows) -> Term:
        """See `GenericCause`: nothing is added."""
        return linear_term(np.zeros((len(rows), 2)))
