"""What the shape of noise can be like other than assumed: skewed, or coarsely rounded.

Each is a test of residuals without structure, robust to tails as heavy as Student's t with 5 degrees of
freedom and to a few gross errors, and is stated only where it is clear: far fewer than 1 log in 100 with
noise as assumed has any.

- Skewed: a transformation x = log(1 + g u) / g of the standardised residuals u to symmetry (D. C. Hoaglin in
  Exploring Data Tables, Trends and Shapes, 1985, ch. 11) that is likelier than none.
- Rounded: almost all counts are multiples of more steps than there are between two checks of the end stop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.unevenness import CONTAMINATION, TAIL_DF, contaminate, log_student_t

# Skewed
MIN_SKEW_LOG_RATIO = 6.0  # nats over symmetric noise
MAX_SKEW = 1.5  # of g; 1 is the log-normal distribution of a standard normal exponent
FIRST_SKEW, MIN_G = 0.3, 1e-3  # from which g is looked for; below which a series is used
TAILS_TRIED = (5.0, 8.0, 15.0, 200.0)  # of symmetric noise
MIN_INSIDE = 1e-12
OPTIONS = {"maxiter": 400, "ftol": 1e-7}
N_ENDS, N_MIDDLE = 50, 200  # values that count one by one at either end; groups of the others
MIN_ROWS = 40
MIN_MEAN_SHIFT = 1.5  # of the mean from the median, times sqrt(n), below which skewness is not looked for
CLIP = 3.0  # of deviations in that mean
BOUNDS = ((-3.0, 3.0), (-3.0, 3.0), (-2.0, 2.0))  # of location, log scale and g
# Rounded
MIN_DISTINCT = 10  # counts
MULTIPLES_SHARE = 0.98  # of the counts, with gross errors among them
MIN_ROUNDING_LOG_RATIO = 14.0  # nats over chance: of some thousand spacings that are tried
SUBSET, MIN_SUBSET_SHARE = 60, 0.85  # distinct counts by which spacings are ruled out at first
MAX_SPACING_SHARE = 0.25  # of the median count


@dataclass(frozen=True)
class Skewness:
    """Noise u = location + scale * (exp(g x) - 1) / g, with x symmetric.

    Attributes
    ----------
    g : float
        0 for symmetric noise; positive where the long tail is above.
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
    if len(deviation) < MIN_ROWS:
        return None
    middle = float(np.median(deviation))
    unit = float(np.median(np.abs(deviation - middle))) / 0.6745
    if not unit > 0:
        return None
    z = (deviation - middle) / unit
    shift = float(np.clip(z, -CLIP, CLIP).mean())
    if abs(shift) * np.sqrt(len(z)) < MIN_MEAN_SHIFT:
        return None
    below, inner, above = np.split(np.sort(z), [N_ENDS, max(len(z) - N_ENDS, N_ENDS)])
    inner, rows = merge_neighbours(inner, N_MIDDLE)
    z = np.concatenate([below, inner, above])
    rows = np.pad(rows, (len(below), len(above)), constant_values=1.0)

    begin = np.array([0.0, 0.0, np.copysign(FIRST_SKEW, shift)])
    best = min((_fit(z, rows, begin, df) for df in TAIL_DF), key=lambda fit: fit.fun)
    location, log_scale, g = best.x
    most = best.fun + MIN_SKEW_LOG_RATIO
    # Where the same without skewness is nearly as likely, the likeliest symmetric noise need not be found.
    if abs(g) > MAX_SKEW or any(_negative_log(best.x[:2], z, rows, df)[0] < most for df in TAILS_TRIED):
        return None
    if any(_fit(z, rows, best.x[:2], df).fun < most for df in TAILS_TRIED):
        return None
    return Skewness(float(g), middle + unit * float(location), unit * float(np.exp(log_scale)))


def merge_neighbours(ordered: Array, groups: int) -> tuple[Array, Array]:
    """Many values in ascending order, shape (..., n), as means of groups; how many rows each group has.

    Where a density is looked up at hundreds of groups its log likelihood changes by some 0.01 nats.

    Examples
    --------
    >>> merge_neighbours(np.array([1.0, 2.0, 3.0, 5.0, 7.0]), 2)
    (array([1.5, 5. ]), array([2., 3.]))
    """
    n = ordered.shape[-1]
    if n <= groups:
        return ordered, np.ones(n)
    firsts = np.arange(groups) * n // groups
    rows = np.diff(np.append(firsts, n)).astype(float)
    return np.add.reduceat(ordered, firsts, axis=-1) / rows, rows


def _fit(z: Array, rows: Array, start: Array, df: float) -> Any:
    """The likeliest location, log scale and, with a start for it, skewness; `rows` is how often each z is."""
    from scipy.optimize import minimize

    more: Any = {"method": "L-BFGS-B", "jac": True, "bounds": BOUNDS[: len(start)], "options": OPTIONS}
    return minimize(_negative_log, start, (z, rows, df), **more)


def _negative_log(values: Array, z: Array, rows: Array, df: float) -> tuple[float, Array]:
    """Minus the log likelihood of location, log scale and skewness, 0 where it is left out; its gradient.

    Short tails end; a unit of the noise of the calibration beyond the end is possible all the same.
    """
    location, log_scale, g = *values[:2], values[2] if len(values) > 2 else 0.0
    u = (z - location) * np.exp(-log_scale)
    inside = 1.0 + g * u
    is_inside, inside = inside > 0, np.maximum(inside, MIN_INSIDE)
    x = np.log(inside) / g if abs(g) > MIN_G else u - 0.5 * g * u**2
    log = np.where(is_inside, log_student_t(x, df) - g * x - log_scale, -np.inf)
    both = contaminate(log, z)
    weight = rows * (1.0 - CONTAMINATION) * np.exp(log - both)  # of those that are no gross errors
    by_x = weight * (-(df + 1.0) * x / (df + x**2) - g)
    gradient = [-by_x / inside * np.exp(-log_scale), -by_x / inside * u - weight]
    if len(values) > 2:
        bent = (u / inside - x) / g if abs(g) > MIN_G else -0.5 * u**2
        gradient.append(by_x * bent - weight * x)
    return -float(rows @ both), -np.array([one.sum() for one in gradient])


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
