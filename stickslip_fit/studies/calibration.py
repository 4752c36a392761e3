"""Calibrates simulated campaigns by each strategy, and computes step-size and tip errors by campaign.

Traverses are chosen once, because all campaigns share the plan. Strategies that fit a law are
calibrated in one batched least squares over all sessions and campaigns; any other is called session by
session.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import norm

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.estimation.noise import COVERAGE
from stickslip_fit.laws import StepLaw, constant_law, published_law, traverse_length
from stickslip_fit.moves import StepModel, TipPaths, TrueLaws, draw_random_paths, step_model_from_parameters
from stickslip_fit.simulation.campaign import GROUPS
from stickslip_fit.strategies import (
    CalibrationTask,
    ClosedForm,
    ConstantStepStrategy,
    LeastSquares,
    NotApplicable,
    Predictor,
    Strategy,
    compute_tip_errors,
    other_sessions,
)
from stickslip_fit.strategies.base import (
    handling_seconds,
    select_first_traverses,
    solve_law,
    stepping_seconds,
)
from stickslip_fit.strategies.evaluation import choose_traverses
from stickslip_fit.studies.plan import Scenario, StudyPlan
from stickslip_fit.studies.simulation import (
    MOVE_STREAM,
    SimulatedCampaigns,
    seed_sequence,
    simulate_nominal_campaign,
)
from stickslip_fit.units import JOINTS


@dataclass(frozen=True, eq=False)
class DesignCell:
    """One session, joint and direction of the plan.

    Attributes
    ----------
    session : str
    direction : {"+", "-"}
    law : StepLaw
        The published one, as the plan's configurations can support it.
    repeatability : float
    offered : array of int, shape (m,)
        The first traverse of each configuration, as places in a campaign; all of them are predicted.
    others : array of int
        All traverses of the joint and direction in the sessions that it may look back on.
    made : dict of str to array of int
        By strategy, the places of those that it calibrates from.
    """

    session: str
    direction: str
    law: StepLaw
    repeatability: float
    offered: IntArray
    others: IntArray
    made: dict[str, IntArray]


@dataclass(frozen=True, eq=False)
class StudyDesign:
    """What all campaigns of a study have in common.

    Attributes
    ----------
    cells : tuple of Cell
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    handling_seconds : float
        Seconds that a traverse costs beside its steps.
    paths : Paths or None
        Moves that are made in every session.
    """

    cells: tuple[DesignCell, ...]
    left_out: pd.DataFrame
    handling_seconds: float
    paths: TipPaths | None

    def drives(self) -> Iterator[tuple[int, str, list[DesignCell], list[str]]]:
        """Each joint and direction: the cells of its sessions, and the strategies that suit all of them."""
        for joint, direction in dict.fromkeys((cell.law.joint, cell.direction) for cell in self.cells):
            subset = [
                cell_ for cell_ in self.cells if (cell_.law.joint, cell_.direction) == (joint, direction)
            ]
            if strategies := [name for name in subset[0].made if all(name in cell.made for cell in subset)]:
                yield joint, direction, subset, strategies


def design_study(study: StudyPlan) -> StudyDesign:
    """Let every strategy choose, by a campaign in which nothing is hidden and nothing left to chance.

    Raises
    ------
    InputError
        If a strategy chooses what is not offered, no strategy suits the plan, or the plan cannot be driven.
    """
    nominal = simulate_nominal_campaign(study)
    cells, left_out = [], []
    for cell in _make_cells(study, nominal):
        task = make_task(study, cell, nominal.rows)
        for strategy in study.strategies:
            try:
                cell.made[strategy.name] = cell.offered[choose_traverses(strategy, task)]
            except NotApplicable as error:
                left_out.append((strategy.name, cell.session, cell.law.joint, cell.direction, str(error)))
        cells.append(cell)
    table = pd.DataFrame(left_out, columns=["strategy", "session", "joint", "direction", "reason"])
    design = StudyDesign(tuple(cells), table, handling_seconds(nominal.rows), _draw_paths(study))
    _check_applicable(design, table)
    return design


def make_task(study: StudyPlan, cell: DesignCell, rows: pd.DataFrame) -> CalibrationTask:
    """What a strategy is given, `rows` being those of one campaign."""
    offered, others = rows.iloc[cell.offered].drop(columns="steps"), rows.iloc[cell.others]
    return CalibrationTask(
        cell.session, cell.direction, cell.law, study.machine, offered, others, cell.repeatability
    )


def _make_cells(study: StudyPlan, nominal: SimulatedCampaigns) -> Iterator[DesignCell]:
    rows = nominal.rows
    labels = [session.label for session in study.plan.sessions]
    for joint in sorted(rows["joint"].unique()):
        law = published_law(joint, rows[rows["joint"] == joint], study.machine)
        for direction in ("+", "-"):
            subset = rows[(rows["joint"] == joint) & (rows["direction"] == direction)]
            for label in labels:
                own = subset[subset["session"] == label]
                if own.empty:
                    continue
                others = subset.index[subset["session"].isin(other_sessions(labels, label))].to_numpy()
                offered = select_first_traverses(own).index.to_numpy()
                noise = study.repeatability[int(joint), direction]
                yield DesignCell(label, direction, law, noise, offered, others, {})


def _draw_paths(study: StudyPlan) -> TipPaths | None:
    return draw_random_paths(study.machine, study.moves, study.seed, study.length) if study.moves else None


def _check_applicable(design: StudyDesign, left_out: pd.DataFrame) -> None:
    applicable = {(joint, direction): set(names) for joint, direction, _, names in design.drives()}
    if not applicable:
        raise InputError(f"no strategy can calibrate by this plan: {'; '.join(left_out['reason'].unique())}")
    if design.paths is not None and (
        len(applicable) < len(GROUPS) or not set.intersection(*applicable.values())
    ):
        raise InputError(
            "no strategy calibrates all joints in both directions by this plan, so that no move can be made; "
            "set count = 0 under [moves]"
        )


TRAVERSE_COLUMNS = ("direction", "start", "stop", "steps", "check_every")
LAW_STRATEGIES: dict[type, Callable[[StepLaw], StepLaw]] = {
    ConstantStepStrategy: constant_law,
    ClosedForm: lambda law: law,
    LeastSquares: lambda law: law,
}
"""Strategies that fit a law by least squares, and which, given the published one."""


class SessionCalibrations(Protocol):
    """What the calibrations of c sessions say, those of all campaigns numbered one after the other."""

    def predict(self, rows: pd.DataFrame, number: IntArray) -> tuple[Array, Array]:
        """Mean and standard deviation of log(steps), each shape (n,), by each row's session.

        NaN where that session could not be calibrated.
        """
        ...


@dataclass(frozen=True, eq=False)
class LawCalibrations:
    """A law with parameters for each session.

    Attributes
    ----------
    law : StepLaw
    values : array, shape (c, p)
        NaN in sessions that could not be calibrated.
    covariance : array, shape (c, p, p)
    """

    law: StepLaw
    values: Array
    covariance: Array

    def predict(self, rows: pd.DataFrame, number: IntArray) -> tuple[Array, Array]:
        """See `Calibrated.predict`."""
        mean, slopes = self.law.model(rows)(self.values[number])
        return mean, np.sqrt(np.einsum("ni,nij,nj->n", slopes, self.covariance[number], slopes))


@dataclass(frozen=True, eq=False)
class PredictorCalibrations:
    """A predictor for each session.

    Attributes
    ----------
    predictors : sequence of Predictor or None
        None in sessions that could not be calibrated.
    """

    predictors: Sequence[Predictor | None]

    def predict(self, rows: pd.DataFrame, number: IntArray) -> tuple[Array, Array]:
        """See `Calibrated.predict`."""
        response = np.full((2, len(rows)), np.nan)
        for session in np.unique(number):
            subset, predictor = np.flatnonzero(number == session), self.predictors[session]
            if predictor is not None:
                with suppress(InputError):
                    response[:, subset] = predictor(rows.iloc[subset])
        return response[0], response[1]


def calibrate_sessions(
    study: StudyPlan, strategy: Strategy, cells: Sequence[DesignCell], campaigns: SimulatedCampaigns
) -> SessionCalibrations:
    """Calibrate every session of every campaign.

    Parameters
    ----------
    study : StudyPlan
    strategy : Strategy
    cells : sequence of Cell
        Of one joint and direction, one for each session, all of which suit the strategy.
    campaigns : Campaigns
    """
    law_of = LAW_STRATEGIES.get(type(strategy))
    if law_of is None:
        return calibrate_by_task(study, strategy, cells, campaigns)
    return calibrate_by_law(law_of(cells[0].law), strategy.name, cells, campaigns)


def calibrate_by_law(
    law: StepLaw, name: str, cells: Sequence[DesignCell], campaigns: SimulatedCampaigns
) -> LawCalibrations:
    """All sessions of all campaigns in one minimisation."""
    chosen = [cell.made[name] for cell in cells]
    session = np.repeat(np.arange(len(cells)), [len(positions) for positions in chosen])
    number = np.arange(campaigns.count)[:, None] * len(cells) + session
    columns = list(dict.fromkeys([*law.columns, *TRAVERSE_COLUMNS]))
    rows = campaigns.rows[columns].iloc[campaigns.places(np.concatenate(chosen)).ravel()]
    # The number of the session is what tells groups apart.
    solution = solve_law(law, rows.assign(session=number.ravel()), cells[0].repeatability)
    session_of_group = solution.groups.table["session"].to_numpy(np.intp)
    p = solution.values.shape[1]
    values = np.full((campaigns.count * len(cells), p), np.nan)
    covariance = np.full((*values.shape, p), np.nan)
    determined = solution.known.all(axis=1)
    values[session_of_group[determined]], covariance[session_of_group[determined]] = (
        solution.values[determined],
        solution.covariance[determined],
    )
    return LawCalibrations(law, values, covariance)


def calibrate_by_task(
    study: StudyPlan, strategy: Strategy, cells: Sequence[DesignCell], campaigns: SimulatedCampaigns
) -> PredictorCalibrations:
    """Each session of each campaign by itself, as on a measured log."""
    predictors: list[Predictor | None] = []
    for k in range(campaigns.count):
        rows = campaigns.campaign_rows(k)
        predictors += [_calibrate_task(study, strategy, cell, rows) for cell in cells]
    return PredictorCalibrations(predictors)


def _calibrate_task(
    study: StudyPlan, strategy: Strategy, cell: DesignCell, rows: pd.DataFrame
) -> Predictor | None:
    try:
        return strategy.calibrate(make_task(study, cell, rows), rows.iloc[cell.made[strategy.name]])
    except (NotApplicable, InputError):
        return None


Z_95 = float(norm.ppf(0.5 + COVERAGE / 2))  # standard deviations; strategies know the repeatability


def compute_step_size_errors(
    calibrations: Mapping[str, SessionCalibrations],
    cells: Sequence[DesignCell],
    campaigns: SimulatedCampaigns,
) -> pd.DataFrame:
    """Errors of one joint and direction, summed up for each campaign and strategy.

    Predicted is the mean step size of every configuration, each where its first traverse stands in its
    session. A session that a strategy cannot calibrate is left out for all.

    Parameters
    ----------
    calibrations : mapping of str to Calibrated
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
    step = traverse_length(rows).reshape(true.shape) / campaigns.true_steps[offered]
    predicted, failed = {}, {}
    for name, calibration in calibrations.items():
        mean, sd = (found.reshape(true.shape) for found in calibration.predict(rows, number.ravel()))
        n_failed = np.bincount(number.ravel(), ~np.isfinite(mean.ravel()), number.max() + 1)
        predicted[name], failed[name] = (mean, sd), n_failed.reshape(campaigns.count, -1) > 0
    shared = ~np.any(list(failed.values()), axis=0)[:, session]
    tables = [
        _summarize_campaigns(true - mean, sd, step, shared).assign(
            strategy=name, failed=failed[name].sum(axis=1)
        )
        for name, (mean, sd) in predicted.items()
    ]
    return pd.concat(tables, ignore_index=True).assign(sessions=len(cells))


