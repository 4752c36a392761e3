"""All traverses together: F as statsmodels has it, what is found where one configuration is too little."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.anova import analyze_variance
from stickslip_fit.anova.overall import analyze_overall
from stickslip_fit.logs import read_log
from stickslip_fit.reporting.sections import factors_section

MACHINE = """
name = "a turntable on a slide"
[[joint]]
kind = "rotary"
range_deg = [0, 360]
[[joint]]
kind = "prismatic"
range_mm = [0, 25]
"""
TERMS = ("day", "direction", "configuration", "day x direction")
DESIGNS = {  # sessions, places, replicates, whether every traverse has a stretch of its own, share missing
    "repeated": (3, 6, 2, False, 0.0),
    "once each": (3, 3, 1, False, 0.0),
    "two sessions": (2, 3, 2, False, 0.0),
    "gaps": (3, 6, 1, False, 0.3),
    "own stretches": (3, 20, 1, True, 0.0),
    "few own stretches": (2, 10, 1, True, 0.0),
}


@pytest.fixture(scope="module")
def machine(machine_of):
    return machine_of(MACHINE)


def observe(rng, design, absent="", tails=None):
    """Observations of joint 1, where everything differs but what is `absent` and its interactions.

    Sessions differ in level, in what the place does and, each by itself, in the difference of directions.
    """
    n_sessions, n_places, replicates, own, missing = DESIGNS[design]
    index = pd.MultiIndex.from_product([range(n_sessions), (0, 1), range(n_places * replicates)])
    session, up, number = (index.get_level_values(level).to_numpy() for level in range(3))
    n = len(index)
    low = rng.uniform(0, 0.8, n) if own else np.zeros(n)
    high = low + rng.uniform(0.1, 1 - low) if own else np.ones(n)
    slide = rng.random(n) if own else number % n_places / (n_places - 1)

    def place(size):
        sizes, x = size * rng.standard_normal(3), (low + high) / 2
        return sizes @ [np.sin(2 * np.pi * x), slide, np.cos(3 * slide)]

    def by_session(size):
        return size * rng.standard_normal(n_sessions)[session]

    parts = {
        "configuration": place(0.02),
        "day": by_session(0.02),
        "direction": 0.08 * up,
        "day, configuration": sum((session == one) * place(0.01) for one in range(n_sessions)),
        "direction, configuration": up * place(0.01),
        "day, direction, day x direction": up * by_session(0.01),
    }
    y = sum(part for names, part in parts.items() if absent not in names.split(", "))
    noise = rng.standard_normal(n) if tails is None else rng.standard_t(tails, n)
    rows = pd.DataFrame(
        {
            "session": [f"S{one}" for one in session],
            "direction": np.where(up, "+", "-"),
            "low": 6.2 * low,
            "high": 6.2 * high,
            "q1": np.nan,
            "q2": 0.025 * slide,
            "step_size": 1e-3 * np.exp(y + 0.004 * noise),
        }
    )
    rows["configuration"] = [f"{a} {b} {c}" for a, b, c in zip(low, high, slide, strict=True)]
    return rows[rng.random(n) >= missing].assign(joint=1, theta=0.0, psi=0.0)


def analyze(rows, machine):
    analysis, _ = analyze_overall(rows, machine)
    return {} if analysis is None else {test.term: test for test in analysis.tests}


@pytest.mark.parametrize("design", ["repeated", "two sessions"])
def test_f_is_that_of_statsmodels(machine, design):
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    rows = observe(np.random.default_rng(1), design).iloc[3:]  # not balanced
    model = "np.log(step_size) ~ (session + direction + configuration) ** 2"
    table = anova_lm(ols(model, rows).fit(), typ=2)
    tests = analyze(rows, machine)
    names = ("session", "direction", "configuration", "session:direction")
    for term, name in zip(TERMS, names, strict=True):
        assert tests[term].statistic == pytest.approx(table.loc[name, "F"], rel=1e-8)
        assert tests[term].p_value == pytest.approx(table.loc[name, "PR(>F)"], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "logs"),
    [
        ("repeated", 75),
        *(pytest.param(one, 150, marks=pytest.mark.nightly) for one in ("repeated", "own stretches")),
    ],
)
def test_a_difference_is_in_its_interval_and_one_that_is_detectable_is_mostly_detected(machine, design, logs):
    """The directions differ by what is detectable in the first log, at the level of 30 tests; then again."""
    rng, level = np.random.default_rng(2), 0.05 / 30
    first = analyze(observe(rng, design, "direction"), machine)["direction"]
    size = first.difference_unit * first.detectable / first.rms_unit
    assert first.detectable_difference == pytest.approx(size)
    strict = replace(first, level=level)
    assert strict.detectable_difference > 1.3 * first.detectable_difference
    # The true scatter is 0.004, not what the first log has.
    estimate = np.sqrt(
        np.mean(
            [
                analyze(observe(rng, design, "direction"), machine)["direction"].difference_unit ** 2
                for _ in range(25)
            ]
        )
    )
    true = strict.detectable_difference / strict.difference_unit * estimate
    found, covered = [], []
    for _ in range(logs):
        rows = observe(rng, design, "direction")
        rows["step_size"] *= np.exp(true * (rows["direction"] == "+"))
        test = analyze(rows, machine)["direction"]
        found.append(test.p_value < level)
        covered.append(test.effect.low < true < test.effect.high)
    assert np.mean(found) == pytest.approx(0.8, abs=0.1)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.05)


@pytest.mark.nightly
@pytest.mark.parametrize("tails", [None, 5])
@pytest.mark.parametrize("absent", TERMS)
@pytest.mark.parametrize("design", DESIGNS)
def test_false_alarms_are_as_rare_as_they_say(machine, design, absent, tails):
    rng, n = np.random.default_rng(3), 300
    logs = (analyze(observe(rng, design, absent, tails), machine) for _ in range(n))
    p_values = np.array([tests[absent].p_value for tests in logs if absent in tests])
    assert len(p_values) > n / 3
    assert np.mean(p_values < 0.05) < 0.05 + 3.3 * np.sqrt(0.05 * 0.95 / len(p_values))


def write_log(path, rows, machine):
    """A log of joint 1 with the counts that the observations' step sizes give."""
    travel = np.degrees(rows["high"] - rows["low"])
    ends = np.degrees(rows[["low", "high"]].to_numpy()).round(6)
    back = (rows["direction"] == "-").to_numpy()
    ends[back] = ends[back][:, ::-1]
    log = rows[["session", "joint", "direction"]].assign(
        steps=(np.radians(travel) / rows["step_size"]).round().astype(int),
        check_every=1,
        q1_deg="",
        q2_mm=(1e3 * rows["q2"]).round(6),
        from_deg=ends[:, 0],
        to_deg=ends[:, 1],
    )
    log.to_csv(path, index=False)
    return read_log(path, machine=machine)


