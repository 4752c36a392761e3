"""Least squares on optimal traverses is as good as any unbiased calibration from so many can be."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.laws import published_law
from stickslip_fit.logs import read_log
from stickslip_fit.strategies import CalibrationTask, DOptimal, IOptimal
from stickslip_fit.strategies.base import solve_law
from stickslip_fit.strategies.statistics import prediction_variance
from tests.conftest import CALIBRATION, SWEEPS, Truth

SIMULATIONS, REPEATABILITY = 8_000, 0.0027
NAMES = {1: "base", 2: "elbow", 3: "prismatic"}


def slopes_by_hand(truth, joint, table):
    """Slopes of log counts by the law's parameters, from scipy's quadrature and finite differences."""
    values = getattr(truth, NAMES[joint])["+"]

    def log_counts(moved):
        there = replace(truth, **{NAMES[joint]: {"+": tuple(moved)}})
        return np.log([there.steps(row) for row in table.to_dict("records")])

    columns = []
    for place, value in enumerate(values):
        apart = 1e-4 * max(abs(value), 1.0) * (np.arange(len(values)) == place)
        ahead, behind = log_counts(np.array(values) + apart), log_counts(np.array(values) - apart)
        columns.append((ahead - behind) / (2 * apart[place]))
    return log_counts(values), np.stack(columns, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "more", "design"),
    [(3, 0, DOptimal()), (3, 2, IOptimal()), (2, 0, IOptimal()), (1, 1, DOptimal())],
)
def test_the_bound_is_reached(joint, more, design, campaign, written):
    settings = tuple(each for each in CALIBRATION + SWEEPS if each["joint"] == joint)
    table = campaign(
        sessions=("2012-03-05",), settings=settings, directions=("+",), replicates=1, check_every=1
    )
    log = read_log(written(table))
    law = published_law(joint, log.usable, log.machine)
    true, by_hand = slopes_by_hand(Truth(), joint, table)

    offered = log.usable.drop(columns="steps")
    task = CalibrationTask("2012-03-05", "+", law, log.machine, offered, log.usable, REPEATABILITY)
    made = design.pick(task, len(law.parameters) + more)
    noise = np.random.default_rng(joint).standard_normal((SIMULATIONS, len(made)))
    rows = log.usable.iloc[np.tile(made, SIMULATIONS)].assign(
        session=np.repeat(np.arange(SIMULATIONS).astype(str), len(made)),
        steps=np.exp(true[made] + REPEATABILITY * noise).ravel(),
    )
    found = solve_law(law, rows, REPEATABILITY)
    assert found.known.all()

    bound = prediction_variance(by_hand, by_hand[made], np.full(len(made), REPEATABILITY**2))
    for k in range(len(true)):
        off = law.predict(log.usable.iloc[np.full(SIMULATIONS, k)], found.values) - true[k]
        assert np.mean(off**2) == pytest.approx(bound[k], rel=4 * np.sqrt(2 / SIMULATIONS))
