"""Predictions of a fit and their errors: planned traverses, held-out traverses, control chart.

`assess_held_out` compares held-out errors with repeatability and calibration uncertainty by an F test, and
`describe_excess_scatter` residuals with replicates, the cheap sign that a law misses something;
`held_out_errors` sets the law beside the constant step (thesis Ch. 7). The control chart compares each
session with the prediction interval from earlier sessions (Student's t, Bonferroni over its
parameters).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import fdtrc, gammaincinv, stdtrit

from stickslip_fit._format import coordinate_unit, format_direction, format_percent, joint_name, step_unit
from stickslip_fit._summary import Column, Section, Summarized, Summary, Table, numbers, words
from stickslip_fit.errors import check_type
from stickslip_fit.estimation.closed_form import solve_calibration
from stickslip_fit.estimation.result import AxesArray, JointFit, Result, choose_repeatability, convert_table
from stickslip_fit.estimation.reweighting import UNTIMED
from stickslip_fit.estimation.with_causes import law_without_causes
from stickslip_fit.laws import StepLaw, constant_law, expected_steps, rounding_variance, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import position_columns
from stickslip_fit.machine import Machine
from stickslip_fit.units import from_si


def assess_held_out(log: Log, law: Result) -> pd.DataFrame:
    """How the errors of a calibration compare with repeatability and the calibration's own uncertainty.

    Parameters
    ----------
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
    All errors of a session come from one calibration and are correlated, so that the share of traverses
    outside their intervals says little. With r the n errors in log steps, J their derivatives with
    respect to the parameters, C the parameters' covariance and s the repeatability, known to nu degrees of
    freedom from replicates among them, Q = r' (s^2 I + J C J')^-1 r. Without the replicates' own scatter,
    (Q - nu) / (n - nu) follows F(n - nu, nu) under Gaussian noise where the law holds.

    Examples
    --------
    >>> from stickslip_fit.estimation import fit_closed_form
    >>> from stickslip_fit.logs import read_log
    >>> log = read_log("data/reference/campaign.csv")
    >>> bool(assess_held_out(log, fit_closed_form(log))["p_value"].min() > 0.01)
    True
    """
    fresh = law.residuals[~law.residuals["used"].to_numpy(bool) & law.residuals["residual"].notna()]
    rows = log.usable.loc[fresh.index]
    records = []
    for (joint, direction), subset in rows.groupby(["joint", "direction"], observed=True):
        fit = law.joints[int(joint)]
        known = fit.repeatability[str(direction)]
        if known.source != "replicates" or not known.df:
            continue
        squares, number = 0.0, 0
        for _, session in subset.groupby("session", observed=True):
            value = _mahalanobis_square(
                fit, session, fresh.loc[session.index, "residual"].to_numpy(), known.value
            )
            if np.isfinite(value):
                squares, number = squares + value, number + len(session)
        if (residual_df := number - known.df) > 0:
            excess = (squares - known.df) / residual_df
            p_value = float(fdtrc(residual_df, known.df, max(excess, 0.0)))
            records.append((int(joint), str(direction), number, excess, p_value))
    return pd.DataFrame(records, columns=["joint", "direction", "traverses", "excess", "p_value"])


def _mahalanobis_square(fit: JointFit, rows: pd.DataFrame, residual: np.ndarray, noise: float) -> float:
    """Squared Mahalanobis length of the residuals by the parameters' covariance and the noise."""
    group = fit.group_index(rows)
    _, jacobian = fit.law.model(rows)(fit.values[group])
    rounding = rounding_variance(rows["steps"], rows["check_every"])
    expected = jacobian @ fit.covariance[group[0]] @ jacobian.T + np.diag(noise**2 + rounding)
    if not np.all(np.isfinite(expected)):
        return float("nan")
    return float(residual @ np.linalg.solve(expected, residual))


EXCESS_LEVEL, MIN_EXCESS = 1e-3, 1.4  # of the F test over all directions; of the standard deviations
MIN_DF = 4  # of either


