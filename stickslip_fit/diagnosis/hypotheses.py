"""Hypotheses: what could be wrong in a log, each as a subspace of effects with a prior covariance.

The effect of a hypothesis is a sum of orthonormal directions with independent normal coefficients (a
low-rank prior covariance). Known causes give one hypothesis for each of their shapes. The alternatives
without a cause stand for "unknown": smooth or periodic in time, by configuration, harmonics of q2, and
AR(1) noise. Effects confined to one session are stored sparse.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csc_array

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.linearized import LawBlock, LinearizedFit, split_positions
from stickslip_fit.logs.history import previous_rows

# Directions that hold less than this share of a hypothesis's effect are left out.
VARIANCE_TOL = 1e-6
EFFECT_TOL = 1e-6  # repeatabilities; rounding noise of what recalibration absorbs


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One shape that a cause's effect may have, of unknown size.

    The effect, in units of the noise, is a sum of orthonormal directions with independent normal sizes whose
    variances are `share` times the square of the effect's strength.

    Attributes
    ----------
    cause : str
        Whose shape it is; ``unknown`` for structure that no cause has.
    version : object
        The bound cause, or None.
    values : array, shape (q,) or None
        Of the cause's parameters, where it is one shape only.
    columns : array or sparse array, shape (n, m)
        Orthonormal, recalibration taken out; sparse where sessions keep to themselves.
    share : array, shape (m,)
        Adds up to 1.
    length : float
        Strength of the effect as it was tried.
    """

    cause: str
    version: Any
    values: Array | None
    columns: Array | csc_array
    share: Array
    length: float

    @property
    def directions(self) -> Array:
        """As `stored`, never sparse."""
        return self.columns if isinstance(self.columns, np.ndarray) else self.columns.toarray()

    def along(self, residual: Array) -> Array:
        """A residual, shape (n,), along each direction; shape (m,)."""
        return np.asarray(self.columns.T @ residual)

    def combine(self, sizes: Array) -> Array:
        """The directions, so much of each, added up; (m,) -> (n,)."""
        return np.asarray(self.columns @ sizes)

    def leverage(self, kept: Array) -> Array:
        """Share of each row's noise that goes if so much of each direction is kept; (m,) -> (n,)."""
        return np.asarray(self.columns**2 @ kept)


def make_hypothesis(cause: str, version: Any, values: Array | None, effects: Array) -> Hypothesis | None:
    """Make a hypothesis of effects with recalibration taken out, shape (n, m), that are equally likely.

    Returns
    -------
    Hypothesis, or None
        None where the effects are nothing, because recalibration absorbs them.
    """
    if effects.shape[1] == 1:
        length = float(np.linalg.norm(effects))
        if length < EFFECT_TOL:
            return None
        return Hypothesis(cause, version, values, effects / length, np.ones(1), length)
    variance, right = np.linalg.eigh(effects.T @ effects)
    total = float(variance.sum())
    if total < EFFECT_TOL**2:
        return None
    kept = variance > VARIANCE_TOL * total
    directions = effects @ right[:, kept] / np.sqrt(variance[kept])
    return Hypothesis(cause, version, values, directions, variance[kept] / total, float(np.sqrt(total)))


MAX_SPARSE_DENSITY = 0.1  # share of numbers that are not 0; above, arithmetic is faster with all of them


@dataclass(frozen=True, eq=False)
class SessionFit:
    """One session of a study, s rows.

    Attributes
    ----------
    rows : array of int, shape (s,)
    parts : tuple of Part
        With rows that are places in the session.
    tables : tuple of dict of str to array
        Columns of each part's rows.
    blocks : tuple of (array of int, shape (m,), array, shape (m, p))
        Places in the session, and what recalibration can do there.
    shared_basis : array, shape (s, k)
        What all sessions can only do together.
    """

    rows: IntArray
    parts: tuple[LawBlock, ...]
    tables: tuple[dict[str, npt.NDArray[Any]], ...]
    blocks: tuple[tuple[IntArray, Array], ...]
    shared_basis: Array

    def __len__(self) -> int:
        return len(self.rows)

    def project(self, columns: Array) -> Array:
        """Take out what the session's own recalibration would absorb, shape (s, m)."""
        left = columns.copy()
        for subset, basis in self.blocks:
            left[subset] -= basis @ (basis.T @ columns[subset])
        return left


