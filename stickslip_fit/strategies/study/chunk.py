"""A few campaigns of one scenario: the piece of a study that is worked on, and kept, as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from stickslip_fit.strategies.study.calibrations import calibrate
from stickslip_fit.strategies.study.campaigns import simulate_campaigns
from stickslip_fit.strategies.study.design import Design
from stickslip_fit.strategies.study.draws import draw
from stickslip_fit.strategies.study.plan import Scenario, StudyPlan
from stickslip_fit.strategies.study.step_sizes import spent, step_size_errors
from stickslip_fit.strategies.study.tips import tip_distributions

TIP = 0  # in place of a joint
LABEL = ["scenario", "campaign", "strategy", "joint", "direction"]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Campaigns `first` to `last` - 1 of a scenario."""

    study: StudyPlan
    design: Design
    scenario: Scenario
    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first

    def __str__(self) -> str:
        return f"campaigns {self.first} to {self.last - 1} of {self.scenario.name!r}"

    def run(self) -> pd.DataFrame:
        """Simulate, calibrate, predict and move.

        Returns
        -------
        DataFrame
            A row for each campaign, strategy, joint and direction, see `step_size_errors` and `spent`; and
            one with `TIP` for its joint, see `tip_distributions`.

        Raises
        ------
        InputError
            If a joint comes to a halt, or a session is not over when the next one begins.
        """
        numbers = range(self.first, self.last)
        campaigns = simulate_campaigns(self.study, self.scenario, draw(self.study, self.scenario, numbers))
        strategies = {strategy.name: strategy for strategy in self.study.strategies}
        tables, calibrated = [], {}
        for joint, direction, cells, suited in self.design.drives():
            calibrated[joint, direction] = {
                name: calibrate(self.study, strategies[name], cells, campaigns) for name in suited
            }
            errors = step_size_errors(calibrated[joint, direction], cells, campaigns)
            cost = pd.concat([spent(name, cells, campaigns, self.design.handling) for name in suited])
            table = errors.merge(cost, on=["place", "strategy"])
            tables.append(table.assign(joint=joint, direction=direction))
        if self.design.paths is not None:
            tips = tip_distributions(
                self.study, self.scenario, numbers, campaigns, calibrated, self.design.paths
            )
            tables.append(tips.assign(joint=TIP, direction=""))
        found = pd.concat(tables, ignore_index=True)
        found.insert(0, "campaign", self.first + found.pop("place"))
        found.insert(0, "scenario", self.scenario.name)
        named = found[[*LABEL, *(name for name in found if name not in LABEL)]]
        # As a file gives them back.
        return named.astype(dict.fromkeys(("scenario", "strategy", "direction"), "str"))
