"""What may be at work in a log, as directions in which its responses would depart together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array

Array = npt.NDArray[np.float64]

# Directions that hold less than this share of a hypothesis's effect are left out.
NEGLIGIBLE = 1e-6
NOTHING = 1e-6  # repeatabilities; rounding noise of what recalibration absorbs


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One shape that a cause's effect may have, of unknown size.

    The effect, in units of the noise, is a sum of orthonormal directions with independent normal sizes whose
    variances are `share` times the square of the effect's strength.

    Attributes
    ----------
    cause : str
        Whose shape it is; ``unknown`` for structure that no cause has.
    version : object
        The bound cause, or None.
    values : array, shape (q,) or None
        Of the cause's parameters, where it is one shape only.
    stored : array or sparse array, shape (n, m)
        Orthonormal, recalibration taken out; sparse where sessions keep to themselves.
    share : array, shape (m,)
        Adds up to 1.
    length : float
        Strength of the effect as it was tried.
    """

    cause: str
    version: Any
    values: Array | None
    stored: Array | csc_array
    share: Array
    length: float

    @property
    def directions(self) -> Array:
        """As `stored`, never sparse."""
        return self.stored if isinstance(self.stored, np.ndarray) else self.stored.toarray()

    def along(self, residual: Array) -> Array:
        """A residual, shape (n,), along each direction; shape (m,)."""
        return np.asarray(self.stored.T @ residual)

    def sum_of(self, sizes: Array) -> Array:
        """The directions, so much of each, added up; (m,) -> (n,)."""
        return np.asarray(self.stored @ sizes)

    def leverage(self, kept: Array) -> Array:
        """Share of each row's noise that goes if so much of each direction is kept; (m,) -> (n,)."""
        return np.asarray(self.stored**2 @ kept)


def hypothesis(cause: str, version: Any, values: Array | None, effects: Array) -> Hypothesis | None:
    """Make a hypothesis of effects with recalibration taken out, shape (n, m), that are equally likely.

    Returns
    -------
    Hypothesis, or None
        None where the effects are nothing, because recalibration absorbs them.
    """
    if effects.shape[1] == 1:
        length = float(np.linalg.norm(effects))
        if length < NOTHING:
            return None
        return Hypothesis(cause, version, values, effects / length, np.ones(1), length)
    variance, right = np.linalg.eigh(effects.T @ effects)
    total = float(variance.sum())
    if total < NOTHING**2:
        return None
    kept = variance > NEGLIGIBLE * total
    directions = effects @ right[:, kept] / np.sqrt(variance[kept])
    return Hypothesis(cause, version, values, directions, variance[kept] / total, float(np.sqrt(total)))