def compute_cost(
    name: str, cells: Sequence[DesignCell], campaigns: SimulatedCampaigns, handling_time: float
) -> pd.DataFrame:
    """Place of the campaign, and what a session's calibration costs on average: traverses and seconds."""
    measured = campaigns.places(np.concatenate([cell.made[name] for cell in cells]))
    rows = campaigns.rows[["steps", "step_period"]].iloc[measured.ravel()]
    stepping = stepping_seconds(rows).reshape(measured.shape)
    traverses = measured.shape[1] / len(cells)
    seconds = stepping.sum(axis=1) / len(cells) + handling_time * traverses
    return pd.DataFrame(
        {"place": np.arange(campaigns.count), "strategy": name, "traverses": traverses, "seconds": seconds}
    )


def _summarize_campaigns(
    log_error: Array, sd: Array, step: Array, shared: npt.NDArray[np.bool_]
) -> pd.DataFrame:
    """Of each campaign; `off` is log(true steps) less what is predicted, shape (C, m)."""
    count = shared.sum(axis=1)
    columns: dict[str, object] = {"place": np.arange(len(log_error)), "predictions": count}
    relative = np.where(shared, np.expm1(log_error), 0.0)
    share = np.where(count > 0, 1.0 / np.maximum(count, 1), np.nan)
    for suffix, error in (("", relative * step), ("_relative", relative)):
        worst = np.argmax(np.abs(error), axis=1)
        columns[f"rms{suffix}"] = np.sqrt(np.sum(error**2, axis=1) * share)
        columns[f"bias{suffix}"] = np.sum(error, axis=1) * share
        columns[f"worst{suffix}"] = error[np.arange(len(log_error)), worst] + 0.0 * share
    columns["covered"] = np.sum(shared & (np.abs(log_error) <= Z_95 * sd), axis=1) * share
    return pd.DataFrame(columns)


