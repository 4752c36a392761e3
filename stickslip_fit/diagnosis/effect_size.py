"""Effect sizes: from selected causes to findings with parameters and 95 % intervals.

The effect of a cause is estimated in the fitted form and in its alternative forms, as rms over all
rows. Strengths have intervals conditional on detection (`intervals`). The AR(1) coefficient is
estimated by simulation, since projecting out the calibration reduces the correlation of residuals.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import beta

from stickslip_fit._typing import Array
from stickslip_fit.causes import SizedParameter
from stickslip_fit.diagnosis.hypotheses import AR1, Hypothesis, acts_on, compute_changes
from stickslip_fit.diagnosis.intervals import strength_interval, threshold_length
from stickslip_fit.diagnosis.linearized import LinearizedFit, linearize_fit
from stickslip_fit.diagnosis.misfit import STRENGTHS, UNKNOWN
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.result import Finding
from stickslip_fit.diagnosis.selection import (
    MISFIRE,
    SelectedCause,
    Selection,
    allocate_alpha,
    alternative_forms,
)
from stickslip_fit.diagnosis.separability import is_distinguishable
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.units import Interval

AR1_GRID = np.arange(0.0, 0.96, 0.05)
N_SIMULATIONS = 200
INTERVAL_TAILS = (
    0.975,
    0.5,
    0.025,
)  # of the correlations left: the lowest share makes the log's own unusually large


def estimate_ar1_effect(linearized: LinearizedFit, ar1: AR1) -> Interval:
    """Rms of what is carried on to each departure, in units of what is new in it.

    Parameters
    ----------
    linearized : Study
    ar1 : Memory
        As it was found.
    """
    sign = np.sign(ar1.coefficient)
    own = sign * _lag1_correlation(linearized.residual[:, None], ar1)[0]
    noise = np.random.default_rng(0).standard_normal((len(linearized), N_SIMULATIONS))
    left = [
        sign * _lag1_correlation(linearized.project(_simulate_ar1(noise, ar1, sign * k)), ar1)
        for k in AR1_GRID
    ]
    limits = np.maximum.accumulate(np.quantile(left, [1 - tail for tail in INTERVAL_TAILS], axis=1), axis=1)
    low, middle, high = (float(np.interp(own, limit, AR1_GRID)) for limit in limits[::-1])
    return Interval(*(share / np.sqrt(1.0 - share**2) for share in (middle, low, high)))


def _simulate_ar1(noise: Array, ar1: AR1, share: float) -> Array:
    """Noise of which each row keeps a share of the row before, a first one being as large as any other."""
    found = noise.copy()
    for row, before in enumerate(ar1.before):
        found[row] = (
            found[row] + share * found[before] if before >= 0 else found[row] / np.sqrt(1.0 - share**2)
        )
    return found


def _lag1_correlation(residuals: Array, ar1: AR1) -> Array:
    """Of each row with the one before, (n, k) -> (k,)."""
    follows = ar1.before >= 0
    products = residuals[follows] * residuals[ar1.before[follows]]
    return np.asarray(products.sum(axis=0) / np.sum(residuals**2, axis=0))


DIFFERENCE_STEP = 1e-3  # of a parameter's scale
MIN_EXCESS_SD = 2.0  # standard deviations of what noise alone puts into so many further forms


@dataclass(frozen=True, eq=False)
class CauseEffect:
    """A cause's effect on a log, in units of the noise, recalibration taken out.

    Attributes
    ----------
    rows : array, shape (n,)
    rms : float
        Over all rows with equal weight, relative, all that an even recalibration would absorb taken out.
    error : float
        Standard deviation of its length.
    dimensions : int
        Numbers that were fitted for it.
    """

    rows: Array
    rms: float
    error: float
    dimensions: int

    @property
    def length(self) -> float:
        """In repeatabilities."""
        return float(np.linalg.norm(self.rows))


def estimate_effect(
    selection: Selection, linearized: LinearizedFit, found: SelectedCause, subset: slice
) -> CauseEffect:
    """The effect of one of the causes found.

    Parameters
    ----------
    searched : Search
    linearized : Study
        Of the baseline.
    found : Found
    mine : slice
        Where its parameters stand among those of the fit.
    """
    values, covariance = selection.fit.values[subset], selection.fit.covariance[subset, subset]
    steps = DIFFERENCE_STEP * np.array(found.version.scale)
    trials = np.concatenate([values[None], values + np.diag(steps)])
    made = compute_changes(linearized, found.version, trials)
    scaled = linearized.project(made / linearized.scale[:, None])
    form = scaled[:, 0]
    length = max(float(np.linalg.norm(form)), 1e-12)
    slopes = (scaled[:, 1:] - form[:, None]) / steps
    along = slopes.T @ form / length
    error = float(np.sqrt(max(float(along @ covariance @ along), 0.0)))
    dimensions = max(int(np.sum(np.diag(covariance) > 0)), 1)
    beyond = _effect_beyond_fit(selection, found)
    even = linearize_fit(
        linearized.rows, linearized.parts, selection.problem.responses, np.ones(len(linearized))
    )
    rms = float(np.sqrt(np.mean(even.project(made[:, 0] + beyond * linearized.scale) ** 2)))
    return CauseEffect(form + beyond, rms, max(error, 1.0), dimensions)


def _effect_beyond_fit(selection: Selection, found: SelectedCause) -> Array:
    """What the cause's other forms explain beyond the one fitted, shape (n,); 0 where that is chance."""
    problem, fit = selection.problem, selection.fit
    plain = linearize_fit(problem.rows, fit.parts, problem.responses, problem.scale, shared=len(fit.values))
    left, singular, _ = np.linalg.svd(plain.project(alternative_forms(plain, found)), full_matrices=False)
    forms = left[:, singular > 0.05]
    along = forms.T @ plain.residual
    excess = float(along @ along) - len(along)
    if not len(along) or excess < MIN_EXCESS_SD * np.sqrt(2.0 * len(along)):
        return np.zeros(len(plain))
    return np.asarray(forms @ along * (excess / (excess + len(along))))


