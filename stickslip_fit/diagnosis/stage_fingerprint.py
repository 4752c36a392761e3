"""Fingerprints of changes of a stage: what each would do to the counts of one joint and direction.

At one lambda after the other the physical law is fitted to counts without the change; then each change is
fitted to what is left. Its effect on every count is exact, that of the law's own parameters on it linear.
`stage_change` says what each change does to the law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.linearized import RANK_TOL
from stickslip_fit.estimation._groups import group_rows
from stickslip_fit.estimation._problem import DEFAULT_OPTIONS, JointProblem, single_problem
from stickslip_fit.estimation.drive_ratio import RATIOS, laws_by_width, stack_ratios, start_at
from stickslip_fit.laws import FRICTION_LIMITED
from stickslip_fit.laws.physical import POWERS, Physical
from stickslip_fit.machine import Machine

FREE = "free"
SINGLE = tuple(POWERS)  # of mass is friction's with the sign reversed
CHANGES = (*SINGLE, FREE)
DIRECTIONS = np.array([*([power, (0, 0, 0)] for power in POWERS.values()), [(1, 0, 0), (0, 1, 0)]])
"""To which a_f T1^2, r and lambda are multiplied by each of a change's sizes, shape (4, 2, 3)."""
EVERYWHERE = (*RATIOS, FRICTION_LIMITED)
NEAR = (*RATIOS[::2], FRICTION_LIMITED)  # between which is looked for lambda where it is likely
REFINEMENTS = 2
REFITS, FINER = 2, 6  # of the law without the change that fits best, each at ever closer lambdas
UNLIKELY = 60.0  # deviance beyond the least, in units of the noise, of a lambda that is not looked at
LARGEST_EXCESS = 6.0  # standard deviations; where the best change leaves more, all lambdas are looked at
MAX_SPREAD = 3.0  # variance of residuals over that of the noise; beyond it the physical law does not hold
MOST_LEFT = 0.9  # of the excess; where all lambdas leave more, the law is not refitted once more
MAX_ITERATIONS = 60  # of the law's own fit
STEPS = 5  # of Gauss-Newton in the size of a change
DIFFERENCE = 1e-3
MAX_COUNTS = 50_000  # at a time
ALIKE = 1e-6  # relative difference of deviances
LARGEST = 0.5  # logarithm of a change
TINY, SINGULAR = 1e-9, 1e-6  # information of which counts say nothing, and relative to the most


@dataclass(frozen=True, eq=False)
class ChangeFit:
    """Least squares of a change's size s at one lambda: `deviance` + (s - size) information (s - size).

    Attributes
    ----------
    deviance : float
        Sum of squares of the residuals in units of the noise.
    size : array, shape (k,)
        Logarithm of what a quantity is multiplied by, where the course is 1; of a free change those of the
        step size without load and of r.
    information : array, shape (k, k)
    """

    deviance: float
    size: Array
    information: Array


IMPOSSIBLE = {
    name: ChangeFit(np.inf, np.zeros(k), np.zeros((k, k)))
    for name, k in {**dict.fromkeys(SINGLE, 1), FREE: 2}.items()
}


