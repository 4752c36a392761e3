"""What noise can be like other than assumed: uneven, skewed, or coarsely rounded.

Each is a test of residuals without structure, robust to tails as heavy as Student's t with 5 degrees of
freedom and to a few gross errors, and is stated only where it is clear: far fewer than 1 log in 100 with
noise as assumed has any.

- Uneven: standard deviations by session, configuration or stretch of the travel that differ by more than a
  factor of two. Their distribution over the groups is estimated nonparametrically (J. Kiefer and
  J. Wolfowitz, Ann. Math. Stat. 27:887, 1956), once without limits and once as assumed: within a factor of
  two between configurations, the same in all sessions.
- Skewed: a transformation x = log(1 + g u) / g of the standardised residuals u to symmetry (D. C. Hoaglin in
  Exploring Data Tables, Trends and Shapes, 1985, ch. 11) that is likelier than none.
- Rounded: almost all counts are multiples of more steps than there are between two checks of the end stop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import minimize
from scipy.special import poch

from stickslip_fit._typing import Array, IntArray

CONTAMINATION, CONTAMINATION_SCALE = 0.01, 5.0  # Cauchy component of all likelihoods: gross errors
TAIL_DF = (5.0, 200.0)  # of Student t noise
# Uneven
RELATIVE_SDS = 2.0 ** np.arange(-3.0, 4.01, 0.25)
# Steps of this grid within which noise may differ and be as assumed. Between configurations that is a factor
# of 2.4, of which a factor of two falls short wherever it lies; between sessions none.
STEPS_AS_ASSUMED = {"session": 0}
MANY_STEPS_AS_ASSUMED = 5
MIN_RATIO = 2.0  # of the largest to the smallest standard deviation, for noise to be called uneven
MIN_UNEVEN_LOG_RATIO = 8.0  # nats over standard deviations within that factor
MAX_ROUNDS, EM_STEPS = 3, 40
MIN_LIKELIHOOD = 1e-300  # relative to that of the best standard deviation
N_STRETCHES = 6  # of each joint's travel
# Skewed
MIN_SKEW_LOG_RATIO = 6.0  # nats over symmetric noise
MAX_SKEW = 1.5  # of g; 1 is the log-normal distribution of a standard normal exponent
MIN_ROWS = 40
MIN_MEAN_SHIFT = 1.5  # of the mean from the median, times sqrt(n), below which skewness is not looked for
CLIP = 3.0  # of deviations in that mean
# Rounded
MIN_DISTINCT = 10  # counts
MULTIPLES_SHARE = 0.98  # of the counts, with gross errors among them
MIN_ROUNDING_LOG_RATIO = 14.0  # nats over chance: of some thousand spacings that are tried
SUBSET, MIN_SUBSET_SHARE = 60, 0.85  # distinct counts by which spacings are ruled out at first
MAX_SPACING_SHARE = 0.25  # of the median count


@dataclass(frozen=True, eq=False)
class Unevenness:
    """Standard deviations that differ more than assumed; n rows.

    Attributes
    ----------
    ratio : array, shape (n,)
        Of each row's standard deviation to that of all rows; 1 where the noise is as assumed.
    carriers : tuple of str
        What rows with more than twice the noise of others have in common, by the name of the grouping.
    """

    ratio: Array
    carriers: tuple[str, ...] = ()


def group_rows(rows: pd.DataFrame, configuration: IntArray) -> dict[str, IntArray]:
    """Groupings of rows within which the noise may be larger; labels from 0, shape (n,) each."""
    groupings = {"session": pd.factorize(rows["session"].astype(object))[0], "configuration": configuration}
    if {"joint", "start", "stop"} <= set(rows.columns):
        middle = rows[["start", "stop"]].to_numpy(float).mean(axis=1)
        joint = rows["joint"].to_numpy(int)
        stretch = np.zeros(len(rows), dtype=int)
        for one in np.unique(joint):
            ends = rows.loc[joint == one, ["start", "stop"]].to_numpy(float)
            share = (middle - ends.min()) / max(float(np.ptp(ends)), np.finfo(float).tiny)
            place = np.clip((share * N_STRETCHES).astype(int), 0, N_STRETCHES - 1)
            stretch = np.where(joint == one, N_STRETCHES * one + place, stretch)
        groupings["stretch"] = pd.factorize(stretch)[0]
    return {name: labels.astype(np.intp) for name, labels in groupings.items()}


def estimate_unevenness(deviation: Array, groupings: Mapping[str, IntArray]) -> Unevenness:
    """Estimate by how much noise differs between groups, where that is clearly more than assumed.

    `deviation`, shape (n,), are residuals in units of the noise of all rows.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> session = np.repeat([0, 1, 2], 100)
    >>> found = estimate_unevenness(rng.standard_normal(300) * (1 + 4 * (session == 2)), {"session": session})
    >>> found.carriers, float(round(found.ratio[-1] / found.ratio[0]))
    (('session',), 6.0)
    """
    ratio, carriers, remaining = np.ones(len(deviation)), [], dict(groupings)
    for _ in range(MAX_ROUNDS):
        middle = np.median(np.abs(deviation / ratio)) / 0.6745
        if not middle > 0:
            break
        density = np.stack([_log_density(deviation / ratio / middle, sd) for sd in RELATIVE_SDS], axis=1)
        fits = {
            name: _fit_sds(density, labels, STEPS_AS_ASSUMED.get(name, MANY_STEPS_AS_ASSUMED))
            for name, labels in remaining.items()
        }
        best = max(fits, key=lambda name: fits[name][0], default=None)
        if best is None or fits[best][0] < MIN_UNEVEN_LOG_RATIO:
            break
        sds = fits[best][1]
        ratio = ratio * sds[remaining.pop(best)]
        if sds.max() > MIN_RATIO * sds.min():
            carriers.append(best)
    return Unevenness(ratio / np.exp(np.mean(np.log(ratio))), tuple(carriers))


def _log_density(deviation: Array, sd: float) -> Array:
    scale = sd * np.sqrt((TAIL_DF[0] - 2.0) / TAIL_DF[0])
    return _contaminate(_log_student_t(deviation / scale, TAIL_DF[0]) - np.log(scale), deviation)


def _contaminate(log_density: Array, deviation: Array) -> Array:
    cauchy = _log_student_t(deviation / CONTAMINATION_SCALE, 1.0) - np.log(CONTAMINATION_SCALE)
    return np.logaddexp(np.log1p(-CONTAMINATION) + log_density, np.log(CONTAMINATION) + cauchy)


def _log_student_t(x: Array, df: float) -> Array:
    constant = float(np.log(poch(0.5 * df, 0.5)) - 0.5 * np.log(np.pi * df))
    return constant - (df + 1.0) / 2.0 * np.log1p(x**2 / df)


def _fit_sds(log_density: Array, labels: IntArray, steps: int) -> tuple[float, Array]:
    """Log likelihood ratio of free standard deviations to ones within some steps, and each group's own."""
    number = int(labels.max()) + 1
    log = np.stack([np.bincount(labels, column, number) for column in log_density.T], axis=1)
    likelihood = np.exp(log - log.max(axis=1, keepdims=True))
    free, weight = _mixture(likelihood)
    width = steps + 1
    windows = [likelihood[:, first : first + width] for first in range(log.shape[1] - width + 1)]
    posterior = likelihood * weight
    precision = posterior @ RELATIVE_SDS**-2.0 / posterior.sum(axis=1)
    return free - max(_mixture(window)[0] for window in windows), 1.0 / np.sqrt(precision)