Z_95 = 1.959964


def size_findings(selection: Selection, given: DiagnosisProblem, alpha: float) -> tuple[Finding, ...]:
    """Size up everything that was found, strongest first; what has no name comes last.

    Parameters
    ----------
    searched : Search
    given : Bench
        What was searched, misfired rows and all.
    alpha : float
        Of the search.
    """
    linearized, first = selection.problem.study(), 0
    sized = []
    for found in selection.found:
        number = len(found.start)
        if found.cause == MISFIRE:
            sized.append(_size_misfires(selection, given, found))
        elif found.cause == UNKNOWN:
            sized.append(_size_unknown(selection, found, alpha))
        else:
            sized.append(_size_cause(selection, linearized, found, slice(first, first + number), alpha))
            first += number
    return tuple(sorted(sized, key=lambda each: (each.cause == UNKNOWN, -each.effect.estimate)))


def _size_cause(
    selection: Selection, linearized: LinearizedFit, found: SelectedCause, subset: slice, alpha: float
) -> Finding:
    values, covariance = selection.fit.values[subset], selection.fit.covariance[subset, subset]
    effect = estimate_effect(selection, linearized, found, subset)
    strength = _estimate_strength(found, effect.length, effect.error, effect.dimensions, linearized, alpha)
    per_strength = effect.rms / max(effect.length, 1e-12)
    misfit = found.misfit
    assert misfit is not None
    rivals = tuple(
        rival
        for rival in found.cause_set.rivals
        if not is_distinguishable(misfit.best_hypothesis(found.cause), misfit, rival, strength.estimate)
    )
    error = np.sqrt(np.diag(covariance))
    error = np.where(error > 0, error, np.nan)  # of a sudden moment no error is known
    sizes = [
        SizedParameter(
            parameter.name, parameter.unit,
            Interval(value, value - Z_95 * spread, value + Z_95 * spread),
            parameter.joint, parameter.direction, parameter.session,
        )
        for parameter, value, spread in zip(found.version.parameters, values, error, strict=True)
        if np.isfinite(spread) or getattr(parameter, "sudden", False)
    ]  # fmt: skip
    shown = () if found.cause.startswith(COVARIATE_PREFIX) else tuple(sizes)
    laws = [part.law for part in selection.problem.parts if acts_on(found.version, part.law)]
    return Finding(
        found.cause, found.version, rivals, found.p_value, _joints_of_laws(laws),
        strength.times(per_strength), shown,
    )  # fmt: skip


