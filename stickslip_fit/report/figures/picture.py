"""A figure as a page holds it: inline SVG, what to see in it, and in words for those who cannot see it."""

from __future__ import annotations

import io
from dataclasses import dataclass

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

from stickslip_fit.report.figures.style import look
from stickslip_fit.report.figures.svg import compact


@dataclass(frozen=True)
class Picture:
    """One figure of the report, or what it would take to draw it.

    Attributes
    ----------
    key : str
        Short name, unique within a page.
    title : str
    caption : str
        What to see, with this log's numbers; where `svg` is None, what the log lacks.
    svg : Markup or None
    """

    key: str
    title: str
    caption: str
    svg: Markup | None


def picture(key: str, title: str, caption: str, figure: Figure) -> Picture:
    """A drawn figure, ready for a page."""
    return Picture(key, title, caption, Markup(to_svg(figure, key)))


def not_drawn(key: str, title: str, lacking: str) -> Picture:
    """A figure that the log cannot support."""
    return Picture(key, title, lacking, None)


def to_svg(figure: Figure, key: str) -> str:
    """A figure as inline SVG.

    The same figure gives the same text; nothing refers outside of it, and no name in it clashes with
    another figure's of the same page.
    """
    stream = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with look(), mpl.rc_context({"svg.hashsalt": key}):
        figure.savefig(stream, format="svg", metadata=nothing)
    return compact(stream.getvalue(), key)
