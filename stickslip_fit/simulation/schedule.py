"""Schedules: how a quantity of a stage varies from traverse to traverse of a campaign.

A schedule is a change and its share in each traverse: 0 before a moment and 1 from it on, proportional to a
column, or growing with use towards 1. Absolute changes of a quantity add to its value in the stage file,
relative ones multiply the sum.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, Self

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.logs.schema import ARM_FORMAT, COVARIATE_PREFIX
from stickslip_fit.units import from_si

QuantityName = Literal["preload", "friction", "voltage", "ramp time", "payload"]
UNITS_OF: Mapping[str, tuple[str, ...]] = {
    "preload": ("N", "mN"),
    "friction": ("1",),
    "voltage": ("V",),
    "ramp time": ("ms", "s"),
    "payload": ("g", "kg"),
}
Row = Mapping[str, Any]
"""Columns of n traverses, each shape (n,)."""


class Course(Protocol):
    """How much of a change is there in each traverse."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a traverse that it needs."""

    def share(self, row: Row) -> Array:
        """Share of the change, shape (n,)."""

    def bind(self, sessions: Sequence[str], traverses: int) -> Self:
        """The same for a campaign of these sessions, of so many traverses each."""
        return self


@dataclass(frozen=True)
class Since(Course):
    """All of a change from one traverse on.

    Attributes
    ----------
    session : str
        Session in which it happens; empty if `traverse` says it.
    moment : float
        After the session's first traverse, s.
    traverse : int
        Number of the campaign's traverse, counted from 1 through all sessions and joints.
    last : int
        Of the session, once bound.
    """

    session: str = ""
    moment: float = 0.0
    traverse: int = 0
    last: int = 0

    @property
    def columns(self) -> tuple[str, ...]:
        return ("traverse", "session_seconds") if self.moment else ("traverse",)

    def share(self, row: Row) -> Array:
        if not self.traverse:
            raise InputError(f"a change from session {self.session!r} on needs a plan with its sessions")
        number = _numbers(row, "traverse")
        late = number >= self.traverse
        if self.moment:
            late &= (number > self.last) | (_numbers(row, "session_seconds") >= self.moment)
        return late.astype(float)

    def bind(self, sessions: Sequence[str], traverses: int) -> Self:
        """See `Course`; InputError for a session or a traverse that is not planned."""
        if not self.session:
            if self.traverse > len(sessions) * traverses:
                most = len(sessions) * traverses
                raise InputError(
                    f"a stage changes from traverse {self.traverse:,} on, but the plan has {most:,}; "
                    "give an earlier one"
                )
            return self
        if self.session not in sessions:
            raise InputError(
                f"a stage changes from session {self.session!r} on, which the plan does not have; its "
                f"sessions are {', '.join(map(repr, sorted(sessions)))}"
            )
        before = sessions.index(self.session) * traverses
        return replace(self, traverse=before + 1, last=before + traverses)


@dataclass(frozen=True)
class ByColumn(Course):
    """A change in proportion to a column: none at `at`, once for each `per` above it.

    Attributes
    ----------
    column : str
        Its name in the package, such as ``humidity`` or ``covariate:pressure_hPa``.
    at, per : float
        SI.
    """

    column: str
    at: float
    per: float

    @property
    def columns(self) -> tuple[str, ...]:
        return (self.column,)

    def share(self, row: Row) -> Array:
        return (_numbers(row, self.column) - self.at) / self.per


@dataclass(frozen=True)
class WithUse(Course):
    """A change that settles: 1 - exp(-n / scale) of it, n the joint's own steps or the session's seconds.

    Attributes
    ----------
    column : {'steps_before', 'session_seconds'}
    scale : float
        Steps, or s.
    """

    column: Literal["steps_before", "session_seconds"]
    scale: float

    @property
    def columns(self) -> tuple[str, ...]:
        return (self.column,)

    def share(self, row: Row) -> Array:
        return -np.expm1(-_numbers(row, self.column) / self.scale)


@dataclass(frozen=True)
class Schedule:
    """A change of one quantity of a stage.

    Attributes
    ----------
    quantity : {'preload', 'friction', 'voltage', 'ramp time', 'payload'}
    change : float
        A share of the quantity, or SI.
    is_relative : bool
    course : Course

    Examples
    --------
    >>> tighter = Schedule("preload", 0.1, True, Since(traverse=2))
    >>> schedule_values("preload", 1.25, [tighter], {"traverse": [1, 2, 3]})
    array([1.25 , 1.375, 1.375])
    """

    quantity: QuantityName
    change: float
    is_relative: bool
    course: Course

    def bind(self, sessions: Sequence[str], traverses: int) -> Schedule:
        """See `Course`."""
        return replace(self, course=self.course.bind(sessions, traverses))


def schedule_values(quantity: str, nominal: float, schedules: Iterable[Schedule], row: Row) -> Array:
    """A quantity in each traverse, SI, shape (n,) or, where nothing changes it, (1,).

    Raises
    ------
    InputError
        If it does not stay above 0 (a payload: at 0 or above), or a column is missing.
    """
    added, factor = np.zeros(1), np.ones(1)
    for each in schedules:
        if each.quantity == quantity:
            share = each.course.share(row)
            if each.is_relative:
                factor = factor * (1.0 + each.change * share)
            else:
                added = added + each.change * share
    values = (nominal + added) * factor
    lowest = values.min(initial=np.inf)
    if not (lowest > 0 or (quantity == "payload" and lowest >= 0)):
        unit = UNITS_OF[quantity][0]
        raise InputError(
            f"a schedule takes the {quantity} of a stage to {from_si(lowest, unit):.3g} {unit}; "
            "make its change smaller"
        )
    return values


def _numbers(row: Row, name: str) -> Array:
    if name not in row:
        if name == "traverse":
            raise InputError("a change from one traverse on needs a plan, in which traverses have numbers")
        field = ARM_FORMAT.by_name.get(name)
        column = field.spellings[0] if field else name.removeprefix(COVARIATE_PREFIX)
        raise InputError(
            f"a schedule needs {column}, which no [[column]] gives; add one with its name and mean"
        )
    values = np.asarray(row[name], dtype=float)
    if np.isnan(values).any():
        raise InputError(f"a schedule needs {name.removeprefix(COVARIATE_PREFIX)} in every traverse")
    return values
