"""Finding, Gain and NextTraverse: what a diagnosis consists of; LogInfo and TableInfo: what it is of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import format_percent, format_significant, pluralize
from stickslip_fit._typing import Array
from stickslip_fit.causes import SizedParameter
from stickslip_fit.diagnosis.lagged import LaggedColumn
from stickslip_fit.units import UNITS, Interval, from_si

GIVEN_BEFORE = "each given those before it"  # of errors in noise that persists, see `Gain.given_before`
AT_BOUND = 1e-3  # of a parameter or its interval: distance from a bound at which it is there
TO_SOME_EXTENT = " to some extent"  # ends the carrier of structure like that of a cause that is not named


def shown_size(parameter: SizedParameter) -> Interval:
    """A parameter's size in its display unit; one of a table's own units is not converted.

    Examples
    --------
    >>> shown_size(SizedParameter("A", "%", Interval(0.03, 0.02, 0.04))).estimate
    3.0
    >>> shown_size(SizedParameter("c", "N s/m", Interval(0.03, 0.02, 0.04))).estimate
    0.03
    """
    if parameter.unit not in UNITS:
        return parameter.size
    return Interval(*(float(from_si(value, parameter.unit)) for value in astuple(parameter.size)))


def closest_cause(explains: Mapping[str, float], by_equation: Mapping[str, float]) -> str:
    """The cause that explains most of a structure; empty without one.

    Parameters
    ----------
    explains, by_equation
        As of a `Finding`. Almost any curve can be bent into another: the equation decides where it has one
        shape.

    Examples
    --------
    >>> closest_cause({"wear": 0.86, "session-jump": 0.57}, {"wear": 0.07})
    'session-jump'
    """
    own = {**explains, **by_equation}
    return max(own, key=lambda cause: own[cause], default="")


def joints_of_laws(laws: Iterable[Any]) -> tuple[int, ...]:
    """The joints that some laws describe; none for laws of other machines."""
    return tuple(sorted(int(law.joint) for law in laws if hasattr(law, "joint")))


@dataclass(frozen=True)
class Gain:
    """Rms error of the step size (relative) on held-out traverses, before and after extending the law.

    Of a table: of its response, in its unit, on held-out rows.

    Attributes
    ----------
    baseline, extended : float
    noise_floor : float
        The error of the true law: repeatability and rounding.
    low, high : float
        95 % interval of `baseline` less `extended` as the diagnosis of a replicate of the campaign measures
        them: the same traverses with fresh noise.
    by_session : DataFrame
        session, baseline, extended, traverses (of a table: rows).
    held_out : str
        What was held out together, where that is not a log's configurations.
    by_joint : DataFrame
        Of a log: joint, direction, baseline, extended, traverses.
    given_before : tuple of float
        Where the noise of a table persists: both errors of a row given those of the rows before it that were
        held out with it, that is of its innovation. Empty where noise is independent.
    stalled : int
        Held-out traverses that the laws without causes cannot predict, since the joint would stall; they say
        nothing of a cause and count on neither side.
    """

    baseline: float
    extended: float
    noise_floor: float
    low: float
    high: float
    by_session: pd.DataFrame
    held_out: str = ""
    by_joint: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False)
    given_before: tuple[float, ...] = ()
    stalled: int = 0

    @property
    def cut(self) -> Interval:
        """By how much the error falls."""
        return Interval(self.baseline - self.extended, self.low, self.high)

    @property
    def doubt(self) -> str:
        """The end of a sentence on both errors where the interval that judges them holds 0; else empty."""
        is_open = self.low <= 0.0 and not self.given_before
        return ", though a replicate might gain nothing" if is_open else ""

    @property
    def judged(self) -> tuple[float, float]:
        """The errors, before and after, by which what extends the law is judged.

        Noise that persists hides in the errors themselves whatever is smaller than its slow part.
        """
        before, after = self.given_before or (self.baseline, self.extended)
        return before, after


@dataclass(frozen=True, eq=False)
class TravelProfile:
    """The step size along a joint's travel, relative to its mean there.

    Attributes
    ----------
    direction, session : str
        Of the traverses that it holds for; empty for all.
    position : array, shape (n,)
        Places from one end of the travel to the other, rad or m.
    change, error : array, shape (n,)
        Of the step size, relative, with one standard error.
    """

    joint: int
    direction: str
    session: str
    position: Array = field(repr=False)
    change: Array = field(repr=False)
    error: Array = field(repr=False)

    @property
    def rms(self) -> float:
        """Of the change."""
        return float(np.sqrt(np.mean(self.change**2)))


@dataclass(frozen=True)
class Finding:
    """A named cause, or structure without a known cause.

    Attributes
    ----------
    cause : str
        ``unknown`` for structure without a known cause.
    version : object or None
        The cause as it acts in this log, or the term or smooth function that stands for unknown structure;
        None for outlying counts, and for unknown structure without one.
    equivalent : tuple of str
        Causes that this log cannot separate from it.
    p_value : float
    joints : tuple of int
    effect : Interval
        Rms over all rows of the relative change in the count, beyond what calibration absorbs.
    parameters : tuple of SizedParameter
    gain : Gain or None
        From the law with the findings before it to the law with this one too.
    closest, share : str, float
        For ``unknown``: the `closest_cause`, and the share of the structure's square that it explains.
    carrier : str
        For ``unknown``: the variable that the structure follows.
    traverses : DataFrame or None
        For outlying counts: those rows, with `departure` (relative) from the law.
    note : str
        For ``unknown``: the causes that are not named, and why.
    withdrawn : tuple of Finding
        For ``unknown``: those causes as they were found; the effect is then that of the first.
    together_with : tuple of str
        Other causes, or ``unknown``, without which this one would not have been found.
    term : str
        For ``unknown``: the formula of the term that is proposed for it; empty without one.
    explains : mapping of str to float
        For ``unknown``: the share of the structure's square that each known cause explains, bent as the data
        ask where its form may bend.
    explains_by_equation : mapping of str to float
        The same by the cause's equation alone, for causes of which that has one shape.
    lagged : LaggedColumn or None
        For ``unknown``: a column that the structure follows with a lag.
    travel : tuple of TravelProfile
        Where it follows the joints' own positions, and nothing else.
    """

    cause: str
    version: Any
    equivalent: tuple[str, ...]
    p_value: float
    joints: tuple[int, ...]
    effect: Interval
    parameters: tuple[SizedParameter, ...]
    gain: Gain | None = None
    closest: str = ""
    share: float = 0.0
    carrier: str = ""
    traverses: pd.DataFrame | None = None
    note: str = ""
    withdrawn: tuple[Finding, ...] = ()
    together_with: tuple[str, ...] = ()
    term: str = ""
    explains: Mapping[str, float] = field(default_factory=dict)
    explains_by_equation: Mapping[str, float] = field(default_factory=dict)
    lagged: LaggedColumn | None = None
    travel: tuple[TravelProfile, ...] = ()

    @property
    def cause_set(self) -> tuple[str, ...]:
        """The likeliest cause, then those that the log cannot separate from it."""
        return (self.cause, *self.equivalent)

    @property
    def shown_parameters(self) -> tuple[SizedParameter, ...]:
        """The parameters in the units in which they are read most easily."""
        return self.version.readable(self.parameters) if self.version is not None else self.parameters

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Names of the parameters that are at an end of the range in which they were fitted."""
        ends = {one.name: (one.lower, one.upper) for one in getattr(self.version, "parameters", ())}
        found = []
        for one in self.parameters:
            near = AT_BOUND * max(one.size.high - one.size.low, abs(one.size.estimate))
            if any(abs(one.size.estimate - end) <= near for end in ends.get(one.name, ())):
                found.append(one.name)
        return tuple(found)


