"""Causes that leave the same trace in a log, whatever their size: no analysis can tell them apart."""

from __future__ import annotations

from collections import Counter
from itertools import permutations

import numpy as np

from stickslip_fit.diagnose.misfit import Misfit, kind_of

SAME = 1e-9  # what a shape may lack, as a share of its square


def alike(looked: Misfit) -> tuple[tuple[str, str], ...]:
    """Pairs of causes of which the second can do in this log all that the first does.

    Each pair stands once, also where either can do all that the other does. Causes with several shapes to
    choose from are left out: one of them may look like something else by chance.

    Parameters
    ----------
    looked : Misfit
    """
    shapes = Counter(map(kind_of, looked.hypotheses))
    single = [each for each in looked.hypotheses if each.version is not None and shapes[each.cause] == 1]
    found: dict[frozenset[str], tuple[str, str]] = {}
    for one, other in permutations(single, 2):
        lacking = one.directions - other.directions @ (other.directions.T @ one.directions)
        if np.all(np.sum(lacking**2, axis=0) < SAME):
            found.setdefault(frozenset((one.cause, other.cause)), (one.cause, other.cause))
    return tuple(found.values())
