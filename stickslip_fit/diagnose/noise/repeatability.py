"""How well a traverse repeats, whatever else is wrong with the log taken out first.

Replicates of one configuration are usually hours apart, so that what drifts would pass for noise and hide
itself. The repeatability is therefore that of the residuals less the likeliest structure in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.noise.cleared import Cleared
from stickslip_fit.diagnose.noise.unevenness import Unevenness, unevenness

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

WILD = 10.0  # medians; what is further off is taken for this far
FEWEST = 8  # degrees of freedom by which a drive is judged by itself
FEWEST_ALIKE, FAR = 3, 3.0  # rows whose mean is taken out; departures that count as this far in it
LARGEST_LEVERAGE = 0.8


@dataclass(frozen=True, eq=False)
class Repeatability:
    """Of every row of a log.

    Attributes
    ----------
    of_drive : array
        Standard deviation of each drive's responses in configurations that repeat well, rounding left out.
    uneven : Unevenness
        How much worse each row's configuration repeats.
    """

    of_drive: Array
    uneven: Unevenness


def repeatability(
    study: Study, left: Cleared, rounding: Array, drive: Indices, kind: Indices
) -> Repeatability:
    """Judge the noise by what is left of the residuals.

    Parameters
    ----------
    study : Study
    left : Cleared
        Residuals in units of the study's scale, without structure.
    rounding : array, shape (n,)
        Variance that rounding adds.
    drive, kind : array of int, shape (n,)
        Rows of one drive repeat equally well, but for some kinds of rows.
    """
    off = left.residual * study.scale
    free = np.maximum(1.0 - study.leverage - left.leverage, 1.0 - LARGEST_LEVERAGE)
    even = _of_drive(off, free, rounding, drive)
    scale = np.sqrt(even[drive] ** 2 + rounding)
    uneven = unevenness(_within_cells(off / scale / np.sqrt(free), kind * (drive.max() + 1) + drive), kind)
    times = uneven.likely
    return Repeatability(_of_drive(off / times, free, rounding / times**2, drive), uneven)


def _within_cells(off: Array, cell: Indices) -> Array:
    """Departures from the mean of rows that ought to be alike: what else is wrong must not pass for noise."""
    rows = np.bincount(cell)
    mean = np.bincount(cell, np.clip(off, -FAR, FAR)) / np.maximum(rows, 1)
    apart = (off - mean[cell]) * np.sqrt(rows / np.maximum(rows - 1, 1))[cell]
    return np.where(rows[cell] >= FEWEST_ALIKE, apart, off)


def _of_drive(off: Array, free: Array, rounding: Array, drive: Indices) -> Array:
    number, size = int(drive.max()) + 1, np.abs(off)
    median = np.array([np.median(size[drive == k]) if np.any(drive == k) else np.inf for k in range(number)])
    squares = np.minimum(size, WILD * np.maximum(median, 1e-7)[drive]) ** 2
    freedom = np.bincount(drive, free, number)
    pooled = max(float(squares.sum() / max(freedom.sum(), 1.0) - rounding.mean()), 1e-14)
    rows = np.maximum(np.bincount(drive, minlength=number), 1)
    own = np.bincount(drive, squares, number) / np.maximum(freedom, 1.0)
    own -= np.bincount(drive, rounding, number) / rows
    return np.sqrt(np.where(freedom >= FEWEST, np.maximum(own, 0.04 * pooled), pooled))
