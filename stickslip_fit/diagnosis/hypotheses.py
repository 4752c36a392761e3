"""Hypotheses: what could be wrong in a log, each as a subspace of effects with a prior covariance.

The effect of a hypothesis is a sum of orthonormal directions with independent normal coefficients (a
low-rank prior covariance). Known causes give one hypothesis for each of their shapes. The alternatives
without a cause stand for "unknown": smooth or periodic in time, by configuration, harmonics of q2; memory has
no directions (`memory`). Directions confined to a session are stored for its rows only.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csr_array

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.linearized import LawBlock, LinearizedFit, select_filter, split_positions, whiten

VARIANCE_TOL = 1e-6  # share of a hypothesis's variance below which a direction is left out
EFFECT_TOL = 1e-6  # whitened norm; rounding noise of the projection
ABSORBED = 2.0 * EFFECT_TOL  # whitened; a trial without a hypothesis and with a larger effect has failed
SPARSE = 0.75  # share of rows with an effect, below which products leave out the others
MAX_EFFECT = 1e100  # whitened; the squares of larger ones are no numbers
MAX_MISSING = 3  # samples in a row, as where a value is set aside, before noise that persists is lost
SHRINK_FACTOR = 20.0  # on the size of a trial by which a joint would stall


type Block = tuple[IntArray | slice, Array]
"""Directions, shape (s, m), and the rows outside of which they are zero."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One shape that a cause's effect may have, of unknown size.

    The whitened effect is a sum of orthonormal directions with independent normal coefficients, whose
    variances are `share` times the square of the effect's strength.

    Attributes
    ----------
    cause : str
        ``unknown:...`` for an unstructured alternative.
    version : object
        The bound cause, or None.
    values : array, shape (q,) or None
        Of the cause's parameters, where it has one direction only.
    n : int
        Number of rows.
    blocks : sequence of (array of int, shape (s,), or slice; array, shape (s, m'))
        Directions, orthogonal to the calibration but for `shared`, and the rows outside of which they are
        zero: one block of all rows (a slice), or one for each session.
    prior_share : array, shape (m,)
        Of the directions, block by block; sums to 1.
    length : float
        Norm of the effect at `values`.
    one_sided : bool
        Whether the cause's bounds leave only the sign that its size has in `values`: the coefficient along
        its one direction is not negative.
    sign : array, shape (n,), or None
        1 or -1 in each row, times which the blocks are the directions; None for 1 in all rows. Effects that
        are alike or opposite by direction then have the same blocks.
    shared : array, shape (n, k), or None
        Basis of calibration still to be projected out of the blocks, beyond whose rows it reaches.
    """

    cause: str
    version: Any
    values: Array | None
    n: int
    blocks: Sequence[Block]
    prior_share: Array
    length: float
    one_sided: bool = False
    sign: Array | None = None
    shared: Array | None = None

    def apply_sign(self) -> Hypothesis:
        """The same hypothesis with its sign in the blocks."""
        if self.sign is None:
            return self
        blocks = tuple((rows, self.sign[rows, None] * block) for rows, block in self.blocks)
        return replace(self, blocks=blocks, sign=None)

    @property
    def directions(self) -> Array:
        """The directions in all rows, shape (n, m)."""
        directions, first = np.zeros((self.n, len(self.prior_share))), 0
        for rows, block in self.apply_sign().blocks:
            directions[rows, first : first + block.shape[1]] = block
            first += block.shape[1]
        return directions if self.shared is None else directions - self.shared @ self.shared_overlap

    @property
    def shared_overlap(self) -> Array:
        """Inner products of `shared` with the blocks, shape (k, m)."""
        assert self.shared is not None
        blocks = self.apply_sign().blocks
        return np.concatenate([self.shared[rows].T @ block for rows, block in blocks], axis=1)

    @property
    def largest_row_share(self) -> float:
        """The largest share of the effect's prior variance that a single row has."""
        if len(self.blocks) == 1:
            squares = np.square(self.blocks[0][1])
            return float((squares @ self.prior_share if squares.shape[1] > 1 else squares).max(initial=0.0))
        variance, first = np.zeros(self.n), 0
        for rows, block in self.blocks:
            variance[rows] += block**2 @ self.prior_share[first : first + block.shape[1]]
            first += block.shape[1]
        return float(variance.max(initial=0.0))

    def coefficients(self, residual: Array) -> Array:
        """Coefficient of a residual, shape (n,), along each direction; shape (m,)."""
        residual = residual if self.sign is None else self.sign * residual
        along = np.concatenate([block.T @ residual[rows] for rows, block in self.blocks])
        return np.maximum(along, 0.0) if self.one_sided else along

    def combine(self, coefficients: Array) -> Array:
        """Linear combination of the directions; (m,) -> (n,)."""
        return self.directions @ coefficients

    def explain(self, residual: Array) -> Array:
        """The part of a residual, shape (n,), along the directions."""
        return self.combine(self.coefficients(residual))

    def leverage(self, kept: Array) -> Array:
        """Leverage of each row if these shares of the directions are subtracted; (m,) -> (n,)."""
        return np.asarray(self.directions**2 @ kept)


def make_hypothesis(cause: str, version: Any, values: Array | None, effects: Array) -> Hypothesis | None:
    """A hypothesis whose effects are random combinations of columns, whitened and projected, shape (n, m).

    None where calibration absorbs the effects, where they are too large to be numbers, or where their
    eigenvalues do not converge.
    """
    if not np.abs(effects).max(initial=0.0) <= MAX_EFFECT:  # nor if any is no number
        return None
    n, rows = len(effects), find_rows(effects)
    effects = effects[rows]
    if effects.shape[1] == 1:
        column = effects.ravel()
        length = math.sqrt(column @ column)
        if length < EFFECT_TOL:
            return None
        block, one_sided = (rows, effects / length), is_one_sided(version, values)
        return Hypothesis(cause, version, values, n, (block,), np.ones(1), length, one_sided)
    try:
        variance, right = np.linalg.eigh(effects.T @ effects)
    except np.linalg.LinAlgError:
        return None
    total = float(variance.sum())
    if total < EFFECT_TOL**2:
        return None
    kept = variance > VARIANCE_TOL * total
    directions = effects @ right[:, kept] / np.sqrt(variance[kept])
    share, length = variance[kept] / total, float(np.sqrt(total))
    return Hypothesis(cause, version, values, n, ((rows, directions),), share, length)


def find_rows(effects: Array) -> IntArray | slice:
    """The rows outside of which effects, shape (n, m), are zero; all where these are nearly all."""
    acts = effects[:, 0] != 0 if effects.shape[1] == 1 else effects.any(axis=1)
    return np.flatnonzero(acts) if np.count_nonzero(acts) < SPARSE * len(effects) else slice(None)


def is_one_sided(version: Any, values: Array | None) -> bool:
    """Whether the bounds of a cause's size, its first parameter, exclude the other sign than it has here.

    Of a cause without effect at size 0; a size on the excluded side would be no better.
    """
    if version is None or values is None or version.null_values[0] != 0 or values[0] == 0:
        return False
    size = version.parameters[0]
    return bool(size.lower >= 0 if values[0] > 0 else size.upper <= 0)


@dataclass(frozen=True, eq=False)
class SessionFit:
    """One session of a linearized fit, s rows.

    Attributes
    ----------
    rows : array of int, shape (s,)
    parts : tuple of LawBlock
        With rows that are positions in the session.
    tables : tuple of dict of str to array
        Columns of each part's rows.
    blocks : tuple of (array of int, shape (m,), array, shape (m, p))
        Positions in the session, and the basis of its calibration there.
    shared : array, shape (n, k), or None
        Basis of what all sessions share, in all rows; None without any.
    scale : array, shape (s,)
    noise_filter : sparse array, shape (s, s), or None
        Both as of the `LinearizedFit`.
    """

    rows: IntArray
    parts: tuple[LawBlock, ...]
    tables: tuple[dict[str, npt.NDArray[Any]], ...]
    blocks: tuple[tuple[IntArray, Array], ...]
    shared: Array | None
    scale: Array
    noise_filter: csr_array | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def shared_basis(self) -> Array:
        """As `shared`, in the session's rows, shape (s, k)."""
        return np.zeros((len(self), 0)) if self.shared is None else self.shared[self.rows]

    def restrict(self, acts: BoolArray) -> SessionFit:
        """The rows of all blocks of calibration that have a row in which something acts, shape (n,)."""
        acts = acts[self.rows]
        reached = acts.copy()
        for places, _ in self.blocks:
            reached[places] |= acts[places].any()
        place = np.cumsum(reached) - 1
        blocks = tuple((place[places], basis) for places, basis in self.blocks if reached[places].any())
        return SessionFit(self.rows[reached], (), (), blocks, self.shared, self.scale[reached])

    def whiten(self, changes: Array) -> Array:
        """As of the `LinearizedFit`, shape (s, m)."""
        return whiten(changes, self.scale, self.noise_filter)

    def project(self, columns: Array) -> Array:
        """Project out the session's own calibration, shape (s, m)."""
        projected = columns.copy()
        for places, basis in self.blocks:
            projected[places] -= basis @ (basis.T @ columns[places])
        return projected


def split_sessions(linearized: LinearizedFit) -> dict[str, SessionFit]:
    """The sessions of a fit by name; each has its own blocks."""
    number, names = pd.factorize(linearized.rows["session"].astype(object))
    place, rows_of = np.empty(len(linearized), dtype=np.intp), split_positions(number)
    for rows in rows_of:
        place[rows] = np.arange(len(rows))
    blocks: list[list[tuple[IntArray, Array]]] = [[] for _ in names]
    for rows, basis in linearized.blocks:
        blocks[number[rows[0]]].append((place[rows], basis))
    parts: list[list[LawBlock]] = [[] for _ in names]
    tables: list[list[dict[str, npt.NDArray[Any]]]] = [[] for _ in names]
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        for inside in split_positions(number[part.rows]):
            rows = part.rows[inside]
            own = replace(part, rows=place[rows], block=part.block[inside], values=part.values[inside])
            parts[number[rows[0]]].append(own)
            tables[number[rows[0]]].append({name: values[inside] for name, values in table.items()})
    return {
        str(name): SessionFit(
            rows,
            tuple(parts[k]),
            tuple(tables[k]),
            tuple(blocks[k]),
            linearized.shared,
            linearized.scale[rows],
            select_filter(linearized.noise_filter, rows),
        )
        for k, (name, rows) in enumerate(zip(names, rows_of, strict=True))
    }


def build_session_hypotheses(
    cause: str, version: Any, values: Array, n: int, session: SessionFit, effects: Array
) -> list[Hypothesis]:
    """A hypothesis of each column, shape (s, m): whitened effects, orthogonal to the calibration."""
    squares = np.sum(effects**2, axis=0) - np.sum((session.shared_basis.T @ effects) ** 2, axis=0)
    lengths = np.sqrt(np.maximum(squares, EFFECT_TOL**2))
    directions = np.asfortranarray(effects / lengths)  # `group_directions` copies it column by column
    return [
        Hypothesis(
            cause,
            version,
            values[k],
            n,
            ((session.rows, directions[:, k : k + 1]),),
            np.ones(1),
            float(lengths[k]),
            is_one_sided(version, values[k]),
            shared=session.shared,
        )
        for k in np.flatnonzero(lengths > EFFECT_TOL)
    ]


def compute_effects(linearized: LinearizedFit | SessionFit, version: Any, trials: Array) -> Array:
    """Change of every response, whitened, calibration projected out; trials (m, q) -> (n, m)."""
    return linearized.project(linearized.whiten(compute_changes(linearized, version, trials)))


def compute_changes(linearized: LinearizedFit | SessionFit, version: Any, trials: Array) -> Array:
    """Change of every response; trials (m, q) -> (n, m).

    Where a law has no finite response (a joint would stall), the change at a smaller size, scaled up; 0 if
    that is not finite either (`find_failed`).
    """
    changes = _scale_stalled(linearized, version, trials)
    changes[:, find_failed(changes)] = 0.0
    return changes


def find_failed(changes: Array) -> BoolArray:
    """Trials that change a response by what is no number; (n, m) -> (m,)."""
    return ~np.isfinite(changes).all(axis=0)


def count_failed(linearized: LinearizedFit | SessionFit, version: Any, trials: Array) -> int:
    """Number of trials whose effect is no number, at a smaller size either; trials (m, q)."""
    return int(find_failed(_scale_stalled(linearized, version, trials)).sum())


def _scale_stalled(linearized: LinearizedFit | SessionFit, version: Any, trials: Array) -> Array:
    """As `compute_changes`, but not finite where the smaller size is not."""
    changes = _compute_changes(linearized, version, trials)
    if (stalled := find_failed(changes)).any():
        smaller, absent = trials[stalled].copy(), np.array(version.null_values)
        sizes = slice(None) if version.combine_trials else slice(0, 1)
        smaller[:, sizes] = absent[sizes] + (smaller[:, sizes] - absent[sizes]) / SHRINK_FACTOR
        changes[:, stalled] = SHRINK_FACTOR * _compute_changes(linearized, version, smaller)
    return changes


def _compute_changes(linearized: LinearizedFit | SessionFit, version: Any, trials: Array) -> Array:
    changes = np.zeros((len(linearized), len(trials)))
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        if acts_on(version, part.law):
            with np.errstate(divide="ignore", invalid="ignore"):  # what stalls is no number
                changes[part.rows] = version.changes(part.law, table, part.values, trials)
    return changes


def acts_on(version: Any, law: Any) -> bool:
    """Whether a cause acts on the joint of a law; every cause acts on a law without a joint."""
    if not hasattr(law, "joint"):
        return True
    return version.acts_on(law) if hasattr(version, "acts_on") else law.joint in version.joints


@dataclass(frozen=True, eq=False)
class FiniteEffects:
    """What one version of a cause changes at each trial of its parameters, whatever the noise.

    Attributes
    ----------
    cause : str
    version : object
        The bound cause.
    trials : array, shape (m, q)
    changes : array, shape (n, m)
        Of every response; of a version that acts in one session only, of that session's rows. 0 at a trial
        that has failed.
    failed : array of bool, shape (m,)
        Trials whose effect is no number.
    """

    cause: str
    version: Any
    trials: Array
    changes: Array
    failed: BoolArray


def compute_finite_effects(linearized: LinearizedFit, causes: Iterable[Any]) -> list[FiniteEffects]:
    """Every shape of every cause; the same for all fits with these laws and rows."""
    sessions, effects = split_sessions(linearized), []
    for cause in causes:
        for version, trials in cause.trials(linearized.rows):
            where = sessions[version.session] if version.session else linearized
            effects.append(compute_version_effects(where, cause.name, version, trials))
    return effects


def compute_version_effects(
    linearized: LinearizedFit | SessionFit, cause: str, version: Any, trials: Array
) -> FiniteEffects:
    """What a version of a cause changes at trials, shape (m, q), in the rows in which it acts."""
    changes = _scale_stalled(linearized, version, trials)
    failed = find_failed(changes)
    changes[:, failed] = 0.0
    return FiniteEffects(cause, version, trials, changes, failed)


def _begin_anew(session: SessionFit, version: Any, changes: Array) -> BoolArray:
    """Which sudden changes, shape (s, m), begin after more than `MAX_MISSING` samples that are missing.

    Noise that persists may have wandered anywhere meanwhile.
    """
    if session.noise_filter is None or not any(getattr(one, "sudden", False) for one in version.parameters):
        return np.zeros(changes.shape[1], dtype=bool)
    (table,) = session.tables
    spacing = np.diff(table["session_seconds"], prepend=-np.inf)
    after_gap = spacing > (MAX_MISSING + 1.5) * np.median(spacing)
    return np.asarray(after_gap[np.argmax(changes != 0, axis=0)])


@dataclass(frozen=True, eq=False)
class Candidates:
    """The hypotheses of causes, and how many of their trials there were and failed.

    Attributes
    ----------
    hypotheses : list of Hypothesis
    failed : dict of str to (int, int)
        Of each cause with trials that failed their number, and that of all its trials.
    """

    hypotheses: list[Hypothesis]
    failed: dict[str, tuple[int, int]]


def build_candidates(linearized: LinearizedFit, effects: Iterable[FiniteEffects]) -> Candidates:
    """A hypothesis of every shape of every cause."""
    hypotheses: list[Hypothesis] = []
    tried, failed = Counter[str](), Counter[str]()
    n, sessions = len(linearized), split_sessions(linearized)
    for one in effects:
        cause, version, trials = one.cause, one.version, one.trials
        tried[cause] += len(trials)
        if version.session:
            session = sessions[version.session]
            whitened = session.project(session.whiten(one.changes))
            lost = ~np.isfinite(whitened).all(axis=0)
            told = ~_begin_anew(session, version, one.changes)
            hypotheses += build_session_hypotheses(
                cause, version, trials[told], n, session, whitened[:, told]
            )
        else:
            whitened = linearized.project(linearized.whiten(one.changes))
            each = [slice(None)] if version.combine_trials else [slice(k, k + 1) for k in range(len(trials))]
            lost = np.zeros(len(trials), dtype=bool)
            for own in each:
                values = None if version.combine_trials else trials[own.start]
                hypothesis = make_hypothesis(cause, version, values, whitened[:, own])
                if hypothesis is not None:
                    hypotheses.append(hypothesis)
                else:
                    lost[own] = not np.abs(whitened[:, own]).max(initial=0.0) < ABSORBED
        failed[cause] += int(np.sum(one.failed | lost))
    return Candidates(
        hypotheses, {cause: (number, tried[cause]) for cause, number in failed.items() if number}
    )
