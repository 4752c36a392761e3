"""Corner: what a fit knows of one session's parameters, one by one and two by two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.ndimage import gaussian_filter
from scipy.stats import f as fisher
from scipy.stats import gaussian_kde
from scipy.stats import t as student_t

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import joint_name
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.fit import JointFit, Result
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.style import DIRECTION_COLOURS, GREY, INK, WIDTH, canvas, key_line, look
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.fit.bayes import Posterior

Array = npt.NDArray[np.float64]
LEVELS = (0.68, 0.95)
LARGEST_CELL = 1.55  # inches
REACH = 4.0  # standard errors in view
BINS, SMOOTH = 36, 1.2  # of a histogram in two dimensions, and its blur in bins


@dataclass(frozen=True, eq=False)
class Cloud:
    """What a fit knows of p parameters, in people's units.

    Attributes
    ----------
    labels : tuple of str
    centre, error : array, shape (p,)
    interval : array, shape (p, 2)
        95 %.
    title, kind : str
        Of which session, and what the curves are.
    colour : str
    """

    labels: tuple[str, ...]
    centre: Array
    error: Array
    interval: Array
    title: str
    kind: str
    colour: str


def plot_covariance(result: Result, joint: int, direction: str, session: str | None = None) -> Figure:
    """Regions and curves that a result's covariance gives; see `Result.plot_corner`."""
    fit, index, which = _find(result, joint, direction, session)
    cloud = _cloud(fit, index, which, "from the covariance (Student's t, ellipses)")
    factor = cloud.error / np.sqrt(np.diagonal(fit.covariance[index])[which])
    covariance = fit.covariance[index][np.ix_(which, which)] * factor * factor[:, None]
    freedom = fit.repeatability[direction].freedom
    with look():
        figure, axes = _corner(cloud, [key_line("68 % and 95 %", cloud.colour, line="-")])
        for k in range(len(which)):
            x = cloud.centre[k] + cloud.error[k] * np.linspace(-REACH, REACH, 201)
            density = student_t.pdf(x, freedom, cloud.centre[k], cloud.error[k])
            axes[k, k].plot(x, density, color=cloud.colour)
            for j in range(k):
                for level in LEVELS:
                    x, y = _ellipse(cloud.centre, covariance, [j, k], level, freedom)
                    axes[k, j].plot(x, y, color=cloud.colour)
                axes[k, j].plot(cloud.centre[j], cloud.centre[k], "+", color=INK)
    return on_white(figure)


def plot_draws(posterior: Posterior, joint: int, direction: str, session: str | None = None) -> Figure:
    """Histograms of a posterior's draws over the prior's; see `Posterior.plot_corner`."""
    fit, index, which = _find(posterior.result, joint, direction, session)
    name = str(fit.groups["session"].iloc[index])
    cloud = _cloud(fit, index, which, "draws of the posterior")
    place = posterior.sessions(joint, direction).index(name)
    scale = cloud.error / np.sqrt(np.diagonal(fit.covariance[index])[which])
    draws = posterior.draws(joint, direction, "parameters")[:, place, which] * scale
    prior = posterior.prior_draws(joint, direction, "parameters")[:, place, which] * scale
    entries = [key_line("68 % and 95 %", cloud.colour, line="-"), key_line("prior", GREY, line=":")]
    with look():
        figure, axes = _corner(cloud, entries)
        for k in range(len(which)):
            axes[k, k].hist(draws[:, k], BINS, density=True, color=cloud.colour, alpha=0.35)
            low, high = axes[k, k].get_xlim()
            x = np.linspace(low, high, 201)
            axes[k, k].plot(x, gaussian_kde(prior[:, k])(x), color=GREY, ls=":")
            for j in range(k):
                _contours(axes[k, j], draws[:, j], draws[:, k], cloud.colour)
    return on_white(figure)


def _find(
    result: Result, joint: int, direction: str, session: str | None
) -> tuple[JointFit, int, npt.NDArray[np.intp]]:
    """A joint's fit, the group of a session and direction, and which of its parameters have error bars."""
    fit = result.joints.get(joint)
    if fit is None or not (fit.groups["direction"] == direction).any():
        fitted = ", ".join(
            f"{joint} {sign}"
            for joint, each in result.joints.items()
            for sign in each.groups["direction"].unique()
        )
        raise InputError(f"joint {joint}, direction {direction} was not fitted; fitted were {fitted}")
    mine = np.flatnonzero(fit.groups["direction"] == direction)
    names = [str(name) for name in fit.groups["session"].iloc[mine]]
    if session is not None and session not in names:
        raise InputError(f"session {session!r} was not fitted; sessions fitted: {', '.join(names)}")
    index = int(mine[names.index(session) if session is not None else -1])
    which = np.flatnonzero(fit.known[index] & (np.diagonal(fit.covariance[index]) > 0))
    if not len(which):
        reasons = [
            remark.message
            for remark in result.remarks
            if (remark.joint, remark.direction) == (joint, direction)
        ]
        raise InputError(reasons[0] if reasons else "no parameter of this session has an error bar")
    return fit, index, which