def describe_excess_scatter(log: Log, result: Result) -> str:
    """A sentence on the joint and direction with the largest excess; empty where there is none.

    Residual scatter and the replicate scatter of the calibration in closed form are compared by an F test,
    for each joint and direction that has both.

    Parameters
    ----------
    log : Log
        That was fitted.
    result : Result
        By least squares.
    """
    laws = {joint: law_without_causes(fit.law) for joint, fit in result.joints.items()}
    calibration, found = solve_calibration(log, laws, "closed-form"), []
    for joint, fit in result.joints.items():
        for direction, residual in fit.repeatability.items():
            replicate = calibration.joints[joint].repeatability[direction]
            sources = (residual.source, replicate.source)
            if sources != ("residuals", "replicates") or min(residual.df, replicate.df) < MIN_DF:
                continue
            ratio = residual.value / replicate.value if replicate.value > 0 else 0.0
            chance = fdtrc(residual.df, replicate.df, ratio**2) * 2 * len(result.joints)
            if ratio > MIN_EXCESS and chance < EXCESS_LEVEL:
                found.append((ratio, joint, direction, residual.value, replicate.value))
    if not found:
        return ""
    _, joint, direction, residual_scatter, replicate_scatter = max(found)
    return (
        f"The residual scatter is {format_percent(residual_scatter)}, the replicate scatter "
        f"{format_percent(replicate_scatter)} (joint {joint}, direction {format_direction(direction)}): the "
        "law misses something; run stickslip-fit diagnose."
    )


def fit_constant_step(log: Log, result: Result) -> Result:
    """The constant-step model: one step size per joint, session and direction.

    It is that of the first full traverse in the law's first calibration configuration, without gravity and
    recoil; NaN for a session without such a traverse.
    """
    companions = {joint: law_without_causes(fit.law) for joint, fit in result.joints.items()}
    laws: dict[int, StepLaw] = {joint: constant_law(law) for joint, law in companions.items()}
    return solve_calibration(
        log, laws, "constant-step", companion_laws=companions, command=result.provenance.command
    )


