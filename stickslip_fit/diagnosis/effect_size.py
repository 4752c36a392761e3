"""Effect sizes: from selected causes to findings with parameters and 95 % intervals.

The effect of a cause is estimated in the fitted form and in its alternative forms, as rms over all
rows. The length z of an estimated effect, in standard deviations of the noise, is noncentral chi
distributed; since it was selected only because it exceeded the detection threshold, its interval inverts
the distribution of z conditional on detection (J. D. Lee et al., Ann. Stat. 44:907, 2016, for the normal
case). The AR(1) coefficient is estimated by simulation, since projecting out the calibration parameters
reduces the correlation of residuals.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import betaincinv, chdtrc, gammaln

from stickslip_fit._typing import Array
from stickslip_fit.causes import SizedParameter
from stickslip_fit.causes.proposed import PeriodicTerm
from stickslip_fit.diagnosis.extension import SelectedCause, alternative_forms, estimate_strength
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.hypotheses import AR1, Hypothesis, acts_on, compute_changes
from stickslip_fit.diagnosis.linearized import LinearizedFit, linearize_fit
from stickslip_fit.diagnosis.misfit import UNKNOWN, detection_length
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.selection import Selection, allocate_alpha, predict_departures
from stickslip_fit.diagnosis.separability import is_distinguishable
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.units import Interval

QUANTILES_95 = (0.025, 0.5, 0.975)
Z_95, Z_STRONG = 1.959964, 1.96  # the latter for strengths beyond the limit of the next line
MAX_CONDITIONAL_STRENGTH = 12.0  # beyond, the alarm was certain and conditioning changes nothing
AR1_GRID = np.arange(0.0, 0.96, 0.05)
N_SIMULATIONS = 200
DIFFERENCE_STEP = 1e-3  # of a parameter's scale
MIN_EXCESS_SD = 2.0  # standard deviations of a chi-square of noise, for effects in alternative forms
FORM_RANK_TOL = 0.05
MIN_LENGTH = 1e-12
N_MIXTURE_TERMS = 100  # of a noncentral chi-square, beyond twice the largest one


@dataclass(frozen=True, eq=False)
class CauseEffect:
    """A cause's effect on a log, whitened, beyond what calibration absorbs.

    Attributes
    ----------
    rows : array, shape (n,)
    rms : float
        Relative, over all rows with equal weight.
    error : float
        Standard deviation of its length.
    dimensions : int
        Number of fitted parameters; of those with a prior, how many the data determine.
    """

    rows: Array
    rms: float
    error: float
    dimensions: int

    @property
    def length(self) -> float:
        """Norm, in standard deviations of the noise."""
        return float(np.linalg.norm(self.rows))


def size_findings(selection: Selection, problem: DiagnosisProblem, alpha: float) -> tuple[Finding, ...]:
    """Findings of all selected causes, largest effect first, unknown structure last.

    `problem` is the one from which was selected, outlying rows included; `alpha` the false-alarm rate.
    """
    linearized, slices = selection.problem.linearize(), iter(selection.slices)
    findings = []
    for selected in selection.selected:
        if selected.cause == problem.outlier_cause:
            findings.append(_size_outliers(selection, problem, selected))
        elif selected.cause == UNKNOWN:
            finding = size_unknown(selection, selected, alpha)
            findings.append(finding if selected.version is None else _with_law(finding, selection, selected))
        else:
            findings.append(_size_cause(selection, linearized, selected, next(slices), alpha))
    return tuple(sorted(findings, key=lambda finding: (finding.cause == UNKNOWN, -finding.effect.estimate)))


def _size_cause(
    selection: Selection, linearized: LinearizedFit, selected: SelectedCause, place: slice, alpha: float
) -> Finding:
    values, covariance = selection.fit.values[place], selection.fit.covariance[place, place]
    effect = estimate_effect(selection, linearized, selected, place)
    strength = _estimate_strength(selected, effect.length, effect.error, effect.dimensions, linearized, alpha)
    misfit = selected.misfit
    assert misfit is not None
    rivals = tuple(
        rival
        for rival in selected.cause_set.rivals
        if not is_distinguishable(misfit.best_hypothesis(selected.cause), misfit, rival, strength.estimate)
    )
    return Finding(
        selected.cause,
        selected.version,
        rivals,
        selected.p_value,
        _joints_of_laws(part.law for part in selection.problem.parts if acts_on(selected.version, part.law)),
        strength.times(effect.rms / max(effect.length, MIN_LENGTH)),
        _size_parameters(selected.version, selected.cause, values, covariance),
        together_with=selected.together_with,
    )


def _size_parameters(
    version: Any, cause: str, values: Array, covariance: Array
) -> tuple[SizedParameter, ...]:
    """A cause's parameters with intervals; of a smooth function its rms, not its coefficients."""
    if hasattr(version, "summarize"):
        return tuple(version.summarize(values, covariance))
    if cause.startswith(COVARIATE_PREFIX):
        return ()
    error = np.sqrt(np.diag(covariance))
    error = np.where(error > 0, error, np.nan)  # the moment of a sudden change has none
    return tuple(
        SizedParameter(
            parameter.name,
            parameter.unit,
            Interval(value, value - Z_95 * sd, value + Z_95 * sd),
            parameter.joint,
            parameter.direction,
            parameter.session,
        )
        for parameter, value, sd in zip(version.parameters, values, error, strict=True)
        if np.isfinite(sd) or getattr(parameter, "sudden", False)
    )


