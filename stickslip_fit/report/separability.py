"""What a plan could tell, as text: the answer, the causes with their sizes, the pairs that are hard."""

from __future__ import annotations

from textwrap import fill

import numpy as np

from stickslip_fit._format import format_percent, join_words, pluralize
from stickslip_fit._summary import text_table
from stickslip_fit.diagnose.experiments.matrix import CONFUSED, Matrix, Showing
from stickslip_fit.units import from_si

WIDTH = 110
SHOWN_AT = 8.0  # strength at which rates of confusion are shown
MOST_PAIRS = 20


def separability_text(found: Matrix, plan: str, traverses: int, sessions: int) -> str:
    """The answer first, then tables of what matters.

    Parameters
    ----------
    found : Matrix
    plan : str
        Its name.
    traverses, sessions : int
        How many it has.
    """
    hard = _hard(found)
    parts = [
        _answer(found, hard, plan, traverses, sessions),
        f"could be found\n{_sizes(found)}\n{_how(found)}",
    ]
    if hard:
        parts.append(f"hard to tell apart\n{_pairs(found, hard[:MOST_PAIRS])}{_left_out(hard)}")
    if found.untestable:
        parts.append(f"could not be seen in its log\n{_unseen(found)}")
    return "\n\n".join(parts)


def _hard(found: Matrix) -> list[tuple[str, str, float]]:
    """Pairs that are still confused where one of the two is just found."""
    return [
        (one, other, needed)
        for one, other, needed in found.pairs()
        if needed > min(found.of(one).found, found.of(other).found)
    ]


def _answer(
    found: Matrix, hard: list[tuple[str, str, float]], plan: str, traverses: int, sessions: int
) -> str:
    shown = len(found.showing) + len(found.by_scatter)
    told = (
        f"{plan}: {pluralize(traverses, 'traverse')} in {pluralize(sessions, 'session')} could show "
        f"{shown} of {shown + len(found.untestable)} causes."
    )
    never = [f"{one} from {other}" for one, other, _ in hard if not found.apart(one, other)]
    if never:
        told += f" At no plausible size could they tell {join_words(never, 'or')}."
    elif hard:
        told += f" {pluralize(len(hard), 'pair')} of them could be found before they could be told apart."
    else:
        told += " Whatever of these is large enough to be found is told from all others."
    return fill(told, WIDTH, break_on_hyphens=False)


def _sizes(found: Matrix) -> str:
    rows = [
        [each.cause, _size(each, each.smallest), _size(each, each.largest), _hardest(found, each.cause)]
        for each in found.showing
    ]
    return text_table(["cause", "found from", "largest plausible", "hardest rival"], rows)


def _hardest(found: Matrix, cause: str) -> str:
    """The rival that is hardest to tell from a cause, and how often it is taken for it."""
    others = [other for other in found.causes if other != cause]
    rates = [found.rate(cause, other, SHOWN_AT) for other in others]
    if not rates or max(rates) < CONFUSED:
        return "–"
    return f"{others[int(np.argmax(rates))]} {format_percent(max(rates))}"


def _how(found: Matrix) -> str:
    strengths = [each.found for each in found.showing]
    if not found.showing:
        return ""
    scatter = (
        f" Not listed: {join_words(found.by_scatter)}, which single counts show." if found.by_scatter else ""
    )
    return fill(
        f"found from: the size that raises the alarm in nine of ten logs, at a false-alarm rate of "
        f"{format_percent(found.alpha)}; for that, strength (rms effect left after recalibration, over the "
        f"repeatability, times the square root of the traverses) must be {min(strengths):.1f} to "
        f"{max(strengths):.1f}, by logs of this plan in which nothing is wrong. hardest rival: taken for "
        f"each other in so many logs at strength {SHOWN_AT:.0f}, where that is {format_percent(CONFUSED)} or "
        f"more.{scatter}",
        WIDTH,
        break_on_hyphens=False,
    )


def _pairs(found: Matrix, hard: list[tuple[str, str, float]]) -> str:
    rows = [
        [
            one, other, format_percent(found.rate(one, other, SHOWN_AT)),
            f"{needed:.1f}" if np.isfinite(needed) else "never",
            _from(found.of(one), needed), _from(found.of(other), needed),
        ]
        for one, other, needed in hard
    ]  # fmt: skip
    header = ["cause", "rival", f"confused at {SHOWN_AT:.0f}", "told apart from", "cause of", "rival of"]
    return text_table(header, rows, left=2)


def _from(showing: Showing, strength: float) -> str:
    """Size at a strength; in brackets beyond what is plausible."""
    if not np.isfinite(strength):
        return "–"
    text = _size(showing, showing.size(strength))
    return text if showing.size(strength) <= showing.largest else f"({text})"


def _left_out(hard: list[tuple[str, str, float]]) -> str:
    return f"\n(the hardest {MOST_PAIRS} of {len(hard)} pairs)" if len(hard) > MOST_PAIRS else ""


def _unseen(found: Matrix) -> str:
    return "\n".join(
        fill(
            f"{cause}: {reason}", WIDTH, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
        )
        for cause, reason in found.untestable.items()
    )


def _size(showing: Showing, value: float) -> str:
    unit = "" if showing.unit == "1" else f" {showing.unit}"
    return f"{float(f'{from_si(value, showing.unit):.2g}'):,g}{unit}"