def split_sessions(linearized: LinearizedFit) -> dict[str, SessionFit]:
    """The sessions of a study by name; each has its own blocks."""
    number, names = pd.factorize(linearized.rows["session"].astype(object))
    place, rows = np.empty(len(linearized), dtype=np.intp), split_positions(number)
    for subset in rows:
        place[subset] = np.arange(len(subset))
    blocks: list[list[tuple[IntArray, Array]]] = [[] for _ in names]
    for subset, basis in linearized.blocks:
        blocks[number[subset[0]]].append((place[subset], basis))
    parts: list[list[tuple[LawBlock, dict[str, npt.NDArray[Any]]]]] = [[] for _ in names]
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        for subset in split_positions(number[part.rows]):
            at = part.rows[subset]
            own = replace(part, rows=place[at], block=part.block[subset], values=part.values[subset])
            parts[number[at[0]]].append((own, {name: values[subset] for name, values in table.items()}))
    return {
        str(name): SessionFit(
            subset,
            tuple(part for part, _ in parts[k]),
            tuple(table for _, table in parts[k]),
            tuple(blocks[k]),
            linearized.shared_basis[subset],
        )
        for k, (name, subset) in enumerate(zip(names, rows, strict=True))
    }


def build_session_hypotheses(
    cause: str, version: Any, values: Array, n: int, session: SessionFit, effects: Array
) -> list[Hypothesis]:
    """A hypothesis of each column, shape (s, m): effects in units of the noise, recalibration taken out."""
    squares = np.sum(effects**2, axis=0) - np.sum((session.shared_basis.T @ effects) ** 2, axis=0)
    lengths = np.sqrt(np.maximum(squares, EFFECT_TOL**2))
    directions = effects / lengths
    if few := len(session) > MAX_SPARSE_DENSITY * n:
        everywhere = np.zeros((n, effects.shape[1]))
        everywhere[session.rows] = directions

    def stored(k: int) -> Array | csc_array:
        if few:
            return everywhere[:, k : k + 1]
        return csc_array((directions[:, k], session.rows, [0, len(session)]), shape=(n, 1))

    shown = np.flatnonzero(lengths > EFFECT_TOL)
    return [
        Hypothesis(cause, version, values[k], stored(int(k)), np.ones(1), float(lengths[k])) for k in shown
    ]


def build_per_session_hypotheses(
    names: Sequence[str], n: int, every: Sequence[SessionFit], effects: Array
) -> list[Hypothesis]:
    """A hypothesis of each name, whose effects every session has in sizes of its own.

    Parameters
    ----------
    names : sequence of str
    n : int
        Rows of the study.
    every : sequence of Session
    effects : array, shape (n, number of names, w)
        In units of the noise; each session's rows are its own effects.
    """
    width = effects.shape[2]
    directions, variances = np.zeros_like(effects), []
    for session in every:
        flat = effects[session.rows].reshape(len(session.rows), -1)
        own = session.project(flat).reshape(len(session.rows), len(names), width).transpose(1, 0, 2)
        shared = np.einsum("sk,psw->pkw", session.shared_basis, own)
        products = own.transpose(0, 2, 1) @ own - shared.transpose(0, 2, 1) @ shared
        variance, right = np.linalg.eigh(products)
        length = np.sqrt(np.maximum(variance, EFFECT_TOL**2))[:, None, :]
        directions[session.rows] = (own @ (right / length)).transpose(1, 0, 2)
        variances.append(np.maximum(variance, 0.0))
    order = np.concatenate([session.rows for session in every])
    ends = np.cumsum([0, *(len(session.rows) for session in every)])
    starts = (n * np.arange(width)[:, None] + ends[:-1]).ravel()
    found = []
    for k, name in enumerate(names):
        variance = np.stack([each[k] for each in variances], axis=1).ravel()
        if (total := float(variance.sum())) < EFFECT_TOL**2:
            continue
        filled = directions[order, k].T.ravel()
        columns = csc_array((filled, np.tile(order, width), [*starts, n * width]), shape=(n, len(starts)))
        kept = variance > VARIANCE_TOL * total
        columns = columns if kept.all() else csc_array(columns[:, np.flatnonzero(kept)])
        few = columns.nnz > MAX_SPARSE_DENSITY * n * columns.shape[1]
        found.append(
            Hypothesis(
                name, None, None, columns.toarray() if few else columns, variance[kept] / total, total**0.5
            )
        )
    return found


SHRINK_FACTOR = 20.0


def compute_effects(linearized: LinearizedFit, version: Any, trials: Array) -> Array:
    """Change of every response, in units of its noise, recalibration taken out; trials (m, q) -> (n, m)."""
    return linearized.project(compute_changes(linearized, version, trials) / linearized.scale[:, None])