def _mixture(likelihood: Array) -> tuple[float, Array]:
    """Greatest log likelihood of a mixture of columns, (groups, k), and its weights, by EM."""
    likelihood = np.maximum(likelihood, MIN_LIKELIHOOD)
    weight = np.full(likelihood.shape[1], 1.0 / likelihood.shape[1])
    for _ in range(EM_STEPS):
        weight = weight * ((1.0 / (likelihood @ weight)) @ likelihood) / len(likelihood)
    return float(np.log(likelihood @ weight).sum()), weight


@dataclass(frozen=True)
class Skewness:
    """Noise u = location + scale * (exp(g x) - 1) / g, with x symmetric.

    Attributes
    ----------
    g : float
        0 for symmetric noise; positive where the long tail is above.
    location, scale : float
    """

    g: float
    location: float
    scale: float

    def symmetrize(self, deviation: Array) -> Array:
        """Deviations from the location, those in the long tail as long as symmetric noise would have them.

        The short tail stays as it is: the uncertainty of a fit blurs where it ends.
        """
        u = (deviation - self.location) / self.scale
        long_tail = np.log1p(np.maximum(self.g * u, 0.0)) / self.g
        return np.asarray(self.scale * np.where(self.g * u > 0, long_tail, u))


def fit_skewness(deviation: Array) -> Skewness | None:
    """The skewness of residuals, shape (n,), in units of their noise; None where it is not clear.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> round(fit_skewness(np.exp(0.5 * rng.standard_normal(500)) - 1.0).g, 1)
    0.4
    >>> fit_skewness(rng.standard_t(5, 500)) is None
    True
    """
    middle = float(np.median(deviation))
    unit = float(np.median(np.abs(deviation - middle))) / 0.6745
    if len(deviation) < MIN_ROWS or not unit > 0:
        return None
    z = (deviation - middle) / unit
    if abs(float(np.clip(z, -CLIP, CLIP).mean())) * np.sqrt(len(z)) < MIN_MEAN_SHIFT:
        return None

    def negative_log(values: Array, df: float, g: float | None = None) -> float:
        location, log_scale = values[:2]
        return -float(np.sum(_log_skewed(z, location, np.exp(log_scale), values[2] if g is None else g, df)))

    options: Any = {"xatol": 1e-3, "fatol": 1e-2, "maxiter": 400}
    tails = (5.0, 8.0, 15.0, 200.0)
    symmetric = min(_minimize(negative_log, np.zeros(2), (df, 0.0), options).fun for df in tails)
    fits = [
        _minimize(negative_log, np.array([0.0, 0.0, start]), (df,), options)
        for df in TAIL_DF
        for start in (-0.3, 0.3)
    ]
    best = min(fits, key=lambda fit: fit.fun)
    location, log_scale, g = best.x
    if symmetric - best.fun < MIN_SKEW_LOG_RATIO or abs(g) > MAX_SKEW:
        return None
    return Skewness(float(g), middle + unit * float(location), unit * float(np.exp(log_scale)))


