"""What could not be told apart: how often each pair of causes would be confused in this log."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from stickslip_fit.diagnose.diagnosis import Diagnosis, Finding
from stickslip_fit.diagnose.experiments.separability import confusion, likeness
from stickslip_fit.diagnose.searching.misfit import UNKNOWN, Misfit, kind_of
from stickslip_fit.diagnose.searching.search import Found
from stickslip_fit.errors import shorten
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import INK, LETTER_WIDTH, VERMILLION, canvas, look

MOST_CAUSES = 8
WORST, DARK = 0.5, 0.3  # a coin; beyond that numbers are white
SELDOM = 0.01  # not worth a picture
LONGEST_NAME = 24
CELL = 0.55, 0.3  # inches

Array = npt.NDArray[np.float64]


def likeness_picture(diagnosis: Diagnosis) -> Picture:
    """The causes that come nearest to what was found, and how often they would be confused."""
    key, title = "likeness", "What could be told apart"
    chosen = _chosen(diagnosis)
    if chosen is None:
        return not_drawn(key, title, "It would need a named cause that another one resembles.")
    finding, looked, causes = chosen
    rates = rates_of(causes, looked, strength_of(finding, diagnosis))
    if np.nanmax(rates) < SELDOM:
        lacking = (
            f"{finding.cause} is so strong here that it resembles no other cause: fewer than 1 in 100 such "
            "logs would confuse any two of those likest to it."
        )
        return not_drawn(key, title, lacking)
    caption = (
        f"The named cause and those likest to it. For an effect as strong as {finding.cause} is here: the "
        "share of logs of this design, %, in which one would pass for the other, if each may take the shape "
        "in which they are most alike. 50 is a toss of a coin."
    )
    return picture(key, title, caption, draw_likeness(causes, rates))


def strength_of(finding: Finding, diagnosis: Diagnosis) -> float:
    """Effect over noise, all rows together."""
    rows = len(diagnosis.search.bench)
    return float(np.sqrt(rows) * finding.effect.estimate / diagnosis.repeatability)


def rates_of(causes: list[str], looked: Misfit, strength: float) -> Array:
    """Rates of confusion, shape (causes, causes); NaN on the diagonal."""
    shapes = {cause: [each for each in looked.hypotheses if kind_of(each) == cause] for cause in causes}
    rates = np.full((len(causes), len(causes)), np.nan)
    for row, one in enumerate(causes):
        for column, other in enumerate(causes[:row]):
            cosine = max(likeness(a, b) for a in shapes[one] for b in shapes[other])
            rates[row, column] = confusion(strength, cosine)
    return rates


def draw_likeness(causes: list[str], rates: Array) -> Figure:
    """The lower triangle, a number in each cell."""
    names = [shorten(cause, LONGEST_NAME) for cause in causes]
    left = 0.2 + LETTER_WIDTH * max(map(len, names))
    with look():
        figure, axes = canvas(
            [CELL[1] * (len(causes) - 1)], 1, left=left, right=7.1 - left - CELL[0] * len(causes), top=0.08,
            bottom=left,
        )  # fmt: skip
        axis = axes[0, 0]
        colours = LinearSegmentedColormap.from_list("confused", ["#f7f7f4", VERMILLION])
        axis.imshow(rates[1:, :-1], cmap=colours, vmin=0.0, vmax=WORST, aspect="auto")
        for row, column in zip(*np.nonzero(np.isfinite(rates[1:, :-1])), strict=True):
            rate = rates[row + 1, column]
            colour = "white" if rate > DARK else INK
            axis.text(column, row, f"{100 * rate:.0f}", ha="center", va="center", color=colour)
        axis.set_xticks(range(len(causes) - 1), names[:-1], rotation=90)
        axis.set_yticks(range(len(causes) - 1), names[1:])
        axis.tick_params(length=0)
        axis.grid(visible=False)
        for side in ("left", "bottom"):
            axis.spines[side].set_visible(False)
    return figure


def _chosen(diagnosis: Diagnosis) -> tuple[Finding, Misfit, list[str]] | None:
    """The first named finding, the look that found it, and the causes likest to it."""
    by_cause: dict[str, Found] = {each.cause: each for each in diagnosis.search.found}
    for finding in diagnosis.findings:
        looked = by_cause[finding.cause].misfit
        if looked is None or finding.cause == UNKNOWN:
            continue
        best = looked.best_of(finding.cause)
        alike: dict[str, float] = {}
        for each in looked.hypotheses:
            if each.version is not None and each.cause != finding.cause:
                alike[each.cause] = max(likeness(best, each), alike.get(each.cause, 0.0))
        near = sorted(alike, key=lambda cause: -alike[cause])
        others = [*finding.equivalent, *(cause for cause in near if cause not in finding.equivalent)]
        if others:
            return finding, looked, [finding.cause, *others][:MOST_CAUSES]
    return None
