"""Noise of log steps: likelihoods, repeatability from replicates or residuals, intervals; Flag.

The variance of a row's log steps is repeatability^2 plus that of the rounding (`row_variance`); its inverse,
times `Likelihood.irls_weight`, is the row's weight. StudentT weighs residuals as in K. Lange, R. Little and
J. Taylor, JASA 84:881 (1989). Replicates hours apart contain drift and so bound the repeatability from above.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd
from scipy.special import chdtr, chdtrc, stdtrit

from stickslip_fit._format import format_value
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.estimation.shared_estimate import Covariances, find_variances
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs.schema import position_columns


@dataclass(frozen=True)
class Flag:
    """What is wrong with a parameter or a whole group.

    Attributes
    ----------
    flag : str
        ``not_identified``, ``not_converged``, ``at_bound``, ``few_replicates``, ``repeatability_doubted``,
        ``outlier``, ``outlier_pattern``, ``no_times``, ``same_log`` or ``other_stretches``.
    joint : int
    direction, session : str
        An empty one stands for all of them.
    parameters : tuple of str
        Names of the parameters concerned.
    message : str
        What is wrong and what to do.
    """

    flag: str
    joint: int
    direction: str
    session: str
    parameters: tuple[str, ...]
    message: str

    @classmethod
    def at(
        cls, flag: str, joint: int, direction: str, session: str, parameters: tuple[str, ...], text: str
    ) -> Flag:
        """A flag whose message begins with its joint, direction and, unless empty, session."""
        where = f"joint {joint}, direction {direction}" + (f", session {session}" if session else "")
        return cls(flag, joint, direction, session, parameters, f"{where}: {text}")


class Likelihood(Protocol):
    """The distribution of log steps about the law, up to its scale."""

    @property
    def method(self) -> str:
        """What a fit under it is called."""

    @property
    def information(self) -> float:
        """Fisher information about the location, relative to a Gaussian of the same scale."""

    @property
    def spread(self) -> float:
        """Standard deviation in units of the scale."""

    def irls_weight(self, squares: Array) -> Array:
        """Weight of residuals whose squares, over the squared scale, are given; 1 for a Gaussian."""


@dataclass(frozen=True)
class Gaussian(Likelihood):
    """Gaussian errors: ordinary least squares."""

    method: str = "least-squares"
    information: float = 1.0
    spread: float = 1.0

    def irls_weight(self, squares: Array) -> Array:
        return np.ones_like(squares)


@dataclass(frozen=True)
class StudentT(Likelihood):
    """Student's t errors: a misheard end stop has little weight (K. Lange et al., JASA 84:881, 1989).

    Parameters
    ----------
    df : float, optional
        Above 2.

    Examples
    --------
    >>> StudentT(5.0).irls_weight(np.array([0.0, 1.0, 95.0])).round(2)
    array([1.2 , 1.  , 0.06])
    """

    df: float = 5.0
    method: str = "heavy-tailed-least-squares"

    @property
    def information(self) -> float:
        return (self.df + 1.0) / (self.df + 3.0)

    @property
    def spread(self) -> float:
        return float(np.sqrt(self.df / (self.df - 2.0)))

    def irls_weight(self, squares: Array) -> Array:
        return (self.df + 1.0) / (self.df + squares)


GAUSSIAN = Gaussian()
GIVEN_DF = 10**9  # degrees of freedom of a repeatability that somebody knows
DOUBT_LEVEL = 1e-3
FEW_REPLICATES = (
    "no error bars, since no traverse is repeated to show how much one scatters; make each calibration "
    "traverse twice"
)


def configuration_columns(rows: pd.DataFrame) -> list[str]:
    """The columns in which replicates of a session and direction agree."""
    return ["session", "direction", *position_columns(rows), "start", "stop"]


@dataclass(frozen=True)
class NoiseLevel:
    """One joint's repeatability in one direction.

    Attributes
    ----------
    value : float
        Standard deviation of log steps, i.e. relative; NaN where it cannot be known.
    df : int
        Its degrees of freedom.
    source : {"replicates", "residuals", "posterior", "given"}
    """

    value: float
    df: int
    source: str


def estimate_from_replicates(
    law: StepLaw, rows: pd.DataFrame, effect: Array | float = 0.0
) -> dict[str, NoiseLevel]:
    """Repeatability of each direction from replicates of a configuration within a session.

    Replicates hours apart also carry whatever drifts, so this bounds the repeatability from above; known
    causes' `effect` on log(steps), shape (n,), is taken out.
    """
    y, rounding = law.response(rows)
    y = y - effect
    columns = configuration_columns(rows)
    keys = rows[columns].round(9)
    configuration = keys.groupby(columns, dropna=False, sort=False, observed=True).ngroup().to_numpy()
    size = np.bincount(configuration)
    deviation = y - (np.bincount(configuration, y) / size)[configuration]
    noise = {}
    for direction in ("+", "-"):
        subset = (rows["direction"] == direction).to_numpy()
        df = int(subset.sum() - len(np.unique(configuration[subset])))
        noise[direction] = pool_residuals(deviation[subset], rounding[subset], df, "replicates")
    return noise


def pool_residuals(
    residual: Array,
    rounding: Array,
    df: int,
    source: str,
    likelihood: Likelihood = GAUSSIAN,
    noise_ratio: Array | float = 1.0,
) -> NoiseLevel:
    """Repeatability under which the weighted squares of the residuals add up to their degrees of freedom.

    `noise_ratio`, shape (n,), is each row's standard deviation over the repeatability, rounding aside.
    """
    if df < 1:
        return NoiseLevel(np.nan, 0, source)
    squares, rounding = (residual / noise_ratio) ** 2, rounding / noise_ratio**2
    # Rounding is a small part, so this fixed point gains a digit or two a pass; it nears 0 from above.
    scale2 = float(squares.sum()) / df / likelihood.spread**2
    for _ in range(200):
        standard = squares / (scale2 + rounding)
        excess = float(np.sum(likelihood.irls_weight(standard) * standard)) / df - 1.0
        scale2 *= 1.0 + excess
        if abs(excess) < 1e-10:
            break
    return NoiseLevel(float(np.sqrt(scale2)) * likelihood.spread, df, source)


def row_variance(
    rows: pd.DataFrame,
    rounding: Array,
    repeatability: dict[str, NoiseLevel],
    likelihood: Likelihood = GAUSSIAN,
    noise_ratio: Array | float = 1.0,
) -> Array:
    """Squared scale of each row's log steps, rounding included; shape (n,). A Gaussian's is its variance.

    `noise_ratio` is as of `pool_residuals`. A direction whose repeatability is not known takes the other's.
    """
    known = [noise.value for noise in repeatability.values() if noise.df > 0]
    fallback = float(np.mean(known)) if known else 0.0
    sigma = {
        direction: noise.value if noise.df > 0 else fallback for direction, noise in repeatability.items()
    }
    forwards = rows["direction"].to_numpy(dtype=object) == "+"
    level = np.where(forwards, sigma["+"], sigma["-"]) / likelihood.spread
    return np.asarray((level * noise_ratio) ** 2 + rounding)


def flag_missing_error_bars(
    law: StepLaw, groups: pd.DataFrame, repeatability: dict[str, NoiseLevel]
) -> list[Flag]:
    """A flag for each direction that has no more traverses than parameters."""
    names = tuple(parameter.name for parameter in law.parameters)
    return [
        Flag.at("few_replicates", law.joint, direction, "", names, FEW_REPLICATES)
        for direction, noise in repeatability.items()
        if noise.df < 1 and (groups["direction"] == direction).any()
    ]


def flag_doubtful_repeatability(
    law: StepLaw, given: dict[str, NoiseLevel], estimated: dict[str, NoiseLevel]
) -> list[Flag]:
    """A flag for each direction whose residuals contradict the given repeatability (chi-square test)."""
    names = tuple(parameter.name for parameter in law.parameters)
    flags = []
    for direction, known in given.items():
        estimate = estimated[direction]
        squares = estimate.df * (estimate.value / known.value) ** 2 if estimate.df else np.nan
        if min(chdtrc(estimate.df, squares), chdtr(estimate.df, squares)) < DOUBT_LEVEL / 2:
            text = (
                f"residuals scatter by {format_value(estimate.value, '%', 2)}, the repeatability was given "
                f"as {format_value(known.value, '%', 2)}; the error bars take it for true"
            )
            flags.append(Flag.at("repeatability_doubted", law.joint, direction, "", names, text))
    return flags


COVERAGE = 0.95


def quadratic_interval(values: Array, covariance: Covariances, reach: Array) -> Array:
    """Estimate, shape (g, p), plus and minus `reach` times its standard error, shape (g, p, 2).

    `reach` has shape (g, 1) or (g, p); NaN where there is no error bar.
    """
    half = reach * np.sqrt(find_variances(covariance))
    return np.stack([values - half, values + half], axis=-1)


def interval_half_widths(groups: pd.DataFrame, repeatability: dict[str, NoiseLevel]) -> Array:
    """Half-width of each group's intervals in standard errors, shape (g, 1)."""
    return np.array([[t_quantile(repeatability[direction].df)] for direction in groups["direction"]])


