"""How large unknown structure is: what extends the law for it, and what that leaves.

A smooth function or a short expression only comes near an effect that nobody has described. So the
posterior distribution of the rms has three parts: the fit of what stands in the law; what the unstructured
alternatives find in the residuals of that, a mixture over all of them, their strengths, and nothing at all,
by their evidence; and what has none of their forms, of which replicates tell (`lack_of_fit`). Memory in both
directions is measured by simulation, since projecting out the calibration parameters reduces the correlation
of residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import softmax

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.effect_interval import (
    MAX_CONDITIONAL_STRENGTH,
    MIN_LENGTH,
    QUANTILES_95,
    LawEffect,
    detection_threshold,
    estimate_effect,
    fit_beside,
    linearize_unweighted,
    strength_interval,
)
from stickslip_fit.diagnosis.evidence import STRENGTHS, batch_hypotheses, strength_evidence
from stickslip_fit.diagnosis.extension import SelectedCause, estimate_strength, expect_noise
from stickslip_fit.diagnosis.finding import TO_SOME_EXTENT, Finding, closest_cause, joints_of_laws
from stickslip_fit.diagnosis.hypotheses import Hypothesis, make_hypothesis
from stickslip_fit.diagnosis.lack_of_fit import N_DRAWS, UNNAMED_SHARES, LackOfFit, widen
from stickslip_fit.diagnosis.lagged import find_lagged_column
from stickslip_fit.diagnosis.linearized import LinearizedFit, rms
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, classify_cause, remove_structure
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.units import Z_95, Interval

AR1_GRID, LAG_GRID = np.r_[np.arange(0.0, 0.96, 0.05), 0.98], np.linspace(0.0, 4.0, 41)
N_SIMULATIONS = 200
N_ALTERNATIVES = 40  # likeliest ones, of which the mixture is made
MIN_LEFT = 0.01  # share of the square of an alternative's effect that what stands in the law leaves


def size_unknown(selection: Selection, selected: SelectedCause, alpha: float) -> Finding:
    """The finding of unknown structure in the residuals that a selection leaves."""
    misfit, linearized = selected.test, selection.linearized
    evidence = {UNKNOWN: -np.inf} | misfit.log_evidence_by_cause
    # A cause may be likelier that rests on one or two rows, and is not named.
    strongest = UNKNOWN if selected.version is not None else max(evidence, key=lambda name: evidence[name])
    best = misfit.best_hypothesis(strongest)
    residual = linearized.residual if selected.version is None else misfit.residual
    shape = _shrink_structure(best, residual)
    if isinstance(best, AR1) and (selected.version is None or best.sequences.onto is None):
        effect = estimate_ar1_effect(selected.tested or linearized, best, selection.problem.linearize())
        effect = effect if selected.version is None else widen(effect)
    else:
        effect = _size_structure(selection, replace(selected, cause=strongest), shape, alpha)
    size = np.abs(shape)
    joints = joints_of_laws(
        part.law for part in linearized.parts if np.any(size[part.rows] > 1e-3 * size.max())
    )
    is_cause = not best.cause.startswith(UNKNOWN)
    carrier = f"{best.cause}{TO_SOME_EXTENT}" if is_cause else best.cause.removeprefix(f"{UNKNOWN}:")
    baseline = selection.problem.linearize()
    explained = baseline.residual - baseline.project(baseline.whiten(selection.fit.residual))
    return Finding(
        UNKNOWN,
        None,
        (),
        selected.p_value,
        joints,
        effect,
        (),
        carrier=carrier,
        lagged=find_lagged_column(baseline, shape if selected.version is None else explained),
        **_compare_causes(misfit, shape),
    )


def compare_causes(misfit: Misfit, cause: str) -> dict[str, Any]:
    """How all causes compare with the likeliest shape of one of them, as attributes of a `Finding`."""
    return _compare_causes(misfit, _shrink_structure(misfit.best_hypothesis(cause), misfit.residual))


def _compare_causes(misfit: Misfit, shape: Array) -> dict[str, Any]:
    """Of structure `shape`, (n,), whitened: the share that each cause explains, and the likeliest cause."""
    if misfit.basis is not None:  # calibration would absorb a part of what memory predicts
        shape = shape - misfit.basis @ (misfit.basis.T @ shape)
    squares = float(shape @ shape)
    known = {cause: value for cause, value in misfit.log_evidence_by_cause.items() if cause != UNKNOWN}

    def explained(near: Hypothesis) -> float:
        return float(np.sum(near.coefficients(shape) ** 2)) / max(squares, MIN_LENGTH)

    explains = {
        cause: explained(near)
        for cause in known
        if isinstance(near := misfit.best_hypothesis(cause), Hypothesis)
    }
    by_equation = {
        cause: max(map(explained, own)) for cause in explains if (own := misfit.single_directions(cause))
    }
    # The likeliest form need not be the one that is most like the structure, which another one shares.
    explains = {cause: max(share, by_equation.get(cause, 0.0)) for cause, share in explains.items()}
    closest = closest_cause(explains, by_equation)
    return {
        "closest": closest,
        "share": explains.get(closest, 0.0),
        "explains": explains,
        "explains_by_equation": by_equation,
    }


@dataclass(frozen=True, eq=False)
class _Component:
    """One structure that may be there, or nothing, given the residuals.

    Attributes
    ----------
    mean, sd : array, shape (m,)
        Of its coefficients.
    log_weight : float
        Logarithm of its probability, but for a constant.
    """

    structure: Hypothesis | None
    mean: Array
    sd: Array
    log_weight: float


def _size_structure(selection: Selection, selected: SelectedCause, shape: Array, alpha: float) -> Interval:
    """Rms of unknown structure, of which `shape`, (n,), is an estimate, whitened."""
    problem, misfit = selection.problem, selected.test
    linearized = selection.linearized
    plain = linearize_unweighted(problem, fit_beside(selection, selected))
    law, candidates, left = None, _alternatives(misfit, selected.cause), None
    if selected.version is None:
        left = remove_structure(linearized.residual, misfit.hypotheses, misfit.log_evidence, linearized.df)
    else:
        law = estimate_effect(selection, selected)
        linearized = problem.linearize_extended(selection.fit)
        candidates = _beyond_law(misfit, linearized)
    ratio = (expect_noise(problem, selection.linearized, left).scale / problem.scale) ** 2
    inflation = float(np.sqrt(shape**2 @ ratio / max(float(shape @ shape), MIN_LENGTH)))
    components = _weigh_components(candidates, linearized, len(_alternatives(misfit, selected.cause)))
    nothing = [] if law is None else [_Component(None, np.zeros(0), np.zeros(0), 0.0)]
    sizes = _draw_rms(
        law,
        [*nothing, *components],
        inflation,
        lambda rows: plain.project(linearized.unwhiten(rows)),
        len(shape),
    )
    limits = np.quantile(sizes, QUANTILES_95)
    low, middle, high = limits.tolist()
    error = max((high - low) / (2.0 * Z_95), MIN_LENGTH)
    size = Interval(middle, low, high)
    if middle / error <= MAX_CONDITIONAL_STRENGTH:
        threshold = detection_threshold(selected, linearized.df, alpha)
        threshold *= rms(linearized.unwhiten(shape)) / max(float(np.linalg.norm(shape)), MIN_LENGTH)
        size = strength_interval(middle / error, 1, threshold / error).times(error)
    lack = None if law is None else LackOfFit.of(linearized, law, UNNAMED_SHARES)
    if lack is None:
        return size
    # What is lacking only adds, so that the upper end moves most.
    larger = np.quantile(lack.add_to(sizes, problem.scale), QUANTILES_95) / np.maximum(limits, MIN_LENGTH)
    low, middle, high = np.multiply([size.low, size.estimate, size.high], larger).tolist()
    return Interval(middle, low, high)


def _alternatives(misfit: Misfit, cause: str = UNKNOWN) -> list[Hypothesis]:
    """The unstructured alternatives, or the shapes of a cause; where there are none, the likeliest of all."""
    found = [one for one in misfit.hypotheses if isinstance(one, Hypothesis) and classify_cause(one) == cause]
    return found or [misfit.best_subspace(cause)]


def _beyond_law(misfit: Misfit, extended: LinearizedFit) -> list[Hypothesis]:
    """What a law with the structure in it leaves of the alternatives that are likeliest in its residuals."""
    everything = _alternatives(misfit)
    # Residuals are orthogonal to the law; only the lengths of the directions are too great.
    evidence = batch_hypotheses(everything, extended.df).log_evidence(extended.residual[:, None])[:, 0]
    found = []
    for k in np.argsort(-evidence, kind="stable")[:N_ALTERNATIVES]:
        one = everything[k]
        effects = extended.project(one.directions * np.sqrt(one.prior_share))
        left = make_hypothesis(one.cause, one.version, None, effects)
        if left is not None and left.length**2 > MIN_LEFT:
            found.append(left)
    return found


def _weigh_components(
    candidates: Sequence[Hypothesis], linearized: LinearizedFit, number: int
) -> list[_Component]:
    """Candidates, of a `number` that are equally likely beforehand, at each strength, given the residuals."""
    residual, components = linearized.residual, []
    for one in candidates:
        along, signal = one.coefficients(residual), STRENGTHS[:, None] ** 2 * one.prior_share
        evidence = strength_evidence(signal, along, residual, linearized.df)
        for kept, log_weight in zip(
            signal / (1.0 + signal), evidence - np.log(number * len(STRENGTHS)), strict=True
        ):
            components.append(_Component(one, kept * along, np.sqrt(kept), float(log_weight)))
    return components


def _draw_rms(
    law: LawEffect | None,
    components: Sequence[_Component],
    inflation: float,
    calibrate: Callable[[Array], Array],
    n: int,
) -> Array:
    """Draws of the rms over n rows of what is in the law and of a component, shape (N_DRAWS,).

    `inflation` is that of the coefficients' errors; `calibrate` turns whitened rows into changes of
    responses.
    """
    rng, draws = np.random.default_rng(0), []
    log_weight = np.array([one.log_weight for one in components])
    numbers = rng.multinomial(N_DRAWS, softmax(log_weight))
    for one, number in zip(components, numbers, strict=True):
        if not number:
            continue
        columns = [np.zeros((n, 0))] if one.structure is None else [calibrate(one.structure.directions)]
        mean, sd = [one.mean], [inflation * one.sd]
        if law is not None:
            columns += [law.changes[:, None], law.spread]
            mean += [np.ones(1), np.zeros(law.spread.shape[1])]
            sd += [np.zeros(1), np.ones(law.spread.shape[1])]
        triangle = np.linalg.qr(np.concatenate(columns, axis=1), mode="r")
        centre, spread = np.concatenate(mean)[:, None], np.concatenate(sd)[:, None]
        noise = rng.standard_normal((len(centre), number))
        draws.append(np.linalg.norm(triangle @ (centre + spread * noise), axis=0) / np.sqrt(n))
    return np.concatenate(draws)


def _shrink_structure(structure: Hypothesis | AR1, residual: Array) -> Array:
    """Posterior mean of a structure given the residuals, shape (n,)."""
    if isinstance(structure, AR1):
        return structure.shape(residual)
    return structure.combine(_kept_shares(structure, residual) * structure.coefficients(residual))


def _kept_shares(structure: Hypothesis, residual: Array) -> Array:
    """Share of each coefficient that its posterior mean keeps, shape (m,)."""
    signal = estimate_strength(structure, residual) ** 2 * structure.prior_share
    return np.asarray(signal / (1.0 + signal))


def estimate_ar1_effect(linearized: LinearizedFit, ar1: AR1, baseline: LinearizedFit) -> Interval:
    """Rms of what calibration leaves of what each row keeps of the one before.

    Residuals are those of the law with causes, `linearized`, calibration that of the `baseline`. Of `ar1`
    only the sign and the order of rows are used. Its size is that of the residuals, times what it is of them
    in simulations.
    """
    sign, noise = np.sign(ar1.coefficient), np.random.default_rng(0)
    innovations = noise.standard_normal((len(linearized), N_SIMULATIONS))
    observed = sign * _lag1_coefficient(linearized.residual[:, None], ar1)[0]
    simulated, share = [], []
    for coefficient in AR1_GRID if ar1.sequences.onto is None else LAG_GRID:
        series = _simulate_ar1(innovations, ar1, sign * coefficient)
        left = linearized.project(series)
        kept = baseline.project(np.where(ar1.before[:, None] >= 0, series[ar1.before], 0.0))
        simulated.append(sign * _lag1_coefficient(left, ar1))
        share.append(coefficient * rms(kept) / rms(left))
    limits = np.maximum.accumulate(np.quantile(simulated, QUANTILES_95, axis=1), axis=1)
    high, middle, low = (float(np.interp(observed, limit, share)) for limit in limits)
    return Interval(middle, low, high).times(rms(linearized.unwhiten(linearized.residual)))


def _simulate_ar1(innovations: Array, ar1: AR1, coefficient: float) -> Array:
    """An AR(1) sequence, (n, k); stationary where all rows follow the one before."""
    series = innovations.copy()
    for row, before in enumerate(ar1.before):
        if before >= 0:
            series[row] += coefficient * series[before]
        elif ar1.sequences.onto is None:
            series[row] /= np.sqrt(1.0 - coefficient**2)
    return series


def _lag1_coefficient(residuals: Array, ar1: AR1) -> Array:
    """Of the regression of each row on the one before, (n, k) -> (k,)."""
    after, before = residuals[ar1.before >= 0], residuals[ar1.before[ar1.before >= 0]]
    return np.asarray(np.sum(after * before, axis=0) / np.sum(before**2, axis=0))