def _size_unknown(selection: Selection, found: SelectedCause, alpha: float) -> Finding:
    misfit, linearized = found.misfit, selection.study
    assert misfit is not None
    best = misfit.best_hypothesis(UNKNOWN)
    shape = _shrink_structure(best, linearized.residual)
    strength2 = float(shape @ shape)
    length = float(np.linalg.norm(shape))
    if isinstance(best, AR1):
        effect = estimate_ar1_effect(linearized, best).times(_rms(linearized.scale))
    else:
        strength = _estimate_strength(found, np.sqrt(strength2 + 1.0), 1.0, 1, linearized, alpha)
        effect = strength.times(_rms(shape * linearized.scale) / max(length, 1e-12))
    causes = {cause: value for cause, value in misfit.log_evidence_by_cause.items() if cause != UNKNOWN}
    closest = max(causes, key=lambda cause: causes[cause]) if causes else ""
    share = 0.0
    if closest:
        near = misfit.best_hypothesis(closest)
        assert isinstance(near, Hypothesis)
        share = float(np.sum(near.along(shape) ** 2)) / max(strength2, 1e-12)
    carrier = best.cause.removeprefix(f"{UNKNOWN}:")
    size = np.abs(shape)
    touched = _joints_of_laws(
        part.law for part in linearized.parts if np.any(size[part.rows] > 1e-3 * size.max())
    )
    return Finding(UNKNOWN, None, (), found.p_value, touched, effect, (), None, closest, share, carrier)


def _shrink_structure(shape: Hypothesis | AR1, residual: Array) -> Array:
    """What a structure explains of the residuals, shrunk by what noise alone would give it; shape (n,)."""
    if isinstance(shape, AR1):
        return shape.shape(residual)
    along = shape.along(residual)
    strength2 = max(float(along @ along) - len(along), 0.0)
    taken = shape.share * strength2 / (1.0 + shape.share * strength2)
    return shape.combine(taken * along)


def _size_misfires(selection: Selection, given: DiagnosisProblem, found: SelectedCause) -> Finding:
    out, n = selection.outliers, len(given)
    departure = _misfire_offsets(selection, given, out)
    off = np.abs(departure)
    rms = float(np.sqrt(np.sum(off**2) / n))
    spread = Z_95 * rms * float(np.sqrt(np.mean(given.scale[out] ** 2) / np.mean(off**2) / len(out)))
    share = Interval(
        len(out) / n,
        float(beta.ppf(0.025, len(out), n - len(out) + 1)),
        float(beta.ppf(0.975, len(out) + 1, n - len(out))),
    )
    low, middle, high = np.quantile(off, [0.025, 0.5, 0.975])
    joints = _joints_of_laws(part.law for part in given.parts if np.isin(part.rows, out).any())
    return Finding(
        MISFIRE, None, (), found.p_value, joints, Interval(rms, max(rms - spread, 0.0), rms + spread),
        (SizedParameter("share", "%", share), SizedParameter("size", "%", Interval(middle, low, high))),
        traverses=given.rows.iloc[out].assign(departure=departure),
    )  # fmt: skip


def _misfire_offsets(selection: Selection, given: DiagnosisProblem, out: npt.NDArray[np.intp]) -> Array:
    """By how much rows that were left out of the fit differ from it; those it cannot predict by nothing."""
    off = np.zeros(len(given))
    for part, fitted in zip(given.parts, selection.fit.parts, strict=True):
        blocks, first = np.unique(fitted.block, return_index=True)
        subset = np.isin(part.rows, out) & np.isin(part.block, blocks)
        values = fitted.values[first[np.searchsorted(blocks, part.block[subset])]]
        rows = part.rows[subset]
        if len(rows):
            off[rows] = given.responses[rows] - fitted.law.predict(given.rows.iloc[rows], values)
    return off[out]


def _estimate_strength(
    found: SelectedCause,
    length: float,
    error: float,
    dimensions: int,
    linearized: LinearizedFit,
    alpha: float,
) -> Interval:
    """Strength of an effect seen with this length, known to within `error`, because it raised the alarm."""
    misfit = found.misfit
    assert misfit is not None
    shapes = sum(each.cause == found.cause for each in misfit.hypotheses) or 1
    threshold = threshold_length(
        misfit.critical_value(allocate_alpha(alpha)), shapes, linearized.df, STRENGTHS
    )
    return strength_interval(length / error, dimensions, threshold / error).times(error)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _joints_of_laws(laws: Iterable[Any]) -> tuple[int, ...]:
    """Of which joints some laws are; of none where they have nothing to do with any."""
    return tuple(sorted(int(law.joint) for law in laws if hasattr(law, "joint")))
