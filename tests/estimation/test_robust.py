import numpy as np
import pytest

from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation.noise import StudentT


@pytest.mark.slow
def test_a_misheard_end_stop_pulls_little(campaign, read_table):
    table = campaign(seed=4)
    spoilt = table.index[(table.joint == 3) & (table.direction == "+")][[3, 20, 40]]
    table.loc[spoilt, "steps"] = (table.loc[spoilt, "steps"] * 0.7 // 5 * 5).astype(int)
    log = read_table(table)
    truth = {"a": 976e-9, "b": 0.30, "c": 438e-9}
    off = {}
    for name, result in (
        ("gaussian", fit_least_squares(log)),
        ("student", fit_least_squares(log, likelihood=StudentT())),
    ):
        subset = result.si.parameters.query("joint == 3 and direction == '+'")
        off[name] = np.abs(subset["estimate"] / subset["name"].map(truth) - 1.0).max()
    assert off["gaussian"] > 0.03
    assert off["student"] < 0.008


def test_maximises_the_likelihood_of_students_t(campaign, read_table):
    """The score of t5 at the fit vanishes: an independent condition, written out with numpy."""
    log = read_table(campaign(sessions=("2012-03-05",), seed=8))
    result = fit_least_squares(log, likelihood=StudentT(5.0))
    fit = result.joints[3]
    rows = log.usable[log.usable["joint"] == 3]
    subset = rows[rows["direction"] == "-"]
    a, b, c = fit.values[1]
    counts = subset["steps"].to_numpy() - 2.5
    recoil = np.abs(np.cos(subset["q2"])).to_numpy()
    load = (np.cos(subset["psi"] - subset["q2"]) * np.cos(subset["theta"])).to_numpy()
    residual = np.log(counts) - np.log(0.012 / ((1 - b * recoil) * (a - c * load)))
    scale2 = 0.6 * fit.repeatability["-"].value ** 2 + 25 / 12 / counts**2
    pull = 6 * residual / (5 * scale2 + residual**2)
    slopes = np.stack([-a / (a - c * load), recoil / (1 - b * recoil), a * load / (a - c * load)])
    score = slopes @ pull
    assert np.abs(score).max() < 1e-5 * np.sum(np.abs(slopes) * np.abs(pull))


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", [StudentT(5.0)])
def test_intervals_cover_under_heavy_tails(campaign, read_table, likelihood):
    sessions = tuple(f"2012-03-{day:02d}" for day in range(1, 13))
    table = campaign(sessions=sessions, repeatability=0.0, check_every=1)
    noise = np.random.default_rng(2).standard_t(5, len(table)) * 0.0027 / np.sqrt(5 / 3)
    table["steps"] = np.round(table["steps"] * np.exp(noise)).astype(int)
    result = fit_least_squares(read_table(table), likelihood=likelihood)
    truth = {("a", "+"): 976e-9, ("b", "+"): 0.30, ("c", "+"): 438e-9, ("d_q3_12", "-"): 25.91e-6}
    rows = result.si.parameters.set_index(["name", "direction"])
    covered = [
        (rows.loc[key, "low"] < value) & (value < rows.loc[key, "high"]) for key, value in truth.items()
    ]
    share = float(np.mean(np.concatenate([part.to_numpy() for part in covered])))
    assert share == pytest.approx(0.95, abs=3 * np.sqrt(0.95 * 0.05 / 48))
    for fit in result.joints.values():
        for found in fit.repeatability.values():
            assert found.value == pytest.approx(0.0027, rel=5 / np.sqrt(2 * found.df))
