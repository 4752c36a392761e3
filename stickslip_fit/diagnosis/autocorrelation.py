"""Autocorrelation: the noise of a sampled signal as an autoregression, and the filter that removes it.

Neighbouring values of a sampled signal share most of their noise. Taken for independent, a thousand of them
would make any slow wave of the noise an effect. Here the noise is an autoregression of order p, estimated by
restricted maximum likelihood (H. Patterson and R. Thompson, Biometrika 58:545, 1971): plain estimates are
too small, since the law follows the noise, by about (1 + 3 phi) / n and more with each parameter. Effects
that the law may lack count as part of the mean, so that none passes for noise (`table_noise` chooses them).
The order minimizes the Bayesian information criterion (G. Schwarz, Ann. Stat. 6:461, 1978). Coefficients are
searched as partial autocorrelations, between -1 and 1 for every stationary autoregression (O.
Barndorff-Nielsen and G. Schou, J. Multivar. Anal. 3:408, 1973).

Many instruments wander slowly beneath white noise, or flicker; their autoregression is long, its
coefficients small, and what wanders would be taken for something that the law lacks. So ARMA(1, 1) noise,
e[t] = phi e[t-1] + w[t] - theta w[t-1] with white w, is one more candidate, as the long autoregression with
its autocorrelations (G. Box and G. Jenkins, Time Series Analysis, 1976, section 3.4).

The prediction-error filter subtracts from each value its prediction from those before it, exactly from the
first one of a sequence on, where there are fewer than p before (Levinson's recursion). A gap, a removed row
and a new session begin a new sequence. What persists over much of the longest sequence is not called
noise: the poles are drawn in until it does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import product

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.sparse import csr_array
from scipy.special import ndtri

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.restricted_likelihood import (
    LARGEST_PARTIALS,
    RestrictedLikelihood,
    filter_tables,
    order_samples,
)

MAX_ORDER, ROWS_PER_ORDER = 10, 25  # rows with a predecessor for each coefficient
SWING_ORDER = 2  # of noise that swings, which few rows are to tell from a strict period, too
MAX_WITHOUT_GAIN = 2  # orders in a row that do not lower the criterion, after which none is tried
MAX_SHARE_OF_SEQUENCE = 0.4  # over which noise persists
MAX_SHOCKS, MAX_SHOCK_ROWS, MIN_SHOCK_SD = 6, 10, 5.0  # outliers and lasting changes, beside the noise
LEAST_SWING, SHORTEST_SWING = 0.15, 4.0  # of an oscillation after a period; rows
# Of noise that wanders: its autoregression's order, and phi and theta from which its search begins.
LONG_ORDER = 8
WANDERING = tuple(product((0.9, 0.98, 0.998), (0.4, 0.7, 0.9)))
MAX_BEHIND = 3.0  # nats by which it may fall behind where that begins
ACTIVE_TOL = 1e-6  # of an effect's largest value, below which it does not act in a row
MEDIAN_OF_NORMAL = float(ndtri(0.75))  # of the absolute values of standard normal noise
SPAN_TOL, MIN_LENGTH = 1e-6, 1e-300  # of the largest singular value; of a column
SPACING_TOL = 0.25  # of the interval between samples
MIN_REGULAR = 0.8  # share of the rows that follow the one before at the usual interval
MIN_SAMPLED = 30  # rows that do


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """The noise of a sampled signal, n rows.

    Attributes
    ----------
    sample : array of int, shape (n,)
        Number of each sample: neighbours in time differ by 1, all others by more.
    candidate_effects : array, shape (n, m), or None
        Effects, in units of the response, that count as part of the mean; None once the estimate is final.
    coefficients : array, shape (p,)
        Of the values before, the nearest first; empty for independent noise.
    n_free : int
        Parameters that were estimated for them.
    possible_effects : array, shape (n, k), or None
        More effects, which count as part of the mean where that is likelier.
    """

    sample: IntArray
    candidate_effects: Array | None
    coefficients: Array = field(default_factory=lambda: np.zeros(0))
    n_free: int = 0
    possible_effects: Array | None = None

    @cached_property
    def noise_filter(self) -> csr_array | None:
        """The prediction-error filter, shape (n, n), for noise of variance 1; None for independent noise."""
        if not len(self.coefficients):
            return None
        return FilterPattern.of(self.sample, len(self.coefficients)).fill(
            partial_autocorrelations(self.coefficients)
        )

    def whiten(self, columns: Array) -> Array:
        """Columns, shape (n,) or (n, q), as they are under independent noise of variance 1."""
        return columns if self.noise_filter is None else np.asarray(self.noise_filter @ columns)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the filter's determinant."""
        pattern = FilterPattern.of(self.sample, len(self.coefficients))
        return pattern.log_determinant(partial_autocorrelations(self.coefficients))

    @property
    def correlation_rows(self) -> float:
        """Autocorrelation time in rows: so many rows say as much of a mean as one independent value does."""
        gamma = variance_over_innovations(self.coefficients)
        long_run = 1.0 / (1.0 - float(self.coefficients.sum())) ** 2
        return max(float(long_run / gamma), 1.0)

    @property
    def period_rows(self) -> float:
        """Period of the noise's longest-lived oscillation, in rows; NaN where none lasts for a period.

        That of the autoregression's largest pair of complex roots (G. U. Yule, Phil. Trans. A 226:267, 1927).
        """
        roots = np.roots(np.r_[1.0, -self.coefficients])
        waves = roots[np.imag(roots) > 0]
        if not len(waves):
            return np.nan
        largest = waves[np.argmax(np.abs(waves))]
        period = float(2.0 * np.pi / np.angle(largest))
        return period if np.abs(largest) ** period > LEAST_SWING and period > SHORTEST_SWING else np.nan

    def select(self, kept: IntArray) -> Autocorrelation:
        """That of some rows."""
        own = {name: getattr(self, name) for name in ("candidate_effects", "possible_effects")}
        kept_effects = {name: one[kept] for name, one in own.items() if one is not None}
        return replace(self, sample=self.sample[kept], **kept_effects)

    def settle(self) -> Autocorrelation:
        """The same, not to be estimated again."""
        return replace(self, candidate_effects=None, possible_effects=None)

    def shorten(self) -> Autocorrelation:
        """The same with an autocorrelation time of at most a share of the longest sequence."""
        from scipy.optimize import brentq

        starts = np.flatnonzero(np.diff(np.sort(self.sample), prepend=self.sample.min() - 2) != 1)
        longest = int(np.diff(starts, append=len(self.sample)).max())
        limit = max(MAX_SHARE_OF_SEQUENCE * longest, 1.0)

        def drawn_in(factor: float) -> Autocorrelation:
            powers = factor ** np.arange(1, len(self.coefficients) + 1)
            return replace(self, coefficients=self.coefficients * powers)

        if self.correlation_rows <= limit:
            return self
        factor = brentq(lambda factor: drawn_in(factor).correlation_rows - limit, 0.0, 1.0, xtol=1e-6)
        return drawn_in(float(factor))

    def estimate(self, linearized: LinearizedFit) -> Autocorrelation:
        """The autoregression of a fit whose noise counts as independent (`linearized` has no filter)."""
        if self.candidate_effects is None:
            return self
        effects, noise = self._choose_effects(linearized, self.candidate_effects)
        shocks = 0
        while True:
            found = replace(self, coefficients=noise.coefficients, n_free=noise.n_free).shorten()
            before = shocks
            # All shocks that this noise does not explain, before the noise is estimated anew.
            while shocks < MAX_SHOCKS:
                shock = find_shock(linearized, effects, found)
                if shock is None:
                    break
                effects = np.concatenate([effects, linearized.project(shock)[:, None]], axis=1)
                shocks += 1
            if shocks == before:
                return found
            noise = estimate_noise(linearized, effects, self.sample)

    def _choose_effects(self, linearized: LinearizedFit, candidates: Array) -> tuple[Array, Autocorrelation]:
        """Those that count as part of the mean, whitened and projected, and the noise beside them."""
        certain = _beyond_laws(linearized, candidates)
        alone = estimate_noise(linearized, certain, self.sample)
        if self.possible_effects is None:
            return certain, alone
        possible = spanning(_beyond_laws(linearized, self.possible_effects))
        every = np.concatenate([certain, possible], axis=1)
        beside = estimate_noise(linearized, every, self.sample)
        advantage = criterion(linearized, every, beside) - criterion(linearized, certain, alone)
        return (every, beside) if advantage > price(possible) else (certain, alone)