def compute_session_effects(
    linearized: LinearizedFit, session: SessionFit, version: Any, trials: Array
) -> Array:
    """As `effects`, of a version that acts in one session alone, s rows; trials (m, q) -> (s, m)."""
    return session.project(compute_changes(session, version, trials) / linearized.scale[session.rows, None])


def compute_changes(linearized: LinearizedFit | SessionFit, version: Any, trials: Array) -> Array:
    """Change of every response; trials (m, q) -> (n, m).

    A trial by which a law has no answer (a joint would stall) stands for a smaller one of its kind; without
    effect if that has none either.
    """
    found = _compute_changes(linearized, version, trials)
    if (stalled := ~np.isfinite(found).all(axis=0)).any():
        smaller, absent = trials[stalled].copy(), np.array(version.absent)
        sizes = slice(None) if version.joined else slice(0, 1)
        smaller[:, sizes] = absent[sizes] + (smaller[:, sizes] - absent[sizes]) / SHRINK_FACTOR
        again = SHRINK_FACTOR * _compute_changes(linearized, version, smaller)
        found[:, stalled] = np.where(np.isfinite(again).all(axis=0), again, 0.0)
    return found


def _compute_changes(linearized: LinearizedFit | SessionFit, version: Any, trials: Array) -> Array:
    found = np.zeros((len(linearized), len(trials)))
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        if acts_on(version, part.law):
            found[part.rows] = version.changes(part.law, table, part.values, trials)
    return found


def acts_on(version: Any, law: Any) -> bool:
    """Whether a cause concerns a law; laws of joints say of which one, and causes on which ones they act."""
    return not hasattr(law, "joint") or law.joint in version.joints


def build_candidates(linearized: LinearizedFit, causes: Iterable[Any]) -> list[Hypothesis]:
    """Every shape of every cause."""
    found: list[Hypothesis | None] = []
    every = split_sessions(linearized)
    for cause in causes:
        for version, trials in cause.trials(linearized.rows):
            if version.session:
                session = every[version.session]
                shape = compute_session_effects(linearized, session, version, trials)
                found += build_session_hypotheses(
                    cause.name, version, trials, len(linearized), session, shape
                )
                continue
            columns = compute_effects(linearized, version, trials)
            if version.joined:
                found.append(make_hypothesis(cause.name, version, None, columns))
            else:
                found += [
                    make_hypothesis(cause.name, version, trial, column[:, None])
                    for trial, column in zip(trials, columns.T, strict=True)
                ]
    return [each for each in found if each is not None]


@dataclass(frozen=True, eq=False)
class AR1:
    """A first-order autoregression of the residuals, which no cause gives.

    Attributes
    ----------
    cause : str
    before : array of int, shape (n,)
        The row before each row, -1 for the first of a sequence.
    coefficient : float
        Share of a residual that the next one keeps.
    """

    cause: str
    before: npt.NDArray[np.intp]
    coefficient: float
    version: None = None
    values: None = None

    def log_evidence(self, residuals: Array, df: int) -> Array:
        """Log likelihood ratio to noise without memory, its size unknown; (n, k) -> (k,)."""
        follows = self.before >= 0
        earlier = np.where(follows[:, None], residuals[self.before], 0.0)
        new = residuals - self.coefficient * earlier
        new[~follows] *= np.sqrt(1.0 - self.coefficient**2)
        ratio = np.sum(new**2, axis=0) / np.sum(residuals**2, axis=0)
        sequences = int(np.sum(~follows))
        return -0.5 * df * np.log(ratio) + 0.5 * sequences * np.log1p(-(self.coefficient**2))

    def shape(self, residual: Array) -> Array:
        """What memory predicts of each residual, shape (n,)."""
        return np.where(self.before >= 0, self.coefficient * residual[self.before], 0.0)


N_WAVES = 6
MAX_PERIODS = 250
MAX_ELEMENTS = 20_000_000  # held for the departures of configurations; with more they are not looked for
MIN_TRAVERSES_PER_PERIOD = 2.5  # traverses
AR1_COEFFICIENTS = (-0.3, 0.2, 0.35, 0.5, 0.65, 0.8)


