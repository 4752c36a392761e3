"""Parameters that sessions share, bounds, and a repeatability that is known beforehand."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares as scipy_least_squares
from scipy.stats import binom

from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares, load_result
from stickslip_fit.estimation.least_squares import profile_intervals
from stickslip_fit.estimation.noise import StudentT

DAYS = ("2012-03-05", "2012-03-06", "2012-03-07")
NOISE = 0.0027
PRISMATIC = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0},
    {"joint": 3, "q2_deg": -45.0, "theta_deg": -30.0},
)


@pytest.fixture
def read(campaign, read_table):
    """A maker of logs from the campaign generator's arguments."""

    def make(edit=lambda table: table, **arguments):
        return read_table(edit(campaign(**({"sessions": DAYS, "settings": PRISMATIC} | arguments))))

    return make


def dense(log, direction, shared_b):
    """Joint 3 in one direction, written out again: a and c of each day, one b or as many as days."""
    rows = log.usable[(log.usable["joint"] == 3) & (log.usable["direction"] == direction)]
    day, days = pd.factorize(rows["session"].astype(str))
    counts = rows["steps"].to_numpy() - 2.5
    sigma = np.hypot(NOISE, 5 / np.sqrt(12) / counts)
    recoil, load = np.abs(np.cos(rows["q2"])), np.cos(rows["psi"] - rows["q2"]) * np.cos(rows["theta"])
    number = len(days)

    def misfit(x):
        a, c, b = x[:number][day], x[number : 2 * number][day], x[2 * number :]
        b = b[0] if shared_b else b[day]
        return (np.log(counts) - np.log(0.012 / ((1 - b * recoil) * (a - c * load) * 1e-6))) / sigma

    start = [1.0] * number + [0.0] * number + [0.2] * (1 if shared_b else number)
    found = scipy_least_squares(misfit, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


def given(log):
    return {(joint, way): NOISE for joint in log.joints for way in "+-"}


@pytest.mark.parametrize("direction", ["+", "-"])
def test_a_shared_parameter_agrees_with_scipy_on_the_whole_system(read, direction):
    log = read()
    result = fit_least_squares(log, shared=("b",), repeatability=given(log))
    table = result.si.parameters
    subset = table[(table["joint"] == 3) & (table["direction"] == direction)].set_index(["name", "session"])
    estimate, error = dense(log, direction, shared_b=True)
    order = [("a", day) for day in DAYS] + [("c", day) for day in DAYS] + [("b", None)]
    unit = np.array([1e6] * 6 + [1.0])
    ours = subset.reindex(pd.MultiIndex.from_tuples(order))
    assert ours["estimate"].to_numpy() * unit == pytest.approx(estimate, rel=1e-6)
    assert ours["standard_error"].to_numpy() * unit == pytest.approx(error, rel=1e-4)


def test_a_session_without_a_recoil_traverse_learns_b_from_the_others(read):
    def without_recoil(table):
        poor = (table["session"] == DAYS[2]) & (table["q2_deg"] != -90.0)
        return table[~poor | (table["theta_deg"] == 0.0) & (table["q2_deg"] == 0.0)]

    log = read(without_recoil)
    alone, together = fit_least_squares(log), fit_least_squares(log, shared=("b",))
    assert any(flag.flag == "not_identified" for flag in alone.flags)
    assert not together.flags
    table = together.si.parameters
    last = table[(table["session"] == DAYS[2]) & (table["name"] == "c") & (table["direction"] == "+")]
    assert last["estimate"].iloc[0] * 1e9 == pytest.approx(438, abs=4 * last["standard_error"].iloc[0] * 1e9)
    assert last["standard_error"].iloc[0] > 0


def test_a_shared_parameter_that_no_session_shows_is_said_to_be_unknown_once(read):
    log = read(settings=({"joint": 3, "q2_deg": -90.0}, {"joint": 3, "q2_deg": -90.0, "psi_deg": -60.0}))
    result = fit_least_squares(log, shared=("b",))
    said = [flag for flag in result.flags if flag.parameters == ("b",)]
    assert [(flag.direction, flag.session) for flag in said] == [("+", ""), ("-", "")]
    assert "from the whole campaign" in said[0].message
    table = result.si.parameters.set_index("name")
    assert table.loc["b", "estimate"].isna().all()
    assert table.loc[["a", "c"], "estimate"].notna().all()


def test_all_parameters_shared_is_one_fit_of_all_sessions(read):
    """The same as renaming every session alike."""
    log = read()
    together = fit_least_squares(log, shared=("a", "b", "c"))

    def merged(table):
        return table.assign(session="one", time=pd.date_range("2012-03-05", periods=len(table), freq="10min"))

    one = fit_least_squares(read(merged))
    columns = ["estimate", "standard_error", "low", "high"]
    assert together.si.parameters["session"].isna().all()
    found, wanted = (result.si.parameters[columns].to_numpy(float) for result in (together, one))
    assert found == pytest.approx(wanted, rel=1e-6)


def test_shared_parameters_are_saved_with_a_null_session_and_come_back(read, tmp_path):
    result = fit_least_squares(read(), shared=("b",), likelihood=StudentT())
    result.save(tmp_path / "fit.json")
    saved = json.loads((tmp_path / "fit.json").read_text())["parameters"]
    assert [(row["direction"], row["session"]) for row in saved if row["name"] == "b"] == [
        ("+", None),
        ("-", None),
    ]
    again = load_result(tmp_path / "fit.json")
    pd.testing.assert_frame_equal(again.si.parameters, result.si.parameters)
    lines = [line.split() for line in str(again).splitlines() if line.startswith("all sessions")]
    assert [line[2] for line in lines] == ["+", "−"]
    table = again.si.parameters.set_index(["name", "direction"])["estimate"]
    assert [float(line[3]) for line in lines] == pytest.approx([table["b", "+"], table["b", "-"]], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("campaigns", [12, pytest.param(400, marks=pytest.mark.nightly)])
def test_intervals_cover_where_days_share_a_parameter(read, campaigns):
    """b, which is shared, and each day's a and c."""
    truth = {("a", "+"): 976e-9, ("b", "+"): 0.30, ("c", "+"): 438e-9}
    truth |= {("a", "-"): 903e-9, ("b", "-"): 0.27, ("c", "-"): -405e-9}
    inside, asked = dict.fromkeys("abc", 0), dict.fromkeys("abc", 0)
    for seed in range(campaigns):
        table = fit_least_squares(read(seed=seed, replicates=1), shared=("b",)).si.parameters
        for row in table.itertuples():
            inside[row.name] += row.low < truth[row.name, row.direction] < row.high
            asked[row.name] += 1
    for name, hits in inside.items():
        low, high = binom.ppf([1e-3, 1 - 1e-3], asked[name], 0.95)
        assert low <= hits <= high, name


def test_a_bound_holds_and_the_others_make_the_best_of_it(read):
    """Against scipy with b fixed there; the sum of squares would fall beyond the bound."""
    log = read()
    result = fit_least_squares(log, bounds={"b": (0.0, 0.28)}, repeatability=given(log))
    table = result.si.parameters.set_index(["direction", "session", "name"])
    for day in DAYS:
        b = table.loc["+", day, "b"]
        assert b["estimate"] == 0.28
        assert np.isnan(b["standard_error"])
        assert "at_bound" in b["flags"]
        assert b["low"] < b["high"] == 0.28
        assert "at_bound" not in table.loc["-", day, "b"]["flags"]
    rows = log.usable[(log.usable["direction"] == "+") & (log.usable["session"] == DAYS[0])]
    counts = rows["steps"].to_numpy() - 2.5
    sigma = np.hypot(NOISE, 5 / np.sqrt(12) / counts)
    recoil, load = np.abs(np.cos(rows["q2"])), np.cos(rows["psi"] - rows["q2"]) * np.cos(rows["theta"])

    def misfit(x):
        return (np.log(counts) - np.log(0.012 / ((1 - 0.28 * recoil) * (x[0] - x[1] * load) * 1e-6))) / sigma

    found = scipy_least_squares(misfit, [1.0, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    error = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    for k, name in enumerate("ac"):
        ours = table.loc["+", DAYS[0], name]
        assert ours["estimate"] * 1e6 == pytest.approx(found.x[k], rel=1e-6)
        assert ours["standard_error"] * 1e6 == pytest.approx(error[k], rel=1e-4)
    assert any("held back by its bound at 0.2800" in flag.message for flag in result.flags)


@pytest.mark.slow
def test_a_truth_on_its_bound_is_covered(read):
    """Half the estimates are held back, half are free; 95 % of either kind or more reach the truth."""
    inside, held = [], []
    for seed in range(20):
        table = fit_least_squares(read(seed=seed, directions=("+",)), bounds={"b": (0.30, 1.0)}).si.parameters
        subset = table[table["name"] == "b"]
        inside += list((subset["low"] <= 0.30) & (subset["high"] >= 0.30))
        held += ["at_bound" in flags for flags in subset["flags"]]
    assert np.mean(inside) >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(inside))
    assert np.mean(held) == pytest.approx(0.5, abs=3.5 * 0.5 / np.sqrt(len(held)))


def test_a_bound_on_a_shared_parameter_is_told_once(read):
    result = fit_least_squares(read(), shared=("b",), bounds={"b": (0.0, 0.28)})
    said = [flag for flag in result.flags if flag.flag == "at_bound"]
    assert [(flag.direction, flag.session) for flag in said] == [("+", "")]
    table = result.si.parameters.set_index(["name", "direction"])
    assert table.loc[("b", "+"), "estimate"] == 0.28
    assert table.loc[("b", "+"), "flags"] == ("at_bound",)


def test_a_given_repeatability_makes_the_error_bars(read):
    """They scale with it and need no degrees of freedom: one traverse per parameter has some too."""
    few = read(settings=PRISMATIC[:3], replicates=1)
    assert fit_least_squares(few).si.parameters["standard_error"].isna().all()
    table = fit_least_squares(few, repeatability={(3, "+"): 0.003}).si.parameters
    forward = table[(table["direction"] == "+") & (table["name"] == "a")]
    rounding = 5 / np.sqrt(12) * forward["estimate"] / 0.012
    assert list(forward["standard_error"] / forward["estimate"]) == pytest.approx(
        list(np.hypot(0.003, rounding)), rel=1e-3
    )
    width = (forward["high"] - forward["low"]) / forward["standard_error"]
    assert width.to_numpy(float) == pytest.approx(2 * 1.959964, rel=1e-5)


def test_a_given_repeatability_that_the_residuals_belie_is_doubted(read):
    log = read()
    fine = fit_least_squares(log, repeatability={(3, "+"): NOISE})
    assert not [flag for flag in fine.flags if flag.flag == "repeatability_doubted"]
    for wrong in (NOISE / 3, NOISE * 3):
        said = fit_least_squares(log, repeatability={(3, "+"): wrong}).flags
        assert [(flag.flag, flag.direction) for flag in said] == [("repeatability_doubted", "+")]


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"shared": ("e",)}, "no law of this log has a parameter 'e'; there are a, b, c"),
        ({"bounds": {"gamma": (0.0, 1.0)}}, "no law of this log has a parameter 'gamma'"),
        ({"bounds": {"b": (0.5, 0.1)}}, "bounds of b"),
        ({"repeatability": {(3, "+"): 0.0}}, "must be above 0"),
    ],
)
def test_terms_that_cannot_be_meant_are_refused(read, terms, message):
    with pytest.raises(InputError, match=message):
        fit_least_squares(read(), **terms)


def test_profile_intervals_of_shared_parameters_are_refused(read):
    log = read()
    with pytest.raises(InputError, match="all its own parameters"):
        profile_intervals(log, fit_least_squares(log, shared=("b",)))