@dataclass(frozen=True)
class NextTraverse:
    """A traverse to make next; angles rad, lengths m, NaN where the value does not matter.

    Attributes
    ----------
    session : str
        ``new``.
    joint : int
    direction : str
    q1, q2, q3, theta, psi, start, stop : float
    repeats : int
    tells_apart : tuple of str
        The causes that it separates, or the one that it makes testable.
    note : str
        When to make it, where that matters.
    """

    session: str
    joint: int
    direction: str
    q1: float
    q2: float
    q3: float
    theta: float
    psi: float
    start: float
    stop: float
    repeats: int
    tells_apart: tuple[str, ...]
    note: str = ""


class DataInfo:
    """What texts and figures say of the data of a diagnosis.

    Attributes
    ----------
    data, row, response, unit : str
        What they are called, what a row of them and the response are, and the unit in which sizes are shown.
    factor : float
        By which a size is multiplied to be shown.
    held_out, new_session : str
        What is held out if nothing else is said, and what predictions of new sessions are called.
    least_limit, sign : float
        Of a figure's scale, as a law with as many parameters as rows leaves nothing; of the response by what
        laws predict.
    """

    data, row, factor, held_out, new_session = "table", "row", 1.0, "", "a new session"
    least_limit, sign = 0.0, 1.0
    response: str
    unit: str

    @property
    def nameless(self) -> str:
        """The data, if they were never in a file."""
        return f"a {self.data} that was never in a file"

    def format_number(self, value: float) -> str:
        """A size without its unit."""
        return format_significant(value)

    def format_size(self, value: float) -> str:
        """A size with its unit.

        Examples
        --------
        >>> TableInfo("F", "N", 1.0, 600, 600.0).format_size(0.26398), LogInfo().format_size(0.027)
        ('0.264 N', '2.7 %')
        """
        return f"{self.format_number(value)} {self.unit}".rstrip()

    def label(self, what: str) -> str:
        """Of an axis in that unit."""
        return f"{what} ({self.unit})" if self.unit else what

    def format_signed(self, value: float) -> str:
        """A size with its sign, without its unit."""
        return ("+" if value > 0 else "") + self.format_number(value)


