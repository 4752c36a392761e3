"""Noise that grows with the response: its standard deviation as a function of the law's prediction.

Counts scatter by their square root, many instruments by a share of what they show. The variance is taken as
a constant plus a power of the prediction (R. J. Carroll and D. Ruppert, Transformation and Weighting in
Regression, 1988, ch. 3), chosen by the restricted likelihood under each hypothesis's own weights, beside
noise that differs by no more than a factor of two, as in `unevenness`. What looks like noise that grows may
be an effect that does: both are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.extension import compute_evidence
from stickslip_fit.diagnosis.linearized import LinearizedFit, rms
from stickslip_fit.diagnosis.misfit import StructureRemoved, remove_structure
from stickslip_fit.diagnosis.noise import MIN_UNEVEN_LOG_ODDS
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.table_alternatives import TableAlternatives
from stickslip_fit.diagnosis.table_noise import weigh_rows
from stickslip_fit.diagnosis.testability import MIN_TABLE_DF
from stickslip_fit.diagnosis.unevenness import Residuals, residuals_of

POWERS = (0.5, 1.0)  # of the prediction: counts, and a share of the response
FLOORS = 2.0 ** np.arange(0.5, -10.5, -1.0)  # constant part, relative to the other at its largest
MAX_AS_ASSUMED = 2.0  # between the noise of the rows, all but a few, as `unevenness` has it
ENDS = (0.02, 0.98)  # quantiles of the rows between which the noise is compared
MIN_LOG_RATIO = 4.0  # nats over noise as assumed
MAX_ROUNDS, TOL = 3, 0.02  # of weights, fit and prediction; change of a row's noise that ends them


@dataclass(frozen=True, eq=False)
class Growth:
    """How the noise grows; n rows.

    Attributes
    ----------
    ratio : array, shape (n,)
        Standard deviation of each row, relative to their root mean square; 1 where it does not grow.
    log_ratio : float
        Log likelihood ratio to noise as assumed.
    """

    ratio: Array
    log_ratio: float = 0.0


def estimate_growth(residuals: Residuals, prediction: Array) -> Growth:
    """By how much noise grows with a prediction, shape (n,), where it clearly does.

    Examples
    --------
    >>> rng, prediction = np.random.default_rng(1), np.linspace(1.0, 100.0, 200)
    >>> same = np.zeros(200, dtype=int)
    >>> noise = rng.standard_normal(200)
    >>> float(np.ptp(estimate_growth(Residuals(noise, same, np.zeros((200, 1)), same), prediction).ratio))
    0.0
    >>> growing = Residuals(noise * np.sqrt(prediction), same, np.zeros((200, 1)), same)
    >>> ratio = estimate_growth(growing, prediction).ratio
    >>> bool(6 < ratio.max() / ratio.min() < 15)
    True
    """
    size = np.abs(prediction)
    nothing = Growth(np.ones(len(residuals)))
    if not size.max(initial=0.0) > 0:
        return nothing
    size = size / size.max()
    assumed, best = residuals.reweight(nothing.ratio).log_likelihood, Growth(nothing.ratio, -np.inf)
    for power in POWERS:
        for floor in FLOORS:
            ratio = np.hypot(floor, size**power)
            low, high = np.quantile(ratio, ENDS)
            log_likelihood = residuals.reweight(ratio).log_likelihood
            if high <= MAX_AS_ASSUMED * low:
                assumed = max(assumed, log_likelihood)
            elif log_likelihood > best.log_ratio:
                best = Growth(ratio / rms(ratio), log_likelihood)
    log_ratio = best.log_ratio - assumed
    return replace(best, log_ratio=log_ratio) if log_ratio > MIN_LOG_RATIO else nothing


def with_growing_noise(problem: DiagnosisProblem) -> DiagnosisProblem:
    """The problem of a table, with weights for noise that grows with the response where it clearly does."""
    weighted = problem
    for _ in range(MAX_ROUNDS):
        searched = weighted.with_autocorrelation()
        linearized = searched.linearize()
        if linearized.df < MIN_TABLE_DF or linearized.fits_exactly:
            return problem
        growth = _estimate_beside_structure(searched, linearized)
        if np.all(growth.ratio == 1.0):
            return problem
        change = np.abs(np.log(growth.ratio / weighted.relative_sd)).max()
        weighted = weigh_rows(problem, growth.ratio)
        assert isinstance(weighted.alternatives, TableAlternatives)
        weighted = replace(weighted, alternatives=replace(weighted.alternatives, growing=True))
        if change < TOL:
            break
    return weighted


def _estimate_beside_structure(problem: DiagnosisProblem, linearized: LinearizedFit) -> Growth:
    """From residuals without structure, unless noise that grows is likelier than that structure."""
    prediction = np.empty(len(problem))
    for part in problem.parts:
        prediction[part.rows] = part.law.predict(problem.rows.iloc[part.rows], part.values)
    misfit = compute_evidence(linearized, problem)
    left = StructureRemoved(linearized.residual, np.zeros(len(problem)))
    if len(misfit.hypotheses):
        left = remove_structure(linearized.residual, misfit.hypotheses, misfit.log_evidence, linearized.df)

    def estimate(residual: Array, share: Array) -> Growth:
        sd = np.full(len(problem), rms(problem.scale))
        return estimate_growth(residuals_of(linearized, residual, sd, problem.noise_group, share), prediction)

    growth = estimate(left.residual, left.leverage)
    if left.log_evidence > 0:
        whole = estimate(linearized.residual, np.zeros(len(problem)))
        if whole.log_ratio > growth.log_ratio + left.log_evidence + MIN_UNEVEN_LOG_ODDS:
            return whole
    return growth
