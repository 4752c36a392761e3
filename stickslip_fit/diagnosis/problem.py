"""DiagnosisProblem: rows, their laws, responses, noise and candidate causes, built from a log.

The problem knows nothing of actuators: laws and causes act through their interfaces only. It linearizes
the baseline fit, re-estimates the noise, refits the laws with causes in them, and removes rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes import Cause, covariates, library
from stickslip_fit.diagnosis.hypotheses import (
    AR1,
    Hypothesis,
    build_unstructured_alternatives,
    number_configurations,
)
from stickslip_fit.diagnosis.linearized import (
    ExtendedFit,
    LawBlock,
    LinearizedFit,
    fit_extended,
    linearize_fit,
)
from stickslip_fit.diagnosis.misfit import StructureRemoved
from stickslip_fit.diagnosis.noise import NoiseEstimate, estimate_noise
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation._optimize import usable_rows
from stickslip_fit.logs import Log

RESTART_SHARES = (0.3, 0.1)  # shares of the sizes from which a fit is begun again


@dataclass(frozen=True, eq=False)
class DiagnosisProblem:
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
    alternatives : callable
        From a Study to the hypotheses that stand for ``unknown``.
    kind : array of int, shape (n,)
        Rows of some kinds may repeat worse than others.
    uneven : array, shape (n,)
        How much worse each row does.
    """

    rows: pd.DataFrame
    parts: tuple[LawBlock, ...]
    responses: Array
    rounding: Array
    drive: IntArray
    repeatability: Array
    causes: tuple[Any, ...]
    alternatives: Callable[[LinearizedFit], list[Hypothesis | AR1]]
    kind: IntArray
    uneven: Array

    def __len__(self) -> int:
        return len(self.responses)

    @property
    def scale(self) -> Array:
        """Standard deviation of each response, shape (n,)."""
        return np.sqrt((self.repeatability[self.drive] * self.uneven) ** 2 + self.rounding)

    def study(self) -> LinearizedFit:
        """The rows under the baseline."""
        return linearize_fit(self.rows, self.parts, self.responses, self.scale)

    def estimate_noise(self, linearized: LinearizedFit, left: StructureRemoved) -> NoiseEstimate:
        """The repeatability that shows in what is left of a study's residuals."""
        return estimate_noise(linearized, left, self.rounding, self.drive, self.kind)

    def with_noise(self, noise: NoiseEstimate) -> DiagnosisProblem:
        """With another repeatability."""
        return replace(self, repeatability=noise.sd, uneven=noise.uneven.ratio)

    def fit_extended(self, versions: Sequence[Any] = (), start: Array | None = None) -> ExtendedFit:
        """The baseline with some causes in it, fitted anew.

        What does not converge from where it begins is begun nearer to no effect, where the fit is linear.
        """
        first = np.zeros(0) if start is None else start
        found = fit_extended(self.rows, self.parts, self.responses, self.scale, versions, first)
        for share in RESTART_SHARES:
            if found.converged or not len(first):
                break
            nearer = _absent_values(versions) + share * (first - _absent_values(versions))
            again = fit_extended(
                self.rows, self.parts, self.responses, self.scale, versions,
                np.where(_are_sizes(versions), nearer, first),
            )  # fmt: skip
            if again.converged or self._chi_square(again) < self._chi_square(found):
                found = again
        return found

    def _chi_square(self, fit: ExtendedFit) -> float:
        return float(np.sum((fit.residual / self.scale) ** 2))

    def without(self, out: IntArray) -> DiagnosisProblem:
        """The bench without some rows, the baseline fitted anew."""
        kept = np.setdiff1d(np.arange(len(self)), out)
        place = np.full(len(self), -1)
        place[kept] = np.arange(len(kept))
        parts = []
        for part in self.parts:
            subset = place[part.rows] >= 0
            parts.append(
                replace(
                    part, rows=place[part.rows][subset], block=part.block[subset], values=part.values[subset]
                )
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
        return replace(smaller, parts=smaller.fit_extended().parts)


def _absent_values(versions: Sequence[Any]) -> Array:
    return np.concatenate([np.array(each.absent, dtype=float) for each in versions])


def _are_sizes(versions: Sequence[Any]) -> npt.NDArray[np.bool_]:
    """Which parameters are sizes: the first of each cause, or all where they act in any combination."""
    return np.concatenate([[each.joined or k == 0 for k in range(len(each.absent))] for each in versions])


def problem_from_log(
    log: Log, causes: Iterable[Cause] | None = None
) -> tuple[DiagnosisProblem, dict[str, str]]:
    """A log under the published laws, fitted to each session and direction.

    Parameters
    ----------
    log : Log
    causes : iterable of Cause, optional
        The library and the lab's own columns without it.

    Returns
    -------
    bench : Bench
    missing : dict of str to str
        Causes that the log has nothing to show of, and why.
    """
    rows = usable_rows(log)
    fitted = fit_least_squares(log)
    known = (*library(), *covariates(rows)) if causes is None else tuple(causes)
    missing = {cause.name: why for cause in known if (why := cause.missing(rows)) is not None}
    parts, repeatability = [], []
    responses, rounding = np.zeros(len(rows)), np.zeros(len(rows))
    drive = np.zeros(len(rows), dtype=np.intp)
    backwards = (rows["direction"] == "-").to_numpy()
    for number, (joint, fit) in enumerate(fitted.joints.items()):
        subset = np.flatnonzero((rows["joint"] == joint).to_numpy())
        block = fit.group_index(rows.iloc[subset])
        responses[subset], rounding[subset] = fit.law.response(rows.iloc[subset])
        drive[subset] = 2 * number + backwards[subset]
        parts.append(LawBlock(fit.law, subset, block, fit.values[block]))
        values = [fit.repeatability[direction].value for direction in "+-"]
        repeatability += [value if np.isfinite(value) else np.nan for value in values]
    noise = np.array(repeatability)
    noise = np.where(np.isfinite(noise), noise, np.nanmean(noise) if np.isfinite(noise).any() else 3e-3)
    present = tuple(cause.bind(rows, log.machine) for cause in known if cause.name not in missing)
    problem = DiagnosisProblem(
        rows, tuple(parts), responses, rounding, drive, noise, present, build_unstructured_alternatives, number_configurations(rows),
        np.ones(len(rows)),
    )  # fmt: skip
    return problem, missing