class LogInfo(DataInfo):
    """Of a log: sizes are relative, and shown as per cent of a step."""

    data, row, response, unit, factor = "log", "traverse", "the step size", "%", 100.0
    sign = -1.0  # larger steps, fewer of them
    held_out, new_session = "whole configurations", "a new session, by its calibration"
    least_limit = 0.05

    def format_number(self, value: float) -> str:
        return format_percent(value, with_unit=False)


@dataclass(frozen=True)
class TableInfo(DataInfo):
    """The table that a diagnosis is of, where that is no log; effects are in the unit of the response.

    Attributes
    ----------
    response, unit : str
        Name of the response, and its unit; "" where none was given.
    response_sd : float
        Standard deviation of the response: what the per cent of the JSON are of.
    rows : int
        That have a response; those that are set aside later included.
    independent : float
        How many independent values carry as much as they do; `rows` without autocorrelation.
    correlation_rows : float
        Autocorrelation time in rows: `rows` over `independent`; 1 without autocorrelation.
    correlation_time : float
        The same in the unit of the time; NaN without a time.
    noise_period : float
        Of the noise's oscillation, in that unit; NaN where it has none.
    time_unit : str
    roles : mapping of str to str
        Column of each role that was given or found: session, time, position, direction, group, sigma.
    unnamed_time : str
        A column of times where none was named as the time.
    file, sha256 : str
        Empty for a table that was never in a file; the hash is then that of its values.
    files : tuple of str
        Files that no output may replace: the table's, and that of its law.
    notes : tuple of str
        Sentences on how it was read, and what was left out.
    """

    response: str
    unit: str
    response_sd: float
    rows: int
    independent: float
    correlation_rows: float = 1.0
    correlation_time: float = float("nan")
    noise_period: float = float("nan")
    time_unit: str = "s"
    roles: Mapping[str, str] = field(default_factory=dict)
    unnamed_time: str = ""
    file: str = ""
    sha256: str = ""
    files: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def nameless(self) -> str:
        return f"{self.response} over {pluralize(self.rows, 'row')}"

    @property
    def is_correlated(self) -> bool:
        """Whether a value says something of the next one."""
        return self.correlation_rows > 1.0 or self.noise_period > 0.0
