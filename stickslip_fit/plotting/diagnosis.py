"""Figures of a diagnosis: probabilities of causes, gain by session, confusion matrix of causes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import pluralize as count
from stickslip_fit._typing import Array
from stickslip_fit.diagnosis import Diagnosis, Finding, Gain
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, classify_cause
from stickslip_fit.diagnosis.residuals import compare_residuals, compute_shape
from stickslip_fit.diagnosis.selection import SelectedCause
from stickslip_fit.diagnosis.separability import (
    MAX_CONFUSION_DESIGN,
    SeparabilityMatrix,
    confusion_rate,
    largest_cosine,
)
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.plotting._style import (
    BLUE,
    FIGURE_WIDTH,
    GREY,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    TITLE_LINE,
    VERMILLION,
    add_legend,
    make_figure,
    make_legend_entry,
    report_style,
    set_white_background,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture
from stickslip_fit.plotting.residuals import draw_finding

MAX_CAUSES = 8
MIN_LOG10_PROBABILITY = -12.0  # powers of ten; less likely is drawn there
CHANCE_LABEL = "chance alone"
MAX_NAME_LENGTH = 24
NAMED_LABEL, RIVAL_LABEL, OTHER_LABEL, NULL_LABEL = (
    "named",
    "cannot be told from it",
    "another cause",
    CHANCE_LABEL,
)
LABEL_STYLES = {
    NAMED_LABEL: (BLUE, "o"),
    RIVAL_LABEL: (VERMILLION, "s"),
    OTHER_LABEL: (GREY, "^"),
    NULL_LABEL: (INK, "D"),
}


def ranking_picture(diagnosis: Diagnosis) -> Picture:
    """Causes at each look at the residuals, likeliest first."""
    key, title = "ranking", "How likely each cause is"
    looks = list_selection_steps(diagnosis)
    if not looks[0][1].log_evidence_by_cause:
        return make_missing_picture(
            key, title, "It would need more traverses; see what could not have been seen."
        )
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
    return make_picture(key, title, caption, draw_ranking(diagnosis))


def plot_ranking(diagnosis: Diagnosis) -> Figure:
    """The ranking by itself."""
    return set_white_background(draw_ranking(diagnosis))


def list_selection_steps(diagnosis: Diagnosis) -> list[tuple[str, Misfit, str, tuple[str, ...]]]:
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
    looks = list_selection_steps(diagnosis)
    ranked = [_rank_causes(misfit, named, rivals) for _, misfit, named, rivals in looks]
    longest = max(len(shorten(cause, MAX_NAME_LENGTH)) for each in ranked for cause, *_ in each)
    kinds = [kind for kind in LABEL_STYLES if any(kind == found for each in ranked for *_, found in each)]
    with report_style():
        figure, axes = make_figure(
            [0.17 * len(each) + 0.1 for each in ranked], 1, left=0.2 + LETTER_WIDTH * longest,
            top=LEGEND_LINE + TITLE_LINE + 0.14, down=0.2 + TITLE_LINE, share_y=False,
        )  # fmt: skip
        for axis, (title, *_), each in zip(axes[:, 0], looks, ranked, strict=True):
            axis.set_title(shorten(title, 80), loc="left")
            _draw_bars(axis, each)
        axes[-1, 0].set_xlabel("probability")
        axes[-1, 0].xaxis.set_major_formatter(FuncFormatter(lambda power, _: _format_power(power)))
        add_legend(figure, [_make_entry(kind) for kind in kinds])
    return figure


def _rank_causes(misfit: Misfit, named: str, rivals: Sequence[str]) -> list[tuple[str, float, str]]:
    """Name, log10 of the probability, and what it is here; likeliest first."""
    if not misfit.log_evidence_by_cause:
        return [(CHANCE_LABEL, 0.0, NULL_LABEL)]
    causes = [*misfit.log_evidence_by_cause, CHANCE_LABEL]
    logs = np.array([*misfit.log_evidence_by_cause.values(), np.log(len(misfit.log_evidence_by_cause))])
    powers = (logs - np.logaddexp.reduce(logs)) / np.log(10.0)
    order = sorted(range(len(causes)), key=lambda k: -powers[k])
    shown = [k for k in order if causes[k] != CHANCE_LABEL][:MAX_CAUSES]
    kept = [k for k in order if k in shown or causes[k] == CHANCE_LABEL]
    return [(causes[k], float(powers[k]), _classify(causes[k], named, rivals)) for k in kept]


def _classify(cause: str, named: str, rivals: Sequence[str]) -> str:
    if cause == CHANCE_LABEL:
        return NULL_LABEL
    return NAMED_LABEL if cause == named else RIVAL_LABEL if cause in rivals else OTHER_LABEL


def _draw_bars(axis: Axes, ranked: Sequence[tuple[str, float, str]]) -> None:
    for place, (_, power, kind) in enumerate(ranked):
        colour, marker = LABEL_STYLES[kind]
        end = max(power, MIN_LOG10_PROBABILITY)
        axis.plot([MIN_LOG10_PROBABILITY - 0.5, end], [place, place], color=colour, lw=0.8)
        axis.plot(
            end,
            place,
            color=colour,
            marker="<" if power < MIN_LOG10_PROBABILITY else marker,
            ms=4.0,
            clip_on=False,
        )
    axis.set_yticks(range(len(ranked)), [shorten(cause, MAX_NAME_LENGTH) for cause, *_ in ranked])
    axis.set_ylim(len(ranked) - 0.5, -0.5)
    axis.set_xlim(MIN_LOG10_PROBABILITY - 0.5, 0.3)
    axis.set_xticks(np.arange(MIN_LOG10_PROBABILITY, 1.0, 2.0))
    axis.grid(visible=False, axis="y")


def _make_entry(kind: str) -> Line2D:
    colour, marker = LABEL_STYLES[kind]
    return make_legend_entry(kind, colour, marker=marker, line="-")


def _format_power(power: float) -> str:
    digits = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
    if power > -2.5:
        return f"{10**power:g}"
    return f"10⁻{f'{-power:.0f}'.translate(digits)}"


MAX_SESSIONS = 30
CROWDED_SESSIONS, MAX_SESSION_LABELS = 6, 12  # session names: side by side; and that there is room for
FLOOR_LABEL = "repeatability and rounding"


def gain_picture(diagnosis: Diagnosis) -> Picture:
    """What the extended law gains in each session."""
    key, title, gain = "gain", "Errors on held-out traverses, by session", diagnosis.gain
    if gain is None or gain.by_session.empty or not diagnosis.findings:
        return make_missing_picture(
            key, title, "It would need a named cause, and traverses beside those that fit it."
        )
    sessions = len(gain.by_session)
    caption = f"The latest {MAX_SESSIONS} of {count(sessions, 'session')}. " * (sessions > MAX_SESSIONS)
    caption += (
        "Each traverse predicted by laws to which it contributed nothing, the search for causes "
        f"included: {percent(gain.baseline)} rms by the published law, {percent(gain.extended)} by the "
        f"extended one, over all sessions. No law can be better than the line, {percent(gain.noise_floor)}."
    )
    return make_picture(key, title, caption, draw_gain(gain))


def plot_gain(diagnosis: Diagnosis) -> Figure:
    """The chart by itself.

    Raises
    ------
    InputError
        If nothing was named, so that nothing was gained.
    """
    if diagnosis.gain is None or diagnosis.gain.by_session.empty:
        raise InputError("there is no gain to draw: no cause was named, or no traverse could be held out")
    return set_white_background(draw_gain(diagnosis.gain))


def draw_gain(gain: Gain) -> Figure:
    """A pair of points for each session."""
    shown = gain.by_session.tail(MAX_SESSIONS)
    place, crowded = np.arange(len(shown)), len(shown) > CROWDED_SESSIONS
    before, after = (100 * shown[name].to_numpy(float) for name in ("baseline", "extended"))
    with report_style():
        figure, axes = make_figure([1.6], 1, top=LEGEND_LINE + 0.12, bottom=0.9 if crowded else 0.3)
        axis = axes[0, 0]
        axis.vlines(place, after, before, color=GREY, lw=0.9)
        axis.plot(place, before, ls="", marker="s", ms=4.5, color=VERMILLION)
        axis.plot(place, after, ls="", marker="o", ms=4.5, color=BLUE)
        axis.axhline(100 * gain.noise_floor, color=INK, lw=0.8, ls="--")
        every = -(-len(shown) // MAX_SESSION_LABELS)
        names = [shorten(str(name), 14) for name in shown["session"]]
        axis.set_xticks(place[::every], names[::every], rotation=90 if crowded else 0)
        axis.set_xlim(-0.5, len(shown) - 0.5)
        axis.set_ylim(0.0, 1.1 * max(float(before.max()), float(after.max())))
        axis.set_ylabel("rms error (%)")
        axis.grid(visible=False, axis="x")
        entries = [
            make_legend_entry("published law", VERMILLION, marker="s"),
            make_legend_entry("extended law", BLUE, marker="o"),
            make_legend_entry(FLOOR_LABEL, INK, line="--"),
        ]
        add_legend(figure, entries)
    return figure


def plot_residuals(diagnosis: Diagnosis, finding: int) -> Figure:
    """One finding's residuals before and after.

    Raises
    ------
    InputError
        If there is no such finding, or it has no shape.
    """
    found = {each.cause: each for each in diagnosis.search.found}
    if not 0 <= finding < len(diagnosis.findings):
        raise InputError(f"there is no finding {finding}: this diagnosis has {len(diagnosis.findings)}")
    chosen = diagnosis.findings[finding]
    if found[chosen.cause].misfit is None:
        raise InputError("misfires have no shape to draw; the finding's `traverses` are those counts")
    shape = compute_shape(found[chosen.cause], diagnosis.search.problem.study())
    left = compare_residuals(diagnosis.search, diagnosis.seed)
    return set_white_background(draw_finding(chosen, found[chosen.cause], shape, left)[1])


MAX_RATE, DARK_RATE = 0.5, 0.3  # a coin; beyond that numbers are white
MIN_RATE = 0.01  # not worth a picture
CELL_SIZE = 0.55, 0.3  # inches


def confusion_picture(diagnosis: Diagnosis) -> Picture:
    """The causes that come nearest to what was found, and how often they would be confused."""
    key, title = "likeness", "What could be told apart"
    chosen = _choose_causes(diagnosis)
    if chosen is None:
        return make_missing_picture(key, title, "It would need a named cause that another one resembles.")
    finding, misfit, causes = chosen
    rates = compute_confusion_rates(causes, misfit, effect_strength(finding, diagnosis))
    if np.nanmax(rates) < MIN_RATE:
        lacking = (
            f"{finding.cause} is so strong here that it resembles no other cause: fewer than 1 in 100 such "
            "logs would confuse any two of those likest to it."
        )
        return make_missing_picture(key, title, lacking)
    caption = (
        f"The named cause and those likest to it. For an effect as strong as {finding.cause} is here: the "
        "share of logs of this design, %, in which one would pass for the other, if each may take the shape "
        "in which they are most alike. 50 is a toss of a coin."
    )
    return make_picture(key, title, caption, draw_confusion_matrix(causes, rates))


def effect_strength(finding: Finding, diagnosis: Diagnosis) -> float:
    """Effect over noise, all rows together."""
    rows = len(diagnosis.search.problem)
    return float(np.sqrt(rows) * finding.effect.estimate / diagnosis.repeatability)


def compute_confusion_rates(causes: list[str], misfit: Misfit, strength: float) -> Array:
    """Rates of confusion, shape (causes, causes); NaN on the diagonal."""
    shapes = {
        cause: [each for each in misfit.hypotheses if classify_cause(each) == cause] for cause in causes
    }
    rates = np.full((len(causes), len(causes)), np.nan)
    for row, one in enumerate(causes):
        for column, other in enumerate(causes[:row]):
            cosine = max(largest_cosine(a, b) for a in shapes[one] for b in shapes[other])
            rates[row, column] = confusion_rate(strength, cosine)
    return rates


def draw_confusion_matrix(causes: list[str], rates: Array) -> Figure:
    """The lower triangle, a number in each cell."""
    names = [shorten(cause, MAX_NAME_LENGTH) for cause in causes]
    left = 0.2 + LETTER_WIDTH * max(map(len, names))
    with report_style():
        figure, axes = make_figure(
            [CELL_SIZE[1] * (len(causes) - 1)], 1, left=left, right=7.1 - left - CELL_SIZE[0] * len(causes), top=0.08,
            bottom=left,
        )  # fmt: skip
        axis = axes[0, 0]
        colours = LinearSegmentedColormap.from_list("confused", ["#f7f7f4", VERMILLION])
        axis.imshow(rates[1:, :-1], cmap=colours, vmin=0.0, vmax=MAX_RATE, aspect="auto")
        for row, column in zip(*np.nonzero(np.isfinite(rates[1:, :-1])), strict=True):
            rate = rates[row + 1, column]
            colour = "white" if rate > DARK_RATE else INK
            axis.text(column, row, f"{100 * rate:.0f}", ha="center", va="center", color=colour)
        axis.set_xticks(range(len(causes) - 1), names[:-1], rotation=90)
        axis.set_yticks(range(len(causes) - 1), names[1:])
        axis.tick_params(length=0)
        axis.grid(visible=False)
        for side in ("left", "bottom"):
            axis.spines[side].set_visible(False)
    return figure


def _choose_causes(diagnosis: Diagnosis) -> tuple[Finding, Misfit, list[str]] | None:
    """The first named finding, the look that found it, and the causes likest to it."""
    by_cause: dict[str, SelectedCause] = {each.cause: each for each in diagnosis.search.found}
    for finding in diagnosis.findings:
        misfit = by_cause[finding.cause].misfit
        if misfit is None or finding.cause == UNKNOWN:
            continue
        best = misfit.best_hypothesis(finding.cause)
        alike: dict[str, float] = {}
        for each in misfit.hypotheses:
            if each.version is not None and each.cause != finding.cause:
                alike[each.cause] = max(largest_cosine(best, each), alike.get(each.cause, 0.0))
        near = sorted(alike, key=lambda cause: -alike[cause])
        others = [*finding.equivalent, *(cause for cause in near if cause not in finding.equivalent)]
        if others:
            return finding, misfit, [finding.cause, *others][:MAX_CAUSES]
    return None


PLAN_MAX_RATE = 0.5  # a coin
PLAN_DARK_RATE = 0.3  # beyond, numbers are white
TITLE_HEIGHT = 0.3  # inches


def plot_separability(found: SeparabilityMatrix, strength: float) -> Figure:
    """Rate of confusion of each pair of causes, at one strength.

    Parameters
    ----------
    found : Matrix
        Of two causes or more.
    strength : float
    """
    causes = found.causes
    margin = 0.15 + LETTER_WIDTH * max(map(len, causes))
    cell = (FIGURE_WIDTH - margin - 0.1) / (len(causes) - 1)
    rates = np.full((len(causes) - 1, len(causes) - 1), np.nan)
    for row, one in enumerate(causes[1:]):
        for column, other in enumerate(causes[: row + 1]):
            rates[row, column] = found.rate(one, other, strength)
    with report_style():
        figure, axes = make_figure(
            [min(cell, 0.3) * len(rates)], 1, left=margin, right=0.1, top=TITLE_HEIGHT, bottom=margin
        )
        axis = axes[0, 0]
        colours = LinearSegmentedColormap.from_list("confused", ["#f7f7f4", VERMILLION])
        axis.imshow(rates, cmap=colours, vmin=0.0, vmax=PLAN_MAX_RATE, aspect="auto")
        for row, column in zip(*np.nonzero(rates >= MAX_CONFUSION_DESIGN), strict=True):
            rate = rates[row, column]
            colour = "white" if rate > PLAN_DARK_RATE else INK
            axis.text(column, row, f"{100 * rate:.0f}", ha="center", va="center", fontsize=6.5, color=colour)
        axis.set_xticks(range(len(rates)), causes[:-1], rotation=90)
        axis.set_yticks(range(len(rates)), causes[1:])
        axis.tick_params(length=0)
        axis.grid(visible=False)
        for side in ("left", "bottom"):
            axis.spines[side].set_visible(False)
        figure.suptitle(
            f"Logs in which the two are confused (%), effects of strength {strength:.0f}; "
            f"numbers from {100 * MAX_CONFUSION_DESIGN:.0f} %",
            x=0.01, y=0.995, ha="left", va="top",
        )  # fmt: skip
    return set_white_background(figure)
