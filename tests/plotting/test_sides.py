"""Residuals over many quantities: axes that people read."""

import numpy as np
import pandas as pd

from stickslip_fit.diagnosis.finding import LogInfo
from stickslip_fit.diagnosis.residuals import ResidualComparison
from stickslip_fit.plotting.residuals import REVERSED
from stickslip_fit.plotting.sides import draw_overview


def test_the_two_settings_of_a_switch_are_its_ticks():
    rng = np.random.default_rng(2)
    residual, null = rng.normal(0, 0.01, 60), rng.normal(0, 0.01, (60, 30))
    comparison = ResidualComparison(pd.DataFrame(index=range(60)), residual, residual, null, null)
    columns = {"steps": rng.uniform(100, 1000, 60), REVERSED: np.tile([0.0, 1.0], 30)}
    figure = draw_overview(columns, comparison, {"black": np.full(60, True)}, [], LogInfo())
    many, switch = figure.axes[:2]
    assert list(switch.get_xticks()) == [0.0, 1.0]
    assert switch.get_xlim()[0] < -0.2
    assert len(many.get_xticks()) > 2