@dataclass(frozen=True, eq=False)
class Fingerprint:
    """All changes fitted to the traverses of one joint and direction.

    Attributes
    ----------
    ratios : array, shape (m,)
        The lambdas, in rising order.
    fits : tuple of mapping of str to ChangeFit
        At each, by change: those of `SINGLE` and `FREE`; of infinite deviance where lambda is too unlikely.
    df : array of int, shape (m,)
        Of the residuals that a free change leaves.
    """

    joint: int
    direction: str
    ratios: Array
    fits: tuple[dict[str, ChangeFit], ...]
    df: IntArray

    @property
    def excess(self) -> float:
        """Deviance that the best of the single changes leaves beyond noise's, in standard deviations."""
        deviance = np.array([_least(fits) for fits in self.fits])
        return float(np.min((deviance - self.df) / np.sqrt(2.0 * self.df)))

    @property
    def spread(self) -> float:
        """Variance of the residuals beside the noise's; at least 1."""
        return max(1.0, float(np.min(self._best / self.df)))

    @property
    def penalty(self) -> Array:
        """What laws of more parameters pay for them as in Akaike's criterion, as a deviance, shape (m,)."""
        return np.asarray(2.0 * self.spread * (self.df.max() - self.df), float)

    @property
    def least(self) -> float:
        """The deviance that the best change leaves, free or into the other regime, with the penalty."""
        return float(np.min(self._best + self.penalty))

    @property
    def _best(self) -> Array:
        """The least deviance at each lambda, shape (m,)."""
        return np.array([min(fit.deviance for fit in fits.values()) for fits in self.fits])

    def log_ratio(self, excess: Array) -> Array:
        """Twice the log likelihood ratio of deviances that differ so; the residuals tell the noise."""
        df = int(self.df.max())
        return df * np.log1p(np.maximum(excess, 0.0) / (df * self.spread))


def fit_changes(
    joint: int,
    direction: str,
    rows: pd.DataFrame,
    machine: Machine,
    response: Array,
    effect: Array,
    scale: Array,
    course: Array,
) -> Fingerprint:
    """Fit every change to the traverses of one joint and direction.

    Parameters
    ----------
    rows : DataFrame
        n traverses.
    response : array, shape (n,)
        log(steps).
    effect : array, shape (n,)
        The part of it that is the finding's, as the diagnosis fitted it.
    scale : array, shape (n,)
        Standard deviation of the responses.
    course : array, shape (n,)
        How far the change is on at each traverse, 1 at most.
    """
    groups = group_rows(rows)
    order = np.argsort(groups.of_row, kind="stable")
    rows, effect = rows.iloc[order].reset_index(drop=True), effect[order]
    first = np.r_[0, np.cumsum(groups.sizes)[:-1]]
    data = response[order], scale[order], course[order]
    problems = {
        len(laws[0].parameters): single_problem(laws[0], rows, DEFAULT_OPTIONS)
        for laws in laws_by_width(joint, rows, machine, EVERYWHERE)
    }
    traverses = _Traverses(joint, direction, rows, machine, *data, first, problems)
    found = traverses.fit_near(effect)
    if found.excess < LARGEST_EXCESS:
        return found
    # Of a change that takes some loads from one regime to the other, the finding's effect may be far off, and
    # with it the lambda that fits best without it.
    wide = found
    for _ in range(REFITS):
        wide, effect = traverses.fit_everywhere(effect)
        if wide.spread >= MAX_SPREAD and wide.excess > MOST_LEFT * found.excess:
            break  # the finding's effect is not why the law does not hold
    return min(found, wide, key=lambda one: one.excess)


@dataclass(frozen=True, eq=False)
class _LawFit:
    """The law at one lambda, fitted to n traverses without a change; p parameters.

    Attributes
    ----------
    values : array, shape (n, p)
        Of each traverse's session.
    basis : array, shape (n, p)
        Orthonormal columns of each session's own Jacobian, in units of the noise; 0 for those that it lacks.
    residual : array, shape (n,)
        In units of the noise, orthogonal to `basis`.
    df : int
        Of the residuals.
    """

    law: Physical
    values: Array
    basis: Array
    residual: Array
    df: int

    @property
    def ratio(self) -> float:
        """Of the law."""
        return self.law.ratios[0]

    @property
    def square(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)


