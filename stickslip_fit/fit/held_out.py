"""Whether errors on traverses that took no part in a calibration are more than chance explains."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import f as f_distribution

from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.laws import rounding_variance
from stickslip_fit.logs import Log


def held_out_misfit(log: Log, law: Result) -> pd.DataFrame:
    """How the errors of a calibration compare with repeatability and the calibration's own uncertainty.

    Parameters
    ----------
    log : Log
    law : Result
        A calibration of the same log.

    Returns
    -------
    DataFrame
        joint, direction, traverses, excess (mean square of the errors over what is expected of them, the
        scatter of replicates left out of both) and p_value. Directions without a repeatability from
        replicates, or with nothing but replicates, are left out.

    Notes
    -----
    All errors of a session come from one calibration and go up and down together, so that the share of
    traverses outside their intervals says little. With r the n errors in log steps, J their derivatives with
    respect to the parameters, C the parameters' covariance and s the repeatability, known to nu degrees of
    freedom from replicates among them, Q = r' (s^2 I + J C J')^-1 r. Without the replicates' own scatter,
    (Q - nu) / (n - nu) follows F(n - nu, nu) under Gaussian noise where the law holds.

    Examples
    --------
    >>> from stickslip_fit.fit import closed_form
    >>> from stickslip_fit.logs import read_log
    >>> log = read_log("data/reference/campaign.csv")
    >>> bool(held_out_misfit(log, closed_form(log))["p_value"].min() > 0.01)
    True
    """
    fresh = law.residuals[~law.residuals["used"].to_numpy(bool) & law.residuals["residual"].notna()]
    rows = log.usable.loc[fresh.index]
    found = []
    for (joint, direction), mine in rows.groupby(["joint", "direction"], observed=True):
        fit = law.joints[int(joint)]
        known = fit.repeatability[str(direction)]
        if known.source != "replicates" or not known.freedom:
            continue
        squares, number = 0.0, 0
        for _, session in mine.groupby("session", observed=True):
            value = _square(fit, session, fresh.loc[session.index, "residual"].to_numpy(), known.value)
            if np.isfinite(value):
                squares, number = squares + value, number + len(session)
        if (further := number - known.freedom) > 0:
            excess = (squares - known.freedom) / further
            p_value = float(f_distribution.sf(excess, further, known.freedom))
            found.append((int(joint), str(direction), number, excess, p_value))
    return pd.DataFrame(found, columns=["joint", "direction", "traverses", "excess", "p_value"])


def _square(fit: JointFit, rows: pd.DataFrame, residual: np.ndarray, noise: float) -> float:
    """The residuals' squared length in units of what is expected of them; NaN without error bars."""
    group = fit.group_of(rows)
    _, jacobian = fit.law.model(rows)(fit.values[group])
    rounding = rounding_variance(rows["steps"], rows["check_every"])
    expected = jacobian @ fit.covariance[group[0]] @ jacobian.T + np.diag(noise**2 + rounding)
    if not np.all(np.isfinite(expected)):
        return float("nan")
    return float(residual @ np.linalg.solve(expected, residual))
