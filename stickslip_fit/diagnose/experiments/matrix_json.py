"""What a design can tell, as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from stickslip_fit.diagnose.experiments.matrix import Matrix, Showing
from stickslip_fit.units import from_si

SCHEMA = "stickslip-fit/separability/1"


def matrix_json(found: Matrix, strength: float) -> dict[str, Any]:
    """A matrix in plain JSON types; what no strength reaches is None.

    Parameters
    ----------
    found : Matrix
    strength : float
        At which the rates of confusion are given.
    """
    return {
        "schema": SCHEMA,
        "alpha": found.alpha,
        "strength": strength,
        "causes": [_showing(each) for each in found.showing],
        "pairs": [
            {
                "causes": [one, other],
                "confusion": found.rate(one, other, strength),
                "strength_needed": needed if np.isfinite(needed) else None,
                "told_apart": found.apart(one, other),
            }
            for one, other, needed in found.pairs()
        ],
        "shown_by_scatter": list(found.by_scatter),
        "untestable": [{"cause": cause, "reason": why} for cause, why in found.untestable.items()],
    }


def _showing(showing: Showing) -> dict[str, Any]:
    return {
        "cause": showing.cause,
        "unit": showing.unit,
        "strength_of_size_1": 1.0 / float(from_si(1.0 / showing.per_size, showing.unit)),
        "strength_found": showing.found,
        "smallest_found": float(from_si(showing.smallest, showing.unit)),
        "largest_plausible": float(from_si(showing.largest, showing.unit)),
    }
