"""Operator, the interface to the person at the rig, and its terminal and unattended implementations.

The operator sets what no motor can (base, stops, joints by hand) and decides what to do with a reading
that differs from its prediction. `ExpectedCount` is that prediction, with its 95 % interval.
"""

from __future__ import annotations

import os
import re
import select
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from importlib import import_module
from math import inf, isfinite
from time import monotonic, sleep
from types import TracebackType
from typing import Any, Protocol, Self

import pandas as pd
import typer

from stickslip_fit._format import format_value
from stickslip_fit.capture.protocols import Detection
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.schema import CONDITION_SPELLINGS, COVARIATE_PREFIX, explain_bad_unit, is_known
from stickslip_fit.units import PRISMATIC, from_si, to_si

DEFAULT_TOLERANCE = 0.10  # by how much a reading may miss a prediction that doesn't say how sure it is
MAX_HALF_WIDTHS = 2.0  # half-widths of the 95 % interval; one reading in 10,000 lies beyond by chance


class CountPredictor(Protocol):
    """Says beforehand what counts will be."""

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Counts of traverses to come.

        Parameters
        ----------
        rows : DataFrame
            Traverses in a plan's columns.

        Returns
        -------
        DataFrame
            steps, before they are rounded up to the next check, low and high (95 % of readings); NaN
            where they are not known.
        """


@dataclass(frozen=True)
class ExpectedCount:
    """A prediction of one count.

    Attributes
    ----------
    steps, low, high : float
        NaN where not known.

    Examples
    --------
    >>> ExpectedCount(12300.0, 12230.0, 12370.0).departure(12500)
    '1.6 % more steps than predicted (12,300)'
    >>> ExpectedCount(12300.0, 12230.0, 12370.0).departure(12400)
    ''
    """

    steps: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether anything was predicted."""
        return isfinite(self.steps) and self.steps > 0

    def departure(self, steps: float) -> str:
        """How far a count lies from what it should be; empty where that may be chance, or nobody knows."""
        if not self.known:
            return ""
        allowed = DEFAULT_TOLERANCE * self.steps
        if isfinite(self.low) and isfinite(self.high):
            allowed = MAX_HALF_WIDTHS * max(self.high - self.steps, self.steps - self.low)
        if abs(steps - self.steps) <= allowed:
            return ""
        more = "more" if steps > self.steps else "fewer"
        share = abs(steps / self.steps - 1)
        return f"{share:.1%} {more} steps than predicted ({self.steps:,.0f})".replace("%", " %")


UNKNOWN_COUNT = ExpectedCount(float("nan"), float("nan"), float("nan"))


def predict_count(predictor: CountPredictor | None, row: pd.Series) -> ExpectedCount:
    """What the predictor says of one traverse; nothing without one."""
    if predictor is None:
        return UNKNOWN_COUNT
    found = predictor.predict(row.to_frame().T.infer_objects().reset_index(drop=True)).iloc[0]
    return ExpectedCount(float(found["steps"]), float(found["low"]), float(found["high"]))


class OperatorChoice(Enum):
    """What the person wants."""

    GO_ON = "go on"
    REPEAT = "repeat"
    SKIP = "skip"
    QUIT = "quit"


