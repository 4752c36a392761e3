"""How much a law may still lack, in no form that the alternatives have: what replicates tell from noise.

A term or smooth function for unknown structure only comes near it, and so does a cause whose effect is far
above the noise and has not quite the form that the law gives it. Of an effect that is the same in replicates,
what is left varies between configurations, sessions and directions; noise varies within them, too. So the
residuals have two sums of squares, as in the analysis of variance of a regression with replicates (G. E. P.
Box and N. R. Draper, Empirical Model-Building and Response Surfaces, 1987, section 3.12). Half of the prior
is on a law that lacks nothing, half on one that lacks a share of the effect: where a form is wrong, what it
misses grows with the effect. Where replicates are none, as of an effect in time, that is all that is known.

A form that was found for what has no name may lack more than a cause's: of 111 effects from outside the
library, far above the noise, a tenth were 1.35 times as large as what was found of them, a twentieth 1.5
times (`benchmarks/README.md`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.special import softmax

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.effect_interval import MIN_LENGTH, QUANTILES_95, LawEffect
from stickslip_fit.diagnosis.linearized import LinearizedFit, rms
from stickslip_fit.logs.log import number_configurations
from stickslip_fit.units import Z_95, Interval

# Of the norm of an effect, what a law that comes near it lacks: of a cause, and of what has no name.
SHARES, UNNAMED_SHARES = (0.125, 0.25, 0.5), (0.25, 0.5, 1.0)
SAME_EFFECT = 0.2  # of its rms, by which an effect may differ between replicates, rms
GAUSSIAN_KURTOSIS = 3.0
N_DRAWS = 2000  # of the posterior distribution of a size


@dataclass(frozen=True)
class LackOfFit:
    """Squared residuals of a law between cells of replicates and within them, in units of the noise.

    Attributes
    ----------
    between, within : float
        Sums of squares.
    df_between, df_within : int
        Their degrees of freedom.
    kurtosis : float
        Of the residuals; 3 or more.
    strength : float
        Norm of the effect that is in the law.
    shares : tuple of float
        Of that norm, what the law may lack.

    Examples
    --------
    Without a difference the law probably lacks nothing; where cells differ, it does.

    >>> alike, different = (LackOfFit(squares, 100, 200, 100, 3.0, 25.0) for squares in (200, 300))
    >>> alike.probabilities.round(2), different.probabilities.round(2)
    (array([0.66, 0.21, 0.13, 0.  ]), array([0.16, 0.09, 0.31, 0.44]))
    """

    between: float
    within: float
    df_between: int
    df_within: int
    kurtosis: float
    strength: float
    shares: tuple[float, ...] = SHARES

    @classmethod
    def of(
        cls, linearized: LinearizedFit, law: LawEffect, shares: tuple[float, ...] = SHARES
    ) -> LackOfFit | None:
        """Of a log's law with what extends it; None of other tables."""
        rows, residual = linearized.rows, linearized.residual
        if linearized.noise_filter is not None or not all(
            hasattr(one.law, "joint") for one in linearized.parts
        ):
            return None
        session, _ = pd.factorize(rows["session"].astype(object))
        keys = np.column_stack([session, number_configurations(rows), linearized.direction_sign])
        _, cell = np.unique(keys, axis=0, return_inverse=True)
        size, cell = np.bincount(cell.ravel()), cell.ravel()
        within_cells = law.changes - (np.bincount(cell, law.changes) / size)[cell]
        if rms(within_cells) > SAME_EFFECT * max(law.rms, MIN_LENGTH):
            # What the law lacks of an effect that follows time, or what was before, differs there, too.
            size, cell = np.ones(len(rows), dtype=np.intp), np.arange(len(rows))
        df_within, df_between = len(rows) - len(size), linearized.df - len(rows) + len(size)
        if df_between < 1:
            return None
        within = float(np.sum((residual - (np.bincount(cell, residual) / size)[cell]) ** 2))
        kurtosis = float(np.mean(residual**4) / np.mean(residual**2) ** 2)
        total = float(residual @ residual)
        kurtosis = max(kurtosis, GAUSSIAN_KURTOSIS)
        return cls(total - within, within, df_between, df_within, kurtosis, law.strength, shares)

    @property
    def signal(self) -> Array:
        """Variance between cells over that of the noise: none, and with each of the `shares`."""
        return np.square(self.strength * np.array([0.0, *self.shares])) / self.df_between

    @cached_property
    def probabilities(self) -> Array:
        """Posterior of each; in heavy tails squares say less, by the ratio of their variances."""
        df = self.df_between + self.df_within
        left = self.between / (1.0 + self.signal) + self.within
        log_evidence = -0.5 * (self.df_between * np.log1p(self.signal) + df * np.log(left))
        log_evidence *= (GAUSSIAN_KURTOSIS - 1.0) / (self.kurtosis - 1.0)
        return np.asarray(softmax(log_evidence + np.log(_prior(self.shares))))

    def add_to(self, sizes: Array, noise: Array) -> Array:
        """Draws of an effect's rms with what the law lacks; `noise`, (n,), is the sd of each response."""
        squares = self.draw_squares(len(sizes), np.random.default_rng(1))
        return np.asarray(np.sqrt(sizes**2 + squares / len(noise) * np.mean(noise**2)))

    def draw_squares(self, number: int, rng: np.random.Generator) -> Array:
        """Draws of the squared norm of what the law lacks, in units of the noise, shape (number,)."""
        kept = self.signal / (1.0 + self.signal)
        variance = (self.between * (1.0 - kept) + self.within) / (self.df_between + self.df_within)
        squares = kept**2 * self.between / variance + kept * self.df_between
        return squares[rng.choice(len(squares), number, p=self.probabilities)]


def _prior(shares: tuple[float, ...]) -> Array:
    """Of a law that lacks nothing, and of each share of the effect that it may lack."""
    return np.array([0.5, *(0.5 / len(shares) for _ in shares)])


def widen(size: Interval) -> Interval:
    """The size of what has no name, its upper end with what its form may lack, of which nothing tells.

    Examples
    --------
    >>> round(widen(Interval(0.20, 0.18, 0.22)).high, 2)
    0.3
    """
    rng, error = np.random.default_rng(0), (size.high - size.low) / (2.0 * Z_95)
    shares = rng.choice([0.0, *UNNAMED_SHARES], N_DRAWS, p=_prior(UNNAMED_SHARES))
    sizes = (size.estimate + error * rng.standard_normal(N_DRAWS)) * np.hypot(1.0, shares)
    return replace(size, high=max(size.high, float(np.quantile(sizes, QUANTILES_95[-1]))))
