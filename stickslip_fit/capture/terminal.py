"""The person at the rig, met at a terminal; and what is shown where nobody is there to answer."""

from __future__ import annotations

import sys

import typer

from stickslip_fit._format import format_value
from stickslip_fit.capture.conditions import EXAMPLE, conditions_of, conditions_text
from stickslip_fit.capture.ear import Heard
from stickslip_fit.capture.keys import Keys
from stickslip_fit.capture.person import Answer, Choice, Reading, Setting, Work, position_text
from stickslip_fit.errors import InputError
from stickslip_fit.machine import PRISMATIC

DOUBT = 30.0  # s for which a doubtful reading is waited with, so that an unattended afternoon goes on
SHOWN_EVERY = 20  # checks
MOST_TROUBLES = 3  # in a row, where nobody is there to answer
WORDS = {
    "r": "r makes it again",
    "s": "s leaves it out",
    "q": "q ends",
    "n": "n takes a note",
    "c": "c notes conditions",
}
CHOICES = {"": Choice.GO_ON, "r": Choice.REPEAT, "s": Choice.SKIP, "q": Choice.QUIT}


class Teller:
    """Prints how a capture goes."""

    def __init__(self) -> None:
        self._checks = 0

    def tell(self, text: str) -> None:
        """See `Person.tell`."""
        self._clear()
        print(text)

    def begins(self, work: Work) -> None:
        """See `Person.begins`."""
        self._checks = 0
        self.tell(f"{work.title} ({work.row['joint']}{work.row['direction']})")

    def progress(self, work: Work, steps: int, heard: Heard) -> None:
        """See `Person.progress`; shown where a person can watch it."""
        self._checks += 1
        if sys.stdout.isatty() and self._checks % SHOWN_EVERY == 0:
            about = f" of about {work.expected.steps:,.0f}" if work.expected.known else ""
            typer.echo(f"\r\x1b[K  {steps:,}{about} steps, {heard.level:+.1f} dB", nl=False)

    def _clear(self) -> None:
        if sys.stdout.isatty():
            typer.echo("\r\x1b[K", nl=False)  # which old Windows consoles have to be told in their way


class Terminal(Teller):
    """Asks at the terminal.

    Parameters
    ----------
    keys : Keys
    """

    def __init__(self, keys: Keys) -> None:
        super().__init__()
        self.keys = keys

    def begin_session(self, label: str) -> Answer:
        """See `Person.begin_session`."""
        return self._ask(f"Session {label}: switch on and warm up.", "sqc")

    def set_up(self, wanted: Setting, before: Setting | None) -> Answer:
        """See `Person.set_up`."""
        return self._ask(setting_text(wanted, before), "sqc")

    def bring(self, joint: int, position: float) -> Answer:
        """See `Person.bring`."""
        return self._ask(f"Bring joint {joint} to {position_text(joint, position)} by hand.", "sqc")

    def stop_wanted(self) -> bool:
        """See `Person.stop_wanted`."""
        return self.keys.pressed()

    def reading(self, reading: Reading) -> Answer:
        """See `Person.reading`; a doubtful one is waited with for a while, then kept."""
        self.tell(reading_text(reading))
        return self._ask(f"kept in {DOUBT:.0f} s", "rsqnc", DOUBT) if reading.departure else Answer()

    def trouble(self, work: Work, why: str) -> Answer:
        """See `Person.trouble`."""
        return self._ask(f"Broken off: {why}.", "sqnc")

    def _ask(self, question: str, choices: str, seconds: float | None = None) -> Answer:
        asked = ["Enter goes on", *(WORDS[each] for each in choices), "p waits"]
        self.tell(f"{question}\n  [{', '.join(asked)}]")
        note, conditions = "", dict[str, float]()
        while True:
            key = self.keys.key(seconds)
            if key == "n" and key in choices:
                note = self.keys.line("note")
            elif key == "c" and key in choices:
                conditions |= self._conditions()
            elif key in CHOICES and (not key or key in choices):
                return Answer(CHOICES[key], note, conditions)
            # Whoever answers is there: from now on there is no hurry.
            seconds = None

    def _conditions(self) -> dict[str, float]:
        self.tell(f"  as a log's columns have them, e.g. {EXAMPLE}")
        try:
            found = conditions_of(self.keys.line("conditions"))
        except InputError as error:
            self.tell(f"  {error}; nothing is changed, c once more")
            return {}
        self.tell(f"  from now on {conditions_text(found)}" if found else "  nothing is changed")
        return found


class Unattended(Teller):
    """Nobody answers: all is taken to be set as it should be, and a drive that keeps failing ends it."""

    def __init__(self) -> None:
        super().__init__()
        self._troubles = 0

    def begin_session(self, label: str) -> Answer:
        """See `Person.begin_session`."""
        self.tell(f"Session {label}")
        return Answer()

    def set_up(self, wanted: Setting, before: Setting | None) -> Answer:
        """See `Person.set_up`."""
        self.tell(setting_text(wanted, before))
        return Answer()

    def bring(self, joint: int, position: float) -> Answer:
        """See `Person.bring`."""
        self.tell(f"joint {joint} brought to {position_text(joint, position)} by hand")
        return Answer()

    def stop_wanted(self) -> bool:
        """See `Person.stop_wanted`."""
        return False

    def reading(self, reading: Reading) -> Answer:
        """See `Person.reading`."""
        self._troubles = 0
        self.tell(reading_text(reading))
        return Answer()

    def trouble(self, work: Work, why: str) -> Answer:
        """See `Person.trouble`."""
        self._troubles += 1
        self.tell(f"  broken off: {why}")
        return Answer(Choice.QUIT if self._troubles >= MOST_TROUBLES else Choice.GO_ON)


def setting_text(wanted: Setting, before: Setting | None) -> str:
    """What a person has to set, as far as it is not set already.

    Examples
    --------
    >>> print(setting_text(Setting(0.0, 0.0, ((3, 0.002, 0.006),)), Setting(0.5, 0.0)))
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
            ends = " and ".join(position_text(joint, end) for end in (low, high))
            said.append(f"set stops for joint {joint} at {ends}, with the joint between them")
    text = "; ".join(said)
    return text[:1].upper() + text[1:] + "."


def reading_text(reading: Reading) -> str:
    """A reading with the law's prediction beside it."""
    row, expected = reading.work.row, reading.work.expected
    unit = "nm" if row["joint"] == PRISMATIC else "µrad"
    text = f"  {reading.steps:,} steps, {format_value(reading.step_size, unit, 2)} a step"
    if expected.known:
        size = abs(row["stop"] - row["start"]) / expected.steps
        text += f"; the law says {expected.steps:,.0f}, {format_value(size, unit, 2)}"
    return text + (f"\n  DOUBTFUL: {reading.departure}" if reading.departure else "")