@dataclass(frozen=True)
class OperatorReply:
    """What the person wants, and what they have to say.

    Attributes
    ----------
    choice : Choice
    note : str
        On the drive that was just made, where there was one.
    conditions : dict of str to float
        Those that have changed, by the columns of a log, SI.
    """

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
        Joint and the two positions between which it is to be held, rad or m, where they are not the ends
        of its range. Both are to be stops that it can run into.
    """

    theta: float
    psi: float
    stops: tuple[tuple[int, float, float], ...] = ()


@dataclass(frozen=True)
class PlannedDrive:
    """The drive about to be made.

    Attributes
    ----------
    row : Series
        A traverse in a log's columns.
    title : str
    expected : Expected
    """

    row: pd.Series
    title: str
    expected: ExpectedCount


@dataclass(frozen=True)
class TraverseReading:
    """A traverse that was heard to its end; it has been written down.

    Attributes
    ----------
    work : Work
    steps : int
    step_size : float
        Mean over the traverse, rad or m.
    departure : str
        Empty, or what is odd about it.
    """

    work: PlannedDrive
    steps: int
    step_size: float
    departure: str


class Operator(Protocol):
    """Whoever sets what a motor cannot, and decides what is done with a doubtful reading."""

    def tell(self, text: str) -> None:
        """Say something that needs no answer."""

    def begin_session(self, label: str) -> OperatorReply:
        """Another session begins: return when the rig is ready for it."""
        ...

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        """Ask for a setting, and return when it is made; `before` is what stood until now."""
        ...

    def bring(self, joint: int, position: float) -> OperatorReply:
        """Ask for a joint to be brought to a position by hand, and return when it is there."""
        ...

    def begins(self, work: PlannedDrive) -> None:
        """A drive is about to begin."""

    def progress(self, work: PlannedDrive, steps: int, heard: Detection) -> None:
        """So many steps have been made."""

    def stop_wanted(self) -> bool:
        """Whether a key was pressed."""
        ...

    def reading(self, reading: TraverseReading) -> OperatorReply:
        """Show a reading; a good one need not be waited for."""
        ...

    def trouble(self, work: PlannedDrive, why: str) -> OperatorReply:
        """Ask what to do about a drive that was broken off: ``GO_ON`` makes it again."""
        ...


def format_position(joint: int, position: float) -> str:
    """A joint's position in people's units."""
    return format_value(position, "mm" if joint == PRISMATIC else "deg", 2)


END_OF_INPUT = "q"  # what the end of the input means
SPECIAL = "\x1b"  # an arrow or a function key, whichever
POLL = 0.02  # s between two looks at a keyboard that cannot be waited for


class Console(Protocol):
    """A terminal from which keys come as they are pressed, not shown, between `open` and `close`."""

    def open(self) -> None:
        """Have every key at once."""

    def close(self) -> None:
        """Leave the terminal as it was."""

    def waiting(self, seconds: float | None) -> bool:
        """Whether a key is there to be read, within so many seconds."""
        ...

    def typed(self) -> str:
        """What has been typed; waits for it."""
        ...


class PosixConsole:
    """The standard input, read past Python's buffer, which would hide from `waiting` what is in it."""

    def __init__(self) -> None:
        self._before: list[Any] = []

    def open(self) -> None:
        """See `Console.open`."""
        import termios
        import tty

        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)

    def close(self) -> None:
        """See `Console.close`."""
        import termios

        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def waiting(self, seconds: float | None) -> bool:
        """See `Console.waiting`."""
        return bool(select.select([sys.stdin], [], [], seconds)[0])

    def typed(self) -> str:
        """See `Console.typed`."""
        typed = os.read(sys.stdin.fileno(), 64).decode("utf-8", "replace")
        if not typed:
            raise KeyboardInterrupt  # the terminal is gone, and with it whoever could answer
        return re.sub(r"\x1b[\[O][0-9;]*[A-Za-z~]", SPECIAL, typed)


class WindowsConsole:
    """The console window, which gives keys one by one and cannot be waited for but by looking."""

    def __init__(self) -> None:
        self._console: Any = import_module("msvcrt")

    def open(self) -> None:
        """See `Console.open`: it always does."""

    def close(self) -> None:
        """See `Console.close`."""

    def waiting(self, seconds: float | None) -> bool:
        """See `Console.waiting`."""
        end = monotonic() + (inf if seconds is None else seconds)
        while not self._console.kbhit():
            if monotonic() >= end:
                return False
            sleep(POLL)
        return True

    def typed(self) -> str:
        """See `Console.typed`."""
        key = self._console.getwch()
        if key == "\x03":
            raise KeyboardInterrupt  # Ctrl-C, which this way of reading takes for a key
        if key == "\x00" or (key == "\xe0" and self._console.kbhit()):  # else an à
            self._console.getwch()  # says which
            return SPECIAL
        return key


