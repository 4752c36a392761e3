"""Simulates many campaigns of one plan side by side, each from its own random streams.

`draw_campaigns` draws the random numbers, `draw_truths` each session's true parameters, and
`simulate_campaigns` the counts. A campaign is the same whichever others are simulated with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise
from zlib import crc32

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, Int64Array, IntArray
from stickslip_fit.causes import ExtendedLaw, extend
from stickslip_fit.estimation.noise import configuration_columns
from stickslip_fit.laws import StepLaw, observed_count, traverse_length
from stickslip_fit.logs.plan import Plan, PlannedSession
from stickslip_fit.logs.reader import DIRECTIONS
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.simulation import expected_counts
from stickslip_fit.simulation.campaign import GROUPS, draw_random, drive_through, group_index
from stickslip_fit.simulation.truth import Group
from stickslip_fit.studies.plan import Scenario, StudyPlan

MAX_DEVIATION_SD = (
    3.0  # standard deviations; a law that stalls once in a thousand campaigns would stop a study
)
MAX_PARAMETERS = 4  # of a published law
SCATTER_RANGE = (1.0, 2.0)
COUNT_STREAM, LAW_STREAM, MOVE_STREAM = range(3)


@dataclass(frozen=True, eq=False)
class CampaignDraws:
    """The draws of C campaigns of S sessions and n traverses.

    Attributes
    ----------
    day : array, shape (C, S, groups)
    noise, wait : array, shape (C, n)
    misfire_draws : array, shape (C, n, 3)
        See `RandomDraws`.
    law : array, shape (C, S + 1, groups, parameters)
        Standardized deviation of each parameter from its mean: first the campaign's, then each session's.
    """

    day: Array
    noise: Array
    wait: Array
    misfire_draws: Array
    law: Array


def draw_campaigns(study: StudyPlan, scenario: Scenario, campaigns: Sequence[int]) -> CampaignDraws:
    """The draws of campaigns by number, independent of which other campaigns are drawn with them."""
    scatter_groups = _scatter_groups(study.plan) if study.scatter == "uneven" else None
    draws = [_draw_campaign(study, scenario, number, scatter_groups) for number in campaigns]
    return CampaignDraws(*(np.stack(parts) for parts in zip(*draws, strict=True)))


def seed_sequence(study: StudyPlan, scenario: Scenario, number: int, kind: int) -> np.random.SeedSequence:
    """The seed of one of a campaign's random streams."""
    return np.random.SeedSequence([study.seed, crc32(scenario.name.encode()), number, kind])


def campaign_seed(study: StudyPlan, scenario: Scenario, number: int) -> int:
    """The seed with which `simulate` draws the noise, days and pauses of a campaign of a study."""
    return int(seed_sequence(study, scenario, number, COUNT_STREAM).generate_state(1, np.uint64)[0])


def _draw_campaign(
    study: StudyPlan, scenario: Scenario, number: int, scatter_groups: tuple[IntArray, IntArray] | None
) -> tuple[Array, ...]:
    sessions, traverses = len(study.plan.sessions), study.plan.traverses_per_session
    draws = draw_random(campaign_seed(study, scenario, number), sessions, traverses, len(GROUPS), study.kind)
    rng = np.random.default_rng(seed_sequence(study, scenario, number, LAW_STREAM))
    deviations = rng.standard_normal((sessions + 1, len(GROUPS), MAX_PARAMETERS))
    law = np.clip(deviations, -MAX_DEVIATION_SD, MAX_DEVIATION_SD)
    noise = (
        draws.noise if scatter_groups is None else draws.noise * _draw_scatter_factors(*scatter_groups, rng)
    )
    return draws.day, noise, draws.wait, draws.misfire_draws, law


def _scatter_groups(plan: Plan) -> tuple[IntArray, IntArray]:
    """Each row's configuration, without the session, and its joint and direction, as group numbers."""
    rows = plan.rows()
    columns = [name for name in configuration_columns(rows) if name != "session"]
    keys = rows[columns].round(9).assign(joint=rows["joint"])
    configuration = keys.groupby(list(keys), dropna=False, sort=False).ngroup().to_numpy()
    group = keys.groupby(["joint", "direction"], sort=False).ngroup().to_numpy()
    return configuration, group


def _draw_scatter_factors(configuration: IntArray, group: IntArray, rng: np.random.Generator) -> Array:
    """Factors of the scatter, shape (n,), whose squares have mean 1 in each joint and direction."""
    factor = rng.uniform(*SCATTER_RANGE, configuration.max() + 1)[configuration]
    square = np.bincount(group, factor**2) / np.bincount(group)
    return factor / np.sqrt(square)[group]


