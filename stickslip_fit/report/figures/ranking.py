"""How likely each cause is at each look at the residuals, with its rivals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from stickslip_fit._format import pluralize as count
from stickslip_fit.diagnose.diagnosis import Diagnosis
from stickslip_fit.diagnose.searching.misfit import Misfit
from stickslip_fit.errors import shorten
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    BLUE,
    GREY,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    TITLE_LINE,
    VERMILLION,
    canvas,
    key_line,
    legend,
    look,
)

MOST_CAUSES = 8
LEAST = -12.0  # powers of ten; less likely is drawn there
CHANCE = "chance alone"
LONGEST_NAME = 24
NAMED, RIVAL, OTHER, NOTHING = "named", "cannot be told from it", "another cause", CHANCE
LOOKS = {NAMED: (BLUE, "o"), RIVAL: (VERMILLION, "s"), OTHER: (GREY, "^"), NOTHING: (INK, "D")}


def ranking_picture(diagnosis: Diagnosis) -> Picture:
    """Causes at each look at the residuals, likeliest first."""
    key, title = "ranking", "How likely each cause is"
    looks = looks_of(diagnosis)
    if not looks[0][1].by_cause:
        return not_drawn(key, title, "It would need more traverses; see what could not have been seen.")
    caption = (
        "If one cause or nothing is at work: the probability of each, on a scale of powers of ten; nothing "
        "is as likely beforehand as all causes together. "
        + (
            f"{count(len(looks), 'look')} at the residuals, one after the other: what was named is in the "
            "law at the next. What stands close to what was named is its rival."
            if len(looks) > 1
            else "Nothing that stands clear of chance alone."
        )
    )
    return picture(key, title, caption, draw_ranking(diagnosis))


def plot_ranking(diagnosis: Diagnosis) -> Figure:
    """The ranking by itself."""
    return on_white(draw_ranking(diagnosis))


def looks_of(diagnosis: Diagnosis) -> list[tuple[str, Misfit, str, tuple[str, ...]]]:
    """Each look: its title, the evidence, what was named and what that cannot be told from."""
    equivalent = {finding.cause: finding.equivalent for finding in diagnosis.findings}
    found = [each for each in diagnosis.search.found if each.misfit is not None and diagnosis.findings]
    looks, known = [], ""
    for each in found:
        assert each.misfit is not None
        rivals = equivalent.get(each.cause, ())
        looks.append((known or "the published law", each.misfit, each.cause, rivals))
        known = f"with {each.cause}" if not known else f"{known}, {each.cause}"
    if not found or diagnosis.search.last is not found[-1].misfit:
        looks.append((known or "the published law", diagnosis.search.last, "", ()))
    return looks


def draw_ranking(diagnosis: Diagnosis) -> Figure:
    """One panel for each look, below one another."""
    looks = looks_of(diagnosis)
    ranked = [_ranked(looked, named, rivals) for _, looked, named, rivals in looks]
    longest = max(len(shorten(cause, LONGEST_NAME)) for each in ranked for cause, *_ in each)
    kinds = [kind for kind in LOOKS if any(kind == found for each in ranked for *_, found in each)]
    with look():
        figure, axes = canvas(
            [0.17 * len(each) + 0.1 for each in ranked], 1, left=0.2 + LETTER_WIDTH * longest,
            top=LEGEND_LINE + TITLE_LINE + 0.14, down=0.2 + TITLE_LINE, share_y=False,
        )  # fmt: skip
        for axis, (title, *_), each in zip(axes[:, 0], looks, ranked, strict=True):
            axis.set_title(shorten(title, 80), loc="left")
            _bars(axis, each)
        axes[-1, 0].set_xlabel("probability")
        axes[-1, 0].xaxis.set_major_formatter(FuncFormatter(lambda power, _: _power(power)))
        legend(figure, [_entry(kind) for kind in kinds])
    return figure


def _ranked(looked: Misfit, named: str, rivals: Sequence[str]) -> list[tuple[str, float, str]]:
    """Name, log10 of the probability, and what it is here; likeliest first."""
    if not looked.by_cause:
        return [(CHANCE, 0.0, NOTHING)]
    causes = [*looked.by_cause, CHANCE]
    logs = np.array([*looked.by_cause.values(), np.log(len(looked.by_cause))])
    powers = (logs - np.logaddexp.reduce(logs)) / np.log(10.0)
    order = sorted(range(len(causes)), key=lambda k: -powers[k])
    shown = [k for k in order if causes[k] != CHANCE][:MOST_CAUSES]
    kept = [k for k in order if k in shown or causes[k] == CHANCE]
    return [(causes[k], float(powers[k]), _kind(causes[k], named, rivals)) for k in kept]


def _kind(cause: str, named: str, rivals: Sequence[str]) -> str:
    if cause == CHANCE:
        return NOTHING
    return NAMED if cause == named else RIVAL if cause in rivals else OTHER


def _bars(axis: Axes, ranked: Sequence[tuple[str, float, str]]) -> None:
    for place, (_, power, kind) in enumerate(ranked):
        colour, marker = LOOKS[kind]
        end = max(power, LEAST)
        axis.plot([LEAST - 0.5, end], [place, place], color=colour, lw=0.8)
        axis.plot(end, place, color=colour, marker="<" if power < LEAST else marker, ms=4.0, clip_on=False)
    axis.set_yticks(range(len(ranked)), [shorten(cause, LONGEST_NAME) for cause, *_ in ranked])
    axis.set_ylim(len(ranked) - 0.5, -0.5)
    axis.set_xlim(LEAST - 0.5, 0.3)
    axis.set_xticks(np.arange(LEAST, 1.0, 2.0))
    axis.grid(visible=False, axis="y")


def _entry(kind: str) -> Line2D:
    colour, marker = LOOKS[kind]
    return key_line(kind, colour, marker=marker, line="-")


def _power(power: float) -> str:
    digits = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
    if power > -2.5:
        return f"{10**power:g}"
    return f"10⁻{f'{-power:.0f}'.translate(digits)}"
