"""What a simulated study found: every number, and how it shows itself."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from stickslip_fit._summary import Summarized
from stickslip_fit.fit.result import AxesOf
from stickslip_fit.strategies.study.chunk import TIP
from stickslip_fit.strategies.study.design import Design
from stickslip_fit.strategies.study.plan import StudyPlan
from stickslip_fit.strategies.study.summary import summarise, summarise_tips


@dataclass(frozen=True, eq=False, repr=False)
class Study(Summarized):
    """What `run_study` returns; SI.

    Attributes
    ----------
    plan : StudyPlan
    design : Design
    campaigns : DataFrame
        See `Chunk.run`: a row for each campaign, strategy, joint and direction, and for the tip.
    command : str
        As typed; empty where the study was made in a notebook.
    """

    plan: StudyPlan
    design: Design
    campaigns: pd.DataFrame
    command: str = ""

    def plot_errors(self) -> AxesOf:
        """Calibration time against the error of the mean step size, scenario by scenario."""
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.study import plot_errors

        return panels(plot_errors(self))

    def plot_tips(self) -> AxesOf:
        """The tip's error after open-loop moves, by scenario and strategy.

        Raises
        ------
        InputError
            If the study made no moves.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.study import plot_tips

        return panels(plot_tips(self))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints that at least one strategy can calibrate."""
        return tuple(int(joint) for joint in sorted(self.campaigns["joint"].unique()) if joint != TIP)

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""
        return tuple(scenario.name for scenario in self.plan.scenarios)

    def strategies(self, joint: int) -> tuple[str, ...]:
        """Names of the strategies that suit a joint."""
        there = set(self.campaigns.loc[self.campaigns["joint"] == joint, "strategy"])
        return tuple(each.name for each in self.plan.strategies if each.name in there)

    def accuracy(self, *by: str) -> pd.DataFrame:
        """Errors of the mean step size by scenario, joint and strategy, and by further columns.

        Parameters
        ----------
        *by : str
            None, or ``"direction"``.

        Returns
        -------
        DataFrame
            See `summary.summarise`.
        """
        steps = self.campaigns[self.campaigns["joint"] != TIP]
        return summarise(steps, ["scenario", "joint", "strategy", *by])

    def tips(self) -> pd.DataFrame:
        """The tip's errors by scenario and strategy, see `summary.summarise_tips`; empty without moves."""
        tips = self.campaigns[self.campaigns["joint"] == TIP]
        return summarise_tips(tips) if len(tips) else tips