def test_a_log_whose_stretches_are_all_different_is_answered(machine, tmp_path):
    rows = observe(np.random.default_rng(4), "own stretches", "configuration")
    found = analyze_variance(write_log(tmp_path / "log.csv", rows, machine))
    text = " ".join(str(found).split())
    assert text.startswith("Joint 1: the step size changes from session to session by up to")
    (test,) = [test for test in found.overall[0].tests if test.term == "direction"]
    assert test.effect.difference == pytest.approx(0.08, abs=0.015)
    advice = "Recalibrate each session and keep separate parameters for each direction."
    assert text.split(" Which factors matter")[0].endswith(advice)
    conclusion = factors_section(found).conclusion
    assert "joint 1: day, direction and day x direction." in conclusion


def test_nothing_is_said_twice_of_a_log_that_answers_nothing(machine, tmp_path):
    rows = observe(np.random.default_rng(5), "own stretches").iloc[:1]
    section = factors_section(analyze_variance(write_log(tmp_path / "log.csv", rows, machine)))
    assert section.conclusion == "Nothing can be answered from this log."
    assert section.conclusion not in section.paragraphs


def test_what_one_configuration_cannot_show_all_together_do(log_of_readings, readings_of):
    """Directions 12 nm apart, by two traverses of each in each session: too few for any single test."""
    design = {
        (day, sign, theta): 2 for day in ("Mon", "Tue") for sign in "+-" for theta in (0.0, -30.0, -60.0)
    }
    log = log_of_readings(readings_of(design, lambda day, sign, theta: 12.0 * (sign == "+"), noise=3.0))
    found = analyze_variance(log)
    assert not any(test.is_significant for test in found.factor_tests)
    text = " ".join(str(found).split())
    assert text.startswith("Joint 3: the step size changes between the directions by 1.")
    assert "Keep separate parameters for each direction." in text