class Keyboard:
    """Reads the standard input key by key, as long as it is used as a context."""

    def __init__(self) -> None:
        self._console: Console | None = None
        self._ahead = ""  # typed, and not asked for yet

    def __enter__(self) -> Self:
        if sys.stdin.isatty():
            self._console = console()
            self._console.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._console is not None:
            self._console.close()
            self._console = None

    def pressed(self) -> bool:
        """Whether a key was pressed since; it counts as read. What was typed ahead of that is forgotten."""
        self._ahead, pressed = "", False
        while self._console is not None and self._console.waiting(0.0):
            pressed = bool(self._console.typed())
        return pressed

    def key(self, seconds: float | None = None) -> str:
        """Wait for a key, for so many seconds or as long as it takes.

        Returns
        -------
        str
            In lower case; empty for Enter, and where none was pressed in time.
        """
        if self._console is None:
            line = sys.stdin.readline()
            return line.strip()[:1].lower() if line else END_OF_INPUT
        if seconds is not None and not (self._ahead or self._console.waiting(seconds)):
            return ""
        return self._next(self._console).strip().lower()

    def line(self, label: str) -> str:
        """A line of text as it is typed behind a label."""
        if self._console is None:
            return sys.stdin.readline().strip()
        text = ""
        print(f"{label}: ", end="", flush=True)
        while (key := self._next(self._console)) not in "\r\n":  # Enter comes as either
            if key.isprintable():
                text += key
                print(key, end="", flush=True)
            elif key in "\b\x7f" and text:
                text = text[:-1]
                print("\b \b", end="", flush=True)
        print()
        return text.strip()

    def _next(self, console: Console) -> str:
        self._ahead = self._ahead or console.typed()
        key, self._ahead = self._ahead[0], self._ahead[1:]
        return key


def console() -> Console:
    """The terminal of this system."""
    try:
        import_module("termios")
    except ImportError:
        return WindowsConsole()
    return PosixConsole()


CONDITIONS_EXAMPLE = "temperature_C=22.5 humidity_pct=40"
PLANNED_CONDITION = "step_period"


def parse_conditions(text: str, option: str | None = None) -> dict[str, float]:
    """What "temperature_C=22.5 pressure_hPa=1013" says, by the columns of a log, SI.

    Parameters
    ----------
    text : str
        Names as a log's columns have them, each with a number. Other names than the format's make columns of
        the lab's own.
    option : str, optional
        As messages call it.

    Raises
    ------
    InputError
        For what is no such pair, lacks its unit, or is said by the plan.

    Examples
    --------
    >>> parse_conditions("supply_V=80, payload_g=0.5 pressure_hPa=1013")
    {'supply': 80.0, 'payload': 0.0005, 'covariate:pressure_hPa': 1013.0}
    """
    pairs = re.findall(r"[^\s,;]+", re.sub(r"\s*=\s*", "=", text))
    return dict(_parse_condition(pair, option) for pair in pairs)


def _parse_condition(pair: str, option: str | None) -> tuple[str, float]:
    name, _, said = pair.partition("=")
    column, unit = CONDITION_SPELLINGS.get(name, (COVARIATE_PREFIX + name, "1"))
    message = None
    value = _parse_number(said)
    if value is None or not name:
        message = f"give a name and a number, e.g. {CONDITIONS_EXAMPLE}"
    elif fault := explain_bad_unit(name):
        message = fault
    elif column == PLANNED_CONDITION or (is_known(name) and name not in CONDITION_SPELLINGS):
        message = "is what the plan says; leave it out"
    if message or value is None:
        raise InputError(InputIssue(message or "", column=option, value=pair))
    return column, to_si(value, unit)


def _parse_number(said: str) -> float | None:
    try:
        value = float(said)
    except ValueError:
        return None
    return value if isfinite(value) else None


