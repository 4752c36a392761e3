"""lambda, the drive ratio of a physical law, by its profile likelihood; and with it the regime.

For each lambda the other parameters of every session are fitted, which is smooth; the sum of squares of a
direction over all sessions is its profile. In log lambda the prior is even, as much of it above 1 as below.
No count depends on lambda above the largest 1 + r of the log: then there is a lower bound, no estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.estimation._groups import Groups, group_rows
from stickslip_fit.estimation._optimize import Minimum
from stickslip_fit.estimation._problem import DEFAULT_OPTIONS, JointProblem, Problem, single_problem
from stickslip_fit.estimation.identifiability import identifiable_parameters
from stickslip_fit.laws import Rows, StepLaw
from stickslip_fit.laws.base import Model, float_column
from stickslip_fit.laws.physical import DEEP, FRICTION_LIMITED, VELOCITY_LIMITED, Physical, physical_law_with
from stickslip_fit.machine import Machine

LOWEST, HIGHEST = 0.1, 10.0  # of the prior
RATIOS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2, 1.35, 1.6, 2.0)
REFINEMENTS = 2
UNLIKELY = 0.147  # likelihood ratio at the ends of an interval of 95 %
NEGLIGIBLE = 1e-3  # of the largest density
FLAT = 0.7  # likelihood ratio of neighbours between which nothing is looked for
MAX_ITERATIONS = 40
MAX_OTHERS, MAX_CHANGES = 4, 2  # lambdas beside the best, and directions in which their fits differ
MIN_CHANGE = 1e-3  # of the responses of all traverses together
EXACT = 1e-6  # root mean square of residuals, log(steps), below which a law passes through every count
START_SLOPE = 0.2  # share of the step size that a full load takes


@dataclass(frozen=True, eq=False)
class RatioProfile:
    """What the traverses of one joint and direction say of lambda.

    Attributes
    ----------
    ratios : array, shape (k,)
        In rising order; the last is `FRICTION_LIMITED`, for all above the one before it.
    probability : array, shape (k,)
        Posterior of the interval around each, 1 in sum.
    share, share_error : array, shape (k,)
        r of the law's last parameter given lambda, mean over sessions, and its standard error.
    squares : array, shape (k,)
        Sum of squares of the residuals, log(steps).
    free : array of int, shape (k,)
        Their degrees of freedom.
    """

    ratios: Array
    probability: Array
    share: Array
    share_error: Array
    squares: Array
    free: IntArray

    @property
    def likelihood(self) -> Array:
        """Relative to that of the most likely lambda, shape (k,)."""
        return _relative_likelihood(self.squares, self.free)

    @property
    def best(self) -> float:
        """`FRICTION_LIMITED` where that is not unlikely, else the most likely lambda."""
        if self.likelihood[-1] > UNLIKELY:
            return FRICTION_LIMITED
        return float(self.ratios[np.argmax(self.likelihood)])

    @property
    def others(self) -> tuple[float, ...]:
        """A few lambdas besides the best that are not very unlikely, the least and the greatest included."""
        inside = self.ratios[(self.likelihood > NEGLIGIBLE) & (self.ratios != self.best)]
        at = np.unique(np.linspace(0, len(inside) - 1, min(len(inside), MAX_OTHERS)).round().astype(int))
        return tuple(map(float, inside[at]))

    def within(self, regime: str) -> float:
        """A lambda well within a regime, where none there is very unlikely; else the best."""
        inside = self.ratios < VELOCITY_LIMITED if regime == "velocity-limited" else self.ratios > DEEP
        own = np.where(inside, self.probability, 0.0)
        if inside[self.ratios == self.best].any() or self.likelihood[inside].max() < NEGLIGIBLE:
            return self.best
        return float(self.ratios[np.searchsorted(np.cumsum(own), own.sum() / 2)])

    @property
    def noise(self) -> float:
        """Standard deviation of log(steps) that the most likely lambda leaves; NaN without residuals."""
        tested = _leaves_residuals(self.squares, self.free)
        at = int(np.argmax(np.where(tested, self.likelihood, -1.0)))
        return float(np.sqrt(self.squares[at] / self.free[at])) if tested[at] else np.nan

    @property
    def friction_limited(self) -> float:
        """Probability that lambda is above 1: friction-limited without load."""
        return float(
            self.probability[self.ratios > 1.0].sum() + self.probability[self.ratios == 1.0].sum() / 2
        )

    def interval(self) -> tuple[float, float]:
        """Where lambda lies with 95 % confidence, by likelihood ratio; 0 or infinite where not bounded."""
        inside = np.flatnonzero(self.likelihood > UNLIKELY)
        first, last = inside[0], inside[-1]
        low = 0.0 if first == 0 else float(np.mean(self.ratios[[first - 1, first]]))
        high = np.inf if last == len(self.ratios) - 1 else float(np.mean(self.ratios[[last, last + 1]]))
        return low, high

    def share_interval(self, spread: float) -> tuple[float, float, float]:
        """Mean of r, and its 95 % interval with lambda's uncertainty; `spread` is the model's, relative."""
        from scipy.special import ndtr

        error = np.hypot(self.share_error, spread * self.share)
        use = (self.probability > 0) & np.isfinite(error) & (error > 0)
        if not use.any():
            return np.nan, np.nan, np.nan
        mean, error, weight = self.share[use], error[use], self.probability[use] / self.probability[use].sum()
        grid = np.linspace(-1.0, 1.0, 8001)
        total = weight @ ndtr((grid - mean[:, None]) / error[:, None])
        low, high = np.interp([0.025, 0.975], total, grid)
        return float(weight @ mean), float(low), float(high)


def physical_law(joint: int, rows: Rows, machine: Machine) -> StepLaw:
    """The physical law of a joint with the lambda that its traverses make most likely.

    What `laws` takes for a joint, ``fit(log, laws={3: physical_law})``. Where traverses say nothing of lambda
    it is friction-limited, as the published parameters are.

    Parameters
    ----------
    joint : int
    rows : DataFrame
        Usable traverses of the joint.
    machine : Machine

    Returns
    -------
    StepLaw
    """
    profiles = profile_ratio(joint, pd.DataFrame(rows), machine) if len(rows) else {}
    law = likeliest_law(joint, rows, machine, profiles)
    up, down = (profiles[way].others if way in profiles else () for way in "+-")
    law.plausible = up, down
    regimes = {}
    for regime in ("velocity-limited", "friction-limited"):
        up_in, down_in = (
            profiles[way].within(regime) if way in profiles else FRICTION_LIMITED for way in "+-"
        )
        if (up_in, down_in) != law.ratios:
            regimes[regime] = up_in, down_in
    law.regimes = regimes
    return law


def likeliest_law(joint: int, rows: Rows, machine: Machine, profiles: Mapping[str, RatioProfile]) -> Physical:
    """With the likeliest lambda of each direction; friction-limited in one that has no profile."""
    up, down = (profiles[way].best if way in profiles else FRICTION_LIMITED for way in "+-")
    return physical_law_with(joint, rows, machine, (up, down))


def ratio_changes(law: object, rows: pd.DataFrame, machine: Machine) -> list[tuple[IntArray, Array]]:
    """What the choice of lambda leaves open in the responses of a log.

    Parameters
    ----------
    law : object
        A physical law with `plausible`; nothing is open of another.
    rows : DataFrame
        Traverses of its joint, from which lambda was chosen.

    Returns
    -------
    list of (array of int, shape (m,); array, shape (m, k))
        For each direction its rows, and by how much the responses of a fit with each of the other plausible
        lambdas differ from those of the fit with the law's own.
    """
    if not isinstance(law, Physical) or not any(law.plausible):
        return []
    search = RatioSearch(law.joint, rows, machine)
    changes = []
    for sign, ratio, others in zip("+-", law.ratios, law.plausible, strict=True):
        own = np.flatnonzero((rows["direction"] == sign).to_numpy())
        if not (len(own) and others):
            continue
        search.evaluate((ratio, *others))
        residuals = [search.residuals[ratio][own] - search.residuals[each][own] for each in others]
        known = [change for change in residuals if np.all(np.isfinite(change))]
        left, singular, _ = svd(np.array([*known, 0.0 * own]).T)
        kept = (singular > MIN_CHANGE)[:MAX_CHANGES]
        if kept.any():
            changes.append((own, (left * singular)[:, :MAX_CHANGES][:, kept]))
    return changes


def profile_ratio(
    joint: int,
    rows: pd.DataFrame,
    machine: Machine,
    ratios: Sequence[float] = RATIOS,
    refinements: int = REFINEMENTS,
) -> dict[str, RatioProfile]:
    """The profile of each direction.

    Parameters
    ----------
    joint : int
    rows : DataFrame
        Usable traverses of the joint.
    machine : Machine
    ratios : sequence of float, optional
        Where to evaluate it, besides `FRICTION_LIMITED`.
    refinements : int, optional
        How often to halve the intervals that matter.
    """
    search = RatioSearch(joint, rows, machine)
    search.refine(ratios, refinements)
    return search.profiles()


@dataclass(frozen=True, eq=False)
class SessionValues:
    """What each session of a joint and direction says at one lambda or more.

    Attributes
    ----------
    values, variances : array, shape (..., g, q)
        The logarithm of the step size without load, then the values of r.
    known : array of bool, shape (..., g, q)
        Whether the session determines them.
    """

    values: Array
    variances: Array
    known: BoolArray


class RatioSearch:
    """Fits at many lambdas, each the same in both directions, which share nothing.

    Parameters
    ----------
    rows : DataFrame
        Usable traverses of the joint.
    """

    def __init__(self, joint: int, rows: pd.DataFrame, machine: Machine) -> None:
        self.joint, self.rows, self.machine = joint, rows, machine
        self.found: dict[float, dict[str, tuple[float, ...]]] = {}
        self.minima: dict[float, Array] = {}
        self.residuals: dict[float, Array] = {}
        self.estimates: dict[float, SessionValues] = {}

    def refine(self, ratios: Sequence[float] = RATIOS, refinements: int = REFINEMENTS) -> None:
        """Evaluate some lambdas and `FRICTION_LIMITED`, then the middles of the intervals that matter."""
        self.evaluate({*ratios, FRICTION_LIMITED})
        for _ in range(refinements):
            self.evaluate(self.wanted())

    def evaluate(self, ratios: Iterable[float]) -> None:
        """Sum of squares, mean r and its error of each direction at lambdas that are not known yet."""
        for laws in laws_by_width(self.joint, self.rows, self.machine, set(ratios) - set(self.found)):
            self._evaluate(single_problem(laws[0], self.rows, DEFAULT_OPTIONS), laws)

    def _evaluate(self, problem: JointProblem, laws: list[Physical]) -> None:
        """Of each group the better of two searches: from usual values, and from the nearest lambda's."""
        law, n, g = laws[0], len(problem.y), len(problem.groups)
        ratios = [law.ratios[0] for law in laws]
        every = stack_ratios(problem, law, np.array(ratios))
        minimum = every.minimize(
            np.ones(len(every.y)),
            np.concatenate([start_at(problem, ratio) for ratio in ratios]),
            MAX_ITERATIONS,
        )
        known = {
            ratio: values for ratio, values in self.minima.items() if values.shape == problem.start.shape
        }
        known |= {ratio: minimum.values[k * g : (k + 1) * g] for k, ratio in enumerate(ratios)}
        if len(known) > 1:
            starts = np.concatenate([_from_nearest(known, law, ratio) for ratio in ratios])
            other = every.minimize(np.ones(len(every.y)), starts, MAX_ITERATIONS)
            old, new = (every.groups.sums(each.residual**2) for each in (minimum, other))
            minimum = _either(new < old, other, minimum, every.groups)
        for k, ratio in enumerate(ratios):
            own = slice(k * g, (k + 1) * g)
            self.minima[ratio] = minimum.values[own]
            self.residuals[ratio] = minimum.residual[k * n : (k + 1) * n]
            determined, _, covariance = identifiable_parameters(minimum.curvature[own], problem.scales)
            self.estimates[ratio] = _session_values(law, minimum.values[own], covariance, determined)
            self.found[ratio] = self._summarize(
                problem, self.estimates[ratio], minimum.rank[own], self.residuals[ratio]
            )

    def _summarize(
        self, problem: JointProblem, estimates: SessionValues, rank: IntArray, residual: Array
    ) -> dict[str, tuple[float, ...]]:
        squares, size = problem.groups.sums(residual**2), problem.groups.sizes
        found: dict[str, tuple[float, ...]] = {}
        for way in dict.fromkeys(problem.directions):
            own = problem.directions == way
            free = int(size[own].sum() - rank[own].sum())
            total = float(squares[own].sum())
            variance = estimates.variances[own, -1] * (total / free if free else np.nan)
            known = variance > 0
            weight = np.where(known, 1.0 / np.where(known, variance, 1.0), 0.0)
            shares = estimates.values[own, -1]
            mean = float(weight @ shares / weight.sum()) if known.any() else float(np.mean(shares))
            error = float(weight.sum() ** -0.5) if known.any() else np.inf
            found[str(way)] = (total, mean, error, free)
        return found

    def sessions(self, direction: str) -> SessionValues:
        """At every lambda, in rising order, with the noise that the likeliest leaves; shapes (m, g, q)."""
        table = group_rows(self.rows).table
        own, every = (
            (table["direction"] == direction).to_numpy(),
            [self.estimates[r] for r in sorted(self.found)],
        )
        noise = self.profiles()[direction].noise
        return SessionValues(
            np.array([one.values[own] for one in every]),
            np.array([one.variances[own] for one in every]) * noise**2,
            np.array([one.known[own] for one in every]),
        )

    def wanted(self) -> list[float]:
        """Middles of the intervals next to what is likely in either direction."""
        middles = set()
        for profile in self.profiles().values():
            likely = _relative_likelihood(profile.squares, profile.free)
            for k in range(len(profile.ratios) - 2):  # all above the last but one is one interval
                pair = likely[k : k + 2]
                if pair.max() > NEGLIGIBLE and pair.min() < FLAT * pair.max():
                    middles.add(float((profile.ratios[k] + profile.ratios[k + 1]) / 2))
        return sorted(middles - set(self.found))

    def profiles(self) -> dict[str, RatioProfile]:
        """What is known so far."""
        ratios = np.array(sorted(self.found))
        found = {}
        for way in self.found[FRICTION_LIMITED]:
            squares, share, error, free = np.array([self.found[ratio][way] for ratio in ratios]).T
            probability = _relative_likelihood(squares, free) * prior_shares(ratios)
            posterior = probability / probability.sum()
            found[way] = RatioProfile(ratios, posterior, share, error, squares, free.astype(np.intp))
        return found


