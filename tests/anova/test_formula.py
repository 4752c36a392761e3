import numpy as np
import pytest
from scipy import stats

from stickslip_fit.anova import analyze_formula, step_size_observations
from stickslip_fit.errors import InputError

DAYS = ("Mon", "Tue", "Wed")
DESIGN = {(d, s, t): 2 for d in DAYS for s in "+-" for t in (0.0, -30.0)}


@pytest.fixture
def log(log_of_readings, readings_of):
    return log_of_readings(readings_of(DESIGN, lambda d, s, t: 20.0 * (s == "+") + 5.0 * DAYS.index(d)))


def test_one_factor_is_the_one_way_analysis(log):
    (found,) = analyze_formula(log, "step_size ~ direction", kind=1)
    rows = step_size_observations(log)
    theirs = stats.f_oneway(*(part["step_size"] for _, part in rows.groupby("direction")))
    assert found.table["F"].iloc[0] == pytest.approx(theirs.statistic, rel=1e-9)
    record = found.to_json()[0]
    assert record["analysis"] == "formula: direction"
    assert record["p_value"] == pytest.approx(theirs.pvalue, rel=1e-9)
    assert record["df"] == [1, 22]
    assert record["difference"] is None


def test_each_joint_has_a_table_of_its_own(campaign, read_table):
    found = analyze_formula(read_table(campaign()), "log(step_size) ~ C(session) * direction")
    assert [table.joint for table in found] == [1, 2, 3]
    assert all(len(table.to_json()) == 3 for table in found)


def test_the_lab_s_own_columns_go_by_their_own_names(campaign, read_table):
    table = campaign(settings=({"joint": 3, "q2_deg": -90.0},), replicates=6)
    pressure = np.random.default_rng(0).normal(1000.0, 5.0, len(table))
    effect = 1 + 1e-3 * (pressure - 1000.0)
    table = table.assign(pressure=pressure, steps=(table["steps"] / effect / 5).round().astype(int) * 5)
    (found,) = analyze_formula(read_table(table), "step_size ~ C(session) * direction + pressure")
    p = found.table.set_index("term")["p"]
    assert p["pressure"] < 1e-3


@pytest.mark.parametrize(
    ("text", "kind", "told"),
    [
        ("step_size ~ nothing", 2, "at character 13, 'nothing' is no column"),
        ("step_size ~", 2, "cannot be used"),
        ("step_size ~ 1", 2, "nothing after its ~"),
        ("step_size ~ 0 + direction", 2, "leaves out the general mean"),
        ("direction ~ session", 2, "one numeric response"),
        ("step_size ~ q3", 2, "empty cells"),
        ("step_size ~ time", 2, "no scatter"),
        ("step_size ~ C(session) / C(time)", 1, "no scatter"),
        ("step_size ~ direction * before_direction", 3, "ask for type 1 or 2"),
        ("step_size ~ direction", 4, "none of 1, 2, 3"),
    ],
)
def test_what_a_formula_cannot_do_is_said(log, text, kind, told):
    with pytest.raises(InputError, match=told):
        analyze_formula(log, text, kind=kind)