def format_conditions(conditions: Mapping[str, float]) -> str:
    """Conditions as they would be typed.

    Examples
    --------
    >>> format_conditions({"temperature": 295.65, "covariate:pressure_hPa": 1013.0})
    'temperature_C=22.5 pressure_hPa=1013'
    """
    usual: dict[str, tuple[str, str]] = {}
    for typed, (column, unit) in CONDITION_SPELLINGS.items():
        usual.setdefault(column, (typed, unit))
    shown = []
    for column, value in conditions.items():
        typed, unit = usual.get(column, (column.removeprefix(COVARIATE_PREFIX), "1"))
        shown.append(f"{typed}={float(from_si(value, unit)):.6g}")
    return " ".join(shown)


DOUBT_SECONDS = 30.0  # s for which a doubtful reading is waited with, so that an unattended afternoon goes on
PROGRESS_INTERVAL = 20  # checks
MAX_FAILURES = 3  # in a row, where nobody is there to answer
KEY_HELP = {
    "r": "r makes it again",
    "s": "s leaves it out",
    "q": "q ends",
    "n": "n takes a note",
    "c": "c notes conditions",
}
KEY_CHOICES = {
    "": OperatorChoice.GO_ON,
    "r": OperatorChoice.REPEAT,
    "s": OperatorChoice.SKIP,
    "q": OperatorChoice.QUIT,
}


class ConsoleOutput:
    """Prints how a capture goes."""

    def __init__(self) -> None:
        self._checks = 0

    def tell(self, text: str) -> None:
        """See `Person.tell`."""
        self._clear()
        print(text)

    def begins(self, work: PlannedDrive) -> None:
        """See `Person.begins`."""
        self._checks = 0
        self.tell(f"{work.title} ({work.row['joint']}{work.row['direction']})")

    def progress(self, work: PlannedDrive, steps: int, heard: Detection) -> None:
        """See `Person.progress`; shown where a person can watch it."""
        self._checks += 1
        if sys.stdout.isatty() and self._checks % PROGRESS_INTERVAL == 0:
            about = f" of about {work.expected.steps:,.0f}" if work.expected.known else ""
            typer.echo(f"\r\x1b[K  {steps:,}{about} steps, {heard.level:+.1f} dB", nl=False)

    def _clear(self) -> None:
        if sys.stdout.isatty():
            typer.echo("\r\x1b[K", nl=False)  # which old Windows consoles have to be told in their way


class TerminalOperator(ConsoleOutput):
    """Asks at the terminal.

    Parameters
    ----------
    keys : Keys
    """

    def __init__(self, keys: Keyboard) -> None:
        super().__init__()
        self.keys = keys

    def begin_session(self, label: str) -> OperatorReply:
        """See `Person.begin_session`."""
        return self._ask(f"Session {label}: switch on and warm up.", "sqc")

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        """See `Person.set_up`."""
        return self._ask(format_setting(wanted, before), "sqc")

    def bring(self, joint: int, position: float) -> OperatorReply:
        """See `Person.bring`."""
        return self._ask(f"Bring joint {joint} to {format_position(joint, position)} by hand.", "sqc")

    def stop_wanted(self) -> bool:
        """See `Person.stop_wanted`."""
        return self.keys.pressed()

    def reading(self, reading: TraverseReading) -> OperatorReply:
        """See `Person.reading`; a doubtful one is waited with for a while, then kept."""
        self.tell(format_reading(reading))
        return (
            self._ask(f"kept in {DOUBT_SECONDS:.0f} s", "rsqnc", DOUBT_SECONDS)
            if reading.departure
            else OperatorReply()
        )

    def trouble(self, work: PlannedDrive, why: str) -> OperatorReply:
        """See `Person.trouble`."""
        return self._ask(f"Broken off: {why}.", "sqnc")

    def _ask(self, question: str, choices: str, seconds: float | None = None) -> OperatorReply:
        asked = ["Enter goes on", *(KEY_HELP[each] for each in choices), "p waits"]
        self.tell(f"{question}\n  [{', '.join(asked)}]")
        note, conditions = "", dict[str, float]()
        while True:
            key = self.keys.key(seconds)
            if key == "n" and key in choices:
                note = self.keys.line("note")
            elif key == "c" and key in choices:
                conditions |= self._conditions()
            elif key in KEY_CHOICES and (not key or key in choices):
                return OperatorReply(KEY_CHOICES[key], note, conditions)
            # Whoever answers is there: from now on there is no hurry.
            seconds = None

    def _conditions(self) -> dict[str, float]:
        self.tell(f"  as a log's columns have them, e.g. {CONDITIONS_EXAMPLE}")
        try:
            found = parse_conditions(self.keys.line("conditions"))
        except InputError as error:
            self.tell(f"  {error}; nothing is changed, c once more")
            return {}
        self.tell(f"  from now on {format_conditions(found)}" if found else "  nothing is changed")
        return found