def laws_by_width(
    joint: int, rows: pd.DataFrame, machine: Machine, ratios: Iterable[float]
) -> list[list[Physical]]:
    """The laws of these lambdas, the same in both directions, in rising order; alike in their parameters."""
    by_width: dict[int, list[Physical]] = {}
    for ratio in sorted(ratios):
        law = physical_law_with(joint, rows, machine, (ratio, ratio))
        by_width.setdefault(len(law.parameters), []).append(law)
    return list(by_width.values())


def stack_ratios(problem: JointProblem, law: Physical, ratios: Array) -> Problem:
    """The problem of one lambda after the other, all at once: a large fit is faster than many small ones."""
    n, k = len(problem.y), len(ratios)
    place, ratio = np.tile(np.arange(n), k), np.repeat(ratios, n)
    number = np.repeat(np.arange(k), n) * len(problem.groups)
    table = pd.DataFrame(index=pd.RangeIndex(k * len(problem.groups)))
    groups = Groups(table, np.tile(problem.groups.of_row, k) + number)
    columns = {name: float_column(problem.rows, name) for name in (*law.columns, "start", "stop")}

    def model_of(some: IntArray) -> Model:
        own_rows = {name: column[place[some]] for name, column in columns.items()}
        count, own = law.ratio_counter(own_rows), ratio[some]

        def predict(values: Array) -> tuple[Array, Array]:
            counts, slopes = count(values, own)
            with np.errstate(invalid="ignore"):
                return np.log(counts), slopes / counts[:, None]

        return predict

    tables = {name: np.tile(getattr(problem, name), (k, 1)) for name in ("start", "scales", "lower", "upper")}
    return Problem(
        groups=groups,
        sharing=problem.sharing,
        y=np.tile(problem.y, k),
        model=model_of(np.arange(n * k)),
        subset=model_of,
        **tables,
    )