def _cloud(fit: JointFit, index: int, which: npt.NDArray[np.intp], kind: str) -> Cloud:
    parameters = [fit.law.parameters[k] for k in which]
    numbers = np.column_stack(
        [fit.values[index], np.sqrt(np.diagonal(fit.covariance[index])), fit.interval[index]]
    )[which]
    shown = np.array(
        [from_si(row, each.unit) for row, each in zip(numbers, parameters, strict=True)], dtype=float
    )
    session, sign = (str(fit.groups[name].iloc[index]) for name in ("session", "direction"))
    return Cloud(
        labels=tuple(each.name if each.unit == "1" else f"{each.name} ({each.unit})" for each in parameters),
        centre=shown[:, 0],
        error=shown[:, 1],
        interval=shown[:, 2:],
        title=f"{joint_name(fit.law.joint)}, direction {way(sign)}\nsession {shorten(session, 30)}",
        kind=kind,
        colour=DIRECTION_COLOURS[sign],
    )


def _corner(cloud: Cloud, entries: Sequence[Line2D]) -> tuple[Figure, npt.NDArray[np.object_]]:
    """Empty axes that show what lies within reach, labelled; the 95 % intervals marked."""
    p = len(cloud.labels)
    left, across = 0.75, 0.12
    cell = min((WIDTH - left - 0.1 - across * (p - 1)) / p, LARGEST_CELL)
    rest = WIDTH - left - cell * p - across * (p - 1)
    figure, axes = canvas(
        [cell] * p, p, left=left, right=rest, top=0.12, bottom=0.45, across=across, down=across,
        share_x=False, share_y=False,
    )  # fmt: skip
    low, high = cloud.centre - REACH * cloud.error, cloud.centre + REACH * cloud.error
    for row in range(p):
        for column in range(p):
            axis: Axes = axes[row, column]
            axis.set_visible(column <= row)
            axis.set_xlim(low[column], high[column])
            axis.locator_params(nbins=3)
            axis.ticklabel_format(useOffset=False)
            axis.tick_params(axis="x", labelbottom=row == p - 1)
            if column == row:
                axis.set_yticks([])
                axis.spines["left"].set_visible(False)
                for end in cloud.interval[row]:
                    axis.axvline(end, color=INK, lw=0.7, ls="--")
            else:
                axis.set_ylim(low[row], high[row])
                axis.tick_params(axis="y", labelleft=column == 0)
        axes[-1, row].set_xlabel(cloud.labels[row])
        if row:
            axes[row, 0].set_ylabel(cloud.labels[row])
    figure.align_ylabels(axes[:, 0])
    _explain(figure, cloud, entries, (left + cell + 0.25) / WIDTH)
    return figure, axes


def _explain(figure: Figure, cloud: Cloud, entries: Sequence[Line2D], x: float) -> None:
    """Title and legend in the upper right, where a corner plot has nothing to show."""
    top = 1 - 0.1 / figure.get_figheight()
    figure.text(x, top, cloud.title, va="top", fontweight="bold", linespacing=1.4)
    figure.legend(
        handles=[*entries, key_line("95 % interval", INK, line="--")],
        title=cloud.kind,
        title_fontsize=7.5,
        alignment="left",
        loc="upper left",
        bbox_to_anchor=(x - 0.01, top - 0.36 / figure.get_figheight()),
    )


def _ellipse(
    centre: Array, covariance: Array, pair: list[int], level: float, freedom: int
) -> tuple[Array, Array]:
    """The edge of the region that holds both parameters of a pair with the given probability."""
    size = np.sqrt(2.0 * fisher.ppf(level, 2, freedom))
    values, vectors = np.linalg.eigh(covariance[np.ix_(pair, pair)])
    turn = np.linspace(0.0, 2 * np.pi, 181)
    circle = np.sqrt(np.maximum(values, 0.0))[:, None] * np.stack([np.cos(turn), np.sin(turn)])
    x, y = centre[pair][:, None] + size * vectors @ circle
    return x, y


def _contours(axes: Axes, x: Array, y: Array, colour: str) -> None:
    """Lines around the densest 68 and 95 % of draws."""
    counts, x_edges, y_edges = np.histogram2d(x, y, BINS, [axes.get_xlim(), axes.get_ylim()])
    density = gaussian_filter(counts, SMOOTH)
    places = [
        np.clip(np.digitize(draws, edges) - 1, 0, BINS - 1) for draws, edges in ((x, x_edges), (y, y_edges))
    ]
    around = [float(np.quantile(density[places[0], places[1]], 1 - level)) for level in LEVELS[::-1]]
    middles = [(each[1:] + each[:-1]) / 2 for each in (x_edges, y_edges)]
    axes.contour(*middles, density.T, levels=around, colors=colour)