@dataclass(frozen=True, eq=False)
class CampaignTruths:
    """The true laws of C campaigns of S sessions.

    Attributes
    ----------
    laws : mapping of int to StepLaw
        Extended by the causes of the scenario.
    values : mapping of (int, str) to array, shape (C, S, p)
        Parameters of each joint and direction, SI.
    factor : mapping of (int, str) to array, shape (C, S)
        Multiplies all step sizes of a session.
    """

    laws: Mapping[int, StepLaw]
    values: Mapping[Group, Array]
    factor: Mapping[Group, Array]

    def without_stop_effects(self) -> CampaignTruths:
        """The laws of motion, without the causes that act on detecting the stop."""
        moving = {}
        for (joint, direction), values in self.values.items():
            law = self.laws[joint]
            moving[joint, direction] = (
                law.without_stop_effects(values) if isinstance(law, ExtendedLaw) else values
            )
        return CampaignTruths(self.laws, moving, self.factor)

    def steps(self, rows: pd.DataFrame, number: IntArray) -> Array:
        """Expected steps of each traverse, shape (n,).

        Parameters
        ----------
        rows : DataFrame, n rows
        number : array of int, shape (n,)
            Index of each row's session among all C S.

        Raises
        ------
        InputError
            If a joint stalls.
        """
        steps, group = np.zeros(len(rows)), group_index(rows)
        for joint, law in self.laws.items():
            subset = np.flatnonzero(rows["joint"].to_numpy() == joint)
            if not len(subset):
                continue
            joint_rows = rows.iloc[subset]
            values = self._of_rows(self.values, joint, group[subset], number[subset])
            expected = np.exp(law.predict(joint_rows, values))
            if not np.all(np.isfinite(expected)):
                expected_counts(law, joint_rows, values)  # raises, with the place of the stall
            added = law.steps_added_by_causes(joint_rows, values) if isinstance(law, ExtendedLaw) else 0.0
            factor = self._of_rows(self.factor, joint, group[subset], number[subset])
            steps[subset] = (expected - added) / factor + added
        return steps

    def misfires(self, rows: pd.DataFrame, number: IntArray, misfire_draws: Array) -> Array:
        """Deviations of log(steps) by stops that are missed or detected too early, (n, 3) -> (n,)."""
        deviation, group = np.zeros(len(rows)), group_index(rows)
        for joint, law in self.laws.items():
            subset = np.flatnonzero(rows["joint"].to_numpy() == joint)
            if isinstance(law, ExtendedLaw) and len(subset):
                deviation[subset] = law.misfire_deviations(
                    self._of_rows(self.values, joint, group[subset], number[subset]), misfire_draws[subset]
                )
        return deviation

    def _of_rows(self, table: Mapping[Group, Array], joint: int, group: IntArray, number: IntArray) -> Array:
        """The entry of its session and direction for each row of a joint, (n, ...)."""
        values = [table[joint, direction] for direction in DIRECTIONS]
        both = np.stack([value.reshape(-1, *value.shape[2:]) for value in values])
        return both[group - GROUPS.index((joint, DIRECTIONS[0])), number]


def draw_truths(
    study: StudyPlan, scenario: Scenario, rows: pd.DataFrame, draws: CampaignDraws
) -> CampaignTruths:
    """Each session's parameters; `rows` are the plan's, of one campaign."""
    laws, values, factor = {}, {}, {}
    for joint in sorted(rows["joint"].unique()):
        subset, law = rows[rows["joint"] == joint], study.truth.laws[joint]
        laws[int(joint)] = extend(law, *scenario.causes) if scenario.causes else law
        for direction in ("+", "-"):
            pair = int(joint), direction
            nominal, shared = _nominal_parameters(study, subset, pair)
            values[pair] = _draw_parameters(study, law, subset, pair, nominal, draws, scenario.sizes)
            day = study.truth.day_to_day.get(pair, 0.0) * shared
            factor[pair] = 1.0 + day * draws.day[:, :, GROUPS.index(pair)]
    return CampaignTruths(laws, values, factor)


def _nominal_parameters(study: StudyPlan, subset: pd.DataFrame, pair: Group) -> tuple[Array, BoolArray]:
    """Each session's parameters as the law file has them, (S, p), and whether days differ from them, (S,)."""
    labels = [session.label for session in study.plan.sessions]
    if not (subset["direction"] == pair[1]).any():
        p = len(study.truth.laws[pair[0]].parameters)
        return np.zeros((len(labels), p)), np.zeros(len(labels), bool)
    sessions = pd.DataFrame({"session": labels, "direction": pair[1]})
    return study.truth.of_rows(sessions, pair[0])


def _draw_parameters(
    study: StudyPlan,
    law: StepLaw,
    subset: pd.DataFrame,
    pair: Group,
    nominal: Array,
    draws: CampaignDraws,
    cause_values: Array,
) -> Array:
    """Parameters of a joint and direction, then those of the causes, (C, S, p + q)."""
    base_law = law.law if isinstance(law, ExtendedLaw) else law
    p, group = len(base_law.parameters), GROUPS.index(pair)
    spread = study.between_campaigns * draws.law[:, :1, group, :p]
    spread = spread + study.between_sessions * draws.law[:, 1:, group, :p]
    values = np.tile(nominal, (len(spread), 1, 1))
    rows = subset[subset["direction"] == pair[1]]
    if len(rows):
        session = pd.Index([each.label for each in study.plan.sessions]).get_indexer(rows["session"])
        steps = expected_counts(law, rows.assign(session_seconds=0.0, steps_before=0), nominal[session])
        mean_step = np.atleast_1d(traverse_length(rows).sum() / steps.sum())
        values[:, :, :p] += spread * base_law.scales(mean_step)[0]
    return np.concatenate(
        [values, np.broadcast_to(cause_values, (*values.shape[:2], len(cause_values)))], axis=2
    )


