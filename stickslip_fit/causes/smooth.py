"""Smooth functions without a formula: sums of cosines whose coefficients have a Gaussian-process prior.

Over a range of length 1 the covariance exp(-(x - y)^2 / (2 length^2)) has the spectral density
exp(-(pi k length)^2 / 2) at the k-th cosine (A. Solin and S. Sarkka, Hilbert space methods for reduced-rank
Gaussian process regression, Stat. Comput. 30:419, 2020). The diagnosis compares lengths and amplitudes by
their evidence; the fit is penalised by the prior.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes.kinds import FactorCause
from stickslip_fit.causes.parameters import Row
from stickslip_fit.laws import State, StepLaw

N_HARMONICS = 4  # of a wave: in them a square wave has 0.90 of its variance, a saw-tooth 0.87
LENGTHS = (1.0, 0.4, 0.15, 0.06)  # correlation lengths that are tried, of the range
MAX_LOG = 50.0  # of a factor: the search for coefficients may try more, of which the square is no number
MAX_KEPT = 1_000_000  # numbers of functions that are kept for the next time, in each state
MIN_PRIOR_SD = 0.03  # of a cosine's coefficient, relative to the largest one, below which it is left out


def cosines(x: Array, low: float, high: float, number: int) -> Array:
    """cos(k pi s) for k = 1 to `number`, s from 0 to 1 over the range and constant beyond it.

    Shape (...) -> (..., number).

    Examples
    --------
    >>> cosines(np.array([0.0, 1.0, 2.0]), 0.0, 2.0, 2).round(3)
    array([[ 1.,  1.],
           [ 0., -1.],
           [-1.,  1.]])
    """
    values = np.empty((*np.shape(x), number))
    for k, own in enumerate(cosine_sequence(x, low, high, number)):
        values[..., k] = own
    return values


def cosine_sequence(x: Array, low: float, high: float, number: int) -> Iterator[Array]:
    """As `cosines`, one after the other."""
    share = np.clip((x - low) / (high - low), 0.0, 1.0)
    before, own = np.ones_like(share), np.cos(np.pi * share)
    twice = 2.0 * own
    for _ in range(number):  # the recurrence of Chebyshev polynomials, ten times as fast as so many cosines
        yield own
        before, own = own, twice * own - before


def prior_sds(length: float) -> Array:
    """Prior standard deviations of the cosines' coefficients, for a function of rms 1; shape (number,).

    `length` is the correlation length as a share of the range.

    Examples
    --------
    >>> [len(prior_sds(length)) for length in LENGTHS]
    [1, 3, 8, 19]
    """
    k = np.arange(1, int(np.ceil(2.0 / length)) + 4)
    sd = np.exp(-((np.pi * k * length) ** 2) / 4.0)
    sd = sd[sd >= MIN_PRIOR_SD * sd[0]]
    return np.asarray(sd / np.sqrt(0.5 * np.sum(sd**2)))


def rough_prior_sds() -> Array:
    """As `prior_sds`, of a function with details of every length: the mean of their covariances.

    Examples
    --------
    >>> len(rough_prior_sds())
    19
    """
    each = [prior_sds(length) for length in LENGTHS]
    longest = max(len(sds) for sds in each)
    return np.asarray(np.sqrt(np.mean([np.pad(sds, (0, longest - len(sds))) ** 2 for sds in each], axis=0)))


def wave_products(waves: Sequence[Array], orders: Sequence[Sequence[int]]) -> Array:
    """Products by their orders of the waves of carriers, each shape (..., highest order); shape (..., q).

    That of order 0 is 1 everywhere.

    Examples
    --------
    >>> wave_products([np.array([0.5, 0.2]), np.array([0.3])], [(1, 1), (2, 0), (0, 1)])
    array([0.15, 0.2 , 0.3 ])
    """
    products: Array | float = 1.0
    for wave, order in zip(waves, np.array(orders).T, strict=True):
        if not order.all():
            wave = np.concatenate([wave, np.ones((*wave.shape[:-1], 1))], axis=-1)  # the last, at place -1
        products = products * wave[..., order - 1]
    return np.asarray(products)


def harmonics(clock: Array, period: float, number: int) -> Array:
    """Cosine and sine of a wave, then those of each harmonic, shape (...) -> (..., 2 number).

    Examples
    --------
    >>> harmonics(np.array([0.0, 1.0]), 4.0, 2).round(3) + 0.0
    array([[ 1.,  0.,  1.,  0.],
           [ 0.,  1., -1.,  0.]])
    """
    angles = 2.0 * np.pi * clock[..., None] / period * np.arange(1, number + 1)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(*np.shape(clock), -1)


class LinearFactor(FactorCause):
    """gamma times 1 + the sum of each parameter times a function; all parameters are 0 without effect."""

    combine_trials = True

    @abstractmethod
    def functions(self, state: State) -> Array:
        """What the parameters are the coefficients of, shape (n, k, m) or (n, 1, m)."""

    def acts(self, state: State) -> Array:
        """By which sign these act on each traverse, 0 where they do not: q = g m parameters, shape (n, g)."""
        return np.ones((len(state.position), 1))

    def factor(self, state: State, values: list[Array]) -> Array:
        return self.factor_of(state, np.concatenate(values, axis=1))

    def factor_of(self, state: State, values: Array) -> Array:
        return self.of_sum(self.linear_sum(state, values))[0]

    def of_sum(self, total: Array) -> tuple[Array, Array | float]:
        """The factor from the sum of each parameter times its function, and its derivative by that sum."""
        return 1.0 + total, 1.0

    def linear_sum(self, state: State, values: Array) -> Array:
        """The sum of each parameter times its function, shape (n, k) or (n, 1)."""
        functions, _ = self._functions_in(state)
        return self.sum_of(functions, self.mix(state, values))

    def sum_of(self, functions: Array, coefficients: Array) -> Array:
        """The sum of functions, (n, k, m), times their coefficients, (n, m); shape (n, k)."""
        return np.asarray(np.einsum("nkm,nm->nk", functions, coefficients))

    def slopes_of(self, functions: Array, coefficients: Array) -> Array:
        """Derivatives of `sum_of` by the coefficients, shape (n, k, m)."""
        return functions

    def factor_slopes(self, state: State, values: list[Array]) -> Array:
        return self.spread(state, self.local_slopes(state, np.concatenate(values, axis=1)))

    def local_slopes(self, state: State, values: Array) -> Array:
        """See `FactorCause.local_slopes`: by the coefficients of the functions of each traverse."""
        functions, _ = self._functions_in(state)
        coefficients = self.mix(state, values)
        by_sum = np.asarray(self.of_sum(self.sum_of(functions, coefficients))[1])
        return self.slopes_of(functions, coefficients) * by_sum[..., None]

    def mix(self, state: State, values: Array) -> Array:
        """The coefficients of the functions of each traverse, (n, q) -> (n, m)."""
        functions, acts = self._functions_in(state)
        return np.asarray(np.einsum("ng,ngm->nm", acts, values.reshape(*acts.shape, functions.shape[2])))

    def spread(self, state: State, slopes: Array) -> Array:
        """See `FactorCause.spread`: the transpose of `mix`."""
        _, acts = self._functions_in(state)
        spread = slopes[:, :, None, :] * acts[:, None, :, None]
        return spread.reshape(*slopes.shape[:2], acts.shape[1] * slopes.shape[2])

    def _functions_in(self, state: State) -> tuple[Array, Array]:
        """`functions` and `acts`, computed once in a state: a fit asks for them again and again."""
        if id(self) in state.functions:
            return state.functions[id(self)][1:]
        functions, acts = self.functions(state), self.acts(state)
        if functions.size <= MAX_KEPT:
            state.functions[id(self)] = self, functions, acts
        return functions, acts

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: by the derivatives without effect, since trials are small and many."""
        if not self.acts_on(law):
            return np.zeros((len(values), len(trials)))
        return np.asarray(self.null_slopes(law, rows, values) @ trials.T)

    def null_slopes(self, law: StepLaw, rows: Row, values: Array) -> Array:
        """Derivatives of the log of the steps by each parameter, all 0, shape (n, q)."""
        extended, slopes = self.extend(law), []
        first = np.concatenate([values, np.zeros((len(values), len(self.parameters)))], axis=1)
        for subset, part in extended.parts(self.row_values(law, rows)):
            counts, own = part.counts_and_slopes(first[subset], extended.chained_slopes_by_last)
            slopes.append(own / (counts + extended.steps_added(part.start_state, first[subset]))[:, None])
        return np.concatenate(slopes)


class LogLinearFactor(LinearFactor):
    """gamma times exp of the sum of each parameter times a function: a step size that stays positive.

    Of a motor whose steps differ by half from place to place a sum has other errors where steps are small.
    """

    def of_sum(self, total: Array) -> tuple[Array, Array]:
        factor = np.exp(np.minimum(total, MAX_LOG))
        return factor, factor