class UnattendedOperator(ConsoleOutput):
    """Nobody answers: all is taken to be set as it should be, and a drive that keeps failing ends it."""

    def __init__(self) -> None:
        super().__init__()
        self._troubles = 0

    def begin_session(self, label: str) -> OperatorReply:
        """See `Person.begin_session`."""
        self.tell(f"Session {label}")
        return OperatorReply()

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        """See `Person.set_up`."""
        self.tell(format_setting(wanted, before))
        return OperatorReply()

    def bring(self, joint: int, position: float) -> OperatorReply:
        """See `Person.bring`."""
        self.tell(f"joint {joint} brought to {format_position(joint, position)} by hand")
        return OperatorReply()

    def stop_wanted(self) -> bool:
        """See `Person.stop_wanted`."""
        return False

    def reading(self, reading: TraverseReading) -> OperatorReply:
        """See `Person.reading`."""
        self._troubles = 0
        self.tell(format_reading(reading))
        return OperatorReply()

    def trouble(self, work: PlannedDrive, why: str) -> OperatorReply:
        """See `Person.trouble`."""
        self._troubles += 1
        self.tell(f"  broken off: {why}")
        return OperatorReply(OperatorChoice.QUIT if self._troubles >= MAX_FAILURES else OperatorChoice.GO_ON)


def format_setting(wanted: RigSetting, before: RigSetting | None) -> str:
    """What a person has to set, as far as it is not set already.

    Examples
    --------
    >>> print(format_setting(RigSetting(0.0, 0.0, ((3, 0.002, 0.006),)), RigSetting(0.5, 0.0)))
    Set theta to 0.0 deg; set stops for joint 3 at 2.00 mm and 6.00 mm, with the joint between them.
    """
    said = [
        f"set {name} to {format_value(getattr(wanted, name), 'deg')}"
        for name in ("theta", "psi")
        if before is None or getattr(before, name) != getattr(wanted, name)
    ]
    stops_before = before.stops if before else ()
    said += [f"take the stops of joint {each[0]} away" for each in stops_before if each not in wanted.stops]
    for joint, low, high in wanted.stops:
        if (joint, low, high) not in stops_before:
            ends = " and ".join(format_position(joint, end) for end in (low, high))
            said.append(f"set stops for joint {joint} at {ends}, with the joint between them")
    text = "; ".join(said)
    return text[:1].upper() + text[1:] + "."


def format_reading(reading: TraverseReading) -> str:
    """A reading with the law's prediction beside it."""
    row, expected = reading.work.row, reading.work.expected
    unit = "nm" if row["joint"] == PRISMATIC else "µrad"
    text = f"  {reading.steps:,} steps, {format_value(reading.step_size, unit, 2)} a step"
    if expected.known:
        size = abs(row["stop"] - row["start"]) / expected.steps
        text += f"; the law says {expected.steps:,.0f}, {format_value(size, unit, 2)}"
    return text + (f"\n  DOUBTFUL: {reading.departure}" if reading.departure else "")
