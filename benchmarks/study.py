"""A study of simulated campaigns beside the same study looped over lmfit.

Both simulate alike, choose the same traverses and predict the same; the loop fits one session, direction and
strategy after the other with lmfit, as its users do it, on a share of the campaigns, and is scaled up.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import lmfit
import numpy as np
import pandas as pd

from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import load_machine
from stickslip_fit.studies import Cores, Scenario, StudyPlan, read_study, run_study
from stickslip_fit.studies.calibration import (
    LAW_STRATEGIES,
    DesignCell,
    LawCalibrations,
    calibrate_by_law,
    design_study,
)
from stickslip_fit.studies.execution import Chunk
from stickslip_fit.studies.simulation import SimulatedCampaigns, draw_campaigns, simulate_campaigns

PLAN = Path(__file__).parents[1] / "data" / "reference" / "study.toml"
CAMPAIGNS = 10_000
LOOPED = 4


def lmfit_loop(law: StepLaw, name: str, cells: list[DesignCell], campaigns: SimulatedCampaigns) -> np.ndarray:
    """Parameters of each campaign and session of a joint and direction, shape (c, p)."""
    found = []
    for number in range(campaigns.count):
        rows = campaigns.campaign_rows(number)
        for cell in cells:
            found.append(lmfit_one(law, rows.iloc[cell.chosen[name]], cell.repeatability))
    return np.array(found)


def lmfit_one(law: StepLaw, made: pd.DataFrame, repeatability: float) -> np.ndarray:
    """One calibration; parameters are handed over in units of their scales."""
    y, rounding = law.response(made)
    root, model = 1.0 / np.sqrt(repeatability**2 + rounding), law.model(made)
    mean = np.exp(np.mean(np.log(np.abs(made["stop"] - made["start"])) - y))
    start, scales = law.start_values(np.array([mean]))[0], law.scales(np.array([mean]))[0]
    names = [f"p{k}" for k in range(len(scales))]

    def misfit(parameters: lmfit.Parameters) -> np.ndarray:
        values = np.array([parameters[name].value for name in names]) * scales
        return root * (y - np.nan_to_num(model(values)[0], nan=1e3))

    begin = lmfit.create_params(**dict(zip(names, start / scales, strict=True)))
    best = lmfit.minimize(misfit, begin, xtol=1e-10, ftol=1e-10).params
    return np.array([best[name].value for name in names]) * scales


def loop(study: StudyPlan) -> tuple[float, float]:
    """Seconds that a looped study of `LOOPED` campaigns takes, and the largest relative disagreement."""
    plain, common = study.scenarios[0], design_study(study)
    began, worst, own = time.perf_counter(), 0.0, 0.0
    campaigns = simulate_campaigns(study, plain, draw_campaigns(study, plain, range(LOOPED)))
    for _, _, cells, _ in common.drives():
        offered = np.concatenate([cell.offered for cell in cells])
        session = np.repeat(np.arange(len(cells)), [len(cell.offered) for cell in cells])
        number = (np.arange(LOOPED)[:, None] * len(cells) + session).ravel()
        rows = campaigns.rows.iloc[campaigns.row_positions(offered).ravel()]
        for strategy in study.strategies:
            law = LAW_STRATEGIES[type(strategy)](cells[0].law)
            values = lmfit_loop(law, strategy.name, cells, campaigns)
            predicted = law.predict(rows, values[number])
            aside = time.perf_counter()
            ours: LawCalibrations = calibrate_by_law(law, strategy.name, cells, campaigns)
            off = np.abs(np.expm1(ours.predict(rows, number)[0] - predicted))
            worst = max(worst, float(np.median(off)))
            own += time.perf_counter() - aside
    return time.perf_counter() - began - own, worst


def main() -> None:
    """Print campaigns per second and the ratio."""
    study = read_study(PLAN, load_machine())
    study = replace(study, scenarios=(Scenario("nothing hidden"),), moves=0, campaigns=CAMPAIGNS)
    print(f"{len(study.strategies)} strategies, {len(study.plan.rows())} traverses a campaign")
    chunk = Chunk(study, design_study(study), study.scenarios[0], 0, 100)
    began = time.perf_counter()
    chunk.run()
    ours = (time.perf_counter() - began) / len(chunk)
    theirs, off = loop(study)
    theirs /= LOOPED
    print(f"one core: {1 / ours:.0f} campaigns a second; looped over lmfit {1 / theirs:.2f}, ", end="")
    print(f"{theirs / ours:.0f} times as long; typical disagreement of predictions {off:.0e} at most")
    began = time.perf_counter()
    run_study(study, backend=Cores())
    took = time.perf_counter() - began
    print(f"{CAMPAIGNS:,} campaigns on all cores: {took:.0f} s, {CAMPAIGNS / took:.0f} a second")


if __name__ == "__main__":
    main()