def _session_values(law: Physical, values: Array, covariance: Array, known: BoolArray) -> SessionValues:
    """In units of the noise, of parameters of shape (g, p)."""
    columns = [0, *_shares(law)]
    variances = np.diagonal(covariance, axis1=1, axis2=2)[:, columns].copy()
    variances[:, 0] /= values[:, 0] ** 2
    own = values[:, columns]
    own[:, 0] = np.log(own[:, 0])
    return SessionValues(own, variances, known[:, columns])


def _from_nearest(known: Mapping[float, Array], law: StepLaw, ratio: float) -> Array:
    """The values of the nearest other lambda, with the response to load that they have there."""
    nearest = min((other for other in known if other != ratio), key=lambda other: abs(np.log(other / ratio)))
    start = known[nearest].copy()
    start[:, _shares(law)] *= min(nearest, DEEP) / min(ratio, DEEP)
    return start


def start_at(problem: JointProblem, ratio: float) -> Array:
    """Start values whose response to load is usual, whatever the regime."""
    start = problem.start.copy()
    start[:, _shares(problem.law)] = min(START_SLOPE / (2.0 if ratio > 1.0 else ratio), 0.6 * max(1.0, ratio))
    return start


def _either(first: BoolArray, one: Minimum, other: Minimum, groups: Groups) -> Minimum:
    """Of some groups the one minimum, of the rest the other."""
    chosen = {
        name: np.where(
            first[:, *[None] * (getattr(one, name).ndim - 1)], getattr(one, name), getattr(other, name)
        )
        for name in ("values", "curvature", "converged", "rank", "at_bound")
    }
    residual = np.where(first[groups.of_row], one.residual, other.residual)
    return replace(other, residual=residual, **chosen)