JointDirection = tuple[int, str]

SHARE_COLUMNS = [f"share_{joint}" for joint in JOINTS]
TIP_COLUMNS = ["moves", "unknown", "rms", "median", "often", "worst", "bias", *SHARE_COLUMNS]


def compute_tip_distributions(
    study: StudyPlan,
    scenario: Scenario,
    numbers: Sequence[int],
    campaigns: SimulatedCampaigns,
    calibrations_by_group: Mapping[JointDirection, Mapping[str, SessionCalibrations]],
    paths: TipPaths,
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
    calibrations_by_group : mapping of (int, str) to mapping of str to Calibrated
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
        if all(strategy.name in of_drive for of_drive in calibrations_by_group.values())
    ]
    calibrations = {
        name: {
            group: _make_steps_function(of_drive[name]) for group, of_drive in calibrations_by_group.items()
        }
        for name in names
    }
    seeds = [
        seed
        for number in numbers
        for seed in seed_sequence(study, scenario, number, MOVE_STREAM).spawn(campaigns.sessions)
    ]
    errors = compute_tip_errors(paths, _make_truth(study, campaigns), calibrations, seeds, study.kind)
    table = errors.table
    table["place"] = table["number"] // campaigns.sessions
    return errors.distribution("place")[["place", "strategy", *TIP_COLUMNS]].astype({"strategy": object})


