"""What is true in many campaigns: each session's parameters, drawn about what a law file says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.causes.base import extend_by
from stickslip_fit.laws import StepLaw, travel
from stickslip_fit.machine import JOINTS
from stickslip_fit.simulate import expected_counts
from stickslip_fit.simulate.simulate import GROUPS
from stickslip_fit.strategies.study.draws import Draws
from stickslip_fit.strategies.study.plan import Scenario, StudyPlan

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Drive = tuple[int, str]

NOTHING_YET = {"session_seconds": 0.0, "steps_before": 0}


@dataclass(frozen=True, eq=False)
class Truths:
    """How the joints truly step in C campaigns of S sessions.

    Attributes
    ----------
    laws : mapping of int to StepLaw
        With the causes of a scenario in them.
    values : mapping of (int, str) to array, shape (C, S, p)
        Parameters of each joint and direction, SI.
    factor : mapping of (int, str) to array, shape (C, S)
        By which all step sizes of a session differ from these.
    """

    laws: Mapping[int, StepLaw]
    values: Mapping[Drive, Array]
    factor: Mapping[Drive, Array]

    def in_motion(self) -> Truths:
        """What is only in hearing the stop left out."""
        moving = {}
        for (joint, direction), values in self.values.items():
            law = self.laws[joint]
            moving[joint, direction] = law.in_motion(values) if isinstance(law, ExtendedLaw) else values
        return Truths(self.laws, moving, self.factor)

    def steps(self, rows: pd.DataFrame, number: Indices) -> Array:
        """Steps that each traverse takes on average, shape (n,).

        Parameters
        ----------
        rows : DataFrame, n rows
        number : array of int, shape (n,)
            The place of each row's session among all C S.

        Raises
        ------
        InputError
            If a joint comes to a halt.
        """
        found, group = np.zeros(len(rows)), groups_of(rows)
        for joint, law in self.laws.items():
            mine = np.flatnonzero(rows["joint"].to_numpy() == joint)
            if not len(mine):
                continue
            these = rows.iloc[mine]
            values = self._of_rows(self.values, joint, group[mine], number[mine])
            expected = np.exp(law.predict(these, values))
            if not np.all(np.isfinite(expected)):
                expected_counts(law, these, values)  # says where the joint comes to a halt
            added = law.added(these, values) if isinstance(law, ExtendedLaw) else 0.0
            factor = self._of_rows(self.factor, joint, group[mine], number[mine])
            found[mine] = (expected - added) / factor + added
        return found

    def misfires(self, rows: pd.DataFrame, number: Indices, luck: Array) -> Array:
        """Log steps by which a stop that is missed or imagined puts counts off, (n, 3) -> (n,)."""
        off, group = np.zeros(len(rows)), groups_of(rows)
        for joint, law in self.laws.items():
            mine = np.flatnonzero(rows["joint"].to_numpy() == joint)
            if isinstance(law, ExtendedLaw) and len(mine):
                off[mine] = law.misfires(
                    self._of_rows(self.values, joint, group[mine], number[mine]), luck[mine]
                )
        return off

    def _of_rows(self, table: Mapping[Drive, Array], joint: int, group: Indices, number: Indices) -> Array:
        """A session's own value of something, for each row of a joint; (n, ...)."""
        drives = [each for each in GROUPS if each[0] == joint]
        both = np.stack([table[each].reshape(-1, *table[each].shape[2:]) for each in drives])
        return both[group - GROUPS.index(drives[0]), number]


def draw_truths(study: StudyPlan, scenario: Scenario, rows: pd.DataFrame, draws: Draws) -> Truths:
    """Draw each session's parameters.

    Parameters
    ----------
    study : StudyPlan
    scenario : Scenario
    rows : DataFrame
        Of one campaign, as the plan has them.
    draws : Draws
    """
    laws, values, factor = {}, {}, {}
    for joint in sorted(rows["joint"].unique()):
        mine, law = rows[rows["joint"] == joint], study.truth.laws[joint]
        laws[int(joint)] = extend_by(law, scenario.causes) if scenario.causes else law
        for direction in ("+", "-"):
            drive = int(joint), direction
            usual, shared = _usual(study, mine, drive)
            values[drive] = _drawn(study, law, mine, drive, usual, draws, scenario.sizes)
            day = study.truth.day_to_day.get(drive, 0.0) * shared
            factor[drive] = 1.0 + day * draws.day[:, :, GROUPS.index(drive)]
    return Truths(laws, values, factor)


def groups_of(rows: pd.DataFrame) -> Indices:
    """The place of each row's joint and direction in `GROUPS`."""
    return 2 * (rows["joint"].to_numpy() - JOINTS[0]) + (rows["direction"] == "-").to_numpy()


def _usual(study: StudyPlan, mine: pd.DataFrame, drive: Drive) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Each session's parameters as the law file has them, (S, p), and whether days differ from them, (S,)."""
    labels = [session.label for session in study.plan.sessions]
    if not (mine["direction"] == drive[1]).any():
        p = len(study.truth.laws[drive[0]].parameters)
        return np.zeros((len(labels), p)), np.zeros(len(labels), bool)
    sessions = pd.DataFrame({"session": labels, "direction": drive[1]})
    return study.truth.of_rows(sessions, drive[0])


def _drawn(
    study: StudyPlan,
    law: StepLaw,
    mine: pd.DataFrame,
    drive: Drive,
    usual: Array,
    draws: Draws,
    hidden: Array,
) -> Array:
    """Parameters of a joint and direction with those of the hidden causes beside them, (C, S, p + q)."""
    own = law.law if isinstance(law, ExtendedLaw) else law
    p, group = len(own.parameters), GROUPS.index(drive)
    spread = study.between_campaigns * draws.law[:, :1, group, :p]
    spread = spread + study.between_sessions * draws.law[:, 1:, group, :p]
    drawn = np.tile(usual, (len(spread), 1, 1))
    rows = mine[mine["direction"] == drive[1]]
    if len(rows):
        session = pd.Index([each.label for each in study.plan.sessions]).get_indexer(rows["session"])
        steps = expected_counts(law, rows.assign(**NOTHING_YET), usual[session])
        mean_step = np.atleast_1d(travel(rows).sum() / steps.sum())
        drawn[:, :, :p] += spread * own.scales(mean_step)[0]
    return np.concatenate([drawn, np.broadcast_to(hidden, (*drawn.shape[:2], len(hidden)))], axis=2)
