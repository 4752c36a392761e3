"""The noise of a baseline fit, estimated anew without the structure that its residuals have.

The noise that a log's replicates or first residuals tell has unexplained structure in it, more in some joints
than in others, so that effects would be weighed wrongly between them. So the likeliest structure is removed
first; where the noise is the same without it, what was computed for that is the test's evidence as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.extension import (
    Extension,
    SelectedCause,
    absorb_unknown,
    add_candidates,
    compute_evidence,
    compute_finer_effects,
    explain_unevenness,
)
from stickslip_fit.diagnosis.hypotheses import FiniteEffects, compute_finite_effects
from stickslip_fit.diagnosis.linearized import MAX_LEVERAGE, LinearizedFit, rms
from stickslip_fit.diagnosis.misfit import Misfit, StructureRemoved, remove_structure
from stickslip_fit.diagnosis.noise import NoiseEstimate, explains_more
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.testability import MIN_DF

MAX_NOISE_LEFT = 0.8  # of the noise, without structure, for which tests are made anew
MIN_FINE_SHARE = 0.5  # of the df of noise, below which coarse rounding tells most of it
SAME_NOISE = 0.01  # relative change of every row's noise, far less than is known of it


@dataclass(frozen=True, eq=False)
class Baseline:
    """The baseline fit in re-estimated noise.

    Attributes
    ----------
    problem : DiagnosisProblem
    linearized : LinearizedFit
    residual : array, shape (n,)
        Without structure, in units of the largest noise that the configuration of each row may have.
    effects : list of FiniteEffects
        Of the causes, at finer trials as well.
    misfit : Misfit or None
        The evidence in this noise, if known.
    """

    problem: DiagnosisProblem
    linearized: LinearizedFit
    residual: Array
    effects: list[FiniteEffects]
    misfit: Misfit | None

    def weigh(self) -> Misfit:
        """The evidence in this noise."""
        if self.misfit is not None:
            return self.misfit
        return compute_evidence(self.linearized, self.problem, effects=self.effects)


def reestimate_noise(problem: DiagnosisProblem) -> Baseline:
    """The baseline in the noise that is left without structure."""
    effects = compute_finite_effects(problem.linearize(), problem.causes)
    for _ in range(2):
        linearized, before = problem.linearize(), problem
        misfit = compute_evidence(linearized, problem, effects=effects)
        if finer := compute_finer_effects(linearized, misfit):
            # A row at a sudden change would be an outlier by the nearest candidate moment.
            effects += finer
            misfit = replace(add_candidates(misfit, linearized, finer), failed=misfit.failed)
        noise, left = estimate_noise_left(problem, linearized, misfit)
        problem = problem.with_noise(noise)
        if np.all(noise.unevenness.ratio == 1.0):
            break
        # What looked like structure may be where the noise is large.
    max_ratio = noise.heteroscedasticity.max_ratio / noise.heteroscedasticity.ratio
    # Rows that the structure follows closely have small residuals; beside them others would look outlying.
    known = 1.0 - np.minimum(linearized.leverage, MAX_LEVERAGE)
    followed = np.minimum(left.leverage / known, MAX_LEVERAGE)
    residual = left.residual / np.sqrt(1.0 - followed) * linearized.scale / problem.scale / max_ratio
    if problem.skewness is not None:
        residual = problem.skewness.symmetrize(residual)
    if np.abs(problem.scale / before.scale - 1.0).max() < SAME_NOISE:
        # Nothing depends on the difference; the evidence is half of the work where nothing is wrong.
        problem = replace(problem, repeatability=before.repeatability, noise_ratio=before.noise_ratio)
        return Baseline(problem, linearized, residual, effects, misfit)
    return Baseline(problem, problem.linearize(), residual, effects, None)


def estimate_noise_left(
    problem: DiagnosisProblem, linearized: LinearizedFit, misfit: Misfit
) -> tuple[NoiseEstimate, StructureRemoved]:
    """The noise without the likeliest structure of a test, and what that leaves."""
    whole = StructureRemoved(linearized.residual, np.zeros(len(problem)))
    left = remove_structure(linearized.residual, misfit.hypotheses, misfit.log_evidence, linearized.df)
    if explains_more(linearized, left.log_evidence):
        left = whole
    noise = problem.estimate_noise(linearized, left)
    df = float(np.sum(1.0 - linearized.leverage - left.leverage))
    # Few fine counts beside coarse ones, whose rounding is known: a shape may have taken up all their noise.
    if left is not whole and noise.df.sum() < min(MIN_DF, MIN_FINE_SHARE * df):
        left, noise = whole, problem.estimate_noise(linearized, whole)
    return explain_unevenness(problem, linearized, misfit, left, noise), left


def reduce_noise(extension: Extension, selected: Sequence[SelectedCause], misfit: Misfit) -> Extension | None:
    """An extension with the noise that its residuals have without structure, if that is much smaller.

    In larger noise the law for that structure would be too smooth.
    """
    problem = extension.problem
    noise, _ = estimate_noise_left(problem, absorb_unknown(extension, selected), misfit)
    # Which rows are noisy, residuals tell that structure followed as far as it could: no new weights.
    quieter = replace(problem, repeatability=noise.sd)
    is_same = rms(quieter.scale) > MAX_NOISE_LEFT * rms(problem.scale)
    if problem.autocorrelation is not None or is_same or noise.df.sum() < MIN_DF:
        return None
    return replace(extension, problem=quieter)
