"""How rows are weighted: iteratively reweighted least squares; and the outliers that it finds.

The first fit weighs all rows alike. Its residuals give the repeatability of each joint and direction, and
with the variance of the counts' rounding the variance of each row, see `noise`; under Student's t a row's
own residual lowers its weight further. The fit is repeated until no weight changes.

Outliers are counts whose residuals in a Student-t fit are more than `ROBUST_Z` robust standard deviations. A
Gaussian fit is pulled so far by an outlier that its own residual no longer stands out, or its neighbours' do.
The Student-t fit has several optima if sessions are short: it starts from the weights of a fit in which all
sessions have the same parameters, where no single traverse can pull much. A session with no more traverses
than parameters can show no outlier.

`ROBUST_Z` is chosen by simulation so that heavy tails alone are flagged in fewer than 1 of 100 logs. Of
1,200 logs of a prismatic joint, 400 rows each, with Student's t noise (df = 5) and no outlier, thresholds of
12, 15, 18 and 21 flag 27, 8, 3 and 1: a false-flag rate of 0.25 % at 18. Of 400 with Gaussian noise,
none has a residual beyond 9. Residuals below 18 TYPICAL_SIGMA = 5.4 % are never flagged.
Outliers that have something in common are told as one pattern, see `outlier_pattern`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import format_configuration, format_percent, pluralize
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.estimation._optimize import Minimum
from stickslip_fit.estimation._problem import (
    MAX_ITERATIONS,
    FitOptions,
    JointProblem,
    Problem,
    columns_of,
    single_problem,
)
from stickslip_fit.estimation.noise import (
    Flag,
    Likelihood,
    NoiseLevel,
    StudentT,
    pool_residuals,
    row_variance,
)
from stickslip_fit.estimation.outlier_pattern import OutlierPattern, find_pattern
from stickslip_fit.estimation.result import ALL_JOINTS, Result
from stickslip_fit.estimation.with_causes import law_without_causes
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import NO_TIMES, has_times
from stickslip_fit.machine import Machine
from stickslip_fit.units import Z_95

UNTIMED = "no_times"
NO_TIMES_TEXT = f"{NO_TIMES}: what changes with time or from one traverse to the next stays unknown"
MAX_PASSES = 100
WEIGHT_TOL = 1e-6


@dataclass(frozen=True, eq=False)
class ConvergedFit:
    """A fit whose weights have converged: `minimum` of `whole`, which combines the joints.

    Each joint has its repeatability by direction; `weight` and `information`, shape (n,), are each row's
    weight in the fit and its Fisher information about its prediction.
    """

    joints: tuple[JointProblem, ...]
    whole: Problem
    minimum: Minimum
    repeatability: tuple[dict[str, NoiseLevel], ...]
    weight: Array
    information: Array

    def groups(self, number: int) -> slice:
        """Positions of one joint's groups among those of the whole."""
        return _place(number, [len(joint.groups) for joint in self.joints])

    def rows(self, number: int) -> slice:
        """Positions of one joint's rows among those of the whole."""
        return _place(number, [len(joint.y) for joint in self.joints])

    def columns(self, number: int) -> IntArray:
        """Positions of one joint's parameters among those of the whole."""
        return columns_of(self.whole, self.joints[number])

    def minimum_of(self, number: int) -> Minimum:
        """One joint's share of the minimum; its curvature is that of the whole."""
        return _minimum_of(self.joints, self.whole, self.minimum, number)


def iterate_weights(
    joints: Sequence[JointProblem],
    whole: Problem,
    options: FitOptions,
    weight: Array | None = None,
    most: int = MAX_ITERATIONS,
) -> ConvergedFit:
    """Minimize `whole`, weigh the rows by their residuals, and repeat until the weights converge.

    `whole` is `combined_problem` of the joints or the only joint itself; `weight`, shape (n,), is the first
    one, by default `first_weight`. Each pass makes `most` iterations at most.
    """
    likelihood, start = options.likelihood, whole.start
    weight = whole.first_weight if weight is None else weight
    for _ in range(MAX_PASSES):
        minimum = whole.minimize(weight, start, most)
        repeatability = tuple(
            from_residuals(joint, _minimum_of(joints, whole, minimum, number), likelihood)
            | options.known_noise(joint.law.joint)
            for number, joint in enumerate(joints)
        )
        scale2 = np.concatenate(
            [
                row_variance(joint.rows, joint.rounding, by_direction, likelihood, joint.noise_ratio)
                for joint, by_direction in zip(joints, repeatability, strict=True)
            ]
        )
        before, weight = weight, likelihood.irls_weight(minimum.residual**2 / scale2) / scale2
        start = minimum.values
        if np.max(np.abs(weight / before - 1.0)) < WEIGHT_TOL:
            break
    return ConvergedFit(tuple(joints), whole, minimum, repeatability, weight, likelihood.information / scale2)


def from_residuals(joint: JointProblem, minimum: Minimum, likelihood: Likelihood) -> dict[str, NoiseLevel]:
    """Repeatability of each direction from the residuals of a fit."""
    repeatability = {}
    of_row, of_group = joint.rows["direction"].to_numpy(dtype=object), joint.directions
    for direction in ("+", "-"):
        rows = of_row == direction
        df = int(rows.sum() - minimum.rank[of_group == direction].sum())
        residual, rounding, ratio = minimum.residual[rows], joint.rounding[rows], joint.noise_ratio[rows]
        repeatability[direction] = pool_residuals(residual, rounding, df, "residuals", likelihood, ratio)
    return repeatability