def _shares(law: StepLaw) -> list[int]:
    return [k for k, parameter in enumerate(law.parameters) if parameter.name.startswith("r")]


def _leaves_residuals(squares: Array, free: Array | IntArray) -> BoolArray:
    """Whether the fit at each lambda does not pass through every count."""
    return (free > 0) & (squares > free * EXACT**2)


def _relative_likelihood(squares: Array, free: Array | IntArray) -> Array:
    """Of each lambda over that of the best, with the noise profiled out.

    Laws of more parameters pay for them as in Akaike's criterion. Those that pass through every count leave
    no residuals that could speak for or against them, and are as likely as the best of the others.
    """
    tested, free = _leaves_residuals(squares, free), free.astype(float)
    if not tested.any():
        return np.ones(len(squares))
    squares = np.where(np.isfinite(squares), squares, np.inf)
    best = int(np.argmin(np.where(tested, squares, np.inf) / np.maximum(free, 1.0)))
    excess = squares / squares[best] - 1.0
    log = -free[best] / 2 * np.log1p(np.maximum(excess, -0.99)) + (free - free[best])
    return np.where(tested, np.exp(log - log[tested].max()), 1.0)


def prior_shares(ratios: Array) -> Array:
    """Share of the prior in the interval around each; the last has all above the one before it."""
    edges = np.log(np.r_[LOWEST, (ratios[1:-1] + ratios[:-2]) / 2, ratios[-2], HIGHEST])
    return np.maximum(np.diff(edges), 0.0) / np.log(HIGHEST / LOWEST)