@dataclass(frozen=True, eq=False)
class _Traverses:
    """The traverses of one joint and direction, session by session from those at `first`."""

    joint: int
    direction: str
    rows: pd.DataFrame
    machine: Machine
    response: Array
    scale: Array
    course: Array
    first: IntArray
    problems: Mapping[int, JointProblem]
    """By the number of parameters of the law."""

    def fit_near(self, effect: Array) -> Fingerprint:
        """Changes at the lambdas that are likely once `effect` is taken out."""
        before = self._fit_laws(NEAR, effect)
        for _ in range(REFINEMENTS):
            squares = {ratio: at.square for ratio, at in before.items()}
            before |= self._fit_laws(_middles_beside_best(squares), effect)
        squares = {ratio: at.square for ratio, at in before.items()}
        least, df = min(squares.values()), max(at.df for at in before.values())
        most = least + UNLIKELY * max(1.0, least / max(df, 1))
        fits = self._fit_all([at for at in before.values() if at.square < most])
        return self._fingerprint(before, dict.fromkeys(before, IMPOSSIBLE) | fits)

    def fit_everywhere(self, effect: Array) -> tuple[Fingerprint, Array]:
        """Changes at every lambda, and what the one that fits best does to each count, shape (n,)."""
        before: dict[float, _LawFit] = {}
        fits: dict[float, dict[str, ChangeFit]] = {}
        ratios: Sequence[float] = EVERYWHERE
        for _ in range(FINER):
            found = self._fit_laws(ratios, effect)
            before |= found
            fits |= self._fit_all(list(found.values()))
            ratios = _middles_beside_best({ratio: _least(own) for ratio, own in fits.items()})
        ratio = min(fits, key=lambda one: _least(fits[one]))
        kind = int(np.argmin([fits[ratio][name].deviance for name in SINGLE]))
        size = np.array([[fits[ratio][SINGLE[kind]].size[0], 0.0]])
        best = self._effects([before[ratio]]).by(np.array([kind]), np.array([0]), size, self.course)
        return self._fingerprint(before, fits), best[0]

    def _fit_laws(self, ratios: Iterable[float], effect: Array) -> dict[float, _LawFit]:
        """The law at each lambda, without an effect."""
        fits: dict[float, _LawFit] = {}
        for laws in laws_by_width(self.joint, self.rows, self.machine, ratios):
            fits |= {fit.ratio: fit for fit in self._fit_alike(laws, effect)}
        return fits

    def _fit_alike(self, laws: Sequence[Physical], effect: Array) -> list[_LawFit]:
        """Laws of the same parameters, all at once."""
        ratios, shape = np.array([law.ratios[0] for law in laws]), (len(laws), len(self.response), -1)
        problem = replace(self.problems[len(laws[0].parameters)], y=self.response - effect)
        every = stack_ratios(problem, laws[0], ratios)
        starts = np.concatenate([start_at(problem, ratio) for ratio in ratios])
        minimum = every.minimize(np.tile(1.0 / self.scale**2, len(laws)), starts, MAX_ITERATIONS)
        values = minimum.values[every.groups.of_row]
        slopes = every.model(values)[1].reshape(shape) / self.scale[:, None]
        basis = np.zeros_like(slopes)
        for begin, end in zip(self.first, [*self.first[1:], len(self.scale)], strict=True):
            own = _orthonormalize(slopes[:, begin:end])
            basis[:, begin:end, : own.shape[-1]] = own
        residuals = self._project(minimum.residual.reshape(shape[:2]) / self.scale, basis)
        ranks = np.round(np.sum(basis**2, axis=(1, 2))).astype(int)
        found = zip(laws, values.reshape(shape), basis, residuals, shape[1] - ranks, strict=True)
        return [_LawFit(law, own, q, residual, int(df)) for law, own, q, residual, df in found]

    def _project(self, columns: Array, basis: Array) -> Array:
        """What each of k bases, shape (k, n, p), leaves of columns in units of the noise, shape (k, n)."""
        along = np.add.reduceat(basis * columns[..., None], self.first, axis=1)
        sizes = np.diff(self.first, append=columns.shape[1])
        return columns - np.einsum("knp,knp->kn", basis, np.repeat(along, sizes, axis=1))

    def _fit_all(self, laws: Sequence[_LawFit]) -> dict[float, dict[str, ChangeFit]]:
        """Every change at every lambda."""
        fits: dict[float, dict[str, ChangeFit]] = {}
        for width in sorted({at.values.shape[1] for at in laws}):
            alike = [at for at in laws if at.values.shape[1] == width]
            found = self._fit_changes(alike)
            for k, at in enumerate(alike):
                fits[at.ratio] = dict(zip(CHANGES, found[k :: len(alike)], strict=True))
        return fits

    def _fit_changes(self, laws: Sequence[_LawFit]) -> list[ChangeFit]:
        """One change after the other, each at every lambda."""
        effects, bases = self._effects(laws), np.stack([at.basis for at in laws])
        kind, place = np.divmod(np.arange(len(CHANGES) * len(laws)), len(laws))

        def projected(some: IntArray, size: Array) -> Array:
            change = effects.by(kind[some], place[some], size, self.course)
            return self._project(change / self.scale, bases[place[some]])

        target = self._project((self.response - effects.unchanged) / self.scale, bases)
        return _fit_sizes(projected, target[place], kind == CHANGES.index(FREE))

    def _effects(self, laws: Sequence[_LawFit]) -> StageEffects:
        values, ratios = np.stack([at.values for at in laws]), np.array([at.ratio for at in laws])
        return StageEffects(laws[0].law, self.rows, values, ratios)

    def _fingerprint(
        self, before: Mapping[float, _LawFit], fits: Mapping[float, dict[str, ChangeFit]]
    ) -> Fingerprint:
        ratios = sorted(fits)
        df = np.array([max(before[ratio].df - 2, 1) for ratio in ratios])
        own = tuple(fits[ratio] for ratio in ratios)
        return Fingerprint(self.joint, self.direction, np.array(ratios), own, df)


