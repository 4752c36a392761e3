"""Position as a factor: F and p as statsmodels has them, what is found, and what cannot be asked."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from stickslip_fit.anova import analyze_formula, analyze_variance
from stickslip_fit.anova.contrasts import _studentized_range_quantile, f_test_power
from stickslip_fit.anova.position import analyze_positions
from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from stickslip_fit.reporting.sections import factors_section

MACHINE = """
name = "two turntables"
[[joint]]
kind = "rotary"
range_deg = [0, 360]
[[joint]]
kind = "rotary"
range_deg = [0, 200]
"""
DAYS = ("Mon", "Tue", "Wed", "Thu")


@pytest.fixture(scope="module")
def machine(machine_of):
    return machine_of(MACHINE)


def observe(seed=0, *, days=DAYS, places=6, replicates=2, size=lambda day, sign, x: 0.0, ends=None):
    """Observations of joint 1; `size` is the log step size at a share x of the travel, `ends` draws ends."""
    rng = np.random.default_rng(seed)
    rows = []
    for k, day in enumerate(days):
        for sign in "+-":
            level = 0.03 * rng.standard_normal()
            for place in range(places * replicates):
                low = place % places / places
                low, high = (low, low + 1 / places) if ends is None else ends(rng, k)
                y = level + size(k, sign, (low + high) / 2) + 0.01 * rng.standard_normal()
                rows.append((day, sign, low * 6.2, high * 6.2, 1e-3 * np.exp(y)))
    rows = pd.DataFrame(rows, columns=["session", "direction", "low", "high", "step_size"])
    return rows.assign(joint=1, q1=np.nan, q2=0.0, theta=0.0, psi=0.0)


def analyze(rows, machine):
    analysis, refused = analyze_positions(rows, machine)
    assert not refused
    return {test.term: test for test in analysis.tests}


def peaked(day, sign, x):
    return 0.1 * np.exp(-(((x - 0.6) / 0.2) ** 2))


def anova_of(rows, formula):
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    named = {
        "y": np.log(rows["step_size"]),
        "day": rows["session"],
        "place": rows["low"].round(6).astype(str),
    }
    return anova_lm(ols(formula, rows.assign(**named)).fit(), typ=2)


@pytest.mark.parametrize("share_missing", [0.0, 0.15])
def test_f_and_p_are_those_of_statsmodels(machine, share_missing):
    rows = observe(1, size=lambda day, sign, x: peaked(day, sign, x) + 0.01 * day * x, replicates=3)
    rows = rows[np.random.default_rng(2).random(len(rows)) >= share_missing]
    tests = analyze(rows, machine)
    raw = anova_of(rows, "y ~ day * direction * place")
    error = raw.loc["Residual", "sum_sq"] / raw.loc["Residual", "df"]
    by_day, line = tests["day x position"], raw.loc["day:place"]
    assert by_day.statistic == pytest.approx(line["sum_sq"] / line["df"] / error, rel=1e-8)
    assert by_day.p_value == pytest.approx(line["PR(>F)"], rel=1e-6)
    assert by_day.error_term == "replicates"
    mean = rows.groupby(["session", "direction", "low"], as_index=False)["step_size"].agg(
        lambda steps: np.exp(np.log(steps).mean())
    )
    cells = anova_of(mean, "y ~ day * direction + day * place + direction * place")
    squares = cells["sum_sq"] / cells["df"]
    # Position by direction by day is what that model leaves.
    for term, name, against in (
        ("position", "place", "day:place"),
        ("direction x position", "direction:place", "Residual"),
    ):
        test = tests[term]
        assert test.statistic == pytest.approx(squares[name] / squares[against], rel=1e-8)
        assert test.p_value == pytest.approx(stats.f.sf(test.statistic, *test.df), rel=1e-8)
        ratio = np.array(test.df) / [cells.loc[name, "df"], cells.loc[against, "df"]]
        assert ratio[0] == pytest.approx(ratio[1])
        assert 0 < ratio[0] <= 1 + 1e-12


def test_a_profile_is_found_with_its_place_and_size(machine):
    test = analyze(observe(3, size=peaked), machine)["position"]
    assert test.p_value < 1e-6
    assert test.extreme_levels == ("177.6 to 236.8 deg", "0 to 59.2 deg")
    places = (np.arange(6) + 0.5) / 6
    truth = peaked(0, "+", places)
    assert test.size == pytest.approx(truth.std(), abs=0.006)
    assert test.effect.low < np.ptp(truth) < test.effect.high


def test_a_profile_of_one_direction_or_of_each_day_is_named_as_that(machine):
    by_direction = analyze(
        observe(4, size=lambda day, sign, x: (sign == "+") * peaked(day, sign, x)), machine
    )
    assert by_direction["direction x position"].p_value < 1e-4
    assert by_direction["day x position"].p_value > 0.01
    by_day = analyze(observe(5, size=lambda day, sign, x: 0.05 * np.cos(3 * x + 2 * day)), machine)
    assert by_day["day x position"].p_value < 1e-4


def random_ends(rng, day):
    """Every other day drives the upper half of each sixth of the travel, the others the lower."""
    length = rng.uniform(0.03, 0.1)
    low = (1 - length) * (rng.integers(6) + 0.5 * (day % 2) + 0.5 * rng.random()) / 6
    return low, low + length


def test_where_in_a_stretch_a_day_drove_is_no_change_of_the_profile(machine):
    def tilted(day, sign, x):
        return 0.3 * x

    p_values = [
        analyze(observe(seed, size=tilted, places=40, replicates=1, ends=random_ends), machine)
        for seed in range(8)
    ]
    assert sum(tests["day x position"].p_value < 0.05 for tests in p_values) <= 3
    assert all(tests["position"].p_value < 1e-4 for tests in p_values)


@pytest.mark.nightly
@pytest.mark.parametrize("what", ["ends", "own ends", "a profile each day"])
def test_false_alarms_are_as_rare_as_they_say(machine, what):
    how = {
        "ends": {"replicates": 1},
        "own ends": {"places": 30, "replicates": 1, "ends": random_ends},
        "a profile each day": {"places": 12, "replicates": 1},
    }[what]
    p_values, n = {}, 400
    for seed in range(n):
        phase = np.random.default_rng([9, seed]).uniform(0, 6.3, len(DAYS))
        if what == "a profile each day":
            how["size"] = lambda day, sign, x, phase=phase: 0.03 * np.cos(4 * x + phase[day])
        for term, test in analyze(observe(seed, **how), machine).items():
            p_values.setdefault(term, []).append(test.p_value)
    terms = ["direction x position", "position"] + (
        ["day x position"] if what != "a profile each day" else []
    )
    for term in terms:
        rate = np.mean(np.array(p_values[term]) < 0.05)
        assert rate < 0.05 + 3 * np.sqrt(0.05 * 0.95 / n), (term, rate)


def test_what_cannot_be_asked_is_one_sentence(machine):
    whole = observe(places=1)
    apart = observe(6, days=("Mon", "Tue"), places=4, replicates=3)
    apart = apart[(apart["session"] == "Mon") == (apart["low"] < 3)]
    for rows, reason in (
        (whole, "drive some, one beside the other"),
        (apart[apart["low"].between(1, 2) | (apart["low"] > 4)], "drive"),
        (observe(days=("Mon",), replicates=1).query("direction == '+'"), "drive some, one beside the other"),
    ):
        analysis, (refused,) = analyze_positions(rows, machine)
        assert analysis is None or not [test for test in analysis.tests if test.term == "position"]
        assert reason in refused.reason


def test_one_session_and_one_reading_each_compare_with_the_other_direction(machine):
    tests = analyze_positions(observe(days=("Mon",), replicates=1, size=peaked), machine)[0].tests
    assert {test.term: test.error_term for test in tests}["position"] == "highest interaction"


def write_log(folder, machine, profile):
    rng, lines = (
        np.random.default_rng(8),
        ["session,joint,direction,steps,check_every,q1_deg,q2_deg,from_deg,to_deg"],
    )
    for day in range(4):
        for sign in "+-":
            for place in range(0, 360, 40):
                shift = profile(day, np.radians(place)) + 0.005 * rng.standard_normal()
                count = round(40 / 0.06 * np.exp(shift))
                ends = (place, place + 40) if sign == "+" else (place + 40, place)
                lines.append(f"day {day},1,{sign},{count},1,,0,{ends[0]},{ends[1]}")
    (folder / "log.csv").write_text("\n".join(lines), "utf-8")
    return read_log(folder / "log.csv", machine=machine)


@pytest.fixture
def log(machine, tmp_path):
    return write_log(tmp_path, machine, lambda day, angle: 0.1 * np.sin(angle))


def test_a_profile_that_differs_between_days_is_in_the_first_sentence(machine, tmp_path):
    """And in that of the report: the table says yes to it."""
    anova = analyze_variance(write_log(tmp_path, machine, lambda day, x: 0.1 * np.cos(x + np.pi * day / 2)))
    text = " ".join(str(anova).split())
    assert text.startswith(
        "Joint 1: the step size changes along the travel in a way that differs from session to session (7."
    )
    assert "between the directions (" not in text
    assert "joint 1: day x position." in factors_section(anova).conclusion


def test_position_is_in_the_answer_the_records_and_formulas(log):
    anova = analyze_variance(log)
    records = {record["analysis"]: record for record in anova.to_json() if record["F"] is not None}
    assert records["position"]["p_holm"] < 1e-4
    assert records["position"]["unit"] == "%"
    low, high = records["position"]["low"], records["position"]["high"]
    assert low < 100 * np.expm1(0.2) < high
    text = " ".join(str(anova).split())
    assert "The step size differs along the travel" in text
    assert "larger at 280 to 320° than at 80 to 120°" in text
    (table,) = analyze_formula(
        log, "log(step_size) ~ session * direction + session * position + direction * position"
    )
    lines = table.table.set_index("term")
    assert lines.loc["session:position", "F"] == pytest.approx(records["day x position"]["F"], rel=1e-8)
    with pytest.raises(InputError, match="leave position out"):
        analyze_formula(log.select(log.rows["start"] == 0), "step_size ~ position")


def test_quantiles_and_power_are_those_of_scipy_and_statsmodels():
    from statsmodels.stats.power import ftest_power_f2

    for levels, df in ((3, 2), (6, 9.5), (20, 40)):
        expected = stats.studentized_range.ppf(0.95, levels, df) / np.sqrt(2)
        assert _studentized_range_quantile(levels, df) == pytest.approx(expected, rel=1e-6)
    for size, df in ((10.0, (3, 8)), (30.0, (26, 52)), (5.0, (1, 2))):
        expected = ftest_power_f2(size / sum(df), *df, 0.05, ncc=0)
        assert f_test_power(size, df) == pytest.approx(expected, rel=1e-9)
