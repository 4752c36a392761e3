"""Which traverses each strategy makes: chosen once, since every campaign has the same plan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.laws import StepLaw, published_law
from stickslip_fit.moves import Paths, random_paths
from stickslip_fit.simulate.simulate import GROUPS
from stickslip_fit.strategies.at_hand import other_sessions
from stickslip_fit.strategies.cost import handling_seconds
from stickslip_fit.strategies.study.campaigns import Campaigns, usual_campaign
from stickslip_fit.strategies.study.plan import StudyPlan
from stickslip_fit.strategies.task import Task, Unsuited, first_of_each
from stickslip_fit.strategies.trials import chosen_by

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Cell:
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
    offered: Indices
    others: Indices
    made: dict[str, Indices]


@dataclass(frozen=True, eq=False)
class Design:
    """What all campaigns of a study have in common.

    Attributes
    ----------
    cells : tuple of Cell
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    handling : float
        Seconds that a traverse costs beside its steps.
    paths : Paths or None
        Moves that are made in every session.
    """

    cells: tuple[Cell, ...]
    left_out: pd.DataFrame
    handling: float
    paths: Paths | None

    def drives(self) -> Iterator[tuple[int, str, list[Cell], list[str]]]:
        """Each joint and direction: the cells of its sessions, and the strategies that suit all of them."""
        for joint, direction in dict.fromkeys((cell.law.joint, cell.direction) for cell in self.cells):
            mine = [each for each in self.cells if (each.law.joint, each.direction) == (joint, direction)]
            if suited := [name for name in mine[0].made if all(name in cell.made for cell in mine)]:
                yield joint, direction, mine, suited


def design(study: StudyPlan) -> Design:
    """Let every strategy choose, by a campaign in which nothing is hidden and nothing left to chance.

    Raises
    ------
    InputError
        If a strategy chooses what is not offered, no strategy suits the plan, or the plan cannot be driven.
    """
    usual = usual_campaign(study)
    cells, left_out = [], []
    for cell in _cells(study, usual):
        task = task_of(study, cell, usual.rows)
        for strategy in study.strategies:
            try:
                cell.made[strategy.name] = cell.offered[chosen_by(strategy, task)]
            except Unsuited as why:
                left_out.append((strategy.name, cell.session, cell.law.joint, cell.direction, str(why)))
        cells.append(cell)
    table = pd.DataFrame(left_out, columns=["strategy", "session", "joint", "direction", "reason"])
    found = Design(tuple(cells), table, handling_seconds(usual.rows), _paths(study))
    _check_suited(found, table)
    return found


def task_of(study: StudyPlan, cell: Cell, rows: pd.DataFrame) -> Task:
    """What a strategy is given, `rows` being those of one campaign."""
    offered, others = rows.iloc[cell.offered].drop(columns="steps"), rows.iloc[cell.others]
    return Task(cell.session, cell.direction, cell.law, study.machine, offered, others, cell.repeatability)


def _cells(study: StudyPlan, usual: Campaigns) -> Iterator[Cell]:
    rows = usual.rows
    labels = [session.label for session in study.plan.sessions]
    for joint in sorted(rows["joint"].unique()):
        law = published_law(joint, rows[rows["joint"] == joint], study.machine)
        for direction in ("+", "-"):
            mine = rows[(rows["joint"] == joint) & (rows["direction"] == direction)]
            for label in labels:
                own = mine[mine["session"] == label]
                if own.empty:
                    continue
                others = mine.index[mine["session"].isin(other_sessions(labels, label))].to_numpy()
                offered = first_of_each(own).index.to_numpy()
                noise = study.repeatability[int(joint), direction]
                yield Cell(label, direction, law, noise, offered, others, {})


def _paths(study: StudyPlan) -> Paths | None:
    return random_paths(study.machine, study.moves, study.seed, study.length) if study.moves else None


def _check_suited(found: Design, left_out: pd.DataFrame) -> None:
    suited = {(joint, direction): set(names) for joint, direction, _, names in found.drives()}
    if not suited:
        raise InputError(f"no strategy can calibrate by this plan: {'; '.join(left_out['reason'].unique())}")
    if found.paths is not None and (len(suited) < len(GROUPS) or not set.intersection(*suited.values())):
        raise InputError(
            "no strategy calibrates all joints in both directions by this plan, so that no move can be made; "
            "set count = 0 under [moves]"
        )