@dataclass(frozen=True, repr=False)
class HeldOutErrors(Summarized):
    """Step sizes predicted for traverses that took no part in calibrating, beside the measured ones.

    Attributes
    ----------
    si : DataFrame, indexed as the log's usable rows
        The log's configuration columns, and measured, law, constant: mean step sizes (rad or m) as
        measured, as the calibrated law predicts them, and as one constant step size does.
    machine : Machine
    """

    si: pd.DataFrame
    machine: Machine

    @property
    def table(self) -> pd.DataFrame:
        """The same in nm, µrad, mm and degrees, with law_error_pct and constant_error_pct in %."""
        table, positions = self.si[["session", "joint", "direction"]].copy(), position_columns(self.si)
        for name in positions:
            unit = coordinate_unit(name, self.machine)
            table[f"{name}_{unit}"] = from_si(self.si[name].to_numpy(float), unit)
        units = {joint: step_unit(joint, self.machine) for joint in self.si["joint"].unique()}
        table["unit"] = self.si["joint"].map(units).astype(object)
        models = ["law", "constant"]
        table[["measured", *models]] = self.si[["measured", *models]]
        table = convert_table(table, ["measured", *models])
        for model in models:
            table[f"{model}_error_pct"] = 100.0 * (self.si[model] / self.si["measured"] - 1.0)
        return table

    def summary(self) -> Summary:
        """The rms and the worst error of both models for each joint and direction."""
        rows = tuple(
            (
                joint_name(int(row.joint), self.machine),
                format_direction(str(row.direction)),
                f"{row.traverses:,}",
                *(format_percent(getattr(row, name), with_unit=False) for name in ERROR_COLUMNS),
            )
            for row in summarize_errors(self.si, ["joint", "direction"]).itertuples(index=False)
        )
        columns = (
            *words("joint", "direction"),
            Column("traverses"),
            *numbers("rms", "worst", unit="%", group="law"),
            *numbers("rms", "worst", unit="%", group="constant step"),
        )
        note = "Predicted less measured mean step size, of traverses that the calibration did not use."
        table = Table("Errors on held-out traverses", columns, rows, stubs=2, note=note)
        return Summary("Held-out errors", sections=(Section(tables=(table,)),))

    def plot(self) -> AxesArray:
        """The share of traverses that each model predicts to better than x, an Axes for each joint."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.accuracy import draw_errors

        return collect_axes(draw_errors(self.si, {}, self.machine))


ERROR_COLUMNS = ("law_rms_relative", "law_worst_relative", "constant_rms_relative", "constant_worst_relative")


def held_out_errors(log: Log, law: Result, constant: Result | None = None) -> HeldOutErrors:
    """Errors of a calibration, and of a constant step, on the traverses that neither used.

    Parameters
    ----------
    log : Log
    law : Result
        A calibration of this log.
    constant : Result, optional
        Another one to compare with; by default `fit_constant_step`.

    Returns
    -------
    HeldOutErrors
        Traverses that a calibration cannot predict are left out.
    """
    check_type("law", law, Result)
    constant = fit_constant_step(log, law) if constant is None else constant
    fresh = ~(law.residuals["used"] | constant.residuals["used"])
    rows = log.usable.loc[fresh.index[fresh]]
    steps = expected_steps(rows["steps"], rows["check_every"])
    table = rows[["session", "joint", "direction", *position_columns(rows), "start", "stop"]].copy()
    table["measured"] = traverse_length(rows) / steps
    table["law"] = law.si.predict(rows)["step_size"]
    table["constant"] = constant.si.predict(rows)["step_size"]
    return HeldOutErrors(table.dropna(subset=["law", "constant"]), log.machine)


def collect_traverses(joint: int, log: Log, calibration: Result, fit: Result) -> pd.DataFrame:
    """Usable traverses of a joint with measured and predicted step sizes, for figures.

    Returns
    -------
    DataFrame
        The log's columns, positions rounded to 1e-9, and centre (middle of the traverse, rad or m),
        step_size (mean over the traverse), error (one repeatability, rounding included; 0 where it is
        not known), model (by the fitted law), departure (step_size / model - 1).
    """
    rows = log.usable
    rows = rows[rows["joint"] == joint].copy()
    positions = position_columns(rows)
    rows[positions] = rows[positions].round(9) + 0.0
    steps = expected_steps(rows["steps"], rows["check_every"])
    rows["centre"] = (rows["start"] + rows["stop"]) / 2
    rows["step_size"] = traverse_length(rows) / steps
    noise = {
        direction: choose_repeatability(joint, direction, calibration, fit).value for direction in ("+", "-")
    }
    spread = np.nan_to_num(rows["direction"].astype(object).map(noise).to_numpy(float))
    rows["error"] = rows["step_size"] * np.sqrt(
        spread**2 + rounding_variance(rows["steps"], rows["check_every"])
    )
    rows["model"] = fit.si.predict(rows)["step_size"]
    rows["departure"] = rows["step_size"] / rows["model"] - 1.0
    return rows


def summarize_errors(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Bias, rms and worst error of both models over groups of traverses.

    Parameters
    ----------
    table : DataFrame
        As `HeldOutErrors.si`.
    by : list of str
        Columns to group by; configurations are compared with NaN equal to NaN.

    Returns
    -------
    DataFrame
        One row per group: the columns `by`, traverses, and for each model (law, constant) its bias, rms and
        worst error, absolute (rad or m) and relative (``law_rms``, ``law_rms_relative``, ...), with
        ``law_rms_low`` and ``law_rms_high``, a 95 % interval of the rms for errors that are Gaussian.
    """
    number = table.groupby(by, dropna=False, sort=True, observed=True).ngroup().to_numpy()
    order = np.argsort(number, kind="stable")
    size = np.bincount(number)
    first, measured = np.cumsum(size) - size, table["measured"].to_numpy(float)
    columns: dict[str, npt.NDArray[Any]] = {"traverses": size}
    for model in ("law", "constant"):
        predicted = table[model].to_numpy(float)
        for suffix, errors in (("", predicted - measured), ("_relative", predicted / measured - 1.0)):
            own = errors[order]
            bias = np.add.reduceat(own, first) / size
            scatter = np.add.reduceat((own - np.repeat(bias, size)) ** 2, first) / size
            high, low = np.maximum.reduceat(own, first), np.minimum.reduceat(own, first)
            columns[f"{model}_bias{suffix}"] = bias
            columns[f"{model}_rms{suffix}"] = np.sqrt(bias**2 + scatter)
            columns[f"{model}_worst{suffix}"] = np.where(high >= -low, high, low)
    half_df = size / 2.0
    for end, q in (("low", 0.975), ("high", 0.025)):
        factor = np.sqrt(half_df / gammaincinv(half_df, q))  # df over the quantile of the chi-square
        columns |= {f"{model}_rms_{end}": columns[f"{model}_rms"] * factor for model in ("law", "constant")}
    return table[by].iloc[order[first]].reset_index(drop=True).assign(**columns)