def _minimize(function: Any, start: Array, more: tuple[float, ...], options: Any) -> Any:
    simplex = np.vstack([start, start + 0.2 * np.eye(len(start))])
    return minimize(
        function, start, more, method="Nelder-Mead", options=options | {"initial_simplex": simplex}
    )


def _log_skewed(z: Array, location: float, scale: float, g: float, df: float) -> Array:
    u = (z - location) / scale
    if abs(g) < 1e-3:
        return _contaminate(_log_student_t(u, df) - np.log(scale), z)
    inside = 1.0 + g * u
    x = np.log(np.maximum(inside, 1e-12)) / g
    # Short tails end; a unit of the noise of the calibration beyond the end is possible all the same.
    log = np.where(inside > 0, _log_student_t(x, df) - g * x - np.log(scale), -np.inf)
    return _contaminate(log, z)


@dataclass(frozen=True, eq=False)
class Quantization:
    """Responses that are rounded to a spacing; n rows.

    Attributes
    ----------
    phase : array, shape (n,)
        Expected responses in units of the spacing, counted from a value that occurs.
    spacing : array, shape (n,)
        In units of each response's standard deviation, rounding included; 0 where there is no rounding.
    """

    phase: Array
    spacing: Array

    def round(self, noise: Array) -> Array:
        """Noise of variance 1, shape (n, k), as responses rounded to the spacing depart with it.

        Replicates of short traverses are all rounded the same way: their errors are far from independent.
        """
        coarse = self.spacing > 0
        spacing, phase = self.spacing[coarse, None], self.phase[coarse, None]
        own = noise[coarse] * np.sqrt(np.maximum(1.0 - spacing**2 / 12.0, 0.0))
        rounded = noise.copy()
        rounded[coarse] = spacing * (np.round(phase + own / spacing) - phase)
        return rounded


def find_count_spacing(
    steps: npt.ArrayLike, check_every: npt.ArrayLike, *groupings: npt.NDArray[Any]
) -> IntArray:
    """Steps between two counts that occur, where that is more than between two checks; else 0; shape (n,).

    All rows are looked at together, then each group of each of the `groupings`, labels of shape (n,).

    Examples
    --------
    >>> steps = np.random.default_rng(1).integers(4000, 9000, 40)
    >>> find_count_spacing(50 * np.round(steps / 50), 5)[:3].tolist()
    [50, 50, 50]
    >>> find_count_spacing(5 * np.round(steps / 5), 5)[:3].tolist()
    [0, 0, 0]
    """
    counts = np.asarray(steps, dtype=np.int64)
    checks = np.broadcast_to(np.asarray(check_every, dtype=np.int64), counts.shape)
    spacing = np.zeros(len(counts), dtype=np.int64)
    for labels in (np.zeros(len(counts), dtype=int), *groupings):
        if spacing.any():
            break
        for label in np.unique(labels):
            inside = labels == label
            spacing[inside] = _spacing_of(counts[inside], checks[inside])
    return spacing


def _spacing_of(steps: IntArray, check_every: IntArray) -> int:
    distinct, first = np.unique(steps, return_index=True)
    checks = check_every[first]
    if len(distinct) < MIN_DISTINCT:
        return 0
    some = distinct[np.linspace(0, len(distinct) - 1, min(SUBSET, len(distinct))).astype(int)]
    largest = int(MAX_SPACING_SHARE * np.median(distinct))
    tried = np.arange(int(checks.max()) + 1, max(largest, int(checks.max()) + 1))
    tried = tried[(some % tried[:, None] == 0).mean(axis=1) > MIN_SUBSET_SHARE] if len(tried) else tried
    best, best_ratio = 0, MIN_ROUNDING_LOG_RATIO
    for one in tried:
        by_chance = np.clip(np.gcd(checks, one) / one, 1e-9, MULTIPLES_SHARE)
        multiple = distinct % one == 0
        hits, misses = np.log(MULTIPLES_SHARE / by_chance), np.log((1 - MULTIPLES_SHARE) / (1 - by_chance))
        ratio = float(np.sum(np.where(multiple, hits, misses)))
        if ratio > best_ratio:
            best, best_ratio = int(one), ratio
    return best
