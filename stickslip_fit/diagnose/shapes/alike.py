"""Causes that leave the same trace in a log, whatever their size: no analysis can tell them apart."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from stickslip_fit.diagnose.searching.misfit import UNKNOWN, Misfit, kind_of
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis

SAME = 1e-3  # what a shape may lack, as a share of its square; no log has the strength to show that
FEW = 4  # shapes; with many to choose from a cause may look like another by chance


def alike(looked: Misfit) -> tuple[tuple[str, str], ...]:
    """Pairs of causes of which the second can do in this log all that the first does.

    Each pair stands once, also where either can do all that the other does.

    Parameters
    ----------
    looked : Misfit
    """
    shapes: dict[str, list[Hypothesis]] = {}
    for each in looked.hypotheses:
        if isinstance(each, Hypothesis) and kind_of(each) != UNKNOWN:
            shapes.setdefault(each.cause, []).append(each)
    few = [cause for cause, mine in shapes.items() if len(mine) <= FEW]
    found: dict[frozenset[str], tuple[str, str]] = {}
    for one, other in permutations(few, 2):
        if all(any(_within(shape, wider) for wider in shapes[other]) for shape in shapes[one]):
            found.setdefault(frozenset((one, other)), (one, other))
    return tuple(found.values())


def _within(shape: Hypothesis, wider: Hypothesis) -> bool:
    lacking = shape.directions - wider.directions @ (wider.directions.T @ shape.directions)
    return bool(np.all(np.sum(lacking**2, axis=0) < SAME))
