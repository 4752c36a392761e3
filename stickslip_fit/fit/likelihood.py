"""How a traverse departs from the law: the shape of the noise, as fits by reweighting see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Likelihood(Protocol):
    """The distribution of log steps about the law, up to its scale."""

    @property
    def method(self) -> str:
        """What a fit under it is called."""

    @property
    def information(self) -> float:
        """Fisher information about the middle, relative to a Gaussian of the same scale."""

    @property
    def spread(self) -> float:
        """Standard deviation in units of the scale."""

    def irls_weight(self, squares: Array) -> Array:
        """Weight of residuals whose squares, over the squared scale, are given; 1 for a Gaussian."""


@dataclass(frozen=True)
class Gaussian:
    """Least squares proper."""

    method: str = "least-squares"
    information: float = 1.0
    spread: float = 1.0

    def irls_weight(self, squares: Array) -> Array:
        """See `Likelihood.irls_weight`."""
        return np.ones_like(squares)


@dataclass(frozen=True)
class StudentT:
    """Heavier tails: a misheard end stop pulls little (K. Lange et al., JASA 84:881, 1989).

    Parameters
    ----------
    freedom : float, optional
        Above 2.

    Examples
    --------
    >>> StudentT(5.0).irls_weight(np.array([0.0, 1.0, 95.0])).round(2)
    array([1.2 , 1.  , 0.06])
    """

    freedom: float = 5.0
    method: str = "heavy-tailed-least-squares"

    @property
    def information(self) -> float:
        """See `Likelihood.information`."""
        return (self.freedom + 1.0) / (self.freedom + 3.0)

    @property
    def spread(self) -> float:
        """See `Likelihood.spread`."""
        return float(np.sqrt(self.freedom / (self.freedom - 2.0)))

    def irls_weight(self, squares: Array) -> Array:
        """See `Likelihood.irls_weight`."""
        return (self.freedom + 1.0) / (self.freedom + squares)
