"""How far a calibrated law is from traverses that took no part in the calibration (thesis Ch. 7)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import chi2

from stickslip_fit.fit.closed_form import calibrate
from stickslip_fit.fit.result import Result
from stickslip_fit.laws import StepLaw, constant_law, expected_steps, published_law, travel
from stickslip_fit.logs import Log


def constant_step(log: Log, result: Result) -> Result:
    """The constant-step model: one step size per joint, session and direction.

    It is measured as the law's first parameter is, by the first full traverse in the law's first calibration
    configuration, where neither gravity nor recoil is in play. A session without such a traverse knows no
    constant step.
    """
    rows = log.usable
    beside = {
        joint: published_law(joint, rows[rows["joint"] == joint], log.machine) for joint in result.joints
    }
    laws: dict[int, StepLaw] = {joint: constant_law(law) for joint, law in beside.items()}
    return calibrate(log, laws, "constant-step", beside=beside, command=result.provenance.command)


def errors(log: Log, law: Result, constant: Result) -> pd.DataFrame:
    """Errors of two calibrations on the traverses that neither used.

    Parameters
    ----------
    log : Log
    law, constant : Result
        Calibrations of the same log.

    Returns
    -------
    DataFrame, indexed as the log's rows
        The log's configuration columns, and measured, law, constant: mean step sizes (rad or m) as
        measured and as predicted. Traverses that a calibration cannot predict are left out.
    """
    fresh = ~(law.residuals["used"] | constant.residuals["used"])
    rows = log.usable.loc[fresh.index[fresh]]
    seen = expected_steps(rows["steps"], rows["check_every"])
    table = rows[["session", "joint", "direction", "q1", "q2", "q3", "theta", "psi", "start", "stop"]].copy()
    table["measured"] = travel(rows) / seen
    table["law"] = law.predict(rows)["step_size"]
    table["constant"] = constant.predict(rows)["step_size"]
    return table.dropna(subset=["law", "constant"])


def summarise(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Bias, rms and worst error of both models over groups of traverses.

    Parameters
    ----------
    table : DataFrame
        As `errors` returns it.
    by : list of str
        Columns to group by; configurations are compared with NaN equal to NaN.

    Returns
    -------
    DataFrame
        One row per group: the columns `by`, traverses, and for each model (law, constant) its bias, rms and
        worst error, absolute (rad or m) and relative (``law_rms``, ``law_rms_relative``, ...), with
        ``law_rms_low`` and ``law_rms_high``, a 95 % interval of the rms for errors that are Gaussian.
    """
    work = table[by].copy()
    for model in ("law", "constant"):
        work[f"{model}_"] = table[model] - table["measured"]
        work[f"{model}_relative_"] = table[model] / table["measured"] - 1.0
    groups = work.groupby(by, dropna=False, sort=True, observed=True)
    summary = groups.size().rename("traverses").to_frame()
    for model in ("law", "constant"):
        for suffix in ("", "_relative"):
            error = groups[f"{model}{suffix}_"]
            bias, high, low = error.mean(), error.max(), error.min()
            summary[f"{model}_bias{suffix}"] = bias
            summary[f"{model}_rms{suffix}"] = np.hypot(bias, error.std(ddof=0))
            summary[f"{model}_worst{suffix}"] = high.where(high >= -low, low)
        for end, q in (("low", 0.975), ("high", 0.025)):
            ratio = summary["traverses"] / chi2.ppf(q, summary["traverses"])
            summary[f"{model}_rms_{end}"] = summary[f"{model}_rms"] * np.sqrt(ratio)
    return summary.reset_index()
