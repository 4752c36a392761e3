"""How well a traverse repeats: the standard deviation of log steps, the counts' rounding left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import chi2

from stickslip_fit._format import format_value
from stickslip_fit.fit.likelihood import Gaussian, Likelihood
from stickslip_fit.fit.remark import Remark
from stickslip_fit.laws import StepLaw

Array = npt.NDArray[np.float64]

GAUSSIAN = Gaussian()
GIVEN = 10**9  # degrees of freedom of a repeatability that somebody knows
DOUBTED = 1e-3
CONFIGURATION = ["session", "direction", "q1", "q2", "q3", "theta", "psi", "start", "stop"]


@dataclass(frozen=True)
class Repeatability:
    """One joint's repeatability in one direction.

    Attributes
    ----------
    value : float
        Standard deviation of log steps, i.e. relative; NaN where it cannot be known.
    freedom : int
        Degrees of freedom behind it.
    source : {"replicates", "residuals", "posterior", "given"}
    """

    value: float
    freedom: int
    source: str


def from_replicates(
    law: StepLaw, rows: pd.DataFrame, effect: Array | float = 0.0
) -> dict[str, Repeatability]:
    """Repeatability of each direction from replicates of a configuration within a session.

    Replicates hours apart also carry whatever drifts, so this bounds the repeatability from above; known
    causes' `effect` on log(steps), shape (n,), is taken out.
    """
    y, rounding = law.response(rows)
    y = y - effect
    keys = rows[CONFIGURATION].round(9)
    together = keys.groupby(CONFIGURATION, dropna=False, sort=False, observed=True).ngroup().to_numpy()
    size = np.bincount(together)
    deviation = y - (np.bincount(together, y) / size)[together]
    found = {}
    for direction in ("+", "-"):
        mine = (rows["direction"] == direction).to_numpy()
        freedom = int(mine.sum() - len(np.unique(together[mine])))
        found[direction] = pooled(deviation[mine], rounding[mine], freedom, "replicates")
    return found


def pooled(
    residual: Array, rounding: Array, freedom: int, source: str, likelihood: Likelihood = GAUSSIAN
) -> Repeatability:
    """Repeatability under which the weighted squares of the residuals add up to their degrees of freedom."""
    if freedom < 1:
        return Repeatability(np.nan, 0, source)
    squares = residual**2
    # Rounding is a small part, so this fixed point gains a digit or two a pass; it nears 0 from above.
    scale2 = float(squares.sum()) / freedom / likelihood.spread**2
    for _ in range(200):
        standard = squares / (scale2 + rounding)
        excess = float(np.sum(likelihood.irls_weight(standard) * standard)) / freedom - 1.0
        scale2 *= 1.0 + excess
        if abs(excess) < 1e-10:
            break
    return Repeatability(float(np.sqrt(scale2)) * likelihood.spread, freedom, source)


def variance_of(
    rows: pd.DataFrame,
    rounding: Array,
    repeatability: dict[str, Repeatability],
    likelihood: Likelihood = GAUSSIAN,
) -> Array:
    """Squared scale of each row's log steps, rounding included; shape (n,). A Gaussian's is its variance.

    A direction whose repeatability is not known borrows the other's, so that weights stay sensible.
    """
    known = [found.value for found in repeatability.values() if found.freedom > 0]
    fallback = float(np.mean(known)) if known else 0.0
    value = {way: found.value if found.freedom > 0 else fallback for way, found in repeatability.items()}
    forwards = (rows["direction"] == "+").to_numpy()
    return (np.where(forwards, value["+"], value["-"]) / likelihood.spread) ** 2 + rounding


def without_error_bars(
    law: StepLaw, groups: pd.DataFrame, repeatability: dict[str, Repeatability]
) -> list[Remark]:
    """A remark for each direction that has no more traverses than parameters."""
    names = tuple(parameter.name for parameter in law.parameters)
    return [
        Remark(
            "few_replicates", law.joint, way, "", names,
            f"joint {law.joint}, direction {way}: no error bars, since no traverse is left over to show how "
            "well one repeats; make each calibration traverse twice",
        )
        for way, found in repeatability.items()
        if found.freedom < 1 and (groups["direction"] == way).any()
    ]  # fmt: skip


def doubts(
    law: StepLaw, given: dict[str, Repeatability], estimated: dict[str, Repeatability]
) -> list[Remark]:
    """A remark for each direction whose residuals do not scatter as the given repeatability says.

    The ratio of variances is judged by chi-square over the estimate's degrees of freedom.
    """
    names = tuple(parameter.name for parameter in law.parameters)
    remarks = []
    for way, told in given.items():
        seen = estimated[way]
        squares = seen.freedom * (seen.value / told.value) ** 2 if seen.freedom else np.nan
        if min(chi2.sf(squares, seen.freedom), chi2.cdf(squares, seen.freedom)) < DOUBTED / 2:
            remarks.append(
                Remark(
                    "repeatability_doubted", law.joint, way, "", names,
                    f"joint {law.joint}, direction {way}: residuals scatter by "
                    f"{format_value(seen.value, '%', 2)}, the repeatability was given as "
                    f"{format_value(told.value, '%', 2)}; the error bars take it for true",
                )
            )  # fmt: skip
    return remarks
