"""A test of a selection repeated without some rows, by linear algebra.

To leave out rows is to project their indicators out of whitened, projected columns (R. D. Cook and S.
Weisberg, Residuals and Influence in Regression, 1982, section 2.2). So the evidence of every hypothesis
follows from its directions in the rows left out; no law, cause or alternative is evaluated again. The laws
are linearized about their fit to all rows, whose noise is kept: both are errors of second order.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from stickslip_fit._linalg import eigh, svd
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.evidence import STRENGTHS, log_likelihood_ratio
from stickslip_fit.diagnosis.extension import SelectedCause, make_selected
from stickslip_fit.diagnosis.hypotheses import VARIANCE_TOL, Hypothesis, make_hypothesis
from stickslip_fit.diagnosis.linearized import split_positions
from stickslip_fit.diagnosis.memory import AR1, leave_out_rows, log_memory_evidence
from stickslip_fit.diagnosis.misfit import Misfit, average_by_cause, classify_cause, weigh_hypotheses

MIN_KNOWN = 1e-6  # of a row left out: what calibration leaves of it; below, its block has no other row
SHARED_FILL = 0.25  # of the rows, above which a direction of the calibration counts as shared by all
MIN_OVERLAP = 1e-9  # product of a direction and a column of the calibration that counts
MIN_LEFT = 1e-6  # of the square of a direction, in the rows left


@dataclass(frozen=True, eq=False)
class _LeftOutBlocks:
    """Blocks of which s rows each are left out, with c columns; B blocks.

    Attributes
    ----------
    members : array of int, shape (B, s)
        Among the rows left out.
    roots : array, shape (B, c, s)
        R, transposed.
    numbers : array of int, shape (B, c)
        Of the columns.
    """

    members: IntArray
    roots: Array
    numbers: IntArray


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Rows left out of n.

    The projector on the rows, P, is block by block 1 - B B', less S S' of what all blocks share. Its inverse
    is R (1 + U e U') R' with R R' the blocks' inverse, so that cost grows linearly with rows.

    Attributes
    ----------
    rows : array of int, shape (h,)
    own : sparse array, shape (h, h')
        R; rows without which their block is not determined add no column.
    blocks : tuple of _LeftOutBlocks
        The same, of blocks with equally many rows and columns.
    shared : array, shape (h, k)
        R U sqrt(e).
    """

    rows: IntArray
    own: csr_array
    blocks: tuple[_LeftOutBlocks, ...]
    shared: Array

    @classmethod
    def of(cls, basis: csr_array, rows: IntArray) -> LeftOut:
        """Rows left out of a fit whose calibration has an orthonormal `basis`, shape (n, p)."""
        is_shared = np.bincount(basis.indices, minlength=basis.shape[1]) > SHARED_FILL * basis.shape[0]
        inside = csc_array(basis[rows])
        own, border = csr_array(inside[:, ~is_shared]), inside[:, is_shared].toarray()
        overlap = coo_array(own @ own.T)
        _, block = connected_components(overlap, directed=False)
        groups, width, blocks = split_positions(block), 0, []
        sizes, place = np.array([len(members) for members in groups]), np.empty(len(rows), dtype=np.intp)
        for members in groups:
            place[members] = np.arange(len(members))
        for size in np.unique(sizes).tolist():
            alike, inside = np.flatnonzero(sizes == size), sizes[block[overlap.row]] == size
            row, column = overlap.row[inside], overlap.col[inside]
            projector = np.tile(np.eye(size), (len(alike), 1, 1))
            projector[np.searchsorted(alike, block[row]), place[row], place[column]] -= overlap.data[inside]
            known, vectors = np.linalg.eigh(projector)
            rank = np.sum(known > MIN_KNOWN, axis=1)
            for c in np.unique(rank).tolist():
                some = np.flatnonzero(rank == c)
                scaled = vectors[some, :, size - c :] / np.sqrt(known[some, None, size - c :])
                numbers = np.arange(width, width := width + len(some) * c).reshape(len(some), c)
                members = np.stack([groups[k] for k in alike[some]])
                blocks.append(_LeftOutBlocks(members, scaled.swapaxes(1, 2), numbers))
        roots = csr_array((len(rows), width))
        if blocks:
            entries = np.concatenate([one.roots.ravel() for one in blocks])
            positions = [np.broadcast_arrays(one.members[:, None], one.numbers[:, :, None]) for one in blocks]
            row, column = (
                np.concatenate([part.ravel() for part in axis]) for axis in zip(*positions, strict=True)
            )
            roots = csr_array((entries, (row, column)), shape=(len(rows), width))
        left, singular, _ = svd(roots.T @ border)
        size = singular**2 / np.maximum(1.0 - singular**2, MIN_KNOWN)
        return cls(rows, roots, tuple(blocks), roots @ (left * np.sqrt(size)))

    def coordinates(self, columns: Array) -> Array:
        """Coordinates of projected columns, (h, m) -> (h' + k, m), with products under the inverse of P."""
        return np.concatenate([self.own.T @ columns, self.shared.T @ columns])

    def select(self, directions: Array, place: IntArray) -> tuple[IntArray, Array]:
        """Coordinates of directions in some rows, of those only that may differ from zero: which, and (c, m).

        `place`, shape (n,), has the row of `directions` of each row, or -1, which is a row of zeros.
        """
        numbers, found = [np.zeros(0, dtype=np.intp)], [directions[:0]]
        for one in self.blocks:
            at = place[self.rows[one.members]]
            inside = np.any(at >= 0, axis=1)
            if inside.any():
                numbers.append(one.numbers[inside].ravel())
                found.append((one.roots[inside] @ directions[at[inside]]).reshape(-1, directions.shape[1]))
        if n_shared := self.shared.shape[1]:
            at = place[self.rows]
            numbers.append(self.own.shape[1] + np.arange(n_shared))
            found.append(self.shared[at >= 0].T @ directions[at[at >= 0]])
        return np.concatenate(numbers), np.concatenate(found)

    def remove(self, columns: Array, basis: csr_array) -> Array:
        """Projected columns without the rows, zero in them, (n, m) -> (n, m)."""
        coordinates = self.coordinates(columns[self.rows])
        n_own = self.own.shape[1]
        combined = self.own @ coordinates[:n_own] + self.shared @ coordinates[n_own:]
        left = columns + basis @ (basis[self.rows].T @ combined)
        left[self.rows] = 0.0
        return np.asarray(left)


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Blocks of w directions each, side by side in the columns of a `_Stack`; k blocks.

    Attributes
    ----------
    columns : slice
    root_share : array, shape (k, w)
        Root of each direction's prior share.
    owner : array of int, shape (k,)
        Hypothesis of each block.
    least : array, shape (k, 1)
        Least coefficient of each block: 0 of a one-sided hypothesis, else minus infinity.
    """

    columns: slice
    root_share: Array
    owner: IntArray
    least: Array


@dataclass(frozen=True, eq=False)
class _Stack:
    """All directions on the same s rows; m directions.

    Attributes
    ----------
    place : array of int, shape (n,)
        Of each row of the fit among the s rows, or -1.
    directions : array, shape (s + 1, m)
        The last row is zero.
    along : array, shape (m,)
        Coefficient of the residual along each direction.
    overlap : array, shape (q, m)
        Products of the directions with the columns of the calibration that reach beyond their rows: what
        these project out of a direction is outside of its rows, too, so that it is kept apart.
    blocks : tuple of _Blocks
        One for each width.
    """

    place: IntArray
    directions: Array
    along: Array
    overlap: Array
    blocks: tuple[_Blocks, ...]

    def without(self, left_out: LeftOut, lost: Array, common: Array) -> tuple[Array, Array]:
        """Coordinates of the directions without some rows, (d, m), and the residual's coefficients, (m,).

        `lost`, shape (h' + k,), are the residual's coordinates, `common`, shape (h' + k, q), those of the
        columns of `overlap`. The coordinates are any with the same products.
        """
        numbers, own = left_out.select(self.directions, self.place)
        along = self.along - lost[numbers] @ own
        if not len(self.overlap):
            return own, along
        # A direction's coordinates are `own` less `common @ overlap`, of which a triangle says enough where
        # `own` is zero.
        own -= common[numbers] @ self.overlap
        beyond = np.linalg.qr(np.delete(common, numbers, axis=0), mode="r")
        return np.concatenate([own, beyond @ self.overlap]), along + (lost @ common) @ self.overlap


def _spectra(
    blocks: Sequence[_Blocks], coordinates: Sequence[Array], along: Sequence[Array]
) -> tuple[IntArray, Array, Array]:
    """Owner, variance and squared coefficient of the new orthogonal directions of blocks of one width.

    `coordinates`, shape (d, k w) each, and `along`, shape (k w,), are those of the blocks without some rows.
    """
    owner = np.concatenate([one.owner for one in blocks])
    root_share = np.concatenate([one.root_share for one in blocks])
    k, w = root_share.shape
    own = np.concatenate(along).reshape(k, w)
    if w == 1:
        left = 1.0 - np.concatenate([np.einsum("ij,ij->j", one, one) for one in coordinates])[:, None]
        least = np.concatenate([one.least for one in blocks])
        squares = np.maximum(own, least) ** 2 / np.maximum(left, MIN_LEFT)
        return owner, np.where(left > MIN_LEFT, left, 0.0) * root_share**2, squares
    each = [one.reshape(len(one), one.shape[1] // w, w).transpose(1, 2, 0) for one in coordinates]
    gram = np.eye(w) - np.concatenate([one @ one.transpose(0, 2, 1) for one in each])
    scaled = root_share[:, :, None] * gram * root_share[:, None, :]
    variance, right = eigh(scaled)
    coefficients = np.einsum("kwv,kw->kv", right, root_share * own)
    kept = variance > VARIANCE_TOL * np.sum(root_share**2, axis=1, keepdims=True)
    squares = coefficients**2 / np.where(kept, variance, np.inf)
    return np.repeat(owner, w), np.where(kept, variance, 0.0), squares


class Look:
    """A misfit test, and its evidence without some rows.

    Hypotheses with log odds below `least`, of other causes than some `named` ones, keep those of all rows:
    they are too far behind to matter, and nearly all are.
    """

    def __init__(self, misfit: Misfit, least: float = -np.inf, named: Collection[str] = ()) -> None:
        assert misfit.basis is not None
        self.misfit, self.basis = misfit, misfit.basis
        self._least, self._named = least, named
        self._left_out: dict[bytes, LeftOut] = {}
        self._known_effects: dict[int, Array] = {}

    @cached_property
    def _stacks(self) -> tuple[list[_Stack], IntArray]:
        """All directions, and the columns of the calibration to which not all are orthogonal."""
        n = len(self.misfit.residual)
        rows_of: dict[bytes, IntArray] = {}
        blocks_of: dict[bytes, dict[int, list[tuple[Array, Array, int, float]]]] = {}
        for number in np.flatnonzero(self._matters).tolist():
            one = self.misfit.hypotheses[number]
            if isinstance(one, AR1):
                continue
            first, least = 0, 0.0 if one.one_sided else -np.inf
            for rows, block in one.apply_sign().blocks:
                if not (width := block.shape[1]):
                    continue
                key = b"" if isinstance(rows, slice) else rows.tobytes()
                rows_of.setdefault(key, np.arange(n) if isinstance(rows, slice) else rows)
                share = one.prior_share[first : (first := first + width)]
                blocks_of.setdefault(key, {}).setdefault(width, []).append((block, share, number, least))
        stacks = []
        for key, rows in rows_of.items():
            directions: list[Array] = []
            blocks, last = [], 0
            for width, parts in blocks_of[key].items():
                own, shares, owners, least_of = zip(*parts, strict=True)
                directions += own
                place = slice(last, last := last + width * len(own))
                blocks.append(
                    _Blocks(place, np.sqrt(np.stack(shares)), np.array(owners), np.array(least_of)[:, None])
                )
            joined, place_of = np.empty((len(rows) + 1, last)), np.full(n, -1)
            np.concatenate(directions, axis=1, out=joined[:-1])
            joined[-1] = 0.0
            place_of[rows] = np.arange(len(rows))
            along = self.misfit.residual[rows] @ joined[:-1]
            overlap = np.asarray(self.basis[rows].T @ joined[:-1])
            stacks.append(_Stack(place_of, joined, along, overlap, tuple(blocks)))
        reach = [np.abs(one.overlap).max(axis=1) > MIN_OVERLAP for one in stacks]
        common = np.flatnonzero(np.any(reach, axis=0))
        return [replace(one, overlap=one.overlap[common]) for one in stacks], common

    def _effects(self, hypothesis: Hypothesis) -> Array:
        """What a hypothesis changes in all rows, all calibration projected out."""
        if id(hypothesis) not in self._known_effects:
            effects = hypothesis.directions * np.sqrt(hypothesis.prior_share) * hypothesis.length
            self._known_effects[id(hypothesis)] = effects - self.basis @ (self.basis.T @ effects)
        return self._known_effects[id(hypothesis)]

    def _leave_out(self, rows: IntArray) -> LeftOut:
        if rows.tobytes() not in self._left_out:
            self._left_out[rows.tobytes()] = LeftOut.of(self.basis, rows)
        return self._left_out[rows.tobytes()]

    @cached_property
    def _causes(self) -> list[str]:
        return [classify_cause(one) for one in self.misfit.hypotheses]

    @cached_property
    def _log_weight(self) -> Array:
        return weigh_hypotheses(self.misfit.hypotheses, self._causes)

    @cached_property
    def _matters(self) -> BoolArray:
        """Which hypotheses are tested anew without some rows, shape (H,)."""
        gained = np.array([self.refit_gain.get(cause, 0.0) for cause in self._causes])
        named = np.array([cause in self._named for cause in self._causes], dtype=bool)
        return named | (self.misfit.log_evidence + self._log_weight + gained >= self._least)

    @cached_property
    def refit_gain(self) -> dict[str, float]:
        """What refits have added to the evidence of each cause that was not dropped, in nats."""
        linear = average_by_cause(self._causes, self._log_weight, self.misfit.log_evidence)
        return {cause: own - linear[cause] for cause, own in self.misfit.log_evidence_by_cause.items()}

    def without(self, rows: IntArray) -> Misfit:
        """The test without some rows, its residual zero in them; neither p-value nor directions are new."""
        residual, left_out = self.misfit.residual, self._leave_out(rows)
        lost = left_out.coordinates(residual[rows, None])[:, 0]
        total = float(residual @ residual - lost @ lost)
        df = len(residual) - self.basis.shape[1] - left_out.own.shape[1]
        number = len(self.misfit.hypotheses)
        stacks, columns = self._stacks
        common = left_out.coordinates(self.basis[rows][:, columns].toarray())
        of_width: dict[int, list[tuple[_Blocks, Array, Array]]] = {}
        for stack in stacks:
            coordinates, along = stack.without(left_out, lost, common)
            for blocks in stack.blocks:
                part = blocks, coordinates[:, blocks.columns], along[blocks.columns]
                of_width.setdefault(blocks.root_share.shape[1], []).append(part)
        spectra = [_spectra(*zip(*parts, strict=True)) for parts in of_width.values()]
        if not spectra:  # nothing is left to test but memory
            spectra = [(np.zeros(0, dtype=np.intp), np.zeros((0, 1)), np.zeros((0, 1)))]
        owner, variance, squares = (
            np.concatenate([one.ravel() for one in parts]) for parts in zip(*spectra, strict=True)
        )
        share = variance / np.maximum(np.bincount(owner, variance, number), np.finfo(float).tiny)[owner]
        at_strength = []
        for strength in STRENGTHS:
            signal = strength**2 * share
            explained = np.bincount(owner, squares * signal / (1.0 + signal), number) / total
            spread = np.bincount(owner, np.log1p(signal), number)
            at_strength.append(log_likelihood_ratio(np.maximum(explained, 0.0), df) - 0.5 * spread)
        evidence = logsumexp(np.stack(at_strength), axis=0) - np.log(len(STRENGTHS))
        evidence = np.where(self._matters, evidence, self.misfit.log_evidence)
        left = left_out.remove(residual[:, None], self.basis)[:, 0]
        evidence = self._with_memory(evidence, rows, left, df)
        share = (len(residual) - len(rows)) / len(residual)
        linear = average_by_cause(self._causes, self._log_weight, evidence)
        by_cause = {cause: linear[cause] + share * by_refit for cause, by_refit in self.refit_gain.items()}
        return replace(self.misfit, residual=left, log_evidence=evidence, log_evidence_by_cause=by_cause)

    def _with_memory(self, evidence: Array, rows: IntArray, left: Array, df: int) -> Array:
        """The evidence with that of each AR(1), whose sequences go on after the rows left out."""
        kept = np.setdiff1d(np.arange(len(left)), rows)
        tested = ((k, self.misfit.hypotheses[k]) for k in np.flatnonzero(self._matters).tolist())
        ar1s = {k: one for k, one in tested if isinstance(one, AR1)}
        smaller = leave_out_rows((one.sequences for one in ar1s.values()), rows)
        others = [replace(one, sequences=smaller[id(one.sequences)]) for one in ar1s.values()]
        for number, own in zip(ar1s, log_memory_evidence(others, left[kept, None], df), strict=True):
            evidence[number] = own[0]
        return evidence

    def select(self, cause: str, without: Misfit, rows: IntArray) -> SelectedCause:
        """The cause as selected from the test `without` some rows, its test that of the others."""
        best = without.best_hypothesis(cause)
        test = self.restrict(without, [without.hypotheses.index(best)], rows)
        return make_selected(test, form_cause_set(without, cause))

    def restrict(self, without: Misfit, places: Sequence[int], rows: IntArray) -> Misfit:
        """The test of the rows that are left, of some hypotheses only, of those that have an effect there."""
        kept = np.setdiff1d(np.arange(len(without.residual)), rows)
        left_out, chosen = self._leave_out(rows), [without.hypotheses[place] for place in places]
        sequences = leave_out_rows((one.sequences for one in chosen if isinstance(one, AR1)), rows)
        own: list[Hypothesis | AR1 | None] = [
            replace(one, sequences=sequences[id(one.sequences)])
            if isinstance(one, AR1)
            else make_hypothesis(
                one.cause, one.version, one.values, left_out.remove(self._effects(one), self.basis)[kept]
            )
            for one in chosen
        ]
        # A jump in a session that is left out has no effect.
        left = [(place, one) for place, one in zip(places, own, strict=True) if one is not None]
        return replace(
            without,
            residual=without.residual[kept],
            basis=None,
            hypotheses=tuple(one for _, one in left),
            log_evidence=without.log_evidence[[place for place, _ in left]],
        )
