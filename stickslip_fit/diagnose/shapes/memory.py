"""Memory from one traverse to the next: noise of which a share is carried over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Memory:
    """A first-order autoregression of the residuals, which no cause gives.

    Attributes
    ----------
    cause : str
    before : array of int, shape (n,)
        The row before each row, -1 for the first of a sequence.
    carried : float
        Share of a residual that the next one keeps.
    """

    cause: str
    before: npt.NDArray[np.intp]
    carried: float
    version: None = None
    values: None = None

    def log_evidence(self, residuals: Array, freedom: int) -> Array:
        """Log likelihood ratio to noise without memory, its size unknown; (n, k) -> (k,)."""
        follows = self.before >= 0
        earlier = np.where(follows[:, None], residuals[self.before], 0.0)
        new = residuals - self.carried * earlier
        new[~follows] *= np.sqrt(1.0 - self.carried**2)
        ratio = np.sum(new**2, axis=0) / np.sum(residuals**2, axis=0)
        sequences = int(np.sum(~follows))
        return -0.5 * freedom * np.log(ratio) + 0.5 * sequences * np.log1p(-(self.carried**2))

    def shape(self, residual: Array) -> Array:
        """What memory predicts of each residual, shape (n,)."""
        return np.where(self.before >= 0, self.carried * residual[self.before], 0.0)
