"""What a study finds, against linear theory and closed forms."""

import numpy as np
import pytest

from stickslip_fit.causes import EndStopLatency
from stickslip_fit.strategies import ClosedForm, IOptimal, LeastSquares
from stickslip_fit.strategies.statistics import prediction_variance
from stickslip_fit.studies import Cores, run_study
from stickslip_fit.studies.calibration import design_study
from tests.conftest import Truth
from tests.strategies.test_bounds import slopes_by_hand
from tests.studies.conftest import JOINT_3, ROTARY, hidden

EXACT = {"check_every": 1, "day_to_day_pct": 0.0, "between_campaigns": 0.0, "between_sessions": 0.0}
CALIBRATION = """
[[sweep]]
joint = 3
q2_deg = -90
[[sweep]]
joint = 3
q2_deg = 0
theta_deg = [0, -90]
"""


def by_hand(rows):
    """Rows of a plan as the tests' own generator has them."""
    table = np.degrees(rows[["q1", "q2", "theta", "psi"]]).fillna(0.0).add_suffix("_deg")
    ends = rows[["start", "stop"]].to_numpy()
    prismatic = (rows["joint"] == 3).to_numpy()
    for k, end in enumerate(("from", "to")):
        table[f"{end}_deg"] = np.degrees(ends[:, k])
        table[f"{end}_mm"] = np.where(prismatic, 1e3 * ends[:, k], 0.0)
    return table.assign(
        q3_mm=1e3 * rows["q3"].fillna(0.0), joint=rows["joint"], direction=rows["direction"].astype(str)
    )


@pytest.mark.slow
@pytest.mark.parametrize("joint", [3, pytest.param(2, marks=pytest.mark.nightly)])
def test_least_squares_reaches_the_cramer_rao_bound(joint, study):
    plan = study(
        JOINT_3 if joint == 3 else ROTARY, sessions=1, campaigns=600,
        strategies=(LeastSquares(IOptimal(), 2), ClosedForm()), **EXACT,
    )  # fmt: skip
    found = run_study(plan, backend=Cores(1)).accuracy("direction")
    rows = plan.plan.rows()
    for strategy in plan.strategies:
        cell = next(
            each for each in design_study(plan).cells if (each.law.joint, each.direction) == (joint, "+")
        )
        places = cell.offered
        _, slopes = slopes_by_hand(Truth(), joint, by_hand(rows.iloc[places]))
        made = np.isin(places, cell.chosen[strategy.name])
        variance = prediction_variance(slopes, slopes[made], np.full(made.sum(), 0.0027**2))
        subset = found[
            (found["strategy"] == strategy.name) & (found["joint"] == joint) & (found["direction"] == "+")
        ]
        assert float(subset["rms_relative"].iloc[0]) == pytest.approx(np.sqrt(variance.mean()), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scatter", "campaigns"),
    [("t5", 75), *(pytest.param(one, 150, marks=pytest.mark.nightly) for one in ("gaussian", "t5"))],
)
def test_stated_intervals_hold_while_nothing_is_hidden(scatter, campaigns, study):
    plan = study(JOINT_3 + ROTARY, sessions=2, campaigns=campaigns, scatter=scatter)
    found = run_study(plan, backend=Cores(1)).accuracy()
    laws = found[found["strategy"] != "constant step"]
    assert laws["covered"].between(0.93, 0.97).all()
    assert (laws["failed"] == 0).all()


def test_a_stop_heard_late_biases_by_its_share_of_the_count(study):
    late = hidden("late", EndStopLatency(), 100.0)
    plan = study(
        CALIBRATION, repeatability=1e-6, campaigns=2, scenarios=(late,), strategies=(ClosedForm(),), **EXACT
    )
    found = run_study(plan, backend=Cores(1)).accuracy("direction")
    rows = by_hand(plan.plan.rows().iloc[: plan.plan.traverses_per_session])
    for direction in "+-":
        steps = np.array(
            [Truth().steps(row) for row in rows.to_dict("records") if row["direction"] == direction]
        )
        subset = found[found["direction"] == direction]
        # Half a count of rounding at most.
        assert float(subset["bias_relative"].iloc[0]) == pytest.approx(
            np.mean(steps / (steps + 100.0) - 1.0), abs=1e-4
        )
        assert float(subset["covered"].iloc[0]) == 0.0
