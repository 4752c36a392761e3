"""Data and priors of each joint and direction, and the priors of causes' parameters.

Hyperparameters: campaign mean, spread between sessions, repeatability. The default priors are weak:
they know the mean step size of the log and the largest plausible size of each cause.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from math import e
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import ndtr, ndtri

from stickslip_fit._format import format_direction, format_value
from stickslip_fit._json import to_plain
from stickslip_fit._summary import Table, numbers, words
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._groups import Groups, group_rows, usable_rows
from stickslip_fit.laws import Laws, Rows, StepLaw, choose_laws, traverse_length
from stickslip_fit.laws.base import Model
from stickslip_fit.logs import Log
from stickslip_fit.units import Z_95

ROWS_PER_CHUNK = 20_000  # for which the law is evaluated at a time; they fit in the cache


@dataclass(frozen=True, eq=False)
class GroupData:
    """The n rows of a joint and direction in S sessions, with their law.

    Attributes
    ----------
    y, rounding : array, shape (n,)
        log(steps) and the variance that the rounding adds; see `StepLaw.response`.
    row_index : array of int, shape (S, m)
        Positions of each session's rows, -1 beyond its last. Of T campaigns shape (T, S, m).
    campaign : array of int, shape (S,), or None
        Of each session the campaign, where there are several.
    """

    law: StepLaw
    rows: pd.DataFrame
    groups: Groups
    y: Array
    rounding: Array
    row_index: IntArray
    campaign: IntArray | None = None

    @cached_property
    def model(self) -> Model:
        """The response and its derivatives as a function of each row's parameters; see `StepLaw.model`."""
        return self.law.model(self.rows)

    @cached_property
    def distinct(self) -> tuple[IntArray, IntArray]:
        """Rows of which no two are replicates, and for each row the position of its replicate among them."""
        conditions = list(dict.fromkeys(["session", *self.law.columns, "start", "stop"]))
        by_condition = self.rows.groupby(conditions, dropna=False, observed=True, sort=False)
        _, first, replicate_of = np.unique(
            by_condition.ngroup().to_numpy(), return_index=True, return_inverse=True
        )
        return first, replicate_of

    def pad(self, column: Array, fill: float) -> Array:
        """A column, shape (n, ...), session by session, shape (S, m, ...)."""
        absent = (self.row_index < 0).reshape(*self.row_index.shape, *[1] * (column.ndim - 1))
        return np.where(absent, fill, column[self.row_index])

    def predict(self, values: Array) -> Array:
        """log(steps) by each draw of the sessions' parameters, shape (d, S, p) -> (d, n); NaN at a stall."""
        first, replicate_of = self.distinct
        distinct = values[:, self.groups.of_row[first]]
        return predict_log_steps(self.law, self.rows.iloc[first], distinct)[:, replicate_of]


def iterate_groups(log: Log, laws: Laws | None = None) -> Iterator[tuple[int, str, GroupData]]:
    """Every joint and direction of a log with its usable traverses, under its law; see `choose_laws`.

    Raises
    ------
    InputError
        If no traverse is usable.
    """
    rows = usable_rows(log)
    # Both directions have one law, whatever each of them covers.
    for joint, law in choose_laws(rows, log.machine, laws).items():
        subset = rows[rows["joint"] == joint]
        for direction in ("+", "-"):
            own = subset[subset["direction"] == direction]
            if len(own):
                yield joint, direction, build_group_data(law, own)


def build_group_data(law: StepLaw, rows: pd.DataFrame) -> GroupData:
    """The rows of one joint and direction with what their fit needs."""
    groups = group_rows(rows)
    y, rounding = law.response(rows)
    order = np.argsort(groups.of_row, kind="stable")
    ends = np.cumsum(groups.sizes)
    row_index = np.full((len(groups), int(groups.sizes.max())), -1)
    within = np.arange(len(order)) - (ends - groups.sizes)[groups.of_row[order]]
    row_index[groups.of_row[order], within] = order
    return GroupData(law, rows, groups, y, rounding, row_index)


def build_campaigns(law: StepLaw, campaigns: Sequence[pd.DataFrame]) -> GroupData:
    """The rows of one joint and direction in T campaigns, whose sessions have nothing in common."""
    rows = pd.concat(campaigns)
    number = np.repeat(np.arange(len(campaigns)), [len(own) for own in campaigns])
    code, names = pd.factorize(rows["session"])
    data = build_group_data(law, rows.assign(session=number * len(names) + code))
    campaign, session = np.divmod(data.groups.table["session"].to_numpy(np.intp), len(names))
    table = data.groups.table.assign(session=np.asarray(names, dtype=object)[session])
    sizes = np.bincount(campaign)
    within = np.arange(len(campaign)) - (np.cumsum(sizes) - sizes)[campaign]
    row_index = np.full((len(campaigns), int(sizes.max()), data.row_index.shape[1]), -1)
    row_index[campaign, within] = data.row_index
    groups = Groups(table, data.groups.of_row)
    return replace(data, rows=rows, groups=groups, row_index=row_index, campaign=campaign)


