"""A log on the bench: its rows, the law each obeys, what was measured and how well that repeats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.laid_out.refit import Refit, refit
from stickslip_fit.diagnose.laid_out.study import Part, Study, study_of
from stickslip_fit.diagnose.noise.cleared import Cleared
from stickslip_fit.diagnose.noise.repeatability import Repeatability, repeatability
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.shapes.memory import Memory

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

NEARER = (0.3, 0.1)  # shares of the sizes from which a fit is begun again


@dataclass(frozen=True, eq=False)
class Bench:
    """What is diagnosed; n rows. Nothing in it is particular to actuators.

    Attributes
    ----------
    rows : DataFrame
    parts : tuple of Part
        The baseline laws, fitted; between them every row once.
    responses, rounding : array, shape (n,)
        What was measured, and the variance that rounding adds.
    drive : array of int, shape (n,)
        Which repeatability each row has.
    repeatability : array
        Standard deviation of each drive's responses.
    causes : tuple
        Bound to the rows, and not obviously without effect in them.
    structures : callable
        From a Study to the hypotheses that stand for ``unknown``.
    kind : array of int, shape (n,)
        Rows of some kinds may repeat worse than others.
    uneven : array, shape (n,)
        How much worse each row does.
    """

    rows: pd.DataFrame
    parts: tuple[Part, ...]
    responses: Array
    rounding: Array
    drive: Indices
    repeatability: Array
    causes: tuple[Any, ...]
    structures: Callable[[Study], list[Hypothesis | Memory]]
    kind: Indices
    uneven: Array

    def __len__(self) -> int:
        return len(self.responses)

    @property
    def scale(self) -> Array:
        """Standard deviation of each response, shape (n,)."""
        return np.sqrt((self.repeatability[self.drive] * self.uneven) ** 2 + self.rounding)

    def study(self) -> Study:
        """The rows under the baseline."""
        return study_of(self.rows, self.parts, self.responses, self.scale)

    def noise_in(self, study: Study, left: Cleared) -> Repeatability:
        """The repeatability that shows in what is left of a study's residuals."""
        return repeatability(study, left, self.rounding, self.drive, self.kind)

    def repeating(self, noise: Repeatability) -> Bench:
        """With another repeatability."""
        return replace(self, repeatability=noise.of_drive, uneven=noise.uneven.likely)

    def fitted(self, versions: Sequence[Any] = (), start: Array | None = None) -> Refit:
        """The baseline with some causes in it, fitted anew.

        What does not converge from where it begins is begun nearer to no effect, where the fit is linear.
        """
        first = np.zeros(0) if start is None else start
        found = refit(self.rows, self.parts, self.responses, self.scale, versions, first)
        for share in NEARER:
            if found.converged or not len(first):
                break
            nearer = _absent(versions) + share * (first - _absent(versions))
            again = refit(
                self.rows, self.parts, self.responses, self.scale, versions,
                np.where(_sizes(versions), nearer, first),
            )  # fmt: skip
            if again.converged or self._chi_square(again) < self._chi_square(found):
                found = again
        return found

    def _chi_square(self, fit: Refit) -> float:
        return float(np.sum((fit.residual / self.scale) ** 2))

    def without(self, out: Indices) -> Bench:
        """The bench without some rows, the baseline fitted anew."""
        kept = np.setdiff1d(np.arange(len(self)), out)
        place = np.full(len(self), -1)
        place[kept] = np.arange(len(kept))
        parts = []
        for part in self.parts:
            mine = place[part.rows] >= 0
            parts.append(
                replace(part, rows=place[part.rows][mine], block=part.block[mine], values=part.values[mine])
            )
        smaller = replace(
            self,
            rows=self.rows.iloc[kept].reset_index(drop=True),
            parts=tuple(parts),
            responses=self.responses[kept],
            rounding=self.rounding[kept],
            drive=self.drive[kept],
            kind=self.kind[kept],
            uneven=self.uneven[kept],
        )
        return replace(smaller, parts=smaller.fitted().parts)


def _absent(versions: Sequence[Any]) -> Array:
    return np.concatenate([np.array(each.absent, dtype=float) for each in versions])


def _sizes(versions: Sequence[Any]) -> npt.NDArray[np.bool_]:
    """Which parameters are sizes: the first of each cause, or all where they act in any combination."""
    return np.concatenate([[each.joined or k == 0 for k in range(len(each.absent))] for each in versions])
