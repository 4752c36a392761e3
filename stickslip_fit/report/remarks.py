"""The results' remarks, those that differ only in their session told once."""

from __future__ import annotations

from stickslip_fit._format import join_words, pluralize
from stickslip_fit.fit import Remark, Result

MOST_NAMED = 6


def remarks(*results: Result) -> list[str]:
    """What cannot be known and which traverses are missing, by any of the results."""
    told: dict[tuple[str, str], list[Remark]] = {}
    for result in results:
        for remark in result.remarks:
            same = (
                remark.message.replace(f"session {remark.session}", "session")
                if remark.session
                else remark.message
            )
            told.setdefault((result.method, same), []).append(remark)
    lines: dict[str, list[str]] = {}
    for (method, _), alike in told.items():
        lines.setdefault(_once(alike), []).append(method.replace("-", " "))
    return [f"{line[0].upper()}{line[1:]} ({join_words(methods)})" for line, methods in lines.items()]


def _once(alike: list[Remark]) -> str:
    first, *others = alike
    if not others:
        return f"{first.message}."
    names = [remark.session for remark in others]
    more = (
        [*names[:MOST_NAMED], pluralize(len(names) - MOST_NAMED, "other")]
        if len(names) > MOST_NAMED
        else names
    )
    return f"{first.message}. The same in {'session' if len(names) == 1 else 'sessions'} {join_words(more)}."
