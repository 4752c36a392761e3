"""How well strategies know the true mean step sizes of a plan's configurations, campaign by campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import norm

from stickslip_fit.fit.intervals import COVERAGE
from stickslip_fit.laws import travel
from stickslip_fit.strategies.cost import stepping_seconds
from stickslip_fit.strategies.study.calibrations import Calibrated
from stickslip_fit.strategies.study.campaigns import Campaigns
from stickslip_fit.strategies.study.design import Cell

Array = npt.NDArray[np.float64]

REACH = float(norm.ppf(0.5 + COVERAGE / 2))  # standard deviations; strategies know the repeatability


def step_size_errors(
    calibrated: Mapping[str, Calibrated], cells: Sequence[Cell], campaigns: Campaigns
) -> pd.DataFrame:
    """Errors of one joint and direction, summed up for each campaign and strategy.

    Predicted is the mean step size of every configuration, each where its first traverse stands in its
    session. A session that a strategy cannot calibrate is left out for all.

    Parameters
    ----------
    calibrated : mapping of str to Calibrated
        By strategy.
    cells : sequence of Cell
        One for each session.
    campaigns : Campaigns

    Returns
    -------
    DataFrame
        place (of the campaign), strategy; sessions, failed (sessions that it could not calibrate),
        predictions; rms, bias, worst (the largest, with its sign) of predicted less true mean step size, SI,
        and under ``_relative`` as a share of it; covered, the share of predictions whose 95 % interval holds
        the truth. NaN where no session is left.
    """
    offered = campaigns.places(np.concatenate([cell.offered for cell in cells]))
    session = np.repeat(np.arange(len(cells)), [len(cell.offered) for cell in cells])
    number = np.arange(campaigns.count)[:, None] * len(cells) + session
    rows = campaigns.rows.iloc[offered.ravel()]
    true = np.log(campaigns.true_steps[offered])
    step = travel(rows).reshape(true.shape) / campaigns.true_steps[offered]
    predicted, failed = {}, {}
    for name, each in calibrated.items():
        mean, sd = (found.reshape(true.shape) for found in each.predict(rows, number.ravel()))
        stalls = np.bincount(number.ravel(), ~np.isfinite(mean.ravel()), number.max() + 1)
        predicted[name], failed[name] = (mean, sd), stalls.reshape(campaigns.count, -1) > 0
    shared = ~np.any(list(failed.values()), axis=0)[:, session]
    tables = [
        _summed_up(true - mean, sd, step, shared).assign(strategy=name, failed=failed[name].sum(axis=1))
        for name, (mean, sd) in predicted.items()
    ]
    return pd.concat(tables, ignore_index=True).assign(sessions=len(cells))


def spent(name: str, cells: Sequence[Cell], campaigns: Campaigns, handling: float) -> pd.DataFrame:
    """Place of the campaign, and what a session's calibration costs on average: traverses and seconds."""
    made = campaigns.places(np.concatenate([cell.made[name] for cell in cells]))
    rows = campaigns.rows[["steps", "step_period"]].iloc[made.ravel()]
    stepping = stepping_seconds(rows).reshape(made.shape)
    traverses = made.shape[1] / len(cells)
    seconds = stepping.sum(axis=1) / len(cells) + handling * traverses
    return pd.DataFrame(
        {"place": np.arange(campaigns.count), "strategy": name, "traverses": traverses, "seconds": seconds}
    )


def _summed_up(off: Array, sd: Array, step: Array, shared: npt.NDArray[np.bool_]) -> pd.DataFrame:
    """Of each campaign; `off` is log(true steps) less what is predicted, shape (C, m)."""
    count = shared.sum(axis=1)
    columns: dict[str, object] = {"place": np.arange(len(off)), "predictions": count}
    relative = np.where(shared, np.expm1(off), 0.0)
    share = np.where(count > 0, 1.0 / np.maximum(count, 1), np.nan)
    for suffix, error in (("", relative * step), ("_relative", relative)):
        largest = np.argmax(np.abs(error), axis=1)
        columns[f"rms{suffix}"] = np.sqrt(np.sum(error**2, axis=1) * share)
        columns[f"bias{suffix}"] = np.sum(error, axis=1) * share
        columns[f"worst{suffix}"] = error[np.arange(len(off)), largest] + 0.0 * share
    columns["covered"] = np.sum(shared & (np.abs(off) <= REACH * sd), axis=1) * share
    return pd.DataFrame(columns)
