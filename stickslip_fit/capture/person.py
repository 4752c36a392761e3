"""The person at the rig, as a capture talks with them; a test plays the person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import pandas as pd

from stickslip_fit._format import format_value
from stickslip_fit.capture.ear import Heard
from stickslip_fit.capture.expected import Expected
from stickslip_fit.machine import PRISMATIC


class Choice(Enum):
    """What the person wants."""

    GO_ON = "go on"
    REPEAT = "repeat"
    SKIP = "skip"
    QUIT = "quit"


@dataclass(frozen=True)
class Answer:
    """What the person wants, and what they have to say.

    Attributes
    ----------
    choice : Choice
    note : str
        On the drive that was just made, where there was one.
    conditions : dict of str to float
        Those that have changed, by the columns of a log, SI.
    """

    choice: Choice = Choice.GO_ON
    note: str = ""
    conditions: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Setting:
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
class Work:
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
    expected: Expected


@dataclass(frozen=True)
class Reading:
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

    work: Work
    steps: int
    step_size: float
    departure: str


class Person(Protocol):
    """Whoever sets what a motor cannot, and decides what is done with a doubtful reading."""

    def tell(self, text: str) -> None:
        """Say something that needs no answer."""

    def begin_session(self, label: str) -> Answer:
        """Another session begins: return when the rig is ready for it."""
        ...

    def set_up(self, wanted: Setting, before: Setting | None) -> Answer:
        """Ask for a setting, and return when it is made; `before` is what stood until now."""
        ...

    def bring(self, joint: int, position: float) -> Answer:
        """Ask for a joint to be brought to a position by hand, and return when it is there."""
        ...

    def begins(self, work: Work) -> None:
        """A drive is about to begin."""

    def progress(self, work: Work, steps: int, heard: Heard) -> None:
        """So many steps have been made."""

    def stop_wanted(self) -> bool:
        """Whether a key was pressed."""
        ...

    def reading(self, reading: Reading) -> Answer:
        """Show a reading; a good one need not be waited for."""
        ...

    def trouble(self, work: Work, why: str) -> Answer:
        """Ask what to do about a drive that was broken off: ``GO_ON`` makes it again."""
        ...


def position_text(joint: int, position: float) -> str:
    """A joint's position in people's units."""
    return format_value(position, "mm" if joint == PRISMATIC else "deg", 2)
