"""What the microphone hears of a joint that moves and of one at its stop, and where to listen."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from stickslip_fit.capture.tuning import HIGHEST, LOWEST, Tuning
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.style import (
    BLUE,
    GREY,
    INK,
    LEGEND_LINE,
    VERMILLION,
    canvas,
    key_line,
    legend,
    legend_rows,
    look,
)

SMOOTH = 100.0  # Hz: what is drawn is averaged over so much
CAPTION_LINE, LETTERS = 0.14, 118  # inches, and letters in a line


def plot_spectrum(tuning: Tuning) -> Figure:
    """Spectra above, their difference below with the tuned band and the limit; the finding as a caption."""
    shown = (tuning.frequencies >= LOWEST / 2) & (tuning.frequencies <= HIGHEST * tuning.rate)
    kilohertz = tuning.frequencies[shown] / 1000
    moving, at_stop = (_decibels(spectrum, tuning)[shown] for spectrum in (tuning.moving, tuning.at_stop))
    limit = 10 * np.log10(tuning.limits.pair[-1])
    caption = textwrap.wrap(tuning.conclusion, LETTERS)
    with look():
        entries = [
            key_line("moving", BLUE, line="-"),
            key_line("at the stop", VERMILLION, line="--"),
            key_line("limit, mean over the band", INK, line=":"),
        ]
        top = legend_rows(entries) * LEGEND_LINE + 0.14
        figure, axes = canvas(
            [1.9, 1.2], 1, top=top, bottom=0.55 + CAPTION_LINE * len(caption), share_x="col"
        )
        above, below = axes[:, 0]
        above.plot(kilohertz, moving, color=BLUE, lw=0.9)
        above.plot(kilohertz, at_stop, color=VERMILLION, lw=0.9, ls="--")
        above.set_ylabel("power (dB of full scale / Hz)")
        below.plot(kilohertz, at_stop - moving, color=INK, lw=0.9)
        below.axhline(0.0, color=GREY, lw=0.8)
        low, high = (tuning.frequency + side * tuning.width / 2 for side in (-1, 1))
        below.plot([low / 1000, high / 1000], [limit, limit], color=INK, ls=":", lw=1.4)
        for axis in (above, below):
            axis.axvspan(low / 1000, high / 1000, color=GREY, alpha=0.2, lw=0)
        below.set_ylabel("stop less moving (dB)")
        below.set_xlabel("frequency (kHz); shaded: the tuned band")
        below.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        above.set_xlim(kilohertz[0], kilohertz[-1])
        figure.align_ylabels(axes[:, 0])
        figure.text(0.02, 0.02, "\n".join(caption), va="bottom", size=7.5, color=INK)
        legend(figure, entries)
    return on_white(figure)


def _decibels(spectrum: np.ndarray, tuning: Tuning) -> np.ndarray:
    bins = max(round(SMOOTH * tuning.seconds), 1)
    even = np.convolve(np.pad(spectrum, bins, mode="edge"), np.ones(bins) / bins, mode="same")[bins:-bins]
    return 10 * np.log10(even)
