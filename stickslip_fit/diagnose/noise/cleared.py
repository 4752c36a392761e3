"""Residuals without the likeliest structure in them: what is left to be noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.searching.evidence import STRENGTHS
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.shapes.memory import Memory

Array = npt.NDArray[np.float64]

CERTAIN = 5.0  # nats by which a structure must be likelier than none to be taken out


@dataclass(frozen=True, eq=False)
class Cleared:
    """What is left of n residuals.

    Attributes
    ----------
    residual : array, shape (n,)
    leverage : array, shape (n,)
        Share of each row's noise that went with the structure.
    """

    residual: Array
    leverage: Array


def cleared(residual: Array, hypotheses: Sequence[Hypothesis | Memory], log_evidence: Array) -> Cleared:
    """Take the likeliest structure out, as far as it is more than noise gives it.

    Parameters
    ----------
    residual : array, shape (n,)
    hypotheses : sequence of Hypothesis or Memory, H
    log_evidence : array, shape (H,)
    """
    best = int(np.argmax(log_evidence))
    shape, nothing = hypotheses[best], np.zeros(len(residual))
    if log_evidence[best] < CERTAIN:
        return Cleared(residual, nothing)
    if isinstance(shape, Memory):
        return Cleared(residual - shape.shape(residual), nothing)
    along = shape.along(residual)
    strength = STRENGTHS[np.argmin(np.abs(np.log(STRENGTHS**2 / max(float(along @ along), 1.0))))]
    kept = strength**2 * shape.share / (1.0 + strength**2 * shape.share)
    return Cleared(residual - shape.sum_of(kept * along), shape.leverage(kept))