def variance_over_innovations(coefficients: Array) -> float:
    """Variance of an autoregression over that of its innovations.

    Examples
    --------
    >>> round(variance_over_innovations(np.array([0.6])), 4)
    1.5625
    """
    return float(np.prod(1.0 / (1.0 - partial_autocorrelations(coefficients) ** 2)))


def partial_autocorrelations(coefficients: Array) -> Array:
    """Partial autocorrelations of an autoregression, by Levinson's recursion backwards, shape (p,)."""
    own, partial = np.array(coefficients, dtype=float), np.zeros(len(coefficients))
    for order in range(len(coefficients), 0, -1):
        last = own[order - 1]
        partial[order - 1] = last
        own = (own[: order - 1] + last * own[: order - 1][::-1]) / (1.0 - last**2)
    return partial


def predict_from_partials(partial: Array) -> Array:
    """Coefficients of the best prediction from the p values before, shape (p,).

    Examples
    --------
    >>> predict_from_partials(np.array([0.5, -0.2])).round(2)
    array([ 0.6, -0.2])
    """
    last = filter_tables(partial[None])[0, -1]
    return np.asarray(-last[1:] / last[0])


@dataclass(frozen=True, eq=False)
class FilterPattern:
    """Where the entries of a prediction-error filter of order p stand, whatever their values; n rows.

    Attributes
    ----------
    depth : array of int, shape (n,)
        Values before each one in its sequence, at most p.
    indices, indptr : array of int
        Of a compressed sparse row matrix: in each row the value itself, then those before, the nearest first.
    """

    depth: IntArray
    indices: IntArray
    indptr: IntArray
    order: int

    @classmethod
    def of(cls, sample: IntArray, order: int) -> FilterPattern:
        """For samples of these numbers."""
        by_number, place = order_samples(sample)
        depth = np.empty(len(sample), dtype=np.intp)
        depth[by_number] = np.minimum(place, order)
        position = np.empty(len(sample), dtype=np.intp)
        position[by_number] = np.arange(len(sample))
        indptr = np.concatenate([[0], np.cumsum(depth + 1)])
        lag = np.arange(indptr[-1]) - np.repeat(indptr[:-1], depth + 1)
        return cls(depth, by_number[np.repeat(position, depth + 1) - lag], indptr, order)

    def fill(self, partial: Array) -> csr_array:
        """The filter for these partial autocorrelations, shape (p,)."""
        table, n = filter_tables(partial[None])[0], len(self.depth)
        return csr_array((table.ravel()[self._places], self.indices, self.indptr), shape=(n, n))

    @cached_property
    def _places(self) -> IntArray:
        """Where each entry of the filter stands in a table by depth and lag."""
        lags = np.arange(self.order + 1)
        return ((self.order + 1) * self.depth[:, None] + lags)[lags <= self.depth[:, None]]

    def log_determinant(self, partial: Array) -> float:
        """Logarithm of the filter's determinant."""
        log_sd = 0.5 * np.cumsum(np.append(0.0, np.log1p(-(partial**2))))
        return -float(log_sd @ np.bincount(self.depth, minlength=self.order + 1))


