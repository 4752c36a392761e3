"""Outlying counts: residuals of a Student-t fit that lie far beyond the scatter of the others.

A plain fit is pulled so far by an outlier that its own residual no longer stands out, or its neighbours' do.
The fit with Student's t (see `StudentT`) gives it next to no weight. It has several optima if sessions are
short: it starts from the weights of a fit in which all sessions have the same parameters, where no single
traverse can pull much. A session with no more traverses than parameters can show no outlier.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.estimation._problem import FitOptions, single_problem
from stickslip_fit.estimation.noise import Flag, StudentT
from stickslip_fit.estimation.result import Result
from stickslip_fit.estimation.reweighting import iterate_weights
from stickslip_fit.laws import StepLaw, published_law
from stickslip_fit.logs import Log

ROBUST_Z = 18.0  # Student's t noise, df = 5, reaches it in fewer than 1 of 100 logs of 400 rows (7 of 900)
SUSPICIOUS_Z = 5.0  # in a fit that an outlier may have pulled towards it
TYPICAL_SIGMA = 0.003  # of log steps; a few residuals that happen to be small are no measure of the scatter
SIGMA_PER_MAD = 1.4826


def flag_outliers(result: Result, log: Log) -> Result:
    """The result with a remark on each outlying count of the log, whatever the estimator.

    Parameters
    ----------
    result : Result
        Where all its residuals are small, no other fit is made.
    log : Log
    """
    flags = []
    for joint in result.joints:
        rows = log.usable[log.usable["joint"] == joint]
        residual = result.residuals.loc[rows.index, "residual"].to_numpy()
        if not np.all(np.abs(residual) < SUSPICIOUS_Z * TYPICAL_SIGMA):
            flags += outliers(published_law(joint, rows, log.machine), rows)
    return replace(result, flags=(*result.flags, *flags))


def outliers(law: StepLaw, rows: pd.DataFrame) -> list[Flag]:
    """A remark on each outlying count of one joint, with the count that the other rows predict."""
    names = tuple(parameter.name for parameter in law.parameters)
    campaign = single_problem(law, rows, FitOptions(StudentT(), shared=names))
    sessions, heavy_tails = single_problem(law, rows, FitOptions()), FitOptions(StudentT())
    first = iterate_weights([campaign], campaign, heavy_tails).weight
    fit = iterate_weights([sessions], sessions, heavy_tails, first)
    residual, sigma = fit.minimum.residual, fit.repeatability[0]
    df = {direction: sigma[direction].df for direction in sigma}
    z = robust_z(residual, rows["direction"].to_numpy(dtype=object), df)
    outlying = np.abs(z) > ROBUST_Z
    y, _ = law.response(rows)
    found = rows[outlying].assign(expected=np.exp(y - residual)[outlying], z=z[outlying])
    return [
        Flag(
            "outlier", law.joint, str(row.direction), str(row.session), names,
            f"joint {law.joint}, direction {row.direction}, session {row.session}: the count {row.steps} of "
            f"{row.time} is an outlier ({abs(row.z):.0f} robust standard deviations); the other traverses "
            f"predict {row.expected:.0f}; correct it, or exclude the traverse",
        )
        for row in found.itertuples()
    ]  # fmt: skip


def robust_z(residual: Array, direction: npt.NDArray[np.object_], df: Mapping[str, int]) -> Array:
    """Residuals over the scatter in their direction, shape (n,).

    The scatter is the median absolute residual as a standard deviation, corrected for the fitted parameters.
    """
    sigma = np.full(len(residual), TYPICAL_SIGMA)
    for each in np.unique(direction):
        rows = direction == each
        median = float(np.median(np.abs(residual[rows])))
        sigma[rows] = max(SIGMA_PER_MAD * median * np.sqrt(rows.sum() / max(df[each], 1)), TYPICAL_SIGMA)
    return residual / sigma
