"""Operator, the interface to the person at the rig, with what the two say to each other.

The operator sets what no motor can (base, stops, joints by hand) and decides what to do with a doubtful
reading: a count that lies further from its prediction than twice the half-width of the 95 % interval or,
where the prediction has no interval, than 10 %.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import inf, isfinite, nan
from typing import Protocol

import pandas as pd

from stickslip_fit._format import capitalize_first, format_value
from stickslip_fit.capture.protocols import Detection
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.schema import CONDITION_SPELLINGS, COVARIATE_PREFIX, explain_bad_unit, is_known
from stickslip_fit.units import PRISMATIC, from_si, to_si

DEFAULT_TOLERANCE = 0.10  # relative difference allowed where the prediction has no interval
MAX_HALF_WIDTHS = 2.0  # half-widths of the 95 % interval; one reading in 10,000 lies beyond by chance


class CountPredictor(Protocol):
    """Predicts the counts of traverses."""

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Counts of traverses given in a plan's columns.

        Returns
        -------
        DataFrame
            steps, before they are rounded up to the next check, low and high (95 % of readings); NaN
            where they are not known.
        """


@dataclass(frozen=True)
class ExpectedCount:
    """A predicted count with its 95 % interval; NaN where not known.

    Examples
    --------
    >>> ExpectedCount(12300.0, 12230.0, 12370.0).deviation(12500)
    '1.6 % more steps than predicted (12,300)'
    >>> ExpectedCount(12300.0, 12230.0, 12370.0).deviation(12400)
    ''
    """

    steps: float = nan
    low: float = nan
    high: float = nan

    @property
    def known(self) -> bool:
        """Whether there is a prediction."""
        return isfinite(self.steps) and self.steps > 0

    def deviation(self, steps: float) -> str:
        """How far a count lies from its prediction; empty within the tolerance or without a prediction."""
        if not self.known:
            return ""
        tolerance = DEFAULT_TOLERANCE * self.steps
        if isfinite(self.low) and isfinite(self.high):
            tolerance = MAX_HALF_WIDTHS * max(self.high - self.steps, self.steps - self.low)
        if abs(steps - self.steps) <= tolerance:
            return ""
        more = "more" if steps > self.steps else "fewer"
        share = abs(steps / self.steps - 1)
        return f"{share:.1%} {more} steps than predicted ({self.steps:,.0f})".replace("%", " %")


def predict_count(predictor: CountPredictor | None, row: pd.Series) -> ExpectedCount:
    """The predicted count of one traverse; unknown without a predictor."""
    if predictor is None:
        return ExpectedCount()
    prediction = predictor.predict(row.to_frame().T.infer_objects().reset_index(drop=True)).iloc[0]
    return ExpectedCount(*(float(prediction[name]) for name in ("steps", "low", "high")))


class OperatorChoice(Enum):
    """What the operator decides."""

    GO_ON = "go on"
    REPEAT = "repeat"
    SKIP = "skip"
    QUIT = "quit"


@dataclass(frozen=True)
class OperatorReply:
    """The operator's decision, a note on the last drive, and changed conditions (columns of a log, SI)."""

    choice: OperatorChoice = OperatorChoice.GO_ON
    note: str = ""
    conditions: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RigSetting:
    """What only a person can set.

    Attributes
    ----------
    theta, psi : float
        Orientation of the base, rad.
    stops : tuple of (int, float, float)
        Joint and the positions, rad or m, of two stops that hold it, where these are not its own.
    """

    theta: float
    psi: float
    stops: tuple[tuple[int, float, float], ...] = ()


@dataclass(frozen=True)
class PlannedDrive:
    """The drive about to begin: a row of a log, its title, its predicted count."""

    row: pd.Series
    title: str
    expected: ExpectedCount


@dataclass(frozen=True)
class TraverseReading:
    """A completed traverse, already recorded.

    Attributes
    ----------
    step_size : float
        Mean over the traverse, rad or m.
    deviation : str
        How far the count lies from its prediction; empty within the tolerance.
    """

    drive: PlannedDrive
    steps: int
    step_size: float
    deviation: str


class Operator(Protocol):
    """Sets what a motor cannot, and decides what is done with a doubtful reading."""

    def show(self, text: str) -> None:
        """Show a message that needs no answer."""

    def begin_session(self, label: str) -> OperatorReply:
        """Return when the rig is ready for a session."""

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        """Return when a setting is made; `before` is the one that holds until now."""

    def bring_joint(self, joint: int, position: float) -> OperatorReply:
        """Return when a joint has been brought to a position by hand."""

    def begin_drive(self, drive: PlannedDrive) -> None:
        """A drive is about to begin."""

    def progress(self, drive: PlannedDrive, steps: int, detection: Detection) -> None:
        """So many steps have been made."""

    def stop_wanted(self) -> bool:
        """Whether a key was pressed."""

    def review(self, reading: TraverseReading) -> OperatorReply:
        """Show a reading; only a doubtful one needs an answer."""

    def handle_failure(self, drive: PlannedDrive, reason: str) -> OperatorReply:
        """Decide about an interrupted drive: ``GO_ON`` repeats it."""


