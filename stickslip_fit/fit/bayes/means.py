"""From draws to the result that every estimator gives: means, covariances, quantiles, remarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.bayes.remarks import known_sizes, remarks, remarks_on_sizes
from stickslip_fit.fit.bayes.sample import Sample
from stickslip_fit.fit.groups import group_rows
from stickslip_fit.fit.intervals import COVERAGE
from stickslip_fit.fit.outliers import flag_outliers
from stickslip_fit.fit.provenance import provenance
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.repeatability import Repeatability
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine

Array = npt.NDArray[np.float64]
BOUNDS = (0.5 - COVERAGE / 2, 0.5 + COVERAGE / 2)


def result_of(log: Log, samples: Mapping[tuple[int, str], Sample], seed: int, command: str) -> Result:
    """The result of all joints and directions."""
    joints, residuals, said = {}, [], []
    for joint in dict.fromkeys(joint for joint, _ in samples):
        both = {direction: found for (other, direction), found in samples.items() if other == joint}
        joints[joint], residual, remarked = _fit_joint(joint, both, log.machine)
        residuals.append(residual)
        said += remarked
    said += remarks_on_sizes(next(iter(samples.values())))
    result = Result(
        method="bayes",
        machine=log.machine,
        joints=joints,
        residuals=pd.concat(residuals).sort_index(),
        remarks=tuple(said),
        provenance=replace(provenance(log, command), seed=seed),
    )
    return flag_outliers(result, log)


def _fit_joint(
    joint: int, samples: Mapping[str, Sample], machine: Machine
) -> tuple[JointFit, pd.DataFrame, list[Remark]]:
    """One joint's fit from its directions' samples; also its residuals, and what is to be said."""
    law = next(iter(samples.values())).traverses.law
    rows = pd.concat([found.traverses.rows[["session", "direction"]] for found in samples.values()])
    table = group_rows(rows.sort_index()).table
    g, p = len(table), len(law.parameters)
    values, known = np.full((g, p), np.nan), np.zeros((g, p), dtype=bool)
    covariance, interval = np.full((g, p, p), np.nan), np.full((g, p, 2), np.nan)
    repeatability = {way: Repeatability(np.nan, 0, "posterior") for way in ("+", "-")}
    residuals, said = [], []
    for way, found in samples.items():
        mean = found.draws.parameters.mean(axis=0)
        predicted = law.predict(found.traverses.rows, mean[found.traverses.groups.of_row])
        residual = found.traverses.y - predicted
        remarked, identified = remarks(found.own_part(), machine, way, mean[:, : len(found.prior.names)])
        said += remarked
        if found.converged:
            own = np.flatnonzero(table["direction"] == way)
            values[own], known[own] = mean, np.append(identified, known_sizes(found))
            covariance[own] = _covariance(found.draws.parameters)
            interval[own] = np.moveaxis(np.quantile(found.draws.parameters, BOUNDS, axis=0), 0, -1)
            repeatability[way] = _repeatability(found.draws.repeatability)
        else:
            residual = np.full_like(residual, np.nan)
        columns = {"joint": joint, "residual": residual, "used": True}
        residuals.append(pd.DataFrame(columns, index=found.traverses.rows.index))
    fit = JointFit(law, table, values, known, covariance, interval, repeatability)
    return fit, pd.concat(residuals), said


def _covariance(parameters: Array) -> Array:
    """Of each session's draws, (d, S, p) -> (S, p, p)."""
    departure = parameters - parameters.mean(axis=0)
    return np.einsum("dsi,dsj->sij", departure, departure) / (len(parameters) - 1)


def _repeatability(draws: Array) -> Repeatability:
    """Posterior mean, with the degrees of freedom of as wide a chi-square."""
    freedom = 1.0 / (2.0 * float(np.var(np.log(draws))))
    return Repeatability(float(draws.mean()), max(round(freedom), 1), "posterior")