def _minimum_of(joints: Sequence[JointProblem], whole: Problem, minimum: Minimum, number: int) -> Minimum:
    groups = _place(number, [len(joint.groups) for joint in joints])
    columns = columns_of(whole, joints[number])
    return Minimum(
        values=minimum.values[groups, columns],
        curvature=minimum.curvature,
        residual=minimum.residual[_place(number, [len(joint.y) for joint in joints])],
        converged=minimum.converged[groups],
        rank=minimum.rank[groups],
        at_bound=minimum.at_bound[groups, columns],
        iterations=minimum.iterations,
    )


def _place(number: int, sizes: Sequence[int]) -> slice:
    return slice(sum(sizes[:number]), sum(sizes[: number + 1]))


ROBUST_Z = 18.0  # see above
SUSPICIOUS_Z = 5.0  # in a fit that an outlier may have pulled towards it
SEARCH_ITERATIONS = 50  # of one pass; where the law suits no count, more would take long and show no outlier
TYPICAL_SIGMA = 0.003  # of log steps; the least scatter that a few small residuals may show
SIGMA_PER_MAD = 1.4826
OUTLIER, PATTERN = "outlier", "outlier_pattern"
ADVICE = "repeat the traverse; the Student-t fit (--heavy-tails) needs none excluded"


def flag_outliers(result: Result, log: Log) -> Result:
    """The result with a flag on each outlying count of the log, whatever the estimator.

    Where all its residuals are small, no Student-t fit is made.
    """
    flags = [] if has_times(log.rows) else [Flag(UNTIMED, ALL_JOINTS, "", "", (), NO_TIMES_TEXT)]
    usable = log.usable
    for joint, fit in result.joints.items():
        rows = usable[usable["joint"] == joint]
        residual = result.residuals.loc[rows.index, "residual"].to_numpy()
        if not np.all(np.abs(residual) < SUSPICIOUS_Z * TYPICAL_SIGMA):
            flags += outliers(law_without_causes(fit.law), rows, log.machine)
    return replace(result, flags=(*result.flags, *flags))


def outliers(law: StepLaw, rows: pd.DataFrame, machine: Machine | None = None) -> list[Flag]:
    """A flag on each outlying count of one joint, with the count that the other rows predict.

    Counts that have something in common are one flag: they are a pattern, which the law leaves out.
    """
    names = tuple(parameter.name for parameter in law.parameters)
    campaign = single_problem(law, rows, FitOptions(StudentT(), shared=names))
    sessions, heavy_tails = single_problem(law, rows, FitOptions()), FitOptions(StudentT())
    first = iterate_weights([campaign], campaign, heavy_tails, most=SEARCH_ITERATIONS).weight
    fit = iterate_weights([sessions], sessions, heavy_tails, first, SEARCH_ITERATIONS)
    residual, sigma = fit.minimum.residual, fit.repeatability[0]
    df = {direction: sigma[direction].df for direction in sigma}
    z = robust_z(residual, rows["direction"].to_numpy(dtype=object), df)
    outlying = np.abs(z) > ROBUST_Z
    if not outlying.any():
        return []
    y, _ = law.response(rows)
    log_expected, scatter = (y - residual)[outlying], (residual / z)[outlying]
    pattern = find_pattern(rows, outlying)
    if pattern is not None:
        text = describe_pattern(pattern, int(outlying.sum()), np.exp(np.abs(residual[outlying])).max() - 1)
        return [Flag(PATTERN, law.joint, "", "", (), f"joint {law.joint}: {text}")]
    flags = []
    for (_, row), center, sd in zip(rows[outlying].iterrows(), log_expected, scatter, strict=True):
        place = f" ({format_configuration(row, machine)})" if machine else ""
        low, high = np.exp(center + Z_95 * sd * np.array([-1.0, 1.0]))
        text = (
            f"the count {row['steps']} of {row['time']}{place} is far from the {low:.0f} to "
            f"{high:.0f} (95 %) that the others predict, and stands alone: {ADVICE}"
        )
        flags.append(Flag.at(OUTLIER, law.joint, str(row["direction"]), str(row["session"]), names, text))
    return flags


def describe_pattern(pattern: OutlierPattern, count: int, largest: float) -> str:
    """What outlying counts have in common, and what to do."""
    return (
        f"{pluralize(count, 'count')} are far from what the others predict, by up to "
        f"{format_percent(largest)}, and {pattern.text}: no slips, but a pattern that the law leaves out. "
        "Leave them in, and let `stickslip-fit diagnose` name its cause"
    )


def robust_z(residual: Array, direction: npt.NDArray[np.object_], df: Mapping[str, int]) -> Array:
    """Residuals over the scatter in their direction, shape (n,).

    The scatter is the median absolute residual as a standard deviation, corrected for the fitted parameters.
    """
    sigma = np.full(len(residual), TYPICAL_SIGMA)
    for sign in np.unique(direction):
        rows = direction == sign
        median = float(np.median(np.abs(residual[rows])))
        sigma[rows] = max(SIGMA_PER_MAD * median * np.sqrt(rows.sum() / max(df[sign], 1)), TYPICAL_SIGMA)
    return residual / sigma
