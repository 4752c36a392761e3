"""Restricted likelihood of an autoregression about a linear mean, from sums of products of lagged rows.

The prediction-error filter is a polynomial in shifts by one row, so that products of filtered columns are
sums of products of lagged columns, each times two of the filter's coefficients (J. Durbin, Rev. Int. Stat.
Inst. 28:233, 1960). These sums are computed once for each order, from those of the order before; after that
neither the likelihood nor its gradient depends on the number of rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.linearized import LinearizedFit

# Of a partial autocorrelation; beyond the first, the noise has no variance to speak of.
LARGEST_PARTIALS = (0.998, 0.99, 0.97, 0.9, 0.8, 0.5)
MAX_ITERATIONS, LIKELIHOOD_TOL = 30, 1e-6
WEIGHT_STEP = 1e-6  # of a partial autocorrelation, for derivatives of the filter's coefficients
MIN_LEFT = 1e-11  # of the products whose differences are the squares of filtered residuals; less is rounding


def order_samples(sample: IntArray) -> tuple[IntArray, IntArray]:
    """Rows in order of their numbers, and how many stand before each of these in its sequence; (n,) each."""
    by_number = np.argsort(sample, kind="stable")
    starts = np.flatnonzero(np.diff(sample[by_number], prepend=sample.min() - 2) != 1)
    return by_number, np.arange(len(sample)) - np.repeat(starts, np.diff(starts, append=len(sample)))


def filter_tables(partial: Array) -> Array:
    """Coefficients of the prediction-error filter after 0, 1, ... p values, by Levinson's recursion.

    `partial` are partial autocorrelations, shape (k, p). The result, (k, p + 1, p + 1), has a row for each
    number of values before and a column for each lag, over the standard deviation of the error there.

    Examples
    --------
    >>> filter_tables(np.array([[0.6, -0.2]]))[0].round(3)
    array([[ 1.   ,  0.   ,  0.   ],
           [ 1.25 , -0.75 ,  0.   ],
           [ 1.276, -0.919,  0.255]])
    """
    k, p = partial.shape
    tables = np.zeros((k, p + 1, p + 1))
    tables[:, :, 0] = 1.0
    for depth in range(1, p + 1):
        last, before = partial[:, depth - 1, None], tables[:, depth - 1, 1:depth]
        tables[:, depth, 1:depth] = before - last * before[:, ::-1]
        tables[:, depth, depth] = -last[:, 0]
    error_sd = np.sqrt(np.cumprod(np.concatenate([np.ones((k, 1)), 1.0 - partial**2], axis=1), axis=1))
    return np.asarray(tables / error_sd[:, :, None])


@dataclass(frozen=True, eq=False)
class _LagSums:
    """Sums of products of lagged columns, by two lags, the first at most the second.

    Attributes
    ----------
    starts : tuple of dict
        For each number of values before, over the rows with just so many.
    others : dict
        Over the rows with at least as many as the order.
    """

    starts: tuple[dict[tuple[int, int], Array], ...]
    others: dict[tuple[int, int], Array]

    @property
    def order(self) -> int:
        """Of the autoregression."""
        return len(self.starts)

    @cached_property
    def matrix(self) -> Array:
        """All of them, a row for each entry of `places`."""
        return np.stack([sums[pair] for sums in (*self.starts, self.others) for pair in sorted(sums)])

    @cached_property
    def places(self) -> IntArray:
        """Number of values before, and both lags, of each row of `matrix`, shape (3, k)."""
        every = enumerate((*self.starts, self.others))
        return np.array([(depth, *pair) for depth, sums in every for pair in sorted(sums)]).T


@dataclass(frozen=True, eq=False)
class _Solved:
    """Least squares under k filters: blocks' own columns eliminated first, then the border.

    Attributes
    ----------
    value : array, shape (k,)
        Negative log likelihood.
    squares : array, shape (k,)
        Of the filtered residual.
    direction : array, shape (k, m + 1, 1)
        That residual in terms of the border's columns and the response.
    inverse_border, inverse, eliminated : array
        Of the border's products, shape (k, m, m), of each block's own, (k, b, q, q), and the latter times the
        block's products with the border.
    """

    value: Array
    squares: Array
    direction: Array
    inverse_border: Array
    inverse: Array
    eliminated: Array

    def slopes(self, df: int) -> Array:
        """Derivatives of the first value by the filtered columns' products."""
        direction, eliminated = self.direction[0], self.eliminated[0]
        by_left = 0.5 * df / self.squares[0] * (direction @ direction.T)
        by_left[:-1, :-1] += 0.5 * self.inverse_border[0]
        by_across = -2.0 * eliminated @ by_left
        by_within = eliminated @ by_left @ eliminated.swapaxes(1, 2) + 0.5 * self.inverse[0]
        return np.concatenate([by_left.ravel(), np.concatenate([by_within, by_across], axis=2).ravel()])


