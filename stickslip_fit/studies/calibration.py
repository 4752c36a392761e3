"""Calibrates simulated campaigns by each strategy, and computes step-size and tip errors by campaign.

Traverses are chosen once, because all campaigns share the plan. Strategies that fit a law are
calibrated in one batched least squares over all sessions and campaigns; others session by session.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.laws import StepLaw, choose_laws, constant_law, traverse_length
from stickslip_fit.moves import StepModel, TipPaths, TrueLaws, draw_random_paths, step_model_from_parameters
from stickslip_fit.simulation.campaign import GROUPS
from stickslip_fit.simulation.truth import Group
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
from stickslip_fit.units import Z_95


@dataclass(frozen=True, eq=False)
class DesignCell:
    """One session, joint and direction of the plan.

    Attributes
    ----------
    direction : {"+", "-"}
    law : StepLaw
        The published one, as the plan's configurations can support it.
    offered : array of int, shape (m,)
        The first traverse of each configuration, as row positions in a campaign; all of them are predicted.
    others : array of int
        All traverses of the joint and direction in the other sessions that the calibration may use.
    chosen : dict of str to array of int
        By strategy, the row positions of those that it calibrates from.
    """

    session: str
    direction: str
    law: StepLaw
    repeatability: float
    offered: IntArray
    others: IntArray
    chosen: dict[str, IntArray]


@dataclass(frozen=True, eq=False)
class StudyDesign:
    """What all campaigns of a study have in common.

    Attributes
    ----------
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    handling_seconds : float
        Seconds that a traverse costs beside its steps.
    paths : TipPaths or None
        Moves that are made in every session.
    """

    cells: tuple[DesignCell, ...]
    left_out: pd.DataFrame
    handling_seconds: float
    paths: TipPaths | None

    def drives(self) -> Iterator[tuple[int, str, list[DesignCell], list[str]]]:
        """Each joint and direction: the cells of its sessions, and the strategies that suit all of them."""
        groups: dict[Group, list[DesignCell]] = {}
        for cell in self.cells:
            groups.setdefault((cell.law.joint, cell.direction), []).append(cell)
        for (joint, direction), cells in groups.items():
            if names := [name for name in cells[0].chosen if all(name in cell.chosen for cell in cells)]:
                yield joint, direction, cells, names


def design_study(study: StudyPlan) -> StudyDesign:
    """Let every strategy choose its traverses, in a campaign without causes, noise and spread.

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
                cell.chosen[strategy.name] = cell.offered[choose_traverses(strategy, task)]
            except NotApplicable as error:
                left_out.append((strategy.name, cell.session, cell.law.joint, cell.direction, str(error)))
        cells.append(cell)
    table = pd.DataFrame(left_out, columns=["strategy", "session", "joint", "direction", "reason"])
    paths = draw_random_paths(study.machine, study.moves, study.seed, study.length) if study.moves else None
    design = StudyDesign(tuple(cells), table, handling_seconds(nominal.rows), paths)
    applicable = {(joint, direction): set(names) for joint, direction, _, names in design.drives()}
    if not applicable:
        raise InputError(f"no strategy can calibrate by this plan: {'; '.join(table['reason'].unique())}")
    if study.moves and (len(applicable) < len(GROUPS) or not set.intersection(*applicable.values())):
        raise InputError(
            "no strategy calibrates all joints in both directions by this plan, so that no move can be made; "
            "set count = 0 under [moves]"
        )
    return design


def make_task(study: StudyPlan, cell: DesignCell, rows: pd.DataFrame) -> CalibrationTask:
    """A cell's task in one campaign, whose rows are given."""
    offered, others = rows.iloc[cell.offered].drop(columns="steps"), rows.iloc[cell.others]
    return CalibrationTask(
        cell.session, cell.direction, cell.law, study.machine, offered, others, cell.repeatability
    )


def _make_cells(study: StudyPlan, nominal: SimulatedCampaigns) -> Iterator[DesignCell]:
    rows = nominal.rows[nominal.rows["status"] == "ok"]
    labels = [session.label for session in study.plan.sessions]
    for joint, law in choose_laws(rows, study.machine).items():
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