def t_quantile(df: float) -> float:
    """Half-width of a 95 % interval in standard errors.

    Examples
    --------
    >>> round(t_quantile(4), 3)
    2.776
    """
    return float(stdtrit(df, 0.5 + COVERAGE / 2)) if df > 0 else np.nan


def distance_from_bound(slope: Array, variance: Array, reach: Array) -> Array:
    """End of a bounded parameter's interval: the d with d^2 / variance + 2 |slope| d = reach^2.

    Parameters
    ----------
    slope : array
        By how much half the sum of squares falls per unit of the parameter beyond the bound.
    variance : array
        Of the parameter without the bound; 0 where the rows do not determine it, which has no end.
    reach : array
        Half-width of an interval in standard errors.

    Examples
    --------
    At a bound where the sum of squares is least anyway, it is the ordinary half-width:

    >>> distance_from_bound(np.array([0.0, 2.0]), np.array([4.0, 4.0]), np.array([2.0, 2.0])).round(3)
    array([4.   , 0.944])
    >>> distance_from_bound(np.array([2.0]), np.array([0.0]), np.array([2.0]))
    array([nan])
    """
    steep = np.abs(slope) * variance
    return np.where(variance > 0, np.sqrt(steep**2 + reach**2 * variance) - steep, np.nan)


def one_sided_intervals(
    values: Array, at_bound: BoolArray, lower: Array, neg_gradient: Array, covariance: Array, reach: Array
) -> Array:
    """Intervals of the parameters on a bound, from it to where the likelihood ends them, shape (k, 2).

    Parameters
    ----------
    values, lower, neg_gradient : array, shape (g, p)
        `neg_gradient` is by how much half the sum of squares falls per unit of each parameter.
    at_bound : array of bool, shape (g, p)
    covariance : array, shape (g, p, p)
        Without the bounds.
    reach : array, shape (g, 1) or (g, p)
        Half-width of the intervals in standard errors.
    """
    variance = np.diagonal(covariance, axis1=1, axis2=2)[at_bound]
    reach = np.broadcast_to(reach, values.shape)[at_bound]
    inwards = np.where((values <= lower)[at_bound], 1.0, -1.0)
    ends = values[at_bound] + inwards * distance_from_bound(neg_gradient[at_bound], variance, reach)
    return np.sort(np.stack([values[at_bound], ends], axis=-1), axis=-1)
