"""How well a log's design tells two causes apart."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from stickslip_fit.diagnose.searching.misfit import Misfit, kind_of
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.shapes.memory import Memory

CONFUSED = 0.02  # a rate below which two causes are told apart


def likeness(one: Hypothesis | Memory, other: Hypothesis | Memory) -> float:
    """Largest cosine between a shape that two hypotheses can have; between 0 and 1."""
    if isinstance(one, Memory) or isinstance(other, Memory):
        return 0.0
    return float(np.linalg.svd(one.directions.T @ other.directions, compute_uv=False).max(initial=0.0))


def confusion(strength: float, cosine: float) -> float:
    """How often an effect of this strength would look more like the other cause.

    Examples
    --------
    >>> round(confusion(6.0, 0.5), 4), round(confusion(6.0, 0.99), 2)
    (0.0013, 0.34)
    """
    return float(norm.sf(strength * np.sqrt(max(1.0 - cosine, 0.0) / 2.0)))


def told_apart(named: Hypothesis | Memory, looked: Misfit, rival: str, strength: float) -> bool:
    """Whether a design separates a named shape from every shape of a rival, at this strength."""
    shapes = [each for each in looked.hypotheses if kind_of(each) == rival]
    return confusion(strength, max(likeness(named, each) for each in shapes)) < CONFUSED