EPOCH = datetime(1700, 1, 1)  # the campaigns of a chunk follow each other from this date on
CAMPAIGN_SPACING = timedelta(days=30)  # between two campaigns


@dataclass(frozen=True, eq=False)
class SimulatedCampaigns:
    """C campaigns of S sessions and n traverses each.

    Attributes
    ----------
    count, sessions : int
        C and S.
    rows : DataFrame, C n rows
        A log's columns, campaign after campaign, the plan's order within each.
    true_steps : array, shape (C n,)
        Expected steps of each traverse: without noise, rounding and effects of detecting the stop.
    """

    count: int
    sessions: int
    rows: pd.DataFrame
    truths: CampaignTruths
    true_steps: Array

    @property
    def traverses(self) -> int:
        """Traverses of a campaign."""
        return len(self.rows) // self.count

    def row_positions(self, traverses: IntArray) -> IntArray:
        """Row positions of the same traverses in every campaign, shape (m,) -> (C, m)."""
        return np.arange(self.count)[:, None] * self.traverses + traverses

    def campaign_rows(self, number: int) -> pd.DataFrame:
        """The rows of one campaign, numbered from 0."""
        return self.rows.iloc[number * self.traverses :][: self.traverses].reset_index(drop=True)


def simulate_campaigns(study: StudyPlan, scenario: Scenario, draws: CampaignDraws) -> SimulatedCampaigns:
    """Simulate the counts of the plan in every campaign.

    Raises
    ------
    InputError
        If a joint stalls, or a session is not over when the next one begins.
    """
    count, campaign = len(draws.noise), study.plan.rows()
    side_by_side = _repeat_sessions(study.plan, count)
    number = np.arange(len(side_by_side.sessions)).repeat(study.plan.traverses_per_session)
    labels = pd.Series(np.tile(campaign["session"].astype(object), count))
    rows = pd.concat([campaign] * count, ignore_index=True).assign(session=number)
    truths = draw_truths(study, scenario, campaign, draws)
    repeatability = np.array([study.repeatability.get(group, np.nan) for group in GROUPS])
    scatter = repeatability[group_index(rows)]
    deviation = scatter * draws.noise.ravel() + truths.misfires(
        rows, number, draws.misfire_draws.reshape(-1, 3)
    )

    def count_steps(rows_with_history: pd.DataFrame) -> Int64Array:
        steps = truths.steps(_separate_histories(rows_with_history, labels, count), number)
        return observed_count(steps * np.exp(deviation), rows_with_history["check_every"])

    traverses = drive_through(side_by_side, rows, draws.wait.ravel(), count_steps, truths.laws.values())
    log = _separate_histories(traverses, labels, count).assign(note="")
    log = log.assign(**{name: np.nan for name in CONDITIONS if name not in log})
    steps = truths.without_stop_effects().steps(log, number)
    return SimulatedCampaigns(count, len(study.plan.sessions), log, truths, steps)


def simulate_nominal_campaign(study: StudyPlan) -> SimulatedCampaigns:
    """One campaign without causes, noise and spread."""
    sessions, groups = len(study.plan.sessions), len(GROUPS)
    n = sessions * study.plan.traverses_per_session
    draws = CampaignDraws(
        day=np.zeros((1, sessions, groups)),
        noise=np.zeros((1, n)),
        wait=np.full((1, n), 0.5),
        misfire_draws=np.full((1, n, 3), 0.5),
        law=np.zeros((1, sessions + 1, groups, MAX_PARAMETERS)),
    )
    return simulate_campaigns(study, Scenario("nothing hidden"), draws)


def _repeat_sessions(plan: Plan, count: int) -> Plan:
    """The plan with its sessions repeated, each campaign long after the previous one."""
    begins = [session.begins for session in plan.sessions]
    gaps = [*(later - earlier for earlier, later in pairwise(begins)), CAMPAIGN_SPACING] * count
    moments = EPOCH + np.cumsum([timedelta(), *gaps[:-1]])
    labels = [session.label for session in plan.sessions] * count
    return replace(plan, sessions=tuple(map(PlannedSession, labels, moments)))


def _separate_histories(rows: pd.DataFrame, labels: pd.Series, count: int) -> pd.DataFrame:
    """With the plan's session labels, and steps_before counted from each campaign's first traverse."""
    steps_before = rows["steps_before"].to_numpy().reshape(count, -1).copy()
    joint = rows["joint"].to_numpy()[: steps_before.shape[1]]
    for joint_ in np.unique(joint):
        subset = np.flatnonzero(joint == joint_)
        steps_before[:, subset] -= steps_before[:, subset[:1]]
    return rows.assign(session=labels, steps_before=steps_before.ravel())
