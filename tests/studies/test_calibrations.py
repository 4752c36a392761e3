"""All campaigns at once or task by task: the same numbers; any strategy can take part."""

from dataclasses import dataclass

import numpy as np
import pytest

from stickslip_fit.causes import ThermalWarmUp
from stickslip_fit.strategies import (
    ClosedForm,
    ConstantStepStrategy,
    Hierarchical,
    IOptimal,
    LeastSquares,
    NotApplicable,
)
from stickslip_fit.studies import Cores, run_study
from stickslip_fit.studies.calibration import (
    calibrate_by_law,
    calibrate_by_task,
    calibrate_sessions,
    design_study,
)
from stickslip_fit.studies.simulation import draw_campaigns, simulate_campaigns
from tests.studies.conftest import JOINT_3, ROTARY, hidden


@dataclass(frozen=True)
class MeanStep:
    """The mean step of whatever was driven first: a strategy in a few lines."""

    name: str = "first traverse"

    def choose(self, task):
        return np.array([0])

    def calibrate(self, task, made):
        step = (abs(made["stop"] - made["start"]) / made["steps"]).mean()
        return lambda rows: (np.log(abs(rows["stop"] - rows["start"]) / step), np.zeros(len(rows)))


@dataclass(frozen=True)
class Picky(MeanStep):
    """Suits joint 3 only, and fails in some campaigns."""

    name: str = "picky"

    def choose(self, task):
        if task.law.joint != 3:
            raise NotApplicable("it is made for joint 3")
        return np.array([0])

    def calibrate(self, task, made):
        if made["steps"].iloc[0] % 2:
            raise NotApplicable("odd")
        return super().calibrate(task, made)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [ConstantStepStrategy(), ClosedForm(), LeastSquares(IOptimal(), 2)])
def test_all_at_once_as_task_by_task(strategy, study):
    warm = hidden("warm", ThermalWarmUp(), 0.02, 3600.0)
    plan = study(JOINT_3 + ROTARY, scenarios=(warm,), strategies=(strategy,), scatter="t5")
    campaigns = simulate_campaigns(plan, warm, draw_campaigns(plan, warm, range(2)))
    for _, _, cells, _ in design_study(plan).drives():
        places = campaigns.row_positions(np.concatenate([cell.offered for cell in cells]))
        number = np.arange(2)[:, None] * 2 + np.repeat([0, 1], len(cells[0].offered))
        rows = campaigns.rows.iloc[places.ravel()]
        together = calibrate_sessions(plan, strategy, cells, campaigns)
        one_by_one = calibrate_by_task(plan, strategy, cells, campaigns)
        assert type(together) is not type(one_by_one)
        for subset, alone in zip(
            together.predict(rows, number.ravel()), one_by_one.predict(rows, number.ravel()), strict=True
        ):
            np.testing.assert_allclose(subset, alone, rtol=1e-9)


def test_a_session_without_an_answer_has_no_prediction(study):
    plan = study(strategies=(ClosedForm(),))
    campaigns = simulate_campaigns(plan, plan.scenarios[0], draw_campaigns(plan, plan.scenarios[0], range(3)))
    _, _, cells, _ = next(design_study(plan).drives())
    # The same traverse three times over leaves two parameters open.
    blind = [
        type(cell)(**vars(cell) | {"chosen": {"closed form": cell.offered[[0, 0, 0]]}}) for cell in cells
    ]
    found = calibrate_by_law(cells[0].law, "closed form", blind, campaigns)
    mean, sd = found.predict(campaigns.rows.iloc[:4], np.zeros(4, int))
    assert np.isnan(mean).all()
    assert np.isnan(sd).all()


@pytest.mark.slow
def test_any_strategy_takes_part(study):
    plan = study(
        JOINT_3 + ROTARY, campaigns=2, check_every=1,
        strategies=(MeanStep(), Picky(), Hierarchical(2), ClosedForm()),
    )  # fmt: skip
    found = run_study(plan, backend=Cores(1))
    assert set(found.strategies(3)) == {"first traverse", "picky", "Bayes, 2 I-optimal", "closed form"}
    assert set(found.strategies(2)) == {"first traverse", "Bayes, 2 I-optimal", "closed form"}
    assert "picky 1 + and \N{MINUS SIGN} it is made for joint 3" in " ".join(str(found).split())
    table = found.campaigns[(found.campaigns["joint"] == 3) & (found.campaigns["direction"] == "+")]
    failed = table.pivot(index="campaign", columns="strategy", values="failed")
    assert 0 < failed["picky"].sum() < 4
    # What one cannot calibrate is left out for all.
    left = table.assign(per_session=table["predictions"] / (2 - table["campaign"].map(failed["picky"])))
    known = left[np.isfinite(left["per_session"])]
    assert known["per_session"].nunique() == 1
    assert (known["per_session"] > 5).all()
    accuracy = found.accuracy().set_index(["joint", "strategy"])["rms_relative"]
    # Two traverses today and another session know more than two traverses, and less than nothing known.
    assert accuracy[3, "Bayes, 2 I-optimal"] < 0.02 < accuracy[3, "first traverse"]
