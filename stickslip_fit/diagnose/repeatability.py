"""How well a traverse repeats, whatever else is wrong with the log taken out first.

Replicates of one configuration are usually hours apart, so that what drifts would pass for noise and hide
itself. The repeatability is therefore that of the residuals less the likeliest structure in them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.evidence import STRENGTHS
from stickslip_fit.diagnose.memory import Memory
from stickslip_fit.diagnose.misfit import Misfit
from stickslip_fit.diagnose.study import Study

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

CERTAIN = 5.0  # nats by which a structure must be likelier than none to be taken out
WILD = 10.0  # medians; what is further off is taken for this far
FEWEST = 8  # degrees of freedom by which a drive is judged by itself


def cleared(study: Study, looked: Misfit) -> tuple[Array, float]:
    """The residuals less the likeliest structure in them, shape (n,), and how many directions that took."""
    best = int(np.argmax(looked.log_evidence))
    shape = looked.hypotheses[best]
    if looked.log_evidence[best] < CERTAIN:
        return study.residual, 0.0
    if isinstance(shape, Memory):
        return study.residual - shape.shape(study.residual), 1.0
    along = shape.directions.T @ study.residual
    strength = STRENGTHS[np.argmin(np.abs(np.log(STRENGTHS**2 / max(float(along @ along), 1.0))))]
    kept = strength**2 * shape.share / (1.0 + strength**2 * shape.share)
    return study.residual - shape.directions @ (kept * along), float(kept.sum())


def repeatability(study: Study, residual: Array, taken: float, rounding: Array, drive: Indices) -> Array:
    """Standard deviation of each drive's responses, rounding left out.

    Parameters
    ----------
    study : Study
    residual : array, shape (n,)
        In units of the study's scale.
    taken : float
        Degrees of freedom that cost beside recalibration.
    rounding : array, shape (n,)
        Variance that rounding adds.
    drive : array of int, shape (n,)
    """
    off = np.abs(residual)
    number = int(drive.max()) + 1
    free = np.bincount(drive, 1.0 - study.leverage - taken / len(study), number)
    limit = np.array(
        [np.median(off[drive == each]) if np.any(drive == each) else np.inf for each in range(number)]
    )
    squares = (np.minimum(off, WILD * np.maximum(limit[drive], 1e-3)) * study.scale) ** 2
    pooled = max(float(squares.sum() / max(free.sum(), 1.0) - rounding.mean()), 1e-14)
    own = np.bincount(drive, squares, number) / np.maximum(free, 1.0) - np.bincount(
        drive, rounding, number
    ) / (np.maximum(np.bincount(drive, minlength=number), 1))
    return np.sqrt(np.where(free >= FEWEST, np.maximum(own, 0.04 * pooled), pooled))