def build_unstructured_alternatives(linearized: LinearizedFit) -> list[Hypothesis | AR1]:
    """Every structure that the rows have the columns for."""
    every, rows = list(split_sessions(linearized).values()), linearized.rows
    seconds, session = (
        rows["session_seconds"].to_numpy(float),
        pd.factorize(rows["session"].astype(object))[0],
    )
    waves = _smooth_in_time(seconds, session) / linearized.scale[:, None]
    found: list[Hypothesis | AR1 | None] = [
        make_hypothesis(
            f"unknown:{name}", None, None, linearized.project(columns / linearized.scale[:, None])
        )
        for name, columns in (*_configuration_indicators(rows), *_harmonics(rows))
    ]
    found.append(
        make_hypothesis("unknown:time, the same in each session", None, None, linearized.project(waves))
    )
    found += build_per_session_hypotheses(["unknown:time"], len(rows), every, waves[:, None])
    for joint in rows["joint"].unique():
        subset = (rows["joint"] == joint).to_numpy()[:, None]
        found += build_per_session_hypotheses(
            [f"unknown:time, joint {joint}"], len(rows), every, (waves * subset)[:, None]
        )
    order = rows.groupby(session).cumcount().to_numpy(float)
    for clock, unit, called in ((seconds, 60.0, "min"), (order, 1.0, "traverses")):
        periods = _choose_periods(clock, session)
        angles = 2 * np.pi * clock[:, None] / periods
        pairs = np.stack([np.cos(angles), np.sin(angles)], axis=-1) / linearized.scale[:, None, None]
        names = [f"unknown:period of {period / unit:.1f} {called}" for period in periods]
        found += build_per_session_hypotheses(names, len(rows), every, pairs)
    return [each for each in found if each is not None] + list(_ar1_alternatives(rows))


def _smooth_in_time(seconds: Array, session: npt.NDArray[np.intp]) -> Array:
    """Smooth in time, from each session's beginning to its end, shape (n, waves)."""
    last = pd.Series(seconds).groupby(session).transform("max").to_numpy()
    phase = seconds / np.maximum(last, 1.0)
    return np.stack([np.cos(np.pi * k * phase) / k for k in range(1, N_WAVES + 1)], axis=-1)


def _configuration_indicators(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    """A departure of each configuration, where these come back often enough to show it."""
    kinds = number_configurations(rows)
    if kinds.max() < len(rows) / 3 and 3 * kinds.max() * len(rows) < MAX_ELEMENTS:
        backwards = (rows["direction"] == "-").to_numpy()
        yield "configuration", np.eye(kinds.max() + 1)[kinds]
        yield "configuration and direction", np.eye(2 * kinds.max() + 2)[2 * kinds + backwards]


def _harmonics(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    """Waves of q2 that joint 3's law has not, one by one and together."""
    subset = (rows["joint"] == 3).to_numpy()
    if not subset.any():
        return
    q2 = np.nan_to_num(rows["q2"].to_numpy(float))
    columns = np.stack([f(k * q2) for k in (2, 3, 4) for f in (np.cos, np.sin)], axis=-1) * subset[:, None]
    yield "harmonics of q2, joint 3", columns
    for column, name in zip(columns.T, ("cos 2", "sin 2", "cos 3", "sin 3", "cos 4", "sin 4"), strict=True):
        yield f"{name} q2, joint 3", column[:, None]


def _choose_periods(clock: Array, session: npt.NDArray[np.intp]) -> Array:
    """Periods that a session is long enough for and its traverses dense enough, evenly in frequency."""
    order = np.lexsort((clock, session))
    apart = np.diff(clock[order])[np.diff(session[order]) == 0]
    if not (apart > 0).any():
        return np.zeros(0)
    longest, step = float(clock.max()), float(np.median(apart[apart > 0]))
    if longest < 4 * MIN_TRAVERSES_PER_PERIOD * step:
        return np.zeros(0)
    slowest, fastest = 2.0 / longest, 1.0 / (MIN_TRAVERSES_PER_PERIOD * step)
    number = min(MAX_PERIODS, int(np.ceil(2.0 * longest * (fastest - slowest))))
    return np.asarray(1.0 / np.linspace(slowest, fastest, number))


def _ar1_alternatives(rows: pd.DataFrame) -> Iterator[AR1]:
    session = pd.factorize(rows["session"].astype(object))[0]
    joint = rows["joint"].to_numpy()
    for name, group in (("", session), (" of each joint", 10 * session + joint)):
        before = previous_rows(group.astype(np.int64)).astype(np.intp)
        for carried in AR1_COEFFICIENTS:
            yield AR1(f"unknown:memory{name}", before, carried)


def number_configurations(rows: pd.DataFrame) -> npt.NDArray[np.intp]:
    """A number for each configuration: joint, where the others stand, base, and the stretch, not the way."""
    ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1)
    keys = rows[["joint", "q1", "q2", "q3", "theta", "psi"]].astype(float).fillna(9.0)
    keys = np.column_stack([keys.to_numpy(), ends]).round(6)
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()