def keep_operator(operator: Operator) -> Operator:
    """The operator as it is: nobody else looks on."""
    return operator


def format_position(joint: int, position: float) -> str:
    """A joint's position in deg or mm."""
    return format_value(position, "mm" if joint == PRISMATIC else "deg", 2)


def format_setting(wanted: RigSetting, before: RigSetting | None) -> str:
    """What the operator has to set, as far as it differs from `before`.

    Examples
    --------
    >>> print(format_setting(RigSetting(0.0, 0.0, ((3, 0.002, 0.006),)), RigSetting(0.5, 0.0)))
    Set theta to 0.0 deg; set stops for joint 3 at 2.00 mm and 6.00 mm, with the joint between them.
    """
    tasks = [
        f"set {name} to {format_value(getattr(wanted, name), 'deg')}"
        for name in ("theta", "psi")
        if before is None or getattr(before, name) != getattr(wanted, name)
    ]
    stops_before = before.stops if before else ()
    tasks += [f"take the stops of joint {stop[0]} away" for stop in stops_before if stop not in wanted.stops]
    for joint, low, high in wanted.stops:
        if (joint, low, high) not in stops_before:
            ends = " and ".join(format_position(joint, end) for end in (low, high))
            tasks.append(f"set stops for joint {joint} at {ends}, with the joint between them")
    return capitalize_first("; ".join(tasks)) + "."


def format_reading(reading: TraverseReading) -> str:
    """A reading beside its prediction."""
    row, expected = reading.drive.row, reading.drive.expected
    unit = "nm" if row["joint"] == PRISMATIC else "µrad"
    text = f"  {reading.steps:,} steps, {format_value(reading.step_size, unit, 2)} a step"
    if expected.known:
        size = abs(row["stop"] - row["start"]) / expected.steps
        text += f"; the law says {expected.steps:,.0f}, {format_value(size, unit, 2)}"
    return text + (f"\n  DOUBTFUL: {reading.deviation}" if reading.deviation else "")


CONDITIONS_EXAMPLE = "temperature_C=22.5 humidity_pct=40"
PLANNED_CONDITION = "step_period"


def parse_conditions(text: str, option: str | None = None) -> dict[str, float]:
    """Conditions such as "temperature_C=22.5 pressure_hPa=1013", by the columns of a log, SI.

    Parameters
    ----------
    text : str
        Names as in a log's columns, each with a number; other names make columns of the lab's own.
    option : str, optional
        The option's name, for messages.

    Raises
    ------
    InputError
        For what is no such pair, lacks its unit, or is in the plan.

    Examples
    --------
    >>> parse_conditions("supply_V=80, payload_g=0.5 pressure_hPa=1013")
    {'supply': 80.0, 'payload': 0.0005, 'covariate:pressure_hPa': 1013.0}
    """
    pairs = re.findall(r"[^\s,;]+", re.sub(r"\s*=\s*", "=", text))
    return dict(_parse_condition(pair, option) for pair in pairs)


def _parse_condition(pair: str, option: str | None) -> tuple[str, float]:
    name, _, number = pair.partition("=")
    column, unit = CONDITION_SPELLINGS.get(name, (COVARIATE_PREFIX + name, "1"))
    try:
        value = float(number)
    except ValueError:
        value = inf
    if not isfinite(value) or not name:
        message = f"give a name and a number, e.g. {CONDITIONS_EXAMPLE}"
    elif bad_unit := explain_bad_unit(name):
        message = bad_unit
    elif column == PLANNED_CONDITION or (is_known(name) and name not in CONDITION_SPELLINGS):
        message = "is what the plan says; leave it out"
    else:
        return column, to_si(value, unit)
    raise InputError(InputIssue(message, column=option, value=pair))


def format_conditions(conditions: Mapping[str, float]) -> str:
    """Conditions as they would be typed.

    Examples
    --------
    >>> format_conditions({"temperature": 295.65, "covariate:pressure_hPa": 1013.0})
    'temperature_C=22.5 pressure_hPa=1013'
    """
    spellings: dict[str, tuple[str, str]] = {}
    for name, (column, unit) in CONDITION_SPELLINGS.items():
        spellings.setdefault(column, (name, unit))
    pairs = []
    for column, value in conditions.items():
        name, unit = spellings.get(column, (column.removeprefix(COVARIATE_PREFIX), "1"))
        pairs.append(f"{name}={float(from_si(value, unit)):.6g}")
    return " ".join(pairs)