MIN_EARLIER_SESSIONS = 3  # two earlier sessions give limits too wide to be of use
OUT_OF_CONTROL_LEVEL = 0.01  # over all parameters of a session together


def control_chart(result: Result) -> pd.DataFrame:
    """Every session's parameters beside what the sessions before it predict for them.

    Parameters
    ----------
    result : Result
        By any estimator.

    Returns
    -------
    DataFrame
        name, joint, direction, session, unit, estimate, low, high (its 95 %), expected_low, expected_high
        (SI) and surprising. The range holds all parameters of a drive that changes from session to session
        as it did so far in 99 of 100 sessions (Student's t, Bonferroni over the session's parameters that
        have a range); it is NaN with fewer than three earlier sessions, and in a log without times.
        Parameters that are not known, and those that all sessions share, are not listed.
    """
    table = result.si.parameters.dropna(subset=["estimate", "session"])
    chart = table[["name", "joint", "direction", "session", "unit", "estimate", "low", "high"]]
    chart = chart.reset_index(drop=True)
    histories = chart.groupby(["joint", "direction", "name"], sort=False)["estimate"]
    earlier = histories.cumcount().to_numpy()
    middle, spread = np.full(len(chart), np.nan), np.full(len(chart), np.nan)
    for _, history in histories:
        middle[history.index], spread[history.index] = _predict_next(history.to_numpy(float))
    has_limits = (earlier >= MIN_EARLIER_SESSIONS) & has_order(result)
    n_compared = np.maximum(pd.Series(has_limits).groupby(chart["session"]).transform("sum").to_numpy(), 1)
    df = np.where(has_limits, earlier - 1, 1)
    reach = spread * stdtrit(df, 1 - OUT_OF_CONTROL_LEVEL / 2 / n_compared)
    chart["expected_low"], chart["expected_high"] = middle - reach, middle + reach
    chart["surprising"] = np.abs(chart["estimate"] - middle) > reach
    return chart


NO_ORDER = "The log has no times, so that no session can be compared with those before it."


def has_order(result: Result) -> bool:
    """Whether it is known which session came after which."""
    return all(flag.flag != UNTIMED for flag in result.flags)


def latest_control(result: Result) -> pd.DataFrame:
    """The latest session's parameters beside what the earlier sessions predict for them.

    Returns
    -------
    DataFrame
        The last row in `control_chart` of each parameter with three or more earlier sessions.
    """
    chart = control_chart(result)
    latest = chart.groupby(["joint", "direction", "name"], sort=False).tail(1)
    return latest.dropna(subset=["expected_low"]).reset_index(drop=True)


def format_latest_control(latest: pd.DataFrame) -> str:
    """`latest_control` in words: one sentence, and a line for each parameter out of control."""
    if latest.empty:
        return f"To say whether the latest session is as usual takes {MIN_EARLIER_SESSIONS} earlier ones."
    session, odd = latest["session"].iloc[-1], latest[latest["surprising"].astype(bool)]
    if odd.empty:
        return f"Session {session} lies where the sessions before it lead one to expect."
    lines = [
        f"  joint {row.joint} {format_direction(row.direction)} {row.name}: "
        f"{from_si(row.estimate, row.unit):.4g}, expected {from_si(row.expected_low, row.unit):.4g} to "
        f"{from_si(row.expected_high, row.unit):.4g}{'' if row.unit == '1' else ' ' + row.unit}"
        for row in odd.itertuples(index=False)
    ]
    return "\n".join([f"Session {session} is not where the sessions before it lead one to expect:", *lines])


def _predict_next(estimates: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Mean and standard deviation of the next estimate after each stretch of the past, shape (2, n)."""
    predicted = np.full((2, len(estimates)), np.nan)
    for k in range(MIN_EARLIER_SESSIONS, len(estimates)):
        past = estimates[:k]
        predicted[:, k] = past.mean(), past.std(ddof=1) * np.sqrt(1 + 1 / k)
    return predicted
