"""Many campaigns of one plan, simulated side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.laws import seen_count
from stickslip_fit.logs.columns import CONDITIONS
from stickslip_fit.logs.plan import Plan, PlannedSession
from stickslip_fit.simulate.driven import drive_through
from stickslip_fit.simulate.simulate import GROUPS
from stickslip_fit.strategies.study.draws import Draws, nothing_drawn
from stickslip_fit.strategies.study.plan import Scenario, StudyPlan
from stickslip_fit.strategies.study.truths import Truths, draw_truths, groups_of

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

NOTHING_HIDDEN = Scenario("nothing hidden")
EPOCH = datetime(1700, 1, 1)  # early, so that many campaigns have room on one clock
APART = timedelta(days=30)  # of two campaigns side by side, so that none overlaps the next


@dataclass(frozen=True, eq=False)
class Campaigns:
    """C campaigns of S sessions and n traverses each.

    Attributes
    ----------
    count, sessions : int
        C and S.
    rows : DataFrame, C n rows
        A log's columns, campaign after campaign, the plan's order within each.
    truths : Truths
    true_steps : array, shape (C n,)
        Steps that each traverse truly takes on average: without scatter and rounding, and without what is
        only in hearing the stop.
    """

    count: int
    sessions: int
    rows: pd.DataFrame
    truths: Truths
    true_steps: Array

    @property
    def traverses(self) -> int:
        """Traverses of a campaign."""
        return len(self.rows) // self.count

    def places(self, traverses: Indices) -> Indices:
        """Rows of the same traverses of every campaign, shape (m,) -> (C, m)."""
        return np.arange(self.count)[:, None] * self.traverses + traverses

    def one(self, number: int) -> pd.DataFrame:
        """The rows of one campaign, numbered from 0."""
        return self.rows.iloc[number * self.traverses :][: self.traverses].reset_index(drop=True)


def simulate_campaigns(study: StudyPlan, scenario: Scenario, draws: Draws) -> Campaigns:
    """Drive the plan through in every campaign.

    Raises
    ------
    InputError
        If a joint comes to a halt, or a session is not over when the next one begins.
    """
    count, one = len(draws.noise), study.plan.rows()
    side_by_side = _side_by_side(study.plan, count)
    number = np.arange(len(side_by_side.sessions)).repeat(study.plan.traverses_per_session)
    labels = pd.Series(np.tile(one["session"].astype(object), count))
    rows = pd.concat([one] * count, ignore_index=True).assign(session=number)
    truths = draw_truths(study, scenario, one, draws)
    scatter = np.array([study.repeatability.get(each, np.nan) for each in GROUPS])[groups_of(rows)]
    departure = scatter * draws.noise.ravel() + truths.misfires(rows, number, draws.luck.reshape(-1, 3))

    def seen(known: pd.DataFrame) -> npt.NDArray[np.int64]:
        steps = truths.steps(_own_history(known, labels, count), number)
        return seen_count(steps * np.exp(departure), known["check_every"])

    driven = drive_through(side_by_side, rows, draws.wait.ravel(), seen, truths.laws.values())
    log = _own_history(driven, labels, count).assign(status="ok", note="")
    log = log.assign(**{name: np.nan for name in CONDITIONS if name not in log})
    steps = truths.in_motion().steps(log, number)
    return Campaigns(count, len(study.plan.sessions), log, truths, steps)


def usual_campaign(study: StudyPlan) -> Campaigns:
    """One campaign in which nothing is hidden and nothing left to chance: what a lab plans by."""
    return simulate_campaigns(study, NOTHING_HIDDEN, nothing_drawn(study.plan))


def _side_by_side(plan: Plan, count: int) -> Plan:
    """The plan with its sessions over and over, each campaign long after the one before."""
    begins = [session.begins for session in plan.sessions]
    gaps = [*(later - earlier for earlier, later in pairwise(begins)), APART] * count
    moments = EPOCH + np.cumsum([timedelta(), *gaps[:-1]])
    labels = [session.label for session in plan.sessions] * count
    return replace(plan, sessions=tuple(map(PlannedSession, labels, moments)))


def _own_history(known: pd.DataFrame, labels: pd.Series, count: int) -> pd.DataFrame:
    """With the plan's session labels, and steps counted from each campaign's first traverse on."""
    driven = known["steps_before"].to_numpy().reshape(count, -1).copy()
    joint = known["joint"].to_numpy()[: driven.shape[1]]
    for each in np.unique(joint):
        mine = np.flatnonzero(joint == each)
        driven[:, mine] -= driven[:, mine[:1]]
    return known.assign(session=labels, steps_before=driven.ravel())
