"""Bayes factors of hypotheses, many of them at once: of a log, and of thousands of samples of noise.

With unknown noise variance and effect strength tau, the Bayes factor of a hypothesis against noise
alone is prod (1 + tau^2 s_i)^(-1/2) (1 - sum u_i^2 tau^2 s_i / (1 + tau^2 s_i) / u'u)^(-df/2), with u_i
the residual along direction i and s_i its prior share (A. Zellner, g-prior, 1986), averaged over four
values of tau.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.special import logsumexp

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL, Hypothesis
from stickslip_fit.diagnosis.memory import AR1, log_memory_evidence
from stickslip_fit.diagnosis.session_stacks import Coupling, StackMembers, find_stacks

STRENGTHS = np.array([4.0, 10.0, 25.0, 60.0])  # tau: hyperprior on the norm of an effect, whitened
WIDE_STRENGTHS = np.geomspace(4.0, 40_000.0, 25)  # of a law's function
MAX_EXPLAINED = 1.0 - 1e-12  # share of the squared residuals
AT_ONCE = 100  # directions whose rows are put in another order


def strength_evidence(signal: Array, along: Array, residual: Array, df: int) -> Array:
    """Log Bayes factor at each strength, shape (S,).

    `signal`, shape (S, m), is the prior variance along each direction over that of the noise, `along`, (m,),
    the coefficients of a residual, (n,).
    """
    total = max(float(residual @ residual), np.finfo(float).tiny)
    explained = (signal / (1.0 + signal)) @ along**2 / total
    return log_likelihood_ratio(explained, df) - 0.5 * np.log1p(signal).sum(axis=1)


@dataclass(frozen=True)
class LikeliestStrength:
    """The strength of an effect under which residuals are likeliest.

    Attributes
    ----------
    evidence : float
        Log likelihood ratio to noise alone.
    strength : float
        Norm of the effect in units of the noise.
    noise : float
        Variance of the noise beside it, which a fine function may leave far below 1.
    """

    evidence: float
    strength: float
    noise: float


def find_strength(
    along: Array, share: Array, residual: Array, df: int, strengths: Array = WIDE_STRENGTHS
) -> LikeliestStrength:
    """The likeliest of some strengths of an effect, the size of the noise estimated with it.

    `along` are the coefficients of a whitened residual, shape (n,), along the effect's directions, whose
    prior shares are given, both of shape (m,).
    """
    signal = strengths[:, None] ** 2 * share
    evidence = strength_evidence(signal, along, residual, df)
    best = int(np.argmax(evidence))
    # Of what lies along the directions this share is left, which a difference would lose to rounding.
    left = max(float(residual @ residual - along @ along), 0.0) + float(
        np.sum(along**2 / (1.0 + signal[best]))
    )
    return LikeliestStrength(float(evidence[best]), float(strengths[best]), left / df)


def column_evidence(columns: Array, residual: Array, df: int, one_sided: BoolArray) -> Array:
    """Log Bayes factor of each effect, (n, m), of unknown size, shape (m,); -inf of one that is 0.

    As of hypotheses of one direction each, which may be `one_sided`, (m,).
    """
    lengths, signal = np.sqrt(np.einsum("nm,nm->m", columns, columns)), STRENGTHS[:, None] ** 2
    along = columns.T @ residual / np.maximum(lengths, EFFECT_TOL)
    along[one_sided] = np.maximum(along[one_sided], 0.0)
    total = max(float(residual @ residual), np.finfo(float).tiny)
    at_each = log_likelihood_ratio(signal / (1.0 + signal) * along**2 / total, df) - 0.5 * np.log1p(signal)
    return np.where(lengths < EFFECT_TOL, -np.inf, logsumexp(at_each, axis=0) - np.log(len(STRENGTHS)))


def log_likelihood_ratio(explained: npt.ArrayLike, df: int) -> Array:
    """Maximum log likelihood ratio of an effect that explains a share of the squares, noise size unknown."""
    return -0.5 * df * np.log1p(-np.minimum(explained, MAX_EXPLAINED))


@dataclass(frozen=True, eq=False)
class DirectionGroup:
    """All directions of some hypotheses that are zero outside of the same rows.

    Attributes
    ----------
    rows : array of int, shape (s,), or slice
    directions : array, shape (m', s)
        In rows of the array; those that hypotheses share are there once.
    place : array of int, shape (m,)
        Of each among the directions of the hypotheses one after the other.
    index : array of int, shape (m,)
        Which coefficient is that of each.
    least : array, shape (m', 1)
        Least coefficient along each: 0 of a one-sided hypothesis, else minus infinity.
    n_positive : int or None
        Number of rows before those in which a hypothesis has the sign -1, if one has a sign. Then there are
        m' more coefficients: along the same directions with that sign.
    """

    rows: IntArray | slice
    directions: npt.NDArray[Any]
    place: IntArray
    index: IntArray
    least: npt.NDArray[Any]
    n_positive: int | None = None

    @property
    def n_coefficients(self) -> int:
        """Number of coefficients."""
        return len(self.directions) * (1 if self.n_positive is None else 2)

    def coefficients(self, residuals: npt.NDArray[Any], out: npt.NDArray[Any]) -> None:
        """Coefficients of residuals, shape (n, k), into `out`, shape (number of coefficients, k)."""
        own, (first, second) = residuals[self.rows], np.split(out, [len(self.directions)])
        np.matmul(self.directions[:, : self.n_positive], own[: self.n_positive], out=first)
        if self.n_positive is not None:
            np.matmul(self.directions[:, self.n_positive :], own[self.n_positive :], out=second)
            first += second
            second *= -2.0
            second += first
        if np.isfinite(self.least).any():
            np.maximum(first, self.least, out=first)


@dataclass(frozen=True, eq=False)
class CoupledGroup:
    """All directions of a stack whose sessions are coupled.

    Attributes
    ----------
    sessions : tuple of DirectionGroup
        The columns of each session; their coefficients are no directions'.
    coupling : Coupling
    place, index : array of int, shape (m,)
        As of a `DirectionGroup`.
    sign : array, shape (n,), or None
        That of some hypotheses, if they have one.
    """

    sessions: tuple[DirectionGroup, ...]
    coupling: Coupling
    place: IntArray
    index: IntArray
    sign: npt.NDArray[Any] | None

    @property
    def n_coefficients(self) -> int:
        """See `DirectionGroup.n_coefficients`."""
        return sum(one.n_coefficients for one in self.sessions)

    def coefficients(self, residuals: npt.NDArray[Any], out: npt.NDArray[Any]) -> None:
        """See `DirectionGroup.coefficients`."""
        signs = [None] if self.sign is None else [None, self.sign]
        number, n_samples = len(self.coupling.weights), residuals.shape[1]
        products = []
        for session in self.sessions:
            own = np.empty((session.n_coefficients, n_samples), residuals.dtype)
            session.coefficients(residuals, own)
            products.append(own.reshape(len(signs), number, -1, n_samples))
        samples = [residuals if sign is None else residuals * sign[:, None] for sign in signs]
        shared = np.stack([self.coupling.shared.T @ one for one in samples])
        found = self.coupling.coefficients(np.concatenate(products, axis=2), shared)
        out[:] = found.reshape(-1, n_samples)


def group_directions(
    hypotheses: Sequence[Hypothesis], dtype: npt.DTypeLike = np.float64
) -> tuple[DirectionGroup | CoupledGroup, ...]:
    """The directions of hypotheses, those on the same rows together; sessions have no row in common."""
    firsts = np.cumsum([0, *(len(one.prior_share) for one in hypotheses)])
    stacked, others = find_stacks(hypotheses)
    of_stacks = (group for own in stacked for group in _group_stack(own, firsts[own.numbers], dtype))
    return (*of_stacks, *_group_blocks([hypotheses[k] for k in others], firsts[others], dtype))


def _group_stack(
    members: StackMembers, first: IntArray, dtype: npt.DTypeLike
) -> Iterator[DirectionGroup | CoupledGroup]:
    """The directions of a stack, session by session; `first`, (h,), are the coefficients they begin with."""
    sessions, coupling = [], members.stack.coupling
    for rows, own in zip(members.stack.rows, members.stack.columns, strict=True):
        (number, width, n_rows), n_positive = own.shape, None
        directions = own.reshape(-1, n_rows)
        if members.sign is not None:
            order = np.argsort(-members.sign[rows], kind="stable")
            n_positive, directions = int(np.sum(members.sign[rows] > 0)), directions[:, order]
            rows = np.arange(len(members.sign))[rows][order]
        place, index = _number_directions(members, first, number, width)
        least = np.full((len(directions), 1), -np.inf, dtype)
        sessions.append(DirectionGroup(rows, directions.astype(dtype), place, index, least, n_positive))
        first = first + width
    if coupling is None:
        yield from sessions
        return
    width = members.stack.width
    place, index = _number_directions(members, first - width, len(members.stack), width)
    sign = None if members.sign is None else members.sign.astype(dtype)
    yield CoupledGroup(tuple(sessions), coupling.astype(dtype), place, index, sign)


def _number_directions(
    members: StackMembers, first: IntArray, number: int, width: int
) -> tuple[IntArray, IntArray]:
    """Place and index, as of a `DirectionGroup`, of so many directions of each of a stack's hypotheses."""
    inside = np.arange(width)
    begin = width * (members.places + number * members.is_signed)
    return (first[:, None] + inside).ravel(), (begin[:, None] + inside).ravel()


def _group_blocks(
    hypotheses: Sequence[Hypothesis], firsts: IntArray, dtype: npt.DTypeLike
) -> tuple[DirectionGroup, ...]:
    """The blocks of hypotheses whose coefficients begin at `firsts`, those on the same rows together."""
    key_of: dict[int, bytes] = {}
    rows_of: dict[bytes, IntArray | slice] = {}
    sign_of: dict[bytes, Array] = {}
    directions: dict[bytes, dict[int, Array]] = {}
    uses: dict[bytes, list[tuple[int, int, int, bool]]] = {}
    least: dict[bytes, list[float]] = {}
    begins: dict[int, int] = {}  # of each block among the directions of its group
    sizes = Counter[bytes]()
    for hypothesis, first in zip(hypotheses, firsts.tolist(), strict=True):
        for rows, block in hypothesis.blocks:
            if id(rows) not in key_of:
                key = key_of[id(rows)] = b"" if isinstance(rows, slice) else rows.tobytes()
                if rows_of.setdefault(key, rows) is rows:
                    directions[key], uses[key], least[key] = {}, [], []
            key, width, is_signed = key_of[id(rows)], block.shape[1], hypothesis.sign is not None
            if hypothesis.sign is not None and key not in sign_of:
                sign_of[key] = hypothesis.sign[rows]
            if id(block) not in directions[key]:
                directions[key][id(block)], begins[id(block)] = block.T, sizes[key]
                sizes[key] += width
                least[key].extend([0.0 if hypothesis.one_sided else -np.inf] * width)
            uses[key].append((first, begins[id(block)], width, is_signed))
            first += width
    groups = []
    for key, rows in rows_of.items():
        joined, n_positive = np.concatenate(list(directions[key].values()), dtype=dtype), None
        if key in sign_of:
            order = np.argsort(-sign_of[key], kind="stable")
            rows = np.arange(len(order))[rows][order] if isinstance(rows, slice) else rows[order]
            n_positive = int(np.sum(sign_of[key] > 0))
            for some in np.split(joined, range(AT_ONCE, len(joined), AT_ONCE)):
                some[:] = some[:, order]  # a copy of all of them would take as much memory again
        firsts, beginnings, widths, signed = np.array(uses[key], dtype=np.intp).T
        inside = np.arange(widths.sum()) - np.repeat(np.cumsum(widths) - widths, widths)
        groups.append(
            DirectionGroup(
                rows,
                joined,
                np.repeat(firsts, widths) + inside,
                np.repeat(beginnings + len(joined) * signed, widths) + inside,
                np.array(least[key], dtype)[:, None],
                n_positive,
            )
        )
    return tuple(groups)


@dataclass(frozen=True, eq=False)
class HypothesisBatch:
    """Hypotheses side by side, with m directions in all, which they may share.

    Attributes
    ----------
    subspaces : tuple of Hypothesis
    ar1s : tuple of AR1
    position : array of int, shape (H,)
        Of each hypothesis, in the order given, in (subspaces, AR(1)).
    df : int
    """

    subspaces: tuple[Hypothesis, ...]
    ar1s: tuple[AR1, ...]
    position: npt.NDArray[np.intp]
    df: int

    def log_evidence(self, residuals: Array) -> Array:
        """Log Bayes factor of each hypothesis against noise alone; (n, k) -> (H, k)."""
        along = self.coefficients(residuals)
        explained_share = self._explained_share(np.arange(len(along)), len(along))
        at_each = self._at_each_strength(explained_share @ along**2, np.sum(residuals**2, axis=0))
        subspaces = logsumexp(at_each, axis=1) - np.log(len(STRENGTHS))
        return np.concatenate([subspaces, *self._ar1_log_evidence(residuals)])[self.position]

    def log_mean_evidence(self, residuals: Array, log_weight: Array) -> Array:
        """Log of the weighted sum of all Bayes factors, weights (H,); (n, k) -> (k,).

        In single precision, to some 1e-5 nats.
        """
        weight = np.empty(len(log_weight))
        weight[self.position] = np.exp(log_weight)
        single, total = np.float32, np.sum(residuals**2, axis=0)
        explained = self._explain(residuals.astype(single))
        subspaces = self._at_each_strength(explained, total.astype(single))
        ar1s = [np.zeros((0, len(total))), *self._ar1_log_evidence(residuals)]
        others = np.concatenate(ar1s)
        highest = np.maximum(subspaces.max(axis=(0, 1), initial=0.0), others.max(axis=0, initial=0.0))
        np.exp(np.subtract(subspaces, highest.astype(single), out=subspaces), out=subspaces)
        n = len(subspaces)
        mean = weight[:n].astype(single) @ subspaces.mean(axis=1) + weight[n:] @ np.exp(others - highest)
        return np.asarray(np.log(mean) + highest)

    def _explain(self, residuals: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Part of the squares of samples, (n, k), that each subspace explains at each strength."""
        groups, explained_share = self._grouped
        along, first = np.empty((self.n_coefficients, residuals.shape[1]), residuals.dtype), 0
        for group in groups:
            group.coefficients(residuals, along[first : (first := first + group.n_coefficients)])
        return np.asarray(explained_share @ np.square(along, out=along))

    @cached_property
    def n_coefficients(self) -> int:
        """Number of coefficients of a sample, those with a sign besides."""
        return int(self._grouped[1].shape[1])

    def coefficients(self, residuals: Array) -> Array:
        """Along each direction, one hypothesis after the other, (n, k) -> (m, k)."""
        sizes = self._signal[1]
        firsts, found = np.cumsum(sizes) - sizes, np.empty((int(sizes.sum()), residuals.shape[1]))
        stacked, others = find_stacks(self.subspaces)
        for own in stacked:
            found[firsts[own.numbers, None] + np.arange(own.stack.width)] = own.coefficients(residuals)
        inside: dict[tuple[int, bool], Array] = {}
        known: dict[tuple[int, bool], Array] = {}
        for number in others.tolist():
            one, first = self.subspaces[number], int(firsts[number])
            is_signed = one.sign is not None
            for rows, block in one.blocks:
                if (key := (id(block), is_signed)) not in known:
                    if (place := (id(rows), is_signed)) not in inside:
                        here = residuals[rows]
                        inside[place] = here if one.sign is None else here * one.sign[rows, None]
                    known[key] = block.T @ inside[place]
                    if one.one_sided:
                        np.maximum(known[key], 0.0, out=known[key])
                found[first : (first := first + block.shape[1])] = known[key]
        return found

    @cached_property
    def _grouped(self) -> tuple[tuple[DirectionGroup | CoupledGroup, ...], csr_array]:
        """Directions in single precision, one matrix product for each session, and what is explained."""
        groups = group_directions(self.subspaces, np.float32)
        first = np.cumsum([0, *(group.n_coefficients for group in groups)])
        column = np.empty(sum(len(group.place) for group in groups), dtype=np.intp)
        for k, group in zip(first, groups, strict=False):
            column[group.place] = k + group.index
        return groups, self._explained_share(column, int(first[-1])).astype(np.float32)

    def _explained_share(self, column: IntArray, number: int) -> csr_array:
        """Of the square of each of so many coefficients, what each subspace explains at each strength.

        Shape (S len(STRENGTHS), number); `column`, shape (m,), is the coefficient of each direction.
        """
        signal, sizes = self._signal
        ends = np.r_[0, np.cumsum(np.repeat(sizes, len(STRENGTHS)))]
        first = np.repeat(np.cumsum(sizes) - sizes, len(STRENGTHS))
        strength = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
        direction = np.arange(ends[-1]) + (first - ends[:-1])[strength]
        own = signal[direction, strength % len(STRENGTHS)]
        entries = own / (1.0 + own), column[direction], ends
        return csr_array(entries, shape=(len(ends) - 1, number))

    @cached_property
    def _log_spread(self) -> Array:
        """Log of the prior variance of the residuals over that of the noise, shape (S, len(STRENGTHS))."""
        signal, sizes = self._signal
        owner = np.repeat(np.arange(len(sizes)), sizes)
        spread = [np.bincount(owner, np.log1p(own), len(sizes)) for own in signal.T]
        return np.stack(spread, axis=1)

    @cached_property
    def _signal(self) -> tuple[Array, IntArray]:
        """Prior variance along each direction at each strength, and how many directions each subspace has."""
        shares = [one.prior_share for one in self.subspaces]
        share = np.concatenate([np.zeros(0), *shares])
        return STRENGTHS**2 * share[:, None], np.array([len(own) for own in shares], dtype=np.intp)

    def _at_each_strength(self, explained: npt.NDArray[Any], total: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Log Bayes factor of each subspace at each strength, shape (S, len(STRENGTHS), k).

        `explained`, shape (S len(STRENGTHS), k), of sums of squares of the residuals, shape (k,).
        """
        log = explained.reshape(-1, len(STRENGTHS), len(total))
        log /= -np.maximum(total, np.finfo(log.dtype).tiny)
        largest = MAX_EXPLAINED if log.dtype == np.float64 else 1.0 - 1e-6
        # Several times as fast as log1p, and for shares of this size as good.
        np.log(np.add(np.maximum(log, -largest, out=log), 1.0, out=log), out=log)
        log *= -0.5 * self.df
        log -= 0.5 * self._log_spread[:, :, None].astype(log.dtype)
        return log

    def _ar1_log_evidence(self, residuals: Array) -> list[Array]:
        return [own[None] for own in log_memory_evidence(self.ar1s, residuals, self.df)]


def batch_hypotheses(hypotheses: Sequence[Hypothesis | AR1], df: int) -> HypothesisBatch:
    """Put hypotheses side by side: subspaces, then AR(1)."""
    is_ar1 = np.array([isinstance(one, AR1) for one in hypotheses])
    position = np.empty(len(hypotheses), dtype=np.intp)
    position[np.argsort(is_ar1, kind="stable")] = np.arange(len(hypotheses))
    subspaces = tuple(one for one in hypotheses if isinstance(one, Hypothesis))
    return HypothesisBatch(subspaces, tuple(one for one in hypotheses if isinstance(one, AR1)), position, df)