def _with_law(finding: Finding, selection: Selection, selected: SelectedCause) -> Finding:
    """A finding of unknown structure with the term or smooth function that extends the law."""
    version, place = selected.version, selection.slices[-1]  # it is the last of the causes
    formula = getattr(version, "formula", "")
    carrier = " and ".join(version.carriers) if formula else finding.carrier
    carrier = str(version) if isinstance(version, PeriodicTerm) else carrier
    values, covariance = selection.fit.values[place], selection.fit.covariance[place, place]
    parameters = _size_parameters(version, UNKNOWN, values, covariance) if formula else ()
    return replace(finding, version=version, term=formula, carrier=carrier, parameters=parameters)


def _rms_in_law(selection: Selection, selected: SelectedCause) -> float:
    """Rms of what stands in the law for unknown structure, beyond what calibration absorbs."""
    linearized, values = selection.problem.linearize(), selection.fit.values[selection.slices[-1]]
    changes = compute_changes(linearized, selected.version, values[None])
    return _rms(_linearize_unweighted(selection, linearized).project(changes))


def estimate_effect(
    selection: Selection, linearized: LinearizedFit, selected: SelectedCause, place: slice
) -> CauseEffect:
    """The effect of a selected cause, whose parameters are `place` of those of the fit.

    `linearized` is the baseline.
    """
    values, covariance = selection.fit.values[place], selection.fit.covariance[place, place]
    steps = DIFFERENCE_STEP * np.array(selected.version.scale)
    trials = np.concatenate([values[None], values + np.diag(steps)])
    changes = compute_changes(linearized, selected.version, trials)
    whitened = linearized.project(linearized.whiten(changes))
    form = whitened[:, 0]
    length = max(float(np.linalg.norm(form)), MIN_LENGTH)
    slopes = (whitened[:, 1:] - form[:, None]) / steps
    along = slopes.T @ form / length
    error = float(np.sqrt(max(float(along @ covariance @ along), 0.0)))
    known = 1.0 - np.diag(covariance) / selection.fit.prior_sd[place] ** 2
    dimensions = max(round(float(np.sum(known[np.diag(covariance) > 0]))), 1)
    beyond = _effect_beyond_fit(selection, selected)
    unweighted = _linearize_unweighted(selection, linearized)
    rms = _rms(unweighted.project(changes[:, 0] + linearized.unwhiten(beyond)))
    return CauseEffect(form + beyond, rms, max(error, 1.0), dimensions)


def _linearize_unweighted(selection: Selection, linearized: LinearizedFit) -> LinearizedFit:
    """The baseline with the same noise in all rows."""
    return linearize_fit(
        linearized.rows,
        linearized.parts,
        selection.problem.responses,
        np.ones(len(linearized)),
        shared=selection.problem.n_shared,
    )


def _effect_beyond_fit(selection: Selection, selected: SelectedCause) -> Array:
    """The effect in the cause's alternative forms beyond the one fitted, (n,); 0 where noise explains it."""
    plain = selection.problem.linearize_extended(selection.fit)
    left, singular, _ = np.linalg.svd(plain.project(alternative_forms(plain, selected)), full_matrices=False)
    forms = left[:, singular > FORM_RANK_TOL]
    along = forms.T @ plain.residual
    excess = float(along @ along) - len(along)
    if not len(along) or excess < MIN_EXCESS_SD * np.sqrt(2.0 * len(along)):
        return np.zeros(len(plain))
    return np.asarray(forms @ along * (excess / (excess + len(along))))


