"""A chart as a file of its own."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import write_atomically
from stickslip_fit.fit import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS = 200  # an inch, of a png
# What would make the same chart differ from one writing to the next.
DATES = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def check_suffix(path: Path) -> None:
    """Refuse a file of a kind that cannot be drawn.

    Raises
    ------
    InputError
    """
    if path.suffix.lower() not in DATES:
        raise InputError(
            Problem("is no kind of picture that can be drawn: end its name in .png, .svg or .pdf", str(path))
        )


def write_chart(result: Result, path: Path) -> None:
    """Draw the control chart of all joints.

    Raises
    ------
    InputError
        If the file cannot be written, its suffix is none of png, svg and pdf, or no parameter is known.
    """
    from stickslip_fit.report.figures.control import plot_control

    write_figure(plot_control(result), path, "control")


def write_figure(figure: Figure, path: Path, key: str) -> None:
    """Write a figure; the same figure and key give the same file.

    Raises
    ------
    InputError
        If the file cannot be written, or its suffix is none of png, svg and pdf.
    """
    import matplotlib as mpl

    from stickslip_fit.report.figures.style import look

    check_suffix(path)
    kind, stream = path.suffix.lower(), io.BytesIO()
    with look(), mpl.rc_context({"svg.hashsalt": key}):
        figure.savefig(stream, format=kind[1:], dpi=DOTS, metadata=DATES[kind])
    write_atomically(path, stream.getvalue())
