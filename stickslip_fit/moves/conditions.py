"""What a law with causes in it looks at beside where everything stands, spelled as a log's columns are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.causes.parameters import FIRST, NEEDED
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.fit import Result
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs.columns import CONDITION_SPELLINGS, COVARIATE
from stickslip_fit.units import to_si

SPELLINGS = {
    "session_min": ("session_seconds", "min"),
    "session_s": ("session_seconds", "s"),
    "session_h": ("session_seconds", "h"),
    "steps_before": ("steps_before", "steps"),
    **CONDITION_SPELLINGS,
}
MEANINGS = {"session_seconds": "how long the session has run", "steps_before": NEEDED["steps_before"]}
# What follows from the drives themselves, and from which session is asked for.
OWN = ("session", *FIRST)
# What is asked for, or a plan's own.
GIVEN = (*NEEDED, "step_period")


def looked_at(laws: Iterable[StepLaw]) -> tuple[str, ...]:
    """Columns of a log, beside positions and angles, on which laws depend."""
    causes = [cause for law in laws if isinstance(law, ExtendedLaw) for cause, _ in law.acting]
    return tuple(dict.fromkeys(name for cause in causes for name in cause.columns if name not in OWN))


def conditions_from(texts: Iterable[str], result: Result, option: str) -> dict[str, float]:
    """Conditions such as "temperature_C=23" or "session_min=30", by a log's columns, SI.

    Parameters
    ----------
    texts : iterable of str
    result : Result
        A condition at which none of its laws looks is refused, since it would change nothing.
    option : str
        As messages call it.

    Raises
    ------
    InputError
    """
    wanted, found = _looked_at(result), dict[str, float]()
    known = SPELLINGS | {
        name.removeprefix(COVARIATE): (name, "1") for name in wanted if name.startswith(COVARIATE)
    }
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        column, unit = known.get(name, ("", "1"))
        if column not in wanted:
            told = ", ".join(map(spelled, wanted)) or "nothing beside positions and angles"
            message = f"this law looks at {told}; leave {name or text} out"
            raise InputError(Problem(message, column=option, value=text))
        try:
            found[column] = to_si(float(value), unit)
        except ValueError:
            message = f"give a number, e.g. {name}=20"
            raise InputError(Problem(message, column=option, value=text)) from None
    return found


def refuse_lacking(result: Result, conditions: Mapping[str, Any], option: str) -> None:
    """Ask for what no law can do without.

    Raises
    ------
    InputError
        Naming each such condition as `conditions_from` reads it.
    """
    lacking = [name for name in _looked_at(result) if name in NEEDED and name not in conditions]
    if lacking:
        raise InputError(
            [
                Problem(f"the law looks at {MEANINGS[name]}: say {option} {spelled(name)}=NUMBER")
                for name in lacking
            ]
        )


def conditions_text(result: Result, conditions: Mapping[str, Any], option: str) -> str:
    """What is taken for granted because it was not given; empty where there is nothing."""
    standing_in = [
        f"{option} {spelled(name)}" for name in _looked_at(result) if name not in {*conditions, *GIVEN}
    ]
    return f"as on average in the log, since not given: {', '.join(standing_in)}" if standing_in else ""


def spelled(column: str) -> str:
    """A column as a person types it, the usual unit in its name.

    Examples
    --------
    >>> [spelled(name) for name in ("temperature", "session_seconds", "covariate:pressure_hPa")]
    ['temperature_C', 'session_min', 'pressure_hPa']
    """
    usual = [typed for typed, (name, _) in SPELLINGS.items() if name == column]
    return usual[0] if usual else column.removeprefix(COVARIATE)


def _looked_at(result: Result) -> tuple[str, ...]:
    return looked_at(fit.law for fit in result.joints.values())