def _estimate_strength(
    selected: SelectedCause,
    length: float,
    error: float,
    dimensions: int,
    linearized: LinearizedFit,
    alpha: float,
) -> Interval:
    """Strength of an effect of this length, known to within `error`, conditional on its detection."""
    misfit = selected.misfit
    assert misfit is not None
    critical = misfit.critical_value(allocate_alpha(alpha))
    threshold = detection_length(critical, misfit.n_shapes(selected.cause), linearized.df)
    return strength_interval(length / error, dimensions, threshold / error).times(error)


def strength_interval(z: float, dimensions: int, threshold: float) -> Interval:
    """Strength of an effect of length `z` that was detected because `z` exceeded `threshold`.

    `z` is in standard deviations of the noise; `dimensions` is the number of estimated parameters.

    Examples
    --------
    A strong effect has the ordinary interval; one just above the threshold may well be close to 0.

    >>> strong, weak = strength_interval(20.0, 1, 4.0), strength_interval(4.2, 1, 4.0)
    >>> round(strong.low, 1), round(strong.high, 1), round(weak.low, 1)
    (18.0, 22.0, 0.0)
    >>> round(strength_interval(11.8, 1, 9.3).low, 1)
    9.7
    """
    if z > MAX_CONDITIONAL_STRENGTH:
        middle = np.sqrt(max(z**2 - dimensions, 0.0))
        return Interval(middle, max(z - Z_STRONG, 0.0), float(np.sqrt((z + Z_STRONG) ** 2 - dimensions + 1)))
    threshold = min(threshold, z * (1 - 1e-9))

    def cdf(strength: float) -> float:
        """Probability of less than `z`, given detection."""
        # By survival functions: far below the threshold, 1 - cdf would round to 0.
        detection = max(noncentral_tail(threshold**2, dimensions, strength**2), 1e-300)
        return 1.0 - noncentral_tail(z**2, dimensions, strength**2) / detection

    def solve(probability: float) -> float:
        if cdf(1e-6) < probability:
            return 0.0
        return float(brentq(lambda strength: cdf(strength) - probability, 1e-6, z + 10.0, xtol=1e-4))

    high, middle, low = map(solve, QUANTILES_95)
    return Interval(middle, low, high)


def noncentral_tail(x: float, df: int, noncentrality: float) -> float:
    """Probability that a noncentral chi-square exceeds `x`: the Poisson mixture of central ones.

    All terms are positive, so that the far tail keeps its digits; `scipy.special` has the distribution only.
    """
    half = noncentrality / 2.0
    extra = np.arange(2 * int(max(x, half)) + N_MIXTURE_TERMS)
    weight = np.exp(extra * np.log(half) - half - gammaln(extra + 1.0))
    return float(weight @ chdtrc(df + 2.0 * extra, x))


def size_unknown(selection: Selection, selected: SelectedCause, alpha: float) -> Finding:
    """The finding of unknown structure in the residuals that a selection leaves."""
    misfit, linearized = selected.misfit, selection.linearized
    assert misfit is not None
    best = misfit.best_hypothesis(UNKNOWN)
    residual = linearized.residual if selected.version is None else misfit.residual
    shape = _shrink_structure(best, residual)
    squares, length = float(shape @ shape), float(np.linalg.norm(shape))
    if isinstance(best, AR1):
        effect = estimate_ar1_effect(replace(linearized, residual=residual), best).times(
            _rms(linearized.scale)
        )
    else:
        along, kept = best.coefficients(residual), _kept_shares(best, residual)
        norm, dimensions = float(np.sqrt(kept @ along**2)), max(round(float(kept.sum())), 1)
        strength = _estimate_strength(selected, norm, 1.0, dimensions, linearized, alpha)
        if selected.version is None:
            effect = strength.times(_rms(linearized.unwhiten(shape)) / max(length, MIN_LENGTH))
        else:
            effect = strength.times(_rms_in_law(selection, selected) / max(norm, MIN_LENGTH))
    known = {cause: value for cause, value in misfit.log_evidence_by_cause.items() if cause != UNKNOWN}
    closest = max(known, key=lambda cause: known[cause]) if known else ""
    explains = {
        cause: float(np.sum(near.coefficients(shape) ** 2)) / max(squares, MIN_LENGTH)
        for cause in known
        if isinstance(near := misfit.best_hypothesis(cause), Hypothesis)
    }
    share = explains.get(closest, 0.0)
    size = np.abs(shape)
    joints = _joints_of_laws(
        part.law for part in linearized.parts if np.any(size[part.rows] > 1e-3 * size.max())
    )
    # Where nothing but the causes was searched, the shape is that of one that is not supported.
    is_cause = not best.cause.startswith(UNKNOWN)
    carrier = f"{best.cause} to some extent" if is_cause else best.cause.removeprefix(f"{UNKNOWN}:")
    return Finding(
        UNKNOWN,
        None,
        (),
        selected.p_value,
        joints,
        effect,
        (),
        closest=closest,
        share=share,
        carrier=carrier,
        explains=explains,
    )