class RestrictedLikelihood:
    """Of an autoregression about a mean linear in blocks' own parameters and in those of a border.

    Parameters
    ----------
    linearized : LinearizedFit
        Without a filter.
    border : array, shape (n, m)
    sample : array of int, shape (n,)
        As of `Autocorrelation`; no sequence goes on in another block.
    """

    def __init__(self, linearized: LinearizedFit, border: Array, sample: IntArray) -> None:
        blocks, n = linearized.blocks, len(sample)
        widths = np.array([basis.shape[1] for _, basis in blocks], dtype=np.intp)
        self.own_width = int(max(widths, default=0))
        own, block = np.zeros((n, self.own_width)), np.zeros(n, dtype=np.intp)
        for number, (rows, basis) in enumerate(blocks if self.own_width else ()):
            own[rows, : basis.shape[1]], block[rows] = basis, number
        number = len(blocks) if self.own_width else 1
        absent = np.arange(self.own_width) >= (widths[:, None] if self.own_width else np.zeros((1, 1)))
        self.filled_up = absent[:, None, :] * np.eye(self.own_width)
        self.df = n - int(widths.sum()) - border.shape[1]
        by_number, self.place = order_samples(sample)
        columns = np.concatenate([own, border, linearized.residual[:, None]], axis=1)[by_number]
        self.block, self.n_blocks, width = block[by_number], number, columns.shape[1]
        # The last row, of zeros, is that of blocks that are shorter than others.
        self.columns = np.concatenate([columns, np.zeros((1, width))])
        self.is_last = np.append(self.place[1:] == 0, True)
        everything = self._sum_products(np.arange(n), (0,))
        self.sums = [_LagSums((), everything)]

    def criteria(self, partials: Array, n_free: int) -> Array:
        """Bayesian information criterion, over -2, for noise of so many parameters; shape (k, p) -> (k,).

        Infinite where there is no likelihood, as where next to nothing is left to be noise.
        """
        sums = self._sums_of(partials.shape[1])
        with suppress(np.linalg.LinAlgError):
            price = 0.5 * n_free * float(np.log(max(self.df, 2)))
            return self._solve(sums, partials, _weights(sums, partials)).value + price
        if len(partials) == 1:
            return np.full(1, np.inf)
        return np.concatenate([self.criteria(one[None], n_free) for one in partials])

    def maximize(self, start: Array) -> Array:
        """Partial autocorrelations of the highest likelihood."""
        from scipy.optimize import minimize

        def of_transformed(z: Array) -> tuple[float, Array]:
            partial = np.tanh(z)
            value, slopes = self.differentiate(partial)
            return value, slopes * (1.0 - partial**2)

        # So close to unit roots that nothing of a parameter is left there is no likelihood.
        for largest in LARGEST_PARTIALS:
            limit, first = float(np.arctanh(largest)), np.arctanh(np.clip(start, -largest, largest))
            with suppress(np.linalg.LinAlgError):
                result = minimize(
                    of_transformed,
                    first,
                    method="L-BFGS-B",
                    jac=True,
                    bounds=[(-limit, limit)] * len(start),
                    options={"maxiter": MAX_ITERATIONS, "ftol": LIKELIHOOD_TOL},
                )
                return np.asarray(np.tanh(result.x))
        return start

    def differentiate(self, partial: Array) -> tuple[float, Array]:
        """Negative log likelihood but for a constant, and its derivatives, shape (p,).

        The variance of the noise is maximized out.
        """
        sums = self._sums_of(len(partial))
        steps = WEIGHT_STEP * np.eye(len(partial))
        here, ahead, behind = np.split(
            _weights(sums, np.concatenate([partial[None], partial + steps, partial - steps])),
            [1, len(partial) + 1],
        )
        solved = self._solve(sums, partial[None], here)
        by_cell = solved.slopes(self.df)
        slopes = (ahead - behind) @ (sums.matrix @ by_cell) / (2.0 * WEIGHT_STEP)
        beyond = self._counts(sums.order)[::-1].cumsum()[::-1][1:]
        return float(solved.value[0]), slopes - beyond * partial / (1.0 - partial**2)

    def _counts(self, order: int) -> IntArray:
        """Rows with 0, 1, ... and at least `order` values before them."""
        return np.bincount(np.minimum(self.place, order), minlength=order + 1)

    def _solve(self, sums: _LagSums, partials: Array, weights: Array) -> _Solved:
        """The negative log likelihood of filters of partials (k, p), with the weights of their sums."""
        own = self.own_width
        cells, width = weights @ sums.matrix, self.columns.shape[1] - own
        left = cells[:, : width**2].reshape(len(weights), width, width)
        least = MIN_LEFT * (np.abs(weights) @ np.abs(sums.matrix[:, width**2 - 1]))
        products = cells[:, width**2 :].reshape(len(weights), self.n_blocks, own, own + width)
        within, across = products[..., :own] + self.filled_up, products[..., own:]
        lower, inverse = np.linalg.cholesky(within), np.linalg.inv(within)
        eliminated = inverse @ across
        rows = (len(left), self.n_blocks * own, width)
        left_after = left - across.reshape(rows).swapaxes(1, 2) @ eliminated.reshape(rows)
        border = np.linalg.cholesky(left_after[:, :-1, :-1])
        inverse_border = np.linalg.inv(left_after[:, :-1, :-1])
        sizes = -inverse_border @ left_after[:, :-1, -1:]
        direction = np.concatenate([sizes, np.ones((len(left), 1, 1))], axis=1)
        squares = (direction.swapaxes(1, 2) @ left_after @ direction)[:, 0, 0]
        if np.any(left[:, -1, -1] < least) or np.any(squares <= 0.0):
            raise np.linalg.LinAlgError
        value = 0.5 * self.df * np.log(squares) + np.log(np.diagonal(lower, 0, 2, 3)).sum(axis=(1, 2))
        value += np.log(np.diagonal(border, 0, 1, 2)).sum(axis=1)
        log_sd = 0.5 * np.cumsum(np.log1p(-(partials**2)), axis=1)
        value += log_sd @ self._counts(sums.order)[1:]
        return _Solved(value, squares, direction, inverse_border, inverse, eliminated)

    def _sums_of(self, order: int) -> _LagSums:
        """Those of an order, from those of the order before."""
        while len(self.sums) <= order:
            before, place = self.sums[-1], self.place
            p = before.order
            starting, enough = np.flatnonzero(place == p), np.flatnonzero(place > p)
            ending = np.flatnonzero((place >= p) & self.is_last)
            starts, ends = (self._sum_products(rows, range(p + 1)) for rows in (starting, ending))
            others = {(i + 1, j + 1): before.others[i, j] - lost for (i, j), lost in ends.items()}
            others |= {(0, j): before.others[0, j] - starts[0, j] for j in range(p + 1)}
            others[0, p + 1] = self._sum_products(enough, (0, p + 1))[0, p + 1]
            self.sums.append(_LagSums((*before.starts, starts), others))
        return self.sums[order]

    def _sum_products(self, rows: IntArray, lags: Sequence[int]) -> dict[tuple[int, int], Array]:
        """Products of the columns at every two lags before some rows, in either order, summed.

        First those of the border and the residual, then, block by block, of its own columns with all.
        """
        order = np.argsort(self.block[rows], kind="stable")
        count = np.bincount(self.block[rows], minlength=self.n_blocks)
        padded = np.full((self.n_blocks, int(count.max(initial=0))), -1)
        first = np.repeat(np.cumsum(count) - count, count)
        padded[self.block[rows][order], np.arange(len(rows)) - first] = rows[order]
        at = np.stack([self.columns[np.where(padded >= 0, padded - lag, -1)] for lag in lags])
        number, width, own = len(lags), self.columns.shape[1], self.own_width
        rest = at[..., own:].reshape(number, -1, width - own)
        flat = rest.transpose(1, 0, 2).reshape(rest.shape[1], -1)
        border = (flat.T @ flat).reshape(number, width - own, number, width - own).transpose(0, 2, 1, 3)
        blocks = at[:, None, :, :, :own].swapaxes(-1, -2) @ at
        sums = {}
        for i, one in enumerate(lags):
            for j, other in enumerate(lags[i:], start=i):
                both = np.concatenate([border[i, j].ravel(), blocks[i, j].ravel()])
                if i != j:
                    both += np.concatenate([border[j, i].ravel(), blocks[j, i].ravel()])
                sums[one, other] = both
        return sums


def _weights(sums: _LagSums, partial: Array) -> Array:
    """Factors of the sums in the products of filtered columns, for partials of shape (k, p); (k, rows)."""
    tables, (depth, one, other) = filter_tables(partial), sums.places
    return np.asarray(tables[:, depth, one] * tables[:, depth, other])