def estimate_noise(linearized: LinearizedFit, effects: Array, sample: IntArray) -> Autocorrelation:
    """The noise of a fit, of the order that the data support.

    Parameters
    ----------
    linearized : LinearizedFit
        Without a filter.
    effects : array, shape (n, m)
        Whitened and projected; they count as part of the mean.
    sample : array of int, shape (n,)
    """
    linked = int(np.sum(FilterPattern.of(sample, 1).depth))
    border = np.concatenate([linearized.shared_basis, spanning(effects)], axis=1)
    likelihood = RestrictedLikelihood(linearized, border, sample)
    best, found, n_free = likelihood.criteria(np.zeros((1, 0)), 0)[0], np.zeros(0), 0
    start, without_gain = np.zeros(0), 0
    for order in range(1, min(MAX_ORDER, max(linked // ROWS_PER_ORDER, SWING_ORDER)) + 1):
        start = likelihood.maximize(np.append(start, 0.0))
        (value,) = likelihood.criteria(start[None], order)
        if value < best:
            best, found, n_free, without_gain = value, start, order, 0
        else:
            without_gain += 1
        if without_gain == MAX_WITHOUT_GAIN:
            break
    if linked >= 2 * ROWS_PER_ORDER and np.isfinite(best):
        wandering = _fit_wandering(likelihood, best + MAX_BEHIND)
        if likelihood.criteria(wandering[None], 2)[0] < best:
            found, n_free = wandering, 2
    return Autocorrelation(sample, None, predict_from_partials(found) if n_free else found, n_free)


def _fit_wandering(likelihood: RestrictedLikelihood, most: float) -> Array:
    """Partial autocorrelations of the likeliest noise that wanders, shape (LONG_ORDER,).

    Where the criterion is above `most` at all of `WANDERING`, one of these.
    """
    from scipy.optimize import minimize

    def criterion(z: Array) -> float:
        return float(likelihood.criteria(_wandering_partials(*np.tanh(z))[None], 2)[0])

    begun = _start_of_wandering()
    criteria = likelihood.criteria(begun, 2)
    best = int(np.argmin(criteria))
    if criteria[best] > most:
        return begun[best]
    start = np.arctanh(WANDERING[best])
    bounds = [(0.0, float(np.arctanh(LARGEST_PARTIALS[0])))] * 2
    result = minimize(criterion, start, method="Nelder-Mead", bounds=bounds, options={"maxfev": 40})
    return _wandering_partials(*np.tanh(result.x))


@cache
def _start_of_wandering() -> Array:
    return np.stack([_wandering_partials(*one) for one in WANDERING])


def _wandering_partials(phi: float, theta: float) -> Array:
    """Partial autocorrelations of ARMA(1, 1) noise, shape (LONG_ORDER,)."""
    first = (phi - theta) * (1.0 - phi * theta) / (1.0 - 2.0 * phi * theta + theta**2)
    correlation = np.append(1.0, first * phi ** np.arange(LONG_ORDER))
    return partial_autocorrelations(solve_toeplitz(correlation[:-1], correlation[1:]))


def price(effect: Array) -> float:
    """What the criterion asks for an effect's directions, shape (n, q), each acting in some of the rows."""
    size = np.abs(effect)
    rows = np.sum(size > ACTIVE_TOL * size.max(axis=0), axis=0)
    return 0.5 * float(np.sum(np.log(np.maximum(rows, 1))))


def criterion(linearized: LinearizedFit, mean: Array, noise: Autocorrelation) -> float:
    """Log likelihood with an autoregression, less what the criterion asks for its parameters."""
    columns = np.concatenate([linearized.basis.toarray(), mean, linearized.residual[:, None]], axis=1)
    columns, n = noise.whiten(columns), len(columns)
    size = np.linalg.lstsq(columns[:, :-1], columns[:, -1], rcond=None)[0]
    innovations = columns[:, -1] - columns[:, :-1] @ size
    squares = max(float(innovations @ innovations), float(np.finfo(float).tiny))
    log_determinant = noise.log_determinant if len(noise.coefficients) else 0.0
    return log_determinant - 0.5 * n * float(np.log(squares)) - 0.5 * noise.n_free * float(np.log(n))


def find_shock(linearized: LinearizedFit, effects: Array, noise: Autocorrelation) -> Array | None:
    """An outlier or a lasting change that is far beyond the noise, 1 in its rows, shape (n,), or None.

    An outlier hides autocorrelation, a lasting change looks like it. Parameters are as of
    `estimate_noise`; either shows in the largest of the innovations.
    """
    basis = spanning(effects)
    left = linearized.residual - basis @ (basis.T @ linearized.residual)
    innovations = noise.whiten(left)
    df = max(linearized.df - basis.shape[1], 1)
    sd = min(
        np.sqrt(innovations @ innovations / df), float(np.median(np.abs(innovations))) / MEDIAN_OF_NORMAL
    )
    session = linearized.rows["session"].to_numpy(object)
    shapes = []
    for row in np.argsort(-np.abs(innovations))[:MAX_SHOCK_ROWS]:
        single, lasting = np.zeros(len(left)), np.zeros(len(left))
        single[row], lasting[row:] = 1.0, session[row:] == session[row]
        shapes += [single, lasting]
    columns = np.stack(shapes, axis=1)
    seen = noise.whiten(columns)
    z = np.abs(seen.T @ innovations) / np.linalg.norm(seen, axis=0) / max(sd, np.finfo(float).tiny)
    best = int(np.argmax(z))
    return None if z[best] < MIN_SHOCK_SD else columns[:, best]


def _beyond_laws(linearized: LinearizedFit, effects: Array) -> Array:
    """Effects whitened and projected, but for those that the laws describe, of which rounding is left."""
    whitened = linearized.whiten(effects)
    left = linearized.project(whitened)
    return left[:, np.linalg.norm(left, axis=0) > SPAN_TOL * np.linalg.norm(whitened, axis=0)]


def spanning(columns: Array) -> Array:
    """An orthonormal basis of the span of columns, shape (n, q)."""
    if not columns.shape[1]:
        return columns
    if columns.shape[1] == 1:
        length = float(np.linalg.norm(columns))
        return columns / length if length > MIN_LENGTH else columns[:, :0]
    left, singular, _ = svd(columns)
    return left[:, singular > SPAN_TOL * max(float(singular.max(initial=0.0)), MIN_LENGTH)]


def number_samples(seconds: Array, session: IntArray) -> IntArray | None:
    """Numbers of the samples of a signal sampled at regular times within sessions, None of other data.

    Rows stand in order of time within each session, the sessions one after the other; times that are no
    multiple of the usual interval begin a new sequence.

    Examples
    --------
    >>> seconds = np.r_[np.arange(40.0), 45.0, 46.0, 10.0, 11.0]
    >>> number_samples(seconds, np.repeat([0, 1], [42, 2]))[[0, 1, 39, 40, 41, 42, 43]]
    array([ 0,  1, 39, 45, 46, 48, 49])
    """
    same, spacing = np.diff(session) == 0, np.diff(seconds)
    if not np.any(same & (spacing > 0)):
        return None
    interval = float(np.median(spacing[same & (spacing > 0)]))
    steps = np.maximum(np.round(spacing / interval), 1.0)
    regular = same & (np.abs(spacing / interval - steps) < SPACING_TOL)
    following = int(np.sum(regular & (steps == 1)))
    if following < max(MIN_SAMPLED, MIN_REGULAR * np.sum(same)):
        return None
    return np.concatenate([[0], np.cumsum(np.where(regular, steps, 2))]).astype(np.intp)
