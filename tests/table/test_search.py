"""What is named in tables: false alarms, power beside a test that knows the noise, and outliers."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles
from stickslip_fit.diagnosis.table import problem_from_table
from stickslip_fit.errors import InputError
from tests.table.signals import COEFFICIENTS, EFFECTS, LAW, ROLES, best_term, own_causes, signal, with_effect

ALPHA = 0.01


def search(rows, **options):
    return ssf.diagnose_table(rows, LAW, **ROLES, **{"causes": own_causes(), "gain": False, **options})


def count_alarms(kind: str, sessions: int, length: int, number: int, seed: int = 0) -> int:
    """Tables in which something was found, although nothing is there."""
    tables = (signal(np.random.default_rng([seed, k]), kind, sessions, length) for k in range(number))
    return sum(bool(search(rows, alpha=ALPHA).findings) for rows in tables)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "sessions", "length"),
    [
        ("t5", 3, 60),
        *(pytest.param(*one, marks=pytest.mark.nightly) for one in (("0.9", 1, 200), ("rings", 2, 100))),
    ],
)
def test_nothing_is_found_where_nothing_is(kind, sessions, length):
    assert count_alarms(kind, sessions, length, 1) == 0


@pytest.mark.nightly
@pytest.mark.parametrize(("sessions", "length"), [(1, 200), (1, 600), (5, 120), (20, 100)])
@pytest.mark.parametrize("kind", list(COEFFICIENTS))
def test_false_alarms_are_as_rare_as_promised(kind, sessions, length):
    assert count_alarms(kind, sessions, length, 200, seed=1) <= binom.isf(1e-3, 200, ALPHA)


@pytest.mark.parametrize(
    "name",
    [
        "stribeck",
        pytest.param("viscous-by-direction", marks=pytest.mark.nightly),
        pytest.param("spring", marks=pytest.mark.nightly),
    ],
)
def test_the_answer_is_that_of_a_comparison_by_hand(name):
    rows, _ = with_effect(signal(np.random.default_rng(11), "0.5", 1, 300), "0.5", name, 12.0)
    assert [one.cause for one in search(rows).findings] == [best_term(rows)] == [name]


def name_rates(kind: str, name: str, strength: float, number: int) -> tuple[float, float, float]:
    """Shares of tables with the cause in the answer, with another instead, and of a z above its limit."""
    right = wrong = alarms = 0
    for k in range(number):
        rows = signal(np.random.default_rng([77, k]), kind, 1, 600)
        rows, z = with_effect(rows, kind, name, strength)
        findings = search(rows, seed=k).findings
        inside = any(name in (one.cause, *one.equivalent) for one in findings)
        right, wrong = right + inside, wrong + bool(findings and not inside)
        alarms += abs(z) > 2.5758  # two-sided, at ALPHA
    return right / number, wrong / number, alarms / number


@pytest.mark.nightly
@pytest.mark.parametrize(("strength", "least"), [(6.0, 0.8), (12.0, 0.95)])
@pytest.mark.parametrize("kind", ["white", "0.9", "rings"])
@pytest.mark.parametrize("name", ["viscous-by-direction", "stribeck", "spring"])
def test_causes_are_named_about_as_often_as_by_who_knows_the_noise(name, kind, strength, least):
    right, wrong, oracle = name_rates(kind, name, strength, 60)
    margin = 2.0 * np.sqrt(least * (1 - least) / 60)
    assert right > least * oracle - margin
    assert wrong <= 0.05


@pytest.mark.nightly
@pytest.mark.parametrize("name", list(EFFECTS))
def test_every_generic_cause_is_named(name):
    right, wrong, _ = name_rates("white", name, 14.0, 20)
    assert right >= 0.9
    assert wrong <= 0.1


@pytest.mark.nightly
def test_outliers_of_a_signal_are_those_rows_alone():
    rows = signal(np.random.default_rng(3), "0.9", 1, 300)
    rows.loc[[50, 200], "F"] += 5.0
    (outliers,) = search(rows).findings
    assert outliers.cause == "outliers"
    np.testing.assert_allclose(sorted(outliers.traverses["t"]), [0.5, 2.0])


@pytest.mark.nightly
def test_a_lasting_change_in_a_signal_is_no_outlier():
    rows, _ = with_effect(signal(np.random.default_rng(5), "0.5", 1, 300), "0.5", "sudden-change", 25.0)
    assert "sudden-change" in [one.cause for one in search(rows).findings]


@pytest.mark.slow
def test_memory_of_rows_at_irregular_times_is_unknown():
    rng = np.random.default_rng(4)
    rows = signal(rng, "0.9", 1, 200)
    rows["t"] = np.cumsum(rng.exponential(size=200))
    (unknown,) = ssf.diagnose_table(rows, LAW, **ROLES, gain=False).findings
    assert unknown.cause == "unknown"


@pytest.mark.parametrize("shared", ["all", ("M", "Fv")])
def test_shared_parameters_have_one_value(shared):
    rows = signal(np.random.default_rng(1), "white", 3, 50)
    law = ssf.Law(LAW, shared=shared)
    problem, _ = problem_from_table(rows, law, roles=TableRoles(**ROLES))
    values = problem.fit_extended().parts[0].values
    names = [one.name for one in problem.parts[0].law.parameters]
    vel = rows["vel"].to_numpy()
    columns = {"M": rows["acc"], "Fv": vel, "Fc": np.sign(vel), "offset": np.ones(len(rows))}
    runs = np.eye(3)[rows["run"].factorize()[0]]
    common = names if shared == "all" else list(shared)
    design = [
        np.asarray(columns[name])[:, None] * (np.ones((len(rows), 1)) if name in common else runs)
        for name in names
    ]
    fitted = np.hstack(design) @ np.linalg.lstsq(np.hstack(design), rows["F"], rcond=None)[0]
    np.testing.assert_allclose(problem.parts[0].law.predict(rows, values), fitted, atol=1e-8)
    widths = sum(1 if name in common else 3 for name in names)
    assert problem.linearize().basis.shape[1] == widths


def test_a_law_that_fits_exactly_has_nothing_wrong():
    rows = signal(np.random.default_rng(1), "white", 2, 60)
    exact = rows.assign(F=1.3 * rows["acc"] + 4.0 * rows["vel"] + 0.8 * np.sign(rows["vel"]))
    diagnosis = ssf.diagnose_table(exact, LAW, **ROLES)
    assert diagnosis.verdict == "nothing wrong"
    assert "no scatter" in diagnosis.untestable["drift"]


@pytest.mark.slow
def test_a_law_that_fits_exactly_with_a_cause_ends_the_search():
    rng = np.random.default_rng(4)
    rows = pd.DataFrame({"x": rng.normal(size=21), "year": np.arange(1921.0, 1942.0)})
    diagnosis = ssf.diagnose_table(rows.assign(y=rows["year"] - 1931.0), "y ~ a + b*x", time="year")
    assert [one.cause for one in diagnosis.findings] == ["drift"]
    assert diagnosis.gain.extended < 1e-6 * diagnosis.gain.baseline


@pytest.mark.slow
def test_a_response_that_is_the_time_itself_has_noise_of_no_likelihood_and_an_answer():
    rng = np.random.default_rng(1)
    rows = pd.DataFrame({"x": rng.normal(size=108), "time": np.arange(1.0, 109.0)})
    diagnosis = ssf.diagnose_table(rows.assign(y=rows["time"]), "y ~ a + b*x", time="time", gain=False)
    assert diagnosis.findings[0].cause == "drift"
    assert diagnosis.findings[0].effect.estimate == pytest.approx(np.std(rows["time"]), rel=0.05)


@pytest.mark.slow
def test_a_table_of_mostly_zeros_has_an_answer():
    """A robust fit may run through all zeros, so that its scale is none."""
    rng = np.random.default_rng(1)
    rows = pd.DataFrame({"x": np.sort(rng.integers(20, 43_000, 200)) * 1.0, "u": rng.normal(size=200)})
    rows["y"] = np.where(np.arange(200) % 8 < 3, rows["x"] - 1.0, 0.0)
    diagnosis = ssf.diagnose_table(rows, "y ~ a + b*exp(-k*x)", gain=False)
    assert 0.0 < diagnosis.p_value <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-15, pytest.param(1e15, marks=pytest.mark.nightly)])
def test_the_unit_of_the_response_does_not_matter(factor):
    rows, _ = with_effect(signal(np.random.default_rng(8), "white", 1, 80), "white", "drift", 14.0)
    first, second = (
        ssf.diagnose_table(table, LAW, time="t", gain=False)
        for table in (rows, rows.assign(F=factor * rows["F"]))
    )
    assert first.p_value == second.p_value
    assert [one.cause for one in first.findings] == [one.cause for one in second.findings] == ["drift"]
    assert second.repeatability == pytest.approx(factor * first.repeatability)


@pytest.mark.nightly
def test_the_order_of_a_file_does_not_matter():
    rows, _ = with_effect(signal(np.random.default_rng(9), "0.5", 2, 80), "0.5", "spring", 14.0)
    shuffled = rows.sample(frac=1.0, random_state=1)
    assert search(rows).findings[0].effect.estimate == pytest.approx(
        search(shuffled).findings[0].effect.estimate, rel=0.01
    )


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.nightly)])
def test_a_cause_and_a_function_without_a_name_do_not_cancel_each_other(seed):
    """A piezo's hysteresis, swept up and down once by hand: any course in time would do for it."""
    rng = np.random.default_rng(seed)
    share = np.concatenate([np.arange(38.0), np.arange(37.0, -1.0, -1.0)]) / 37.0
    up, times = np.repeat([True, False], 38), [rng.uniform(4.0, 10.0, 38).cumsum() for _ in range(2)]
    bow = np.where(up, 0.25, -0.2) * share * (1.0 - share)
    volts = 100.0 * (share + bow) + 0.15 * rng.standard_normal(76)
    seconds = np.concatenate([36.0 + times[0], 900.0 + times[1]]).round(1)
    rows = pd.DataFrame({"t": seconds, "V": volts, "d": 23.3 * share})
    rows["way"] = np.where(up, "up", "down")
    found = ssf.diagnose_table(rows, "d ~ a + b*V", time="t", gain=False)
    assert found.findings
    assert max(one.effect.estimate for one in found.findings) < 2.0 * found.misfit


@pytest.mark.nightly
def test_a_hysteresis_shows_though_no_column_was_named_as_the_direction():
    rng = np.random.default_rng(4)
    share, up = np.tile(np.linspace(0.0, 1.0, 35), 2), np.repeat([True, False], 35)
    bow = np.where(up, -1.0, 1.0) * share * (1.0 - share)
    rows = pd.DataFrame({"V": 100.0 * share, "way": np.where(up, "up", "down")})
    rows["d"] = 23.0 * share + 8.0 * bow + 0.3 * rng.standard_normal(70)
    found = ssf.diagnose_table(rows, "d ~ a + b*V")
    assert "follows V, oppositely where way is up and down" in " ".join(str(found).split())
    assert found.gain.extended < 0.3 * found.gain.baseline
    fit = found.extended_law()
    assert np.std(fit.predict(rows)["predicted"] - rows["d"]) < 0.4
    with pytest.raises(InputError, match="way"):
        fit.predict(rows[["V"]])