def predict_log_steps(law: StepLaw, rows: pd.DataFrame, values: Array) -> Array:
    """log(steps) of n rows under d draws of their parameters, shape (d, n, p) -> (d, n)."""
    draws, n, p = values.shape
    size = min(max(ROWS_PER_CHUNK // n, 1), draws)
    predict = _response_function(law, rows.iloc[np.tile(np.arange(n), size)])
    log_steps = np.empty((draws, n))
    for first in range(0, draws, size):
        # The last chunk overlaps the one before, so that all have one size.
        chunk = slice(min(first, draws - size), min(first, draws - size) + size)
        log_steps[chunk] = predict(values[chunk].reshape(-1, p)).reshape(size, n)
    return log_steps


def _response_function(law: StepLaw, rows: pd.DataFrame) -> Callable[[Array], Array]:
    """log(steps) as a function of the values; without derivatives where these take most of the time."""
    if not isinstance(law, ExtendedLaw):
        model = law.model(rows)
        return lambda values: model(values)[0]
    steps = law.steps(rows)

    def predict(values: Array) -> Array:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(steps(values))

    return predict


MAX_PRIOR_SD = 4.0  # standard deviations of the prior; beyond is as good as a bound


@dataclass(frozen=True, eq=False)
class CausePriors:
    """The prior of q parameters of causes; arrays of shape (q,), SI.

    A parameter between two bounds is uniform, in its logarithm where both are above 0; any other is normal,
    truncated at its bound. A width of 0 fixes a parameter at its centre.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    centre: Array
    width: Array
    lower: Array
    upper: Array

    def unstandardize(self, eta: Array) -> Array:
        """Parameters at points that are standard normal under the prior, (..., q) -> (..., q).

        Examples
        --------
        >>> numbers = np.array([[0.0, 0.0], [0.1, 1.0], [-np.inf, 60.0], [np.inf, 6000.0]])
        >>> priors = CausePriors(("A", "tau"), ("%", "min"), *numbers)
        >>> priors.unstandardize(np.array([1.0, 0.0])).tolist()
        [0.1, 600.0]
        """
        values = np.zeros(eta.shape)
        for j in range(len(self.names)):
            values[..., j] = self._value(j, eta[..., j])
        return values

    def standardize(self, values: Array) -> Array:
        """Points at which parameters have these values, (..., q) -> (..., q); none beyond the plausible."""
        eta = np.zeros(values.shape)
        for j in range(len(self.names)):
            eta[..., j] = self._standard(j, values[..., j])
        return np.clip(eta, -MAX_PRIOR_SD, MAX_PRIOR_SD)

    def draw(self, size: int, rng: np.random.Generator) -> Array:
        """Parameters from the prior, shape (size, q)."""
        return self.unstandardize(rng.standard_normal((size, len(self.names))))

    @property
    def free(self) -> npt.NDArray[np.bool_]:
        """Which parameters are not fixed, shape (q,)."""
        return self.width > 0

    def describe(self) -> list[list[str]]:
        """Name, and range of 95 %, of each parameter, as people read it."""
        low, high = (self.unstandardize(np.full(len(self.names), sign * Z_95)) for sign in (-1, 1))
        lines = []
        for j, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            text = f"held at {format_value(self.centre[j], unit, 3)}"
            if self.free[j]:
                text = f"{format_value(low[j], unit, 3)} to {format_value(high[j], unit, 3)}"
            lines.append([name, text])
        return lines

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types that `from_json` reads; no bound is null."""
        return to_plain(asdict(self))

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> CausePriors:
        """The priors that `to_json` wrote."""
        unbounded = {"lower": -np.inf, "upper": np.inf}
        numbers = {
            name: np.array(
                [unbounded.get(name) if value is None else value for value in content[name]], float
            )
            for name in ("centre", "width", "lower", "upper")
        }
        return cls(tuple(content["names"]), tuple(content["units"]), **numbers)

    def _value(self, j: int, eta: Array) -> Array:
        centre, width, low, high = self.centre[j], self.width[j], self.lower[j], self.upper[j]
        if not width or not np.isfinite([low, high]).any():
            return centre + width * eta
        if np.isfinite([low, high]).all():
            share = ndtr(eta)
            return low * (high / low) ** share if low > 0 else low + (high - low) * share
        below, above = ndtr((low - centre) / width), ndtr((high - centre) / width)
        return centre + width * ndtri(below + (above - below) * ndtr(eta))

    def _standard(self, j: int, value: Array) -> Array:
        centre, width, low, high = self.centre[j], self.width[j], self.lower[j], self.upper[j]
        if not width:
            return np.zeros_like(value)
        if not np.isfinite([low, high]).any():
            return (value - centre) / width
        if np.isfinite([low, high]).all():
            share = np.log(value / low) / np.log(high / low) if low > 0 else (value - low) / (high - low)
            return np.asarray(ndtri(np.clip(share, 0.0, 1.0)))
        below, above = ndtr((low - centre) / width), ndtr((high - centre) / width)
        share = (ndtr((value - centre) / width) - below) / (above - below)
        return np.asarray(ndtri(np.clip(share, 0.0, 1.0)))


def weak_cause_priors(law: ExtendedLaw, chosen: Array, rows: pd.DataFrame) -> CausePriors:
    """Priors as wide as the largest plausible sizes of a law's causes.

    `chosen`, shape (q,), fixes parameters that are chosen among trials, such as a moment.
    """
    width = np.concatenate([_prior_width(cause, rows) for cause in law.causes])
    sudden = np.array([parameter.sudden for parameter in law.cause_parameters])
    return CausePriors(
        names=tuple(parameter.name for parameter in law.cause_parameters),
        units=tuple(parameter.unit for parameter in law.cause_parameters),
        centre=np.where(sudden, chosen, law.null_values),
        width=np.where(sudden, 0.0, width),
        lower=np.array([parameter.lower for parameter in law.cause_parameters]),
        upper=np.array([parameter.upper for parameter in law.cause_parameters]),
    )


def _prior_width(cause: Cause, rows: pd.DataFrame) -> Array:
    """How far each parameter may plausibly be from no effect, shape (q,)."""
    absent = np.array(cause.null_values, dtype=float)
    sizes: Sequence[Array] = cause.largest_plausible()
    if not sizes:
        trials = np.concatenate([values for version, values in cause.trials(rows) if version == cause])
        most = np.where(np.arange(len(absent)) == 0, cause.max_trial_factor, 1.0)
        sizes = list(absent + most * (trials - absent))
    return np.maximum(np.max(np.abs(np.array(sizes) - absent), axis=0), cause.scale)


Group = tuple[int, str]

# In units of `StepLaw.scales`: changes of the parameters that change a step by its own size.
PRIOR_WIDTH = 0.5
PRIOR_SPREAD = 0.02
PRIOR_REPEATABILITY = 0.003


@dataclass(frozen=True, eq=False)
class Prior:
    """The prior of one joint and direction.

    A session's parameters are normal about the campaign's mean. The mean is normal itself; how much the
    parameters spread from session to session, and the repeatability, are log-normal.

    Attributes
    ----------
    names, units : tuple of str
        Of the law's p parameters.
    centre, width : array, shape (p,)
        Mean and standard deviation of the campaign's mean, SI. Of T campaigns shape (T, 1, p), as is spread.
    spread : array, shape (p,)
        Median of the standard deviation between sessions, SI.
    repeatability : float
        Median of the standard deviation of log(steps).
    spread_factor, repeatability_factor : float
        One standard deviation of their logarithms, as a factor.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    centre: Array
    width: Array
    spread: Array
    repeatability: float
    spread_factor: float = e
    repeatability_factor: float = e

    def levels(self, x: Array) -> tuple[Array, Array]:
        """Spread, shape (..., p), and repeatability, shape (...,), at standard normal x, (..., p + 1)."""
        spread = self.spread * self.spread_factor ** x[..., :-1]
        return spread, self.repeatability * self.repeatability_factor ** x[..., -1]

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Campaign means, (size, p), spreads, (size, p), and repeatabilities, (size,), from the prior."""
        spread, repeatability = self.levels(rng.standard_normal((size, len(self.centre) + 1)))
        return self.centre + self.width * rng.standard_normal(spread.shape), spread, repeatability


@dataclass(frozen=True)
class Priors:
    """The priors of a fit by joint and direction, and of its causes; prints as a table."""

    of: Mapping[Group, Prior]
    causes: CausePriors | None = None

    def __str__(self) -> str:
        return "\n\n".join(table.as_text() for table in self.tables())

    def tables(self) -> tuple[Table, ...]:
        """One of sessions, and one of causes where there are some."""
        heads = ("joint", "direction", "parameter")
        columns = (*words(*heads), *numbers("campaign mean", "between sessions (95 %)"))
        rows = tuple(tuple(line) for group, prior in self.of.items() for line in _prior_lines(group, prior))
        session_values = Table("Priors", columns, rows, stubs=len(heads))
        if self.causes is None:
            return (session_values,)
        columns = (*words("cause"), *numbers("for the whole campaign (95 %)"))
        rows = tuple(tuple(line) for line in self.causes.describe())
        return session_values, Table("Priors of causes", columns, rows)

    def prior(self, joint: int, direction: str) -> Prior:
        """The prior of a joint and direction.

        Raises
        ------
        InputError
            If there is none.
        """
        if (joint, direction) not in self.of:
            raise InputError(f"the priors have no entry for joint {joint}, direction {direction}; add one")
        return self.of[joint, direction]

    def to_json(self) -> list[dict[str, Any]]:
        """Plain JSON types that `from_json` reads."""
        content: list[dict[str, Any]] = [] if self.causes is None else [{"causes": self.causes.to_json()}]
        for (joint, direction), prior in self.of.items():
            values = {name: np.asarray(value).tolist() for name, value in asdict(prior).items()}
            content.append({"joint": joint, "direction": direction} | values)
        return content

    @classmethod
    def from_json(cls, content: list[dict[str, Any]]) -> Priors:
        """The priors that `to_json` wrote."""
        causes = [CausePriors.from_json(item["causes"]) for item in content if "causes" in item]
        of = {}
        for item in content:
            if "joint" in item:
                values = {field.name: item[field.name] for field in fields(Prior)}
                values |= {name: tuple(item[name]) for name in ("names", "units")}
                values |= {name: np.array(item[name]) for name in ("centre", "width", "spread")}
                of[item["joint"], item["direction"]] = Prior(**values)
        return cls(of, *causes)


def weak_prior(law: StepLaw, rows: Rows) -> Prior:
    """A prior that knows only the mean step size of these rows; see `weak_priors`."""
    y, _ = law.response(rows)
    return prior_from_steps(law, np.exp(np.mean(np.log(traverse_length(rows)) - y, keepdims=True)))


def prior_from_steps(law: StepLaw, steps: Array) -> Prior:
    """The prior that knows a mean step size, shape (1,), or one of each campaign, shape (T, 1).

    The campaign's mean has the step size of a law without effects and a standard deviation of half a step;
    sessions differ by 2 % of a step, within a factor of 7 either way, and a count repeats to 0.3 %, likewise.
    """
    shape = (*steps.shape[:-1], 1, len(law.parameters)) if steps.ndim > 1 else (len(law.parameters),)
    scale = law.scales(steps.ravel()).reshape(shape)
    return Prior(
        names=tuple(parameter.name for parameter in law.parameters),
        units=tuple(parameter.unit for parameter in law.parameters),
        centre=law.start_values(steps.ravel()).reshape(shape),
        width=PRIOR_WIDTH * scale,
        spread=PRIOR_SPREAD * scale,
        repeatability=PRIOR_REPEATABILITY,
    )


def weak_priors(log: Log, laws: Laws | None = None) -> Priors:
    """The prior of `weak_prior` for every joint and direction of a log; change what you know better.

    Raises
    ------
    InputError
        If the log has no usable traverse.
    """
    return Priors(
        {
            (joint, direction): weak_prior(traverses.law, traverses.rows)
            for joint, direction, traverses in iterate_groups(log, laws)
        }
    )


def _prior_lines(group: Group, prior: Prior) -> list[list[str]]:
    stub, lines = [str(group[0]), format_direction(group[1])], []
    for j, (name, unit) in enumerate(zip(prior.names, prior.units, strict=True)):
        digits = 3 if unit in ("1", "µrad/mm") else 1
        mean = f"{format_value(prior.centre[j], unit, digits)} ± {format_value(prior.width[j], unit, digits)}"
        spread = _format_range(prior.spread[j], prior.spread_factor, unit, digits)
        lines.append([*stub, name, mean, spread])
    noise = _format_range(prior.repeatability, prior.repeatability_factor, "%", 2)
    return [*lines, [*stub, "repeatability", "", noise]]


def _format_range(median: float, factor: float, unit: str, digits: int) -> str:
    low, high = median * factor**-Z_95, median * factor**Z_95
    return f"{format_value(low, unit, digits)} to {format_value(high, unit, digits)}"