def _shrink_structure(structure: Hypothesis | AR1, residual: Array) -> Array:
    """Posterior mean of a structure given the residuals, shape (n,)."""
    if isinstance(structure, AR1):
        return structure.shape(residual)
    return structure.combine(_kept_shares(structure, residual) * structure.coefficients(residual))


def _kept_shares(structure: Hypothesis, residual: Array) -> Array:
    """Share of each coefficient that its posterior mean keeps, shape (m,)."""
    signal = estimate_strength(structure, residual) ** 2 * structure.prior_share
    return np.asarray(signal / (1.0 + signal))


def estimate_ar1_effect(linearized: LinearizedFit, ar1: AR1) -> Interval:
    """Rms of what each residual keeps of the one before, in units of its innovation.

    Of `ar1` only the sign and the order of rows are used.
    """
    sign = np.sign(ar1.coefficient)
    observed = sign * _lag1_correlation(linearized.residual[:, None], ar1)[0]
    noise = np.random.default_rng(0).standard_normal((len(linearized), N_SIMULATIONS))
    simulated = [
        sign * _lag1_correlation(linearized.project(_simulate_ar1(noise, ar1, sign * coefficient)), ar1)
        for coefficient in AR1_GRID
    ]
    limits = np.maximum.accumulate(np.quantile(simulated, QUANTILES_95, axis=1), axis=1)
    high, middle, low = (float(np.interp(observed, limit, AR1_GRID)) for limit in limits)
    return Interval(*(value / np.sqrt(1.0 - value**2) for value in (middle, low, high)))


def _simulate_ar1(noise: Array, ar1: AR1, coefficient: float) -> Array:
    """A stationary AR(1) sequence with these innovations, (n, k)."""
    series = noise.copy()
    for row, before in enumerate(ar1.before):
        if before >= 0:
            series[row] += coefficient * series[before]
        else:
            series[row] /= np.sqrt(1.0 - coefficient**2)
    return series


def _lag1_correlation(residuals: Array, ar1: AR1) -> Array:
    """Of each row with the one before, (n, k) -> (k,)."""
    follows = ar1.before >= 0
    products = residuals[follows] * residuals[ar1.before[follows]]
    return np.asarray(products.sum(axis=0) / np.sum(residuals**2, axis=0))


def _size_outliers(selection: Selection, problem: DiagnosisProblem, selected: SelectedCause) -> Finding:
    rows, n = selection.outliers, len(problem)
    departure = predict_departures(selection, problem, rows)
    sizes = np.abs(departure)
    rms = float(np.sqrt(np.sum(sizes**2) / n))
    error = Z_95 * rms * float(np.sqrt(np.mean(problem.scale[rows] ** 2) / np.mean(sizes**2) / len(rows)))
    share = Interval(
        len(rows) / n,
        float(betaincinv(len(rows), n - len(rows) + 1, 0.025)),
        float(betaincinv(len(rows) + 1, n - len(rows), 0.975)),
    )
    low, middle, high = np.quantile(sizes, QUANTILES_95)
    unit = getattr(problem.parts[0].law, "response_unit", "%")  # a table's response has one of its own
    return Finding(
        selected.cause,
        None,
        (),
        selected.p_value,
        _joints_of_laws(part.law for part in problem.parts if np.isin(part.rows, rows).any()),
        Interval(rms, max(rms - error, 0.0), rms + error),
        (SizedParameter("share", "%", share), SizedParameter("size", unit, Interval(middle, low, high))),
        traverses=problem.rows.iloc[rows].assign(departure=departure),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _joints_of_laws(laws: Iterable[Any]) -> tuple[int, ...]:
    """The joints that some laws describe; none for laws of other machines."""
    return tuple(sorted(int(law.joint) for law in laws if hasattr(law, "joint")))