TRAVERSE_COLUMNS = ("direction", "start", "stop", "steps", "check_every")
LAW_STRATEGIES: dict[type, Callable[[StepLaw], StepLaw]] = {
    ConstantStepStrategy: constant_law,
    ClosedForm: lambda law: law,
    LeastSquares: lambda law: law,
}
"""Strategies that fit a law by least squares: from the published law to the one that they fit."""


class SessionCalibrations(Protocol):
    """Calibrations of c sessions, numbered campaign by campaign."""

    def predict(self, rows: pd.DataFrame, number: IntArray) -> tuple[Array, Array]:
        """Mean and standard deviation of log(steps), each shape (n,), by the session number of each row.

        NaN where the session could not be calibrated.
        """
        ...


@dataclass(frozen=True, eq=False)
class LawCalibrations(SessionCalibrations):
    """A law with parameters for each session, shape (c, p), and their covariance; NaN without calibration."""

    law: StepLaw
    values: Array
    covariance: Array

    def predict(self, rows: pd.DataFrame, number: IntArray) -> tuple[Array, Array]:
        mean, jacobian = self.law.model(rows)(self.values[number])
        return mean, np.sqrt(np.einsum("ni,nij,nj->n", jacobian, self.covariance[number], jacobian))


@dataclass(frozen=True, eq=False)
class PredictorCalibrations(SessionCalibrations):
    """A predictor for each session; None without calibration."""

    predictors: Sequence[Predictor | None]

    def predict(self, rows: pd.DataFrame, number: IntArray) -> tuple[Array, Array]:
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
    cells : sequence of DesignCell
        Of one joint and direction, one for each session, all of which suit the strategy.
    """
    law_of = LAW_STRATEGIES.get(type(strategy))
    if law_of is None:
        return calibrate_by_task(study, strategy, cells, campaigns)
    return calibrate_by_law(law_of(cells[0].law), strategy.name, cells, campaigns)


def calibrate_by_law(
    law: StepLaw, name: str, cells: Sequence[DesignCell], campaigns: SimulatedCampaigns
) -> LawCalibrations:
    """All sessions of all campaigns in one least-squares fit."""
    chosen = [cell.chosen[name] for cell in cells]
    session = np.repeat(np.arange(len(cells)), [len(positions) for positions in chosen])
    number = np.arange(campaigns.count)[:, None] * len(cells) + session
    columns = list(dict.fromkeys([*law.columns, *TRAVERSE_COLUMNS]))
    rows = campaigns.rows[columns].iloc[campaigns.row_positions(np.concatenate(chosen)).ravel()]
    # The session's number identifies the group.
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
        for cell in cells:
            try:
                measured = rows.iloc[cell.chosen[strategy.name]]
                predictors.append(strategy.calibrate(make_task(study, cell, rows), measured))
            except (NotApplicable, InputError):
                predictors.append(None)
    return PredictorCalibrations(predictors)


def compute_step_size_errors(
    calibrations: Mapping[str, SessionCalibrations],
    cells: Sequence[DesignCell],
    campaigns: SimulatedCampaigns,
) -> pd.DataFrame:
    """Statistics of the step-size errors of one joint and direction, for each campaign and strategy.

    Every configuration's mean step size is predicted, at the time of its first traverse in each session. A
    session that a strategy cannot calibrate is left out for all.

    Parameters
    ----------
    calibrations : mapping of str to SessionCalibrations
        By strategy.
    cells : sequence of DesignCell
        One for each session.

    Returns
    -------
    DataFrame
        campaign (its index), strategy; sessions, failed (sessions that it could not calibrate),
        predictions; rms, bias, worst (the largest, with its sign) of predicted less true mean step size, SI,
        and under ``_relative`` as a share of it; covered, the share of predictions whose 95 % interval holds
        the truth. NaN where no session is left.
    """
    offered = campaigns.row_positions(np.concatenate([cell.offered for cell in cells]))
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
    """For each campaign, the traverses and seconds of a session's calibration on average."""
    measured = campaigns.row_positions(np.concatenate([cell.chosen[name] for cell in cells]))
    rows = campaigns.rows[["steps", "step_period"]].iloc[measured.ravel()]
    stepping = stepping_seconds(rows).reshape(measured.shape)
    traverses = measured.shape[1] / len(cells)
    seconds = stepping.sum(axis=1) / len(cells) + handling_time * traverses
    numbers = np.arange(campaigns.count)
    return pd.DataFrame({"campaign": numbers, "strategy": name, "traverses": traverses, "seconds": seconds})