def _orthonormalize(columns: Array) -> Array:
    """Orthonormal bases of k sets of columns, (k, m, p); columns that a set lacks are 0."""
    length = np.linalg.norm(columns, axis=1, keepdims=True)
    left, singular, _ = svd(columns / np.where(length > 0, length, 1.0))
    least = RANK_TOL * np.maximum(singular.max(axis=1, initial=0.0), np.finfo(float).tiny)
    return left * (singular > least[:, None])[:, None]


def _least(fits: Mapping[str, ChangeFit]) -> float:
    """The deviance that the best of the single changes leaves."""
    return min(fits[name].deviance for name in SINGLE)


def _middles_beside_best(deviance: Mapping[float, float]) -> list[float]:
    """Middles of the intervals beside the lambda that fits best.

    All above the largest 1 + r fit alike but for rounding; of these it is the least, next to others.
    """
    ratios, most = sorted(deviance), min(deviance.values()) * (1.0 + ALIKE)
    best = next(k for k, ratio in enumerate(ratios) if deviance[ratio] <= most)
    return [(ratios[k] + ratios[k + 1]) / 2 for k in (best - 1, best) if 0 <= k < len(ratios) - 2]


def _fit_sizes(
    effect: Callable[[IntArray, Array], Array], target: Array, is_free: BoolArray
) -> list[ChangeFit]:
    """Gauss-Newton in the sizes of q changes at once; a step after which the joint stalls is halved.

    Parameters
    ----------
    effect : callable
        Of some changes, positions of shape (a,) and sizes of shape (a, 2), to effects of shape (a, n).
    target : array, shape (q, n)
    is_free : array of bool, shape (q,)
        Whether a change has two sizes.
    """
    size, now = np.zeros((len(target), 2)), np.zeros_like(target)

    def differentiate(some: IntArray) -> Array:
        both = some[is_free[some]]
        every = np.concatenate([some, both])
        steps = np.repeat(DIFFERENCE * np.eye(2), [len(some), len(both)], axis=0)
        moved = (effect(every, size[every] + steps) - now[every]) / DIFFERENCE
        found = np.zeros((len(some), 2, target.shape[1]))
        found[:, 0], found[is_free[some], 1] = moved[: len(some)], moved[len(some) :]
        return found

    slopes = differentiate(np.arange(len(target)))
    information = slopes @ slopes.swapaxes(1, 2)
    told = np.all(np.isfinite(information), axis=(1, 2)) & ~(information.max(axis=(1, 2)) < TINY)
    information[~told] = 0.0
    active = np.flatnonzero(told)
    for _ in range(STEPS):
        if not len(active):
            break
        rest = target[active] - now[active]
        inverse = np.linalg.pinv(information[active], SINGULAR**2, hermitian=True)
        step = np.einsum("aij,ajn,an->ai", inverse, slopes[active], rest, optimize=True)
        proposed = np.clip(size[active] + step, -LARGEST, LARGEST)
        new = effect(active, proposed)
        while len(stalls := np.flatnonzero(~np.all(np.isfinite(new), axis=1))):
            proposed[stalls] = (size[active[stalls]] + proposed[stalls]) / 2
            new[stalls] = effect(active[stalls], proposed[stalls])
        better = np.sum((target[active] - new) ** 2, axis=1) <= np.sum(rest**2, axis=1)
        active, proposed, new = active[better], proposed[better], new[better]
        moves = np.abs(proposed - size[active]).max(axis=1) >= DIFFERENCE
        size[active], now[active] = proposed, new
        active = active[moves]
        moved = differentiate(active)
        known = np.all(np.isfinite(moved), axis=(1, 2))
        active, moved = active[known], moved[known]
        slopes[active], information[active] = moved, moved @ moved.swapaxes(1, 2)
    deviance, k = np.sum((target - now) ** 2, axis=1), np.where(is_free, 2, 1)
    return [
        ChangeFit(float(deviance[q]), size[q, : k[q]], information[q, : k[q], : k[q]])
        for q in range(len(target))
    ]


