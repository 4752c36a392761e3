"""How large an effect is: its rms over all rows, and the interval of that.

What is wanted is what a cause changes in the law with all other findings: the rms of its effect over all rows
with equal weight, beyond what calibration absorbs. Its error is propagated from that of the parameters, which
are fitted and known by the expected variance of each response (`noise`). Parameters with a prior have a
posterior distribution; others make an effect longer than it is, by what noise adds in every direction of
theirs.

The length z of an estimated effect, in standard errors, is noncentral chi distributed; since it was selected
only because it exceeded the detection threshold, its interval inverts the distribution of z conditional on
detection (J. D. Lee et al., Ann. Stat. 44:907, 2016, for the normal case).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from scipy.special import chdtrc, gammaln

from stickslip_fit._linalg import ridge_inverse, square_root, svd
from stickslip_fit._typing import Array
from stickslip_fit.causes.proposed import CarryOverTerm
from stickslip_fit.diagnosis.extension import SelectedCause, alternative_forms
from stickslip_fit.diagnosis.hypotheses import compute_changes
from stickslip_fit.diagnosis.linearized import ExtendedFit, LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import UNKNOWN, detection_length
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.selection import Selection, allocate_alpha
from stickslip_fit.units import Z_95, Interval

QUANTILES_95 = (0.025, 0.5, 0.975)
MAX_CONDITIONAL_STRENGTH = 12.0  # beyond, the alarm was certain and conditioning changes nothing
DIFFERENCE_STEP = 1e-3  # of a parameter's scale
MIN_EXCESS_SD = 2.0  # standard deviations of a chi-square of noise, for effects in alternative forms
FORM_RANK_TOL, RANK_TOL, SINGULAR_TOL = 0.05, 1e-10, 1e-14
EFFECT_RANK_TOL = 1e-4  # of directions of the parameters along which an effect hardly changes
MIN_LENGTH = 1e-12
UNIFORM_PRECISION = 12.0  # inverse variance of a uniform distribution of width 1
RELIABILITY_PASSES, MIN_RELIABILITY = 20, 0.1  # of departures: share of the variance that is a row's own
N_MIXTURE_TERMS = 100  # of a noncentral chi-square, beyond twice the largest one


@dataclass(frozen=True, eq=False)
class LawEffect:
    """The effect of what extends the laws, beyond what calibration absorbs; n rows.

    Attributes
    ----------
    rows : array, shape (n,)
        Whitened.
    changes : array, shape (n,)
        Of the responses, calibrated with equal weights.
    spread : array, shape (n, m)
        What `changes` may be off by: times independent standard normal numbers.
    shrunk : bool
        Whether the parameters have a prior, so that `changes` are a posterior mean.
    """

    rows: Array
    changes: Array
    spread: Array
    shrunk: bool

    @property
    def strength(self) -> float:
        """Norm, in standard deviations of the noise."""
        return max(float(np.linalg.norm(self.rows)), MIN_LENGTH)

    @property
    def error(self) -> float:
        """Standard error of the norm of `changes`."""
        return max(float(np.linalg.norm(self.spread.T @ self.changes)) / self._length, MIN_LENGTH)

    @property
    def dimensions(self) -> float:
        """In how many independent directions noise adds to the norm of `changes`, as much as along it."""
        return 1.0 if self.shrunk else max(float(np.sum(self.spread**2)) / self.error**2, 1.0)

    @property
    def length(self) -> float:
        """Norm of `changes`; of a posterior mean, with what the posterior variance adds across it."""
        across = float(np.sum(self.spread**2)) - self.error**2 if self.shrunk else 0.0
        return float(np.sqrt(self._length**2 + max(across, 0.0)))

    @property
    def rms(self) -> float:
        """Of `changes`."""
        return self._length / float(np.sqrt(len(self.changes)))

    @property
    def _length(self) -> float:
        return max(float(np.linalg.norm(self.changes)), MIN_LENGTH)

    def interval(self, threshold: float) -> Interval:
        """Rms of `changes`, given that `rows` were detected because they are longer than `threshold`."""
        z = self.length / self.error
        found = strength_interval(z, self.dimensions, threshold / self.strength * z)
        return found.times(self.error / float(np.sqrt(len(self.changes))))


def estimate_effect(selection: Selection, selected: SelectedCause) -> LawEffect:
    """The effect of a selected cause in the law with all others."""
    place, beside = selection.place_of(selected.version), fit_beside(selection, selected)
    linearized = selection.problem.linearize_extended(beside)
    every_value, every_covariance = _refit(selection)
    values, covariance = every_value[place], every_covariance[place, place]
    steps = DIFFERENCE_STEP * np.array(selected.version.scale)
    trials = np.concatenate([values[None], values + np.diag(steps)])
    plain = linearize_unweighted(selection.problem, beside)
    changes = compute_changes(plain, selected.version, trials)
    whitened = linearized.project(linearized.whiten(changes))
    forms, sizes, kept = _forms_beyond_fit(selection, selected)
    rows = whitened[:, 0] + forms @ sizes
    even = plain.project(np.concatenate([changes, linearized.unwhiten(forms)], axis=1))
    slopes, even_forms = (even[:, 1 : len(trials)] - even[:, :1]) / steps, even[:, len(trials) :]
    total = even[:, 0] + even_forms @ sizes
    own = square_root(slopes, covariance)
    before = plain.project(_departures_lost(selection, selected, values))
    spread = np.concatenate([own, np.sqrt(kept) * even_forms, before], axis=1)
    shrunk = bool(np.isfinite(selection.fit.prior_sd[place]).all())
    return LawEffect(rows, total, spread, shrunk)


def _departures_lost(selection: Selection, selected: SelectedCause, values: Array) -> Array:
    """What carries over of noise that departures do not show, shape (n, m): independent parts.

    Calibration absorbs some of the noise. Of a traverse onto which some carries over, what was absorbed of
    the noise before adds to its departure, too; by that noisy regressor the share that carries over is too
    small (W. A. Fuller, Measurement Error Models, 1987, section 1.1).
    """
    memory = _memory_of(selected)
    if memory is None or not isinstance(selected.version, CarryOverTerm):
        return np.zeros((len(selection.problem), 0))
    fit = selection.problem.linearize_extended(selection.fit)
    all_of_it = replace(memory, coefficient=1.0)
    absorbed = all_of_it.shape(fit.unwhiten(fit.basis.toarray()))
    added, squares = np.sum(absorbed**2, axis=1), all_of_it.shape(fit.unwhiten(fit.residual)) ** 2
    share, own = float(values[0]), np.ones(len(fit))
    for _ in range(RELIABILITY_PASSES):
        own = np.maximum(1.0 - share**2 * added / fit.scale**2, MIN_RELIABILITY)
        share = float(values[0] * squares.sum() / (squares @ own[memory.before]))
    hidden = np.diag(fit.scale * np.sqrt(own * (1.0 - own)))[:, own < 1.0]
    return share * np.concatenate([absorbed, all_of_it.shape(hidden)], axis=1)


def _memory_of(selected: SelectedCause) -> AR1 | None:
    """The autoregression that unknown structure is, if it is one."""
    if selected.cause != UNKNOWN or selected.misfit is None:
        return None
    best = selected.misfit.best_hypothesis(UNKNOWN)
    return best if isinstance(best, AR1) else None


def _refit(selection: Selection) -> tuple[Array, Array]:
    """Parameters of all causes, (q,), and their covariance, (q, q), in the noise as it is expected now.

    They are one Gauss-Newton step from the fit of the selection.
    A law's own choice is no parameter of that fit: what the choice leaves open adds to errors only. As a
    parameter it would stand for a part of the effects, beyond any difference that the choice can make.
    """
    fit, problem = selection.fit, selection.expected
    shrinkage, chosen = 1.0 / fit.prior_sd**2, problem.with_laws_as_chosen
    known = _linearize_causes(chosen, selection, EFFECT_RANK_TOL)
    values = fit.values + known.inverse @ (
        known.slopes.T @ known.linearized.residual - shrinkage * fit.values
    )
    if problem.uncertain:
        known = _linearize_causes(problem, selection, EFFECT_RANK_TOL)
    lower, upper = _bounds(selection)
    if np.any((values < lower) | (values > upper)):  # so far from the fit, its slopes say nothing
        values = fit.values
    return values, _covariance(selection, known.slopes, known)


def expected_covariance(selection: Selection) -> Array:
    """Covariance of the parameters in the fit of a selection under the noise as it is expected now, (q, q).

    The fit weighs rows by an estimate of their noise; the information that it would have if that were true,
    A, and the variance that its normal equations have, B, give inv(A) B inv(A) (H. White, Econometrica
    48:817, 1980). A prior counts as an observation in both.
    """
    if not selection.law_causes:
        return np.zeros((0, 0))
    problem = selection.problem
    known = _linearize_causes(problem, selection, RANK_TOL)
    times = selection.expected.scale / problem.scale
    return _covariance(selection, known.slopes * times[:, None], known)


@dataclass(frozen=True, eq=False)
class _LinearCauses:
    """The laws with causes, calibration projected out.

    Attributes
    ----------
    slopes : array, shape (n, q)
        Of the causes, whitened.
    inverse : array, shape (q, q)
        Of the information, which is that of the rows and of the parameters' priors and bounds.
    is_ridge : bool
        Whether that is what rows and normal priors say, and nothing is left out of its inverse.
    """

    linearized: LinearizedFit
    slopes: Array
    inverse: Array
    is_ridge: bool


def _linearize_causes(problem: DiagnosisProblem, selection: Selection, rank_tol: float) -> _LinearCauses:
    """With dependent parameters, which count as known, left out of the inverse."""
    linearized, slopes = problem.linearize_causes(selection.fit)
    priors = np.isfinite(selection.fit.prior_sd).all()
    if priors and len(slopes) < slopes.shape[1] and not np.isfinite(_bounds(selection)).any():
        inverse = ridge_inverse(slopes, 1.0 / selection.fit.prior_sd**2, rank_tol)
        if inverse is not None:
            return _LinearCauses(linearized, slopes, inverse, True)
    correlation, sizes = _standardize(_information(selection, slopes))
    inverse = np.linalg.pinv(correlation, rcond=rank_tol, hermitian=True) / sizes
    return _LinearCauses(linearized, slopes, inverse, False)


def _standardize(information: Array) -> tuple[Array, Array]:
    """An information matrix with a diagonal of 1, and by what that was divided, both of shape (q, q)."""
    size = np.sqrt(np.maximum(np.diag(information), MIN_LENGTH))
    sizes = np.outer(size, size)
    return information / sizes, sizes


def _covariance(selection: Selection, slopes: Array, known: _LinearCauses) -> Array:
    """Of parameters estimated by slopes, (n, q), in units of the noise, which memory may correlate."""
    for one in selection.selected:
        memory = _memory_of(one)
        if memory is None or memory.sequences.onto is not None:
            continue
        if one.version is None:
            slopes = memory.correlate(slopes)
        elif isinstance(one.version, CarryOverTerm):  # beside which the noise is that of the innovations
            slopes = memory.correlate(slopes) / np.sqrt(1.0 - memory.coefficient**2)
    inverse = known.inverse
    if not known.is_ridge:
        return np.asarray(inverse @ _information(selection, slopes) @ inverse)
    # The information is that of which this is the inverse, but for the rows: products of n rows, not of q.
    along, before = slopes @ inverse, known.slopes @ inverse
    return np.asarray(inverse + along.T @ along - before.T @ before)


def _information(selection: Selection, slopes: Array) -> Array:
    """What the rows say of the parameters, by `slopes`, (n, q), and what is known beforehand; (q, q).

    That is their prior; and of one of which all this says less than that it is between its bounds, that, too.
    """
    lower, upper = _bounds(selection)
    information = slopes.T @ slopes + np.diag(1.0 / selection.fit.prior_sd**2)
    if not np.isfinite(upper - lower).any():
        return information
    correlation, sizes = _standardize(information)
    eigenvalue, vector = np.linalg.eigh(correlation)
    # Of dependent parameters, too, the rows say next to nothing.
    variance = vector**2 @ (1.0 / np.maximum(eigenvalue, SINGULAR_TOL)) / np.diag(sizes)
    bounded = UNIFORM_PRECISION / (upper - lower) ** 2
    return information + np.diag(np.where(variance * bounded > 1.0, bounded, 0.0))


def _bounds(selection: Selection) -> tuple[Array, Array]:
    """Lower and upper bounds of the parameters of all causes in the law, each shape (q,)."""
    parameters = [parameter for one in selection.law_causes for parameter in one.version.parameters]
    return np.array([one.lower for one in parameters]), np.array([one.upper for one in parameters])


def fit_beside(selection: Selection, without: SelectedCause) -> ExtendedFit:
    """The fit of the laws with all causes but one, whose parameters count as known.

    Calibrated as without causes where a joint would stall.
    """
    problem, fit = selection.problem, selection.fit
    others = [one for one in selection.law_causes if one.version is not without.version]
    kept = np.ones(len(fit.values), dtype=bool)
    if without.version is not None:
        kept[selection.place_of(without.version)] = False
    parts = []
    for part, fitted in zip(problem.parts, fit.parts, strict=True):
        law = reduce(lambda law, one: one.version.extend(law), others, part.law)
        own = part.values.shape[1]
        values = fitted.values[:, np.append(np.ones(own, dtype=bool), kept)]
        if not np.all(np.isfinite(law.predict(problem.table.subset(part.rows), values))):
            values = np.concatenate([part.values, values[:, own:]], axis=1)
        parts.append(replace(part, law=law, values=values))
    known: dict[str, Any] = {"prior_sd": np.full(kept.sum(), np.inf), "at_bound": np.ones(kept.sum(), bool)}
    return replace(fit, parts=tuple(parts), values=fit.values[kept], **known)


def linearize_unweighted(problem: DiagnosisProblem, fit: ExtendedFit) -> LinearizedFit:
    """A fit of the extended laws, linearized with the same independent noise in all rows."""
    alike = replace(
        problem,
        repeatability=np.ones_like(problem.repeatability),
        noise_ratio=np.ones(len(problem)),
        relative_sd=1.0,
        rounding=np.zeros(len(problem)),
        autocorrelation=None,
        uncertain=(),
    )
    return alike.linearize_extended(fit)


def _forms_beyond_fit(selection: Selection, selected: SelectedCause) -> tuple[Array, Array, float]:
    """The cause's alternative forms, whitened, (n, m), what the effect has of each, and the share kept.

    No form where noise explains what they have, and of unknown structure, which has none.
    """
    plain = selection.problem.linearize_extended(selection.fit)
    left, singular, _ = svd(plain.project(alternative_forms(plain, selected)))
    forms = left[:, singular > FORM_RANK_TOL]
    forms = forms[:, :0] if selected.cause == UNKNOWN else forms
    along = forms.T @ plain.residual
    excess = float(along @ along) - len(along)
    if not len(along) or excess < MIN_EXCESS_SD * np.sqrt(2.0 * len(along)):
        return forms[:, :0], along[:0], 0.0
    kept = excess / (excess + len(along))
    return forms, kept * along, kept


def detection_threshold(selected: SelectedCause, df: int, alpha: float) -> float:
    """Strength of an effect above which a selected cause is detected."""
    misfit = selected.test
    critical = misfit.critical_value(allocate_alpha(alpha))
    return detection_length(critical, misfit.n_shapes(selected.cause), df)


def strength_interval(z: float, dimensions: float, threshold: float) -> Interval:
    """Strength of an effect of length `z` that was detected because `z` exceeded `threshold`.

    `z` is in standard errors; `dimensions` is the number of estimated parameters.

    Examples
    --------
    A strong effect has the ordinary interval; one just above the threshold may well be close to 0.

    >>> strong, weak = strength_interval(20.0, 1, 4.0), strength_interval(4.2, 1, 4.0)
    >>> round(strong.low, 1), round(strong.high, 1), round(weak.low, 1)
    (18.0, 22.0, 0.0)
    >>> round(strength_interval(11.8, 1, 9.3).low, 1)
    9.7

    Below the threshold the alarm came of more than this effect; nothing then says that it is not 0.

    >>> below = strength_interval(3.0, 1, 4.0)
    >>> round(below.low, 1), round(below.estimate, 1), round(below.high, 1)
    (0.0, 3.0, 5.0)
    """
    if z > MAX_CONDITIONAL_STRENGTH or z <= threshold:
        estimate, low, high = (
            float(np.sqrt(max((z + shift) ** 2 - dimensions + 1.0, 0.0))) for shift in (0.0, -Z_95, Z_95)
        )
        return Interval(estimate, low if z > threshold else 0.0, high)

    from scipy.optimize import brentq

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


def noncentral_tail(x: float, df: float, noncentrality: float) -> float:
    """Probability that a noncentral chi-square exceeds `x`: the Poisson mixture of central ones.

    All terms are positive, so that the far tail keeps its digits; `scipy.special` has the distribution only,
    and the import of `scipy.stats` takes longer than all intervals of a diagnosis.
    """
    half = noncentrality / 2.0
    extra = np.arange(2 * int(max(x, half)) + N_MIXTURE_TERMS)
    weight = np.exp(extra * np.log(half) - half - gammaln(extra + 1.0))
    return float(weight @ chdtrc(df + 2.0 * extra, x))