def _summarize_campaigns(log_error: Array, sd: Array, step: Array, shared: BoolArray) -> pd.DataFrame:
    """Of each campaign; `log_error` is log(true steps) less its prediction, shape (C, m)."""
    count = shared.sum(axis=1)
    columns: dict[str, object] = {"campaign": np.arange(len(log_error)), "predictions": count}
    relative = np.where(shared, np.expm1(log_error), 0.0)
    share = np.where(count > 0, 1.0 / np.maximum(count, 1), np.nan)
    for suffix, error in (("", relative * step), ("_relative", relative)):
        worst = np.argmax(np.abs(error), axis=1)
        columns[f"rms{suffix}"] = np.sqrt(np.sum(error**2, axis=1) * share)
        columns[f"bias{suffix}"] = np.sum(error, axis=1) * share
        columns[f"worst{suffix}"] = error[np.arange(len(log_error)), worst] + 0.0 * share
    columns["covered"] = np.sum(shared & (np.abs(log_error) <= Z_95 * sd), axis=1) * share
    return pd.DataFrame(columns)


def compute_tip_distributions(
    study: StudyPlan,
    scenario: Scenario,
    numbers: Sequence[int],
    campaigns: SimulatedCampaigns,
    calibrations_by_group: Mapping[Group, Mapping[str, SessionCalibrations]],
    paths: TipPaths,
) -> pd.DataFrame:
    """The distribution of the tip's error over a campaign's moves, for each strategy.

    The moves are made at the end of each session, with the joints' true step sizes at that time. The steps
    that a joint has made by then are taken as the mean over the joints.

    Parameters
    ----------
    numbers : sequence of int, length C
        Of the campaigns.
    calibrations_by_group : mapping of (int, str) to mapping of str to SessionCalibrations
        By joint and direction, then by strategy.

    Returns
    -------
    DataFrame
        campaign (its index), strategy and the columns of `TipErrors.distribution`.
    """
    groups = calibrations_by_group.items()
    calibrations = {
        strategy.name: {group: _make_step_model(by_name[strategy.name]) for group, by_name in groups}
        for strategy in study.strategies
        if all(strategy.name in by_name for _, by_name in groups)
    }
    seeds = [
        seed
        for number in numbers
        for seed in seed_sequence(study, scenario, number, MOVE_STREAM).spawn(campaigns.sessions)
    ]
    truths = campaigns.truths
    labels = [session.label for session in study.plan.sessions] * campaigns.count
    true_laws = TrueLaws(
        sessions=labels,
        laws=truths.laws,
        values={group: values.reshape(-1, values.shape[-1]) for group, values in truths.values.items()},
        factor={group: factor.ravel() for group, factor in truths.factor.items()},
        repeatability=study.repeatability,
        conditions=_final_conditions(campaigns.rows, len(labels)),
    )
    errors = compute_tip_errors(paths, true_laws, calibrations, seeds, study.kind)
    errors.table["campaign"] = errors.table["number"] // campaigns.sessions
    return errors.distribution("campaign").astype({"strategy": object})


def _final_conditions(rows: pd.DataFrame, sessions: int) -> dict[str, Array]:
    """The columns that a law may depend on at the end of each session, each shape (c, 1)."""
    table = rows[["session_seconds", "steps", "step_period"]].to_numpy(float)
    last = table.reshape(sessions, -1, 3)[:, -1]
    joints, total_steps = rows["joint"].to_numpy(), (rows["steps_before"] + rows["steps"]).to_numpy(float)
    steps = [
        np.where(joints == joint, total_steps, 0.0).reshape(sessions, -1).max(axis=1)
        for joint in np.unique(joints)
    ]
    return {
        "session_seconds": (last[:, 0] + last[:, 1] * last[:, 2])[:, None],
        "steps_before": np.mean(steps, axis=0)[:, None],
        "step_period": last[:, 2:3],
    }


def _make_step_model(calibrations: SessionCalibrations) -> StepModel:
    if isinstance(calibrations, LawCalibrations):
        return step_model_from_parameters(calibrations.law, calibrations.values)
    return lambda rows: np.exp(calibrations.predict(rows, rows["number"].to_numpy())[0])