class StageEffects:
    """What changes of the stage do to log(steps) under a physical law at given parameters.

    Parameters
    ----------
    law : Physical
        Of any lambda with the same parameters.
    rows : DataFrame
        n traverses.
    values : array, shape (m, n, p)
        At each lambda.
    ratios : array, shape (m,)
        lambda before the change.
    """

    def __init__(self, law: Physical, rows: pd.DataFrame, values: Array, ratios: Array) -> None:
        self.values, self.ratios = values, ratios[:, None]
        self.count = law.ratio_counter(rows)
        self.shares = [k for k, parameter in enumerate(law.parameters) if parameter.name.startswith("r")]
        self.unchanged = self._responses(values, np.broadcast_to(self.ratios, values.shape[:2]))

    def by(self, kind: IntArray, place: IntArray, size: Array, course: Array) -> Array:
        """Changes of log(steps), shape (q, n); NaN where the joint stalls.

        Parameters
        ----------
        kind, place : array of int, shape (q,)
            Positions among `CHANGES` and among the lambdas.
        size : array, shape (q, 2)
            See `ChangeFit`; the second is of a free change only.
        course : array, shape (n,)
        """
        own = np.log1p(np.expm1(size)[..., None] * course)
        # Logarithms of what a_f T1^2, r and lambda are multiplied by.
        unit, share, ratio = np.einsum("qkj,qkn->jqn", DIRECTIONS[kind], own)
        before = self.ratios[place]
        now, values = before * np.exp(ratio), self.values[place]
        values[..., 0] *= np.exp(unit) * np.minimum(now, 1.0) / np.minimum(before, 1.0)
        values[..., self.shares] *= np.exp(share)[..., None]
        return self._responses(values, now) - self.unchanged[place]

    def _responses(self, values: Array, ratios: Array) -> Array:
        """log(steps), shape (q, n), so many at a time that memory does not grow with all of them."""
        size = max(MAX_COUNTS // values.shape[1], 1)
        starts = range(0, max(len(values), 1), size)
        counts = [self.count(values[k : k + size], ratios[k : k + size])[0] for k in starts]
        with np.errstate(invalid="ignore"):
            return np.log(np.concatenate(counts))
