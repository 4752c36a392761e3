"""Figures of a diagnosis: probabilities of causes, gain by session, confusion matrix of causes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from stickslip_fit._format import pluralize
from stickslip_fit._typing import Array
from stickslip_fit.diagnosis import Diagnosis, Finding
from stickslip_fit.diagnosis._words import baseline_name
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, classify_cause
from stickslip_fit.diagnosis.residuals import compare_residuals, finding_shape
from stickslip_fit.diagnosis.separability import (
    MAX_CONFUSION_DESIGN,
    SeparabilityMatrix,
    compute_cosines,
    confusion_rate,
)
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.plotting._style import (
    BLUE,
    FIGURE_WIDTH,
    GREY,
    INK,
    LETTER_WIDTH,
    MAX_HORIZONTAL_LABELS,
    MAX_SESSIONS,
    TITLE_LINE,
    VERMILLION,
    label_sessions,
    make_figure,
    make_legend_entry,
    report_style,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture
from stickslip_fit.plotting.residuals import draw_finding, draw_residuals_overview
from stickslip_fit.plotting.table import draw_table_finding, plot_columns

MAX_CAUSES = 8
MIN_LOG10_PROBABILITY = -12.0  # smaller ones are drawn there
MAX_NAME_LENGTH = 24
NAMED_LABEL, ALIASED_LABEL, OTHER_LABEL = "named", "aliased with it", "another cause"
CHANCE_LABEL, WITHDRAWN_LABEL = "chance alone", "withdrawn"
LABEL_STYLES = {
    NAMED_LABEL: (BLUE, "o"),
    ALIASED_LABEL: (VERMILLION, "s"),
    OTHER_LABEL: (GREY, "^"),
    WITHDRAWN_LABEL: (VERMILLION, "X"),
    CHANCE_LABEL: (INK, "D"),
}


def ranking_picture(diagnosis: Diagnosis) -> Picture:
    """Probabilities of the causes at each step of the selection, likeliest first."""
    key, title = "ranking", "How likely each cause is"
    steps = list_selection_steps(diagnosis)
    if not steps[0][1].log_evidence_by_cause:
        lacking = f"It would need more {diagnosis.info.row}s; see what could not have been seen."
        return make_missing_picture(key, title, lacking)
    caption = (
        "If one cause or chance alone is at work: the probability of each, on a scale of powers of ten; an "
        "arrow stands for less. Beforehand chance alone is as likely as all causes together. "
        + (
            f"{pluralize(len(steps), 'step')} of the selection: a cause named in one step is in the law of "
            "the next. Causes with nearly the same probability as the named one are aliased with it."
            if len(steps) > 1
            else "No cause is much likelier than chance alone." * (not diagnosis.findings)
        )
    )
    return make_picture(key, title, caption.rstrip(), plot_ranking(diagnosis))


def list_selection_steps(diagnosis: Diagnosis) -> list[tuple[str, Misfit, str, tuple[str, ...]]]:
    """Each step of the selection: its title, the misfit, the cause named and those aliased with it."""
    equivalent = {finding.cause: finding.equivalent for finding in diagnosis.findings}
    selected = [
        cause for cause in diagnosis.selection.selected if cause.misfit is not None and diagnosis.findings
    ]
    steps, title = [], f"the {baseline_name(diagnosis)}"
    for index, cause in enumerate(selected):
        assert cause.misfit is not None
        steps.append((title, cause.misfit, cause.cause, equivalent.get(cause.cause, ())))
        title = f"{title}, {cause.cause}" if index else f"with {cause.cause}"
    if not selected or diagnosis.selection.last_misfit is not selected[-1].misfit:
        steps.append((title, diagnosis.selection.last_misfit, "", ()))
    return steps


def plot_ranking(diagnosis: Diagnosis) -> Figure:
    """One panel for each step of the selection, below one another."""
    steps = list_selection_steps(diagnosis)
    rankings = [_rank_causes(*step[1:], tuple(diagnosis.withdrawn)) for step in steps]
    longest = max(len(shorten(cause, MAX_NAME_LENGTH)) for ranking in rankings for cause, *_ in ranking)
    labels = {label for ranking in rankings for *_, label in ranking}
    least = min(power for ranking in rankings for _, power, _ in ranking)
    lowest = max(min(float(np.floor(least)), -1.0), MIN_LOG10_PROBABILITY)
    with report_style():
        figure, axes = make_figure(
            [0.17 * len(ranking) + 0.1 for ranking in rankings],
            1,
            [
                make_legend_entry(label, colour, marker=marker, line="-")
                for label, (colour, marker) in LABEL_STYLES.items()
                if label in labels
            ],
            left=0.2 + LETTER_WIDTH * longest,
            top=TITLE_LINE + 0.14,
            down=0.2 + TITLE_LINE,
            share_y=False,
        )
        for axis, (title, *_), ranking in zip(axes[:, 0], steps, rankings, strict=True):
            axis.set_title(shorten(title, 80), loc="left")
            _draw_probabilities(axis, ranking, lowest)
        axes[-1, 0].set_xlabel("probability")
        axes[-1, 0].xaxis.set_major_formatter(FuncFormatter(lambda power, _: _format_power(power)))
    return figure


def _rank_causes(
    misfit: Misfit, named: str, aliased: Sequence[str], withdrawn: Sequence[str]
) -> list[tuple[str, float, str]]:
    """Name, log10 of the probability, and label; likeliest first."""
    if not misfit.log_evidence_by_cause:
        return [(CHANCE_LABEL, 0.0, CHANCE_LABEL)]
    causes = [*misfit.log_evidence_by_cause, CHANCE_LABEL]
    logs = np.array([*misfit.log_evidence_by_cause.values(), np.log(len(misfit.log_evidence_by_cause))])
    powers = (logs - np.logaddexp.reduce(logs)) / np.log(10.0)
    order = sorted(range(len(causes)), key=lambda k: -powers[k])
    likeliest = [k for k in order if causes[k] != CHANCE_LABEL][:MAX_CAUSES]
    labels = {CHANCE_LABEL: CHANCE_LABEL, named: NAMED_LABEL} | dict.fromkeys(aliased, ALIASED_LABEL)
    labels |= dict.fromkeys(withdrawn, WITHDRAWN_LABEL)
    return [
        (causes[k], float(powers[k]), labels.get(causes[k], OTHER_LABEL))
        for k in order
        if k in likeliest or causes[k] == CHANCE_LABEL
    ]


def _draw_probabilities(axis: Axes, ranking: Sequence[tuple[str, float, str]], lowest: float) -> None:
    ends = np.maximum([power for _, power, _ in ranking], lowest)
    colours = [LABEL_STYLES[label][0] for *_, label in ranking]
    axis.hlines(range(len(ranking)), lowest - 0.5, ends, colors=colours, lw=0.8)
    places: dict[tuple[str, str], list[int]] = {}
    for place, (_, power, label) in enumerate(ranking):
        colour, marker = LABEL_STYLES[label]
        marker = "<" if power < lowest else marker
        places.setdefault((colour, marker), []).append(place)
    for (colour, marker), own in places.items():
        axis.plot(ends[own], own, ls="", color=colour, marker=marker, ms=4.0, clip_on=False)
    axis.set_yticks(range(len(ranking)), [shorten(cause, MAX_NAME_LENGTH) for cause, *_ in ranking])
    axis.set_ylim(len(ranking) - 0.5, -0.5)
    axis.set_xlim(lowest - 0.5, 0.3)
    axis.set_xticks(np.arange(0.0, lowest - 0.5, -1.0 if lowest > -6.0 else -2.0))
    axis.grid(visible=False, axis="y")


def _format_power(power: float) -> str:
    digits = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
    if power > -2.5:
        return f"{10**power:g}"
    return f"10⁻{f'{-power:.0f}'.translate(digits)}"


def gain_picture(diagnosis: Diagnosis) -> Picture:
    """Held-out errors of the published and the extended law in each session."""
    gain, info = diagnosis.gain, diagnosis.info
    key, title = "gain", f"Errors on held-out {info.row}s, by session"
    if gain is None or gain.by_session.empty or not diagnosis.findings:
        lacking = f"It would need a named cause, and {info.row}s beside those that fit it."
        return make_missing_picture(key, title, lacking)
    sessions = len(gain.by_session)
    caption = f"The latest {MAX_SESSIONS} of {pluralize(sessions, 'session')}. " * (sessions > MAX_SESSIONS)
    before, after, floor = map(info.format_size, (gain.baseline, gain.extended, gain.noise_floor))
    caption += (
        f"Each {info.row} predicted by laws to which it contributed nothing, the search for causes included: "
        f"{before} rms by the {baseline_name(diagnosis)}, {after} by the extended one, over all sessions. "
        f"Over all sessions no law can be expected to be better than the line, {floor}."
    )
    return make_picture(key, title, caption, plot_gain(diagnosis))


def plot_gain(diagnosis: Diagnosis) -> Figure:
    """A pair of points for each session.

    Raises
    ------
    InputError
        If no cause was named, so that there is no gain.
    """
    gain, info = diagnosis.gain, diagnosis.info
    if gain is None or gain.by_session.empty:
        raise InputError(f"there is no gain to draw: no cause was named, or no {info.row} could be held out")
    sessions = diagnosis.selection.problem.rows["session"].astype(object).unique()
    in_order = gain.by_session.set_index("session").reindex(sessions).dropna().reset_index(names="session")
    recent = in_order.tail(MAX_SESSIONS)
    place, crowded = np.arange(len(recent)), len(recent) > MAX_HORIZONTAL_LABELS
    before, after = (info.factor * recent[name].to_numpy(float) for name in ("baseline", "extended"))
    legend = [
        make_legend_entry(baseline_name(diagnosis), VERMILLION, marker="s"),
        make_legend_entry("extended law", BLUE, marker="o"),
        make_legend_entry("noise floor", INK, line="--"),
    ]
    with report_style():
        figure, axes = make_figure([1.6], 1, legend, top=0.12, bottom=0.9 if crowded else 0.3)
        axis = axes[0, 0]
        axis.vlines(place, after, before, color=GREY, lw=0.9)
        axis.plot(place, before, ls="", marker="s", ms=4.5, color=VERMILLION)
        axis.plot(place, after, ls="", marker="o", ms=4.5, color=BLUE)
        axis.axhline(info.factor * gain.noise_floor, color=INK, lw=0.8, ls="--")
        label_sessions(axis, list(recent["session"]), vertical=crowded)
        axis.set_ylim(0.0, 1.1 * max(float(before.max()), float(after.max())))
        axis.set_ylabel(info.label("rms error"))
    return figure


def plot_diagnosis(diagnosis: Diagnosis) -> Figure:
    """Residuals before and after the first finding that has a shape; without one against every quantity.

    Of a log with nothing to find the joint with most traverses is drawn.
    """
    shapes = {each.cause for each in diagnosis.selection.selected if each.misfit is not None}
    numbers = [k for k, finding in enumerate(diagnosis.findings) if finding.cause in shapes]
    if numbers:
        return plot_residuals(diagnosis, numbers[0])
    if diagnosis.table is not None:
        return plot_columns(diagnosis, diagnosis.table)
    comparison = compare_residuals(diagnosis.selection, diagnosis.seed)
    joint = int(comparison.rows["joint"].mode()[0])
    return draw_residuals_overview(joint, comparison, machine_of(diagnosis))


def machine_of(diagnosis: Diagnosis) -> Machine:
    """The manipulator of its log; the nominal one without a log."""
    return load_machine() if diagnosis.log is None else diagnosis.log.machine


def plot_residuals(diagnosis: Diagnosis, finding: int) -> Figure:
    """One finding's residuals before and after.

    Raises
    ------
    InputError
        If there is no such finding, or it has no shape.
    """
    if not 0 <= finding < len(diagnosis.findings):
        raise InputError(f"there is no finding {finding}: this diagnosis has {len(diagnosis.findings)}")
    chosen = diagnosis.findings[finding]
    selected = diagnosis.selection.behind(chosen)
    if selected.misfit is None:
        raise InputError("outlying values have no shape to draw; the finding's `traverses` are those rows")
    comparison = compare_residuals(diagnosis.selection, diagnosis.seed)
    if diagnosis.table is not None:
        return draw_table_finding(diagnosis, diagnosis.table, chosen, selected, comparison)[1]
    shape = finding_shape(diagnosis.selection, selected)
    return draw_finding(chosen, selected, shape, comparison, machine_of(diagnosis))[1]


MAX_RATE, DARK_RATE = 0.5, 0.3  # a toss of a coin; white numbers from there on
MIN_RATE = 0.01  # below, there is no picture
CELL_SIZE = 0.55, 0.3  # inches
TITLE_HEIGHT = 0.3  # inches


def confusion_picture(diagnosis: Diagnosis) -> Picture:
    """The causes most similar to the one found, and how often they would be confused."""
    key, title = "likeness", "Which causes could be confused"
    chosen = _choose_causes(diagnosis)
    if chosen is None:
        return make_missing_picture(key, title, "It would need a named cause that another one resembles.")
    finding, misfit, causes = chosen
    data = f"{diagnosis.info.data}s"
    rates = compute_confusion_rates(causes, misfit, effect_strength(finding, diagnosis))
    if np.nanmax(rates) < MIN_RATE:
        lacking = (
            f"{finding.cause} is so strong here that it resembles no other cause: fewer than 1 in 100 such "
            f"{data} would confuse any two of those most similar to it."
        )
        return make_missing_picture(key, title, lacking)
    caption = (
        f"The named cause and those most similar to it. For an effect as strong as {finding.cause} is here: "
        f"the share of {data} of this design, %, in which one would be taken for the other, if each may take "
        "the shape in which they are most alike. 50 is a toss of a coin."
    )
    return make_picture(key, title, caption, draw_confusion_matrix(causes, rates))


def effect_strength(finding: Finding, diagnosis: Diagnosis) -> float:
    """Effect over noise, all rows together."""
    n_rows = len(diagnosis.selection.problem)
    return float(np.sqrt(n_rows) * finding.effect.estimate / diagnosis.repeatability)


def compute_confusion_rates(causes: list[str], misfit: Misfit, strength: float) -> Array:
    """Rates of confusion, shape (causes, causes); NaN on the diagonal."""
    hypotheses = {
        cause: [hypothesis for hypothesis in misfit.hypotheses if classify_cause(hypothesis) == cause]
        for cause in causes
    }
    rates = np.full((len(causes), len(causes)), np.nan)
    for row, one in enumerate(causes):
        for column, other in enumerate(causes[:row]):
            cosine = float(compute_cosines(hypotheses[one], hypotheses[other]).max())
            rates[row, column] = confusion_rate(strength, cosine)
    return rates


def draw_confusion_matrix(causes: list[str], rates: Array) -> Figure:
    """The lower triangle, a number in each cell."""
    names = [shorten(cause, MAX_NAME_LENGTH) for cause in causes]
    left, (width, height) = 0.2 + LETTER_WIDTH * max(map(len, names)), CELL_SIZE
    right = 7.1 - left - width * len(causes)
    with report_style():
        figure, axes = make_figure(
            [height * (len(causes) - 1)], 1, left=left, right=right, top=0.08, bottom=left
        )
        _draw_rates(axes[0, 0], names, rates[1:, :-1])
    return figure


def _draw_rates(axis: Axes, names: Sequence[str], rates: Array, lowest: float = 0.0) -> None:
    """Rates of confusion of each two causes as colours, and in per cent from `lowest` on."""
    colours = LinearSegmentedColormap.from_list("confused", ["#f7f7f4", VERMILLION])
    axis.imshow(rates, cmap=colours, vmin=0.0, vmax=MAX_RATE, aspect="auto")
    for row, column in zip(*np.nonzero(rates >= lowest), strict=True):
        colour, size = "white" if rates[row, column] > DARK_RATE else INK, 6.5 if lowest else 8.0
        text = f"{100 * rates[row, column]:.0f}"
        axis.text(column, row, text, ha="center", va="center", color=colour, fontsize=size)
    axis.set_xticks(range(len(rates)), names[:-1], rotation=90)
    axis.set_yticks(range(len(rates)), names[1:])
    axis.tick_params(length=0)
    axis.grid(visible=False)
    axis.spines[["left", "bottom"]].set_visible(False)


def _choose_causes(diagnosis: Diagnosis) -> tuple[Finding, Misfit, list[str]] | None:
    """The first named finding, the misfit that named it, and the causes most similar to it."""
    selected = {cause.cause: cause for cause in diagnosis.selection.selected}
    for finding in diagnosis.findings:
        misfit = selected[finding.cause].misfit
        if misfit is None or finding.cause == UNKNOWN:
            continue
        best = misfit.best_hypothesis(finding.cause)
        rivals = [
            one
            for one in misfit.hypotheses
            if one.version is not None and classify_cause(one) not in (UNKNOWN, finding.cause)
        ]
        cosines: dict[str, float] = {}
        for rival, cosine in zip(rivals, compute_cosines([best], rivals)[0], strict=True):
            cosines[rival.cause] = max(float(cosine), cosines.get(rival.cause, 0.0))
        similar = sorted(cosines, key=lambda cause: -cosines[cause])
        others = [*finding.equivalent, *(cause for cause in similar if cause not in finding.equivalent)]
        if others:
            return finding, misfit, [finding.cause, *others][:MAX_CAUSES]
    return None


def plot_separability(matrix: SeparabilityMatrix, strength: float) -> Figure:
    """Rate of confusion of each pair of two causes or more, at one strength of their effects."""
    causes = matrix.causes
    margin = 0.15 + LETTER_WIDTH * max(map(len, causes))
    cell = (FIGURE_WIDTH - margin - 0.1) / (len(causes) - 1)
    rates = np.full((len(causes) - 1, len(causes) - 1), np.nan)
    for row, one in enumerate(causes[1:]):
        for column, other in enumerate(causes[: row + 1]):
            rates[row, column] = matrix.pair_confusion(one, other, strength)
    with report_style():
        figure, axes = make_figure(
            [min(cell, 0.3) * len(rates)], 1, left=margin, right=0.1, top=TITLE_HEIGHT, bottom=margin
        )
        _draw_rates(axes[0, 0], causes, rates, MAX_CONFUSION_DESIGN)
        title = (
            f"Logs in which the two are confused (%), effects of strength {strength:.0f}; "
            f"numbers from {100 * MAX_CONFUSION_DESIGN:.0f} %"
        )
        figure.suptitle(title, x=0.01, y=0.995, ha="left", va="top")
    return figure
