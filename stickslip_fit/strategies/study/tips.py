"""Where the tip ends after open-loop moves at the end of each session, campaign by campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.machine import JOINTS
from stickslip_fit.moves import Paths, StepsFor, Truth, steps_by_parameters
from stickslip_fit.strategies.study.calibrations import Calibrated, Fitted
from stickslip_fit.strategies.study.campaigns import Campaigns
from stickslip_fit.strategies.study.draws import MOVES, streams
from stickslip_fit.strategies.study.plan import Scenario, StudyPlan
from stickslip_fit.strategies.tip import tip_errors

Array = npt.NDArray[np.float64]
Drive = tuple[int, str]

SHARES = [f"share_{joint}" for joint in JOINTS]
COLUMNS = ["moves", "unknown", "rms", "median", "often", "worst", "bias", *SHARES]


def tip_distributions(
    study: StudyPlan,
    scenario: Scenario,
    numbers: Sequence[int],
    campaigns: Campaigns,
    calibrated: Mapping[Drive, Mapping[str, Calibrated]],
    paths: Paths,
) -> pd.DataFrame:
    """The distribution of the tip's error over a campaign's moves, for each strategy.

    A move is made as soon as its session is over, by the joints' true step sizes at that time. What the
    joints have driven by then is counted as the mean over the joints.

    Parameters
    ----------
    study : StudyPlan
    scenario : Scenario
    numbers : sequence of int, length C
        Of the campaigns.
    campaigns : Campaigns
    calibrated : mapping of (int, str) to mapping of str to Calibrated
        By joint and direction, then by strategy.
    paths : Paths

    Returns
    -------
    DataFrame
        place (of the campaign), strategy and the columns of `TipErrors.summary`.
    """
    names = [
        strategy.name
        for strategy in study.strategies
        if all(strategy.name in of_drive for of_drive in calibrated.values())
    ]
    calibrations = {
        name: {drive: _steps_for(of_drive[name]) for drive, of_drive in calibrated.items()} for name in names
    }
    seeds = [
        seed
        for number in numbers
        for seed in streams(study, scenario, number, MOVES).spawn(campaigns.sessions)
    ]
    found = tip_errors(paths, _truth(study, campaigns), calibrations, seeds, study.kind)
    table = found.table
    table["place"] = table["number"] // campaigns.sessions
    return found.distribution("place")[["place", "strategy", *COLUMNS]].astype({"strategy": object})


def _truth(study: StudyPlan, campaigns: Campaigns) -> Truth:
    truths, rows = campaigns.truths, campaigns.rows
    labels = [session.label for session in study.plan.sessions] * campaigns.count
    return Truth(
        sessions=labels,
        laws=truths.laws,
        values={drive: of.reshape(-1, of.shape[-1]) for drive, of in truths.values.items()},
        factor={drive: of.ravel() for drive, of in truths.factor.items()},
        repeatability=study.repeatability,
        conditions=_at_the_end(rows, len(labels)),
    )


def _at_the_end(rows: pd.DataFrame, sessions: int) -> dict[str, Array]:
    """What a law may look at when a session is over, each shape (c, 1)."""
    table = rows[["session_seconds", "steps", "step_period", "joint"]].to_numpy(float)
    last = table.reshape(sessions, -1, 4)[:, -1]
    over = last[:, 0] + last[:, 1] * last[:, 2]
    joint, after = rows["joint"].to_numpy(), (rows["steps_before"] + rows["steps"]).to_numpy(float)
    driven = [
        np.where(joint == each, after, 0.0).reshape(sessions, -1).max(axis=1) for each in np.unique(joint)
    ]
    return {
        "session_seconds": over[:, None],
        "steps_before": np.mean(driven, axis=0)[:, None],
        "step_period": last[:, 2:3],
    }


def _steps_for(calibrated: Calibrated) -> StepsFor:
    if isinstance(calibrated, Fitted):
        return steps_by_parameters(calibrated.law, calibrated.values)
    return lambda rows: np.exp(calibrated.predict(rows, rows["number"].to_numpy())[0])
