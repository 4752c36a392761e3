"""What a table's law lacks without having a name: short terms, smooth functions, strict periods."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import stickslip_fit as ssf
from stickslip_fit.causes.roles import TableRoles
from stickslip_fit.causes.table_terms import PREDICTION, PeriodicTableTerm, ProposedTableTerm, SmoothTableTerm
from stickslip_fit.diagnosis.alternatives import attribute_to_causes
from stickslip_fit.diagnosis.table import problem_from_table
from tests.differences import numeric_slopes


def bent(seed, bend, n=120, sd=0.5):
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(1.0, 10.0, n), rng.uniform(-1.0, 1.0, n)
    return pd.DataFrame(
        {"x": x, "z": z, "y": 1.0 + 0.7 * x - 0.4 * z + bend(x, z) + sd * rng.standard_normal(n)}
    )


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "bend", "formula"),
    [
        # In each run such a term is proposed beside what follows another column.
        pytest.param(
            "y ~ a + b*x + c*z",
            lambda x, z: 0.12 * (x - 5.0) ** 2,
            "k * ((x",
            marks=pytest.mark.nightly,
        ),
        ("y ~ a + b*x + c*z", lambda x, z: 0.4 * x * z, "k * ((x"),
    ],
)
def test_a_short_term_is_proposed_and_predicts_what_was_not_seen(law, bend, formula):
    diagnosis = ssf.diagnose_table(bent(1, bend), law)
    (finding,) = diagnosis.findings
    assert finding.cause == "unknown"
    assert finding.term.startswith(formula)
    assert f"a term is proposed: {finding.term}, k = " in diagnosis.summary().headline[0]
    assert diagnosis.gain.extended < 0.8 * diagnosis.gain.baseline
    fresh = bent(2, bend, n=2000, sd=0.0)
    fit = diagnosis.extended_law()
    before = ssf.fit_table(bent(1, bend), law).predict(fresh)["predicted"] - fresh["y"]
    assert rms(fit.predict(fresh)["predicted"] - fresh["y"]) < 0.25 * rms(before)


@pytest.mark.slow
def test_what_follows_two_columns_is_proposed_for_both_and_predicts(tmp_path):
    def bends(x, z):
        return 0.15 * (x - 5.0) ** 2 + 1.2 * np.tanh(4.0 * z)

    law, fresh = "y ~ a + b*x + c*z", bent(6, bends, n=2000, sd=0.0)
    frame = bent(5, bends, sd=0.2)
    diagnosis = ssf.diagnose_table(frame, law)
    first, second = diagnosis.findings
    assert {(first.cause, first.carrier), (second.cause, second.carrier)} == {
        ("unknown", "x"),
        ("unknown", "z"),
    }
    assert f"of y follows {second.carrier}" in diagnosis.summary().headline[1]
    assert "extended by the proposed term and the smooth function cuts" in diagnosis.summary().headline[2]
    assert first.gain.extended == second.gain.baseline > second.gain.extended == diagnosis.gain.extended
    fit = diagnosis.extended_law()
    assert len({one.name for one in fit.law.parameters}) == len(fit.law.parameters)
    predicted = fit.predict(fresh)
    before = ssf.fit_table(frame, law).predict(fresh)["predicted"] - fresh["y"]
    assert rms(predicted["predicted"] - fresh["y"]) < 0.12 * rms(before)
    fit.save(tmp_path / "law.json")
    pd.testing.assert_frame_equal(predicted, ssf.load_table_fit(tmp_path / "law.json").predict(fresh))


@pytest.mark.slow
def test_what_a_proposal_only_comes_near_is_no_second_finding():
    rng = np.random.default_rng(10)
    x, own = rng.uniform(-1.0, 1.0, (2, 180))
    z = 0.7 * x + 0.5 * own
    y = x + z + 5.0 * np.abs(x - 0.1) + 0.02 * rng.standard_normal(180)
    diagnosis = ssf.diagnose_table(pd.DataFrame({"x": x, "z": z, "y": y}), "y ~ a + b*x + c*z", gain=False)
    assert [one.carrier for one in diagnosis.findings] == ["x"]


@pytest.mark.slow
def test_where_no_short_term_does_a_smooth_function_predicts(tmp_path):
    def bump(x, z):
        return 2.0 * np.exp(-0.5 * ((x - 4.0) / 0.6) ** 2)

    frame, fresh = bent(3, bump, n=200), bent(4, bump, n=2000, sd=0.0)
    diagnosis = ssf.diagnose_table(frame, "y ~ a + b*x + c*z")
    (finding,) = diagnosis.findings
    assert (finding.cause, finding.term, finding.carrier) == ("unknown", "", "x")
    fit = diagnosis.extended_law()
    predicted = fit.predict(fresh)
    before = ssf.fit_table(frame, "y ~ a + b*x + c*z").predict(fresh)["predicted"] - fresh["y"]
    departure = predicted["predicted"] - fresh["y"]
    assert rms(departure) < 0.4 * rms(before)
    # The posterior covariance of a linear model with a normal prior.
    ((low, high),), orders = finding.version.limits, np.arange(1, len(finding.version.sds) + 1)
    share = (frame["x"].to_numpy() - low) / (high - low)
    columns = np.column_stack([np.ones(200), frame["x"], frame["z"], np.cos(np.pi * share[:, None] * orders)])
    precision = np.diag(np.r_[0.0, 0.0, 0.0, 1.0 / np.square(finding.version.sds)])
    covariance = np.linalg.inv(columns.T @ columns / fit.noise_sd**2 + precision)
    np.testing.assert_allclose(np.diag(fit.covariance), np.diag(covariance), rtol=0.02)
    fit.save(tmp_path / "law.json")
    pd.testing.assert_frame_equal(predicted, ssf.load_table_fit(tmp_path / "law.json").predict(fresh))


LIMITS = ((0.0, 10.0),)
TERMS = [
    SmoothTableTerm(carriers=("x",), limits=LIMITS, orders=((1,), (2,), (3,)), sds=(1.0, 0.5, 0.2)),
    SmoothTableTerm(
        carriers=("x", "z"), limits=(*LIMITS, (-1.0, 1.0)), orders=((1, 1), (1, 2)), sds=(1.0, 0.5)
    ),
    SmoothTableTerm(
        carriers=(PREDICTION,), limits=((0.0, 9.0),), orders=((1,), (2,)), sds=(1.0, 0.5), response="y"
    ),
    PeriodicTableTerm(
        limits=LIMITS,
        orders=((1,), (2,), (3,), (4,)),
        sds=(1.0, 1.0, 0.5, 0.5),
        period=3.0,
        sessions=("all",),
    ),
    ProposedTableTerm(factors=(("x^2", "x", 5.0, 4.0), ("log(x)", "x", 0.0, 2.0))),
]


@pytest.mark.parametrize("term", TERMS, ids=lambda term: " ".join(term.carriers))
def test_derivatives_are_those_of_differences(term):
    frame = bent(5, lambda x, z: 0.0, n=30)
    rows = frame.assign(session="all", session_seconds=np.arange(30.0))
    law = ssf.Law("y ~ a + b*x + c*z").bind_table(frame)
    extended = term.extend(law)
    values = np.r_[1.0, 0.7, -0.4, np.linspace(0.3, -0.2, len(term.parameters))]
    numeric = numeric_slopes(lambda values: extended.predict(rows, values), values)
    np.testing.assert_allclose(extended.jacobian(rows, values), numeric, rtol=1e-5, atol=1e-7)
    trial = np.eye(len(term.parameters))[:1]
    own = np.tile(values[:3], (len(rows), 1))
    alone = np.hstack([own, np.tile(trial, (len(rows), 1))])
    np.testing.assert_allclose(
        term.changes(law, rows, own, trial)[:, 0], extended.predict(rows, alone) - law.predict(rows, own)
    )


def swinging(seed, coefficients, n=360):
    rng = np.random.default_rng(seed)
    return lfilter([1.0], [1.0, *(-np.array(coefficients))], rng.standard_normal(n + 300))[300:]


@pytest.mark.nightly
def test_a_strict_period_is_told_from_noise_with_memory():
    t = np.arange(360) / 12.0
    wave = 1.5 * np.sin(2.0 * np.pi * (t - 0.1)) + 0.6 * np.cos(4.0 * np.pi * t)
    frame = pd.DataFrame({"t": t, "y": 10.0 + wave + swinging(1, [0.6])})
    diagnosis = ssf.diagnose_table(frame, ssf.Law("y ~ mean", units={"t": "year"}), time="t")
    (finding,) = diagnosis.findings
    assert finding.cause == "periodic-in-time"
    # The standard error of a frequency in coloured noise (E. J. Hannan, J. Appl. Prob. 10:510, 1973).
    density = 1.0 / abs(1.0 - 0.6 * np.exp(-2j * np.pi / 12.0)) ** 2
    error = np.sqrt(24.0 * density / (1.5**2 * 360**3)) * 12.0 / (2.0 * np.pi)
    assert finding.version.period == pytest.approx(1.0, abs=3.0 * error)
    amplitudes = [one.size for one in finding.parameters[:2]]
    assert [size.low < truth < size.high for size, truth in zip(amplitudes, (1.5, 0.6), strict=True)] == [
        True
    ] * 2
    assert (
        f"comes and goes with a period of {finding.version.period:.4g} year, by 1.5"
        in diagnosis.summary().headline[0]
    )
    assert (
        diagnosis.gain.extended < 1.05 * 1.25 < diagnosis.gain.baseline
    )  # sd of the noise, of noise and wave


@pytest.mark.nightly
def test_noise_that_swings_has_no_strict_period():
    pole = 0.93 * np.exp(2j * np.pi / 11.0)
    t = np.arange(360.0)
    for seed in range(2):
        frame = pd.DataFrame({"t": t, "y": swinging(seed, [2.0 * pole.real, -(abs(pole) ** 2)])})
        problem = ssf.diagnose_table(frame, "y ~ mean", time="t", gain=False).selection.problem
        assert "periodic-in-time" not in [cause.name for cause in problem.causes]


@pytest.mark.nightly
def test_the_season_of_el_nino_has_a_year():
    from statsmodels.datasets import elnino

    sea = elnino.load_pandas().data.set_index("YEAR").loc[1976:].stack().reset_index(drop=True)
    frame = pd.DataFrame({"month": np.arange(len(sea)), "sea": sea})
    law = ssf.Law("sea ~ mean", units={"month": "months", "sea": "K", "mean": "K"})
    found = ssf.diagnose_table(frame, law, time="month", gain=False)
    assert [finding.cause for finding in found.findings] == ["periodic-in-time"]
    assert found.findings[0].version.period == pytest.approx(12.0, abs=0.02)


def test_columns_of_very_different_sizes_do_not_stop_a_fit():
    """Beside a year and a large offset the numbers of a cause once looked undetermined, and stayed 0."""
    rng = np.random.default_rng(6)
    year, load = np.linspace(1949.0, 1961.0, 144), rng.uniform(size=144)
    y = 1e6 + 3.0 * year + 0.5 * load + 0.05 * rng.standard_normal(144)
    frame = pd.DataFrame({"year": year, "load": load, "y": y})
    found = ssf.diagnose_table(frame, "y ~ a + b*year", gain=False)
    assert [finding.cause for finding in found.findings] == ["covariate:load"]
    assert rms(found.extended_law().residuals["residual"]) == pytest.approx(0.05, rel=0.15)


@pytest.mark.slow
def test_an_alternative_by_direction_is_signed_before_the_noise_is_filtered():
    rng = np.random.default_rng(7)
    n = 300
    x, way = rng.uniform(0.0, 10.0, n), rng.choice([-1.0, 1.0], n)
    frame = pd.DataFrame({"t": np.arange(float(n)), "x": x, "way": way})
    frame["y"] = 1.0 + 0.5 * x + swinging(8, [0.7], n)
    found = ssf.diagnose_table(frame, "y ~ a + b*x", time="t", direction="way", gain=False)
    problem = found.selection.problem
    linearized = problem.linearize()
    assert linearized.noise_filter is not None
    (shape, *_) = [one for one in problem.alternatives(linearized) if one.cause == "unknown:x by direction"]
    functions = shape.version.functions(linearized.columns)
    expected = linearized.project(linearized.whiten(np.asarray(frame["way"])[:, None] * functions))
    outside = shape.directions - expected @ np.linalg.lstsq(expected, shape.directions, rcond=None)[0]
    assert np.abs(outside).max() < 1e-9


def test_offsets_of_groups_are_no_function_of_a_column_that_is_called_group():
    rng = np.random.default_rng(1)
    rows = pd.DataFrame(rng.normal(size=(60, 3)), columns=["x", "y", "group"])
    rows["lab"] = np.repeat(["a", "b", "c"], 20)
    problem, _ = problem_from_table(rows, "y ~ a + b*x", roles=TableRoles(group="lab"))
    found = attribute_to_causes(problem.alternatives(problem.linearize()), problem.causes, ())
    assert {"unknown:group", "covariate:group"} <= {one.cause for one in found}


@pytest.mark.nightly
def test_what_comes_and_goes_slowly_at_irregular_times_gets_a_law():
    rng = np.random.default_rng(9)
    t = np.sort(rng.uniform(0.0, 1000.0, 50))
    y = 5.0 + np.sin(2.0 * np.pi * t / 900.0) + 0.2 * rng.standard_normal(50)
    found = ssf.diagnose_table(pd.DataFrame({"t": t, "y": y}), "y ~ mean", time="t")
    assert found.findings[-1].version is not None
    assert found.gain.extended < 0.5 * found.gain.baseline