def _make_truth(study: StudyPlan, campaigns: SimulatedCampaigns) -> TrueLaws:
    truths, rows = campaigns.truths, campaigns.rows
    labels = [session.label for session in study.plan.sessions] * campaigns.count
    return TrueLaws(
        sessions=labels,
        laws=truths.laws,
        values={drive: of.reshape(-1, of.shape[-1]) for drive, of in truths.values.items()},
        factor={drive: of.ravel() for drive, of in truths.factor.items()},
        repeatability=study.repeatability,
        conditions=_final_conditions(rows, len(labels)),
    )


def _final_conditions(rows: pd.DataFrame, sessions: int) -> dict[str, Array]:
    """What a law may look at when a session is over, each shape (c, 1)."""
    table = rows[["session_seconds", "steps", "step_period", "joint"]].to_numpy(float)
    last = table.reshape(sessions, -1, 4)[:, -1]
    end = last[:, 0] + last[:, 1] * last[:, 2]
    joint, total_steps = rows["joint"].to_numpy(), (rows["steps_before"] + rows["steps"]).to_numpy(float)
    steps = [
        np.where(joint == each, total_steps, 0.0).reshape(sessions, -1).max(axis=1)
        for each in np.unique(joint)
    ]
    return {
        "session_seconds": end[:, None],
        "steps_before": np.mean(steps, axis=0)[:, None],
        "step_period": last[:, 2:3],
    }


def _make_steps_function(calibrations: SessionCalibrations) -> StepModel:
    if isinstance(calibrations, LawCalibrations):
        return step_model_from_parameters(calibrations.law, calibrations.values)
    return lambda rows: np.exp(calibrations.predict(rows, rows["number"].to_numpy())[0])
