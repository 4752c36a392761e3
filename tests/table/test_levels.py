"""Columns of texts: offsets and parameters by level, beside statsmodels' analysis of covariance and scipy."""

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from scipy.optimize import curve_fit

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles, generic_causes, prepare_rows
from stickslip_fit.units import Interval
from tests.differences import numeric_slopes

LINE = "y ~ a + b*x"


def table(seed, offset=(0.0, 0.0, 0.0), slope=(0.0, 0.0, 0.0), n=120):
    rng = np.random.default_rng(seed)
    level, x = rng.integers(3, size=n), rng.uniform(0.0, 10.0, n)
    y = 2.0 + 0.5 * x + np.array(offset)[level] + np.array(slope)[level] * x + 0.3 * rng.standard_normal(n)
    return pd.DataFrame({"x": x, "who": np.array(["Ada", "Ben", "Cy"])[level], "y": y})


def sizes(diagnosis):
    (finding,) = diagnosis.findings
    assert finding.cause == "covariate:who"
    return {one.name: one.size for one in finding.parameters}


def assert_as(size: Interval, fit, name):
    """The estimate is that of least squares; so is the interval, nearly: the noise is estimated otherwise."""
    assert size.estimate == pytest.approx(fit.params[name], abs=0.02 * fit.bse[name])
    low, high = fit.conf_int().loc[name]
    assert size.high - size.low == pytest.approx(high - low, rel=0.12)


def test_offsets_are_those_of_the_analysis_of_covariance():
    frame = table(1, offset=(0.0, 0.5, -0.4))
    frame["who"] = pd.Categorical(frame["who"], categories=frame["who"].unique())
    diagnosis = ssf.diagnose_table(frame, LINE, gain=False)
    found = sizes(diagnosis)
    fit = smf.ols("y ~ x + C(who)", frame).fit()
    assert len(found) == 2
    for level in frame["who"].cat.categories[1:]:
        assert_as(found[f"d[{level}]"], fit, f"C(who)[T.{level}]")
    beside = f"differences from {frame['who'].cat.categories[0]}."
    assert beside in " ".join(str(diagnosis).split())
    assert beside in " ".join(str(diagnosis.extended_law()).split())
    before, after = diagnosis.plot_residuals(0)
    assert [tick.get_text() for tick in after.get_xticklabels()] == list(frame["who"].cat.categories)
    means = smf.ols("y ~ x", frame).fit().resid.groupby(frame["who"], observed=True).mean()
    (bars,) = before.containers
    np.testing.assert_allclose(bars.lines[0].get_ydata(), means[frame["who"].cat.categories], atol=1e-3)


@pytest.mark.nightly
def test_other_parameters_are_said_only_where_an_interaction_is_clear():
    """Beside the p-value of an analysis of covariance; in five of these both are about as likely."""
    found = []
    for seed, offset, slope in [(k, 0.4, 0.08) for k in (3, 5, 7, 8, 11)] + [
        (k, 0.8, 0.15) for k in (4, 6, 7)
    ]:
        rng = np.random.default_rng(seed)
        x, who = rng.uniform(0.0, 10.0, 40), np.repeat(["Ada", "Ben"], 20)
        other = (who == "Ben") * (offset + slope * (x - 5.0))
        frame = pd.DataFrame({"x": x, "who": who, "y": 0.5 * x + other + 0.3 * rng.standard_normal(40)})
        (finding,) = ssf.diagnose_table(frame, LINE, gain=False).findings
        p_value = smf.ols("y ~ x * who", frame).fit().pvalues.iloc[-1]
        found.append((type(finding.version).__name__, bool(p_value < 0.03)))
    assert set(found) == {("LevelDependence", False), ("ParametersByLevel", True)}


def test_a_finding_that_no_column_carries_is_drawn_over_its_own_effect():
    """A product of two columns: what is left without the term rises along it with slope 1."""
    rng = np.random.default_rng(4)
    x, z = rng.uniform(-1.0, 1.0, (2, 200))
    frame = pd.DataFrame({"x": x, "z": z, "y": 1.0 + x + z + x * z + 0.1 * rng.standard_normal(200)})
    without, rest = ssf.diagnose_table(frame, "y ~ a + b*x + c*z", gain=False).plot_residuals(0)
    assert rest.get_xlabel() == "effect of the finding, as fitted"
    slopes = [np.polyfit(*axis.containers[0].lines[0].get_data(), 1)[0] for axis in (without, rest)]
    assert slopes == pytest.approx([1.0, 0.0], abs=0.1)


@pytest.mark.slow
def test_other_parameters_are_those_with_interactions():
    frame = table(2, offset=(0.0, 0.3, 0.0), slope=(0.0, 0.15, -0.1))
    frame = frame[frame["who"] != "Cy"].reset_index(drop=True)
    frame["who"] = pd.Categorical(frame["who"], categories=frame["who"].unique())
    diagnosis = ssf.diagnose_table(frame, LINE)
    first, other = frame["who"].cat.categories
    fit = smf.ols("y ~ x * C(who)", frame).fit()
    found = sizes(diagnosis)
    assert_as(found["a"], fit, f"C(who)[T.{other}]")
    assert_as(found["b"], fit, f"x:C(who)[T.{other}]")
    headline = diagnosis.summary().headline[0]
    assert f"other parameters where who is {other}, not {first}: a by" in headline
    assert diagnosis.gain.extended < 0.7 * diagnosis.gain.baseline


@pytest.mark.slow
def test_values_of_a_quantity_are_not_told_as_names():
    rng = np.random.default_rng(6)
    angle, x = np.tile([10.0, 30.0, 50.0], 20), rng.uniform(0.5, 2.0, 60)
    frame = pd.DataFrame({"x": x, "angle_deg": angle, "y": x * (1.0 + 3e-4 * angle**2)})
    frame["y"] += 0.02 * rng.standard_normal(60)
    for column, words in (("angle_deg", "at each value of angle_deg"), ("who", "for each who")):
        who = frame["angle_deg"].map({10.0: "Ada", 30.0: "Ben", 50.0: "Cy"})
        own = frame if column == "angle_deg" else frame.drop(columns="angle_deg").assign(who=who)
        headline = ssf.diagnose_table(own, "y ~ g*x", gain=False).summary().headline[0]
        assert headline == f"The law has other parameters {words}."


def saturate(x, top, half):
    return top * x / (half + x)


def enzyme(seed):
    rng = np.random.default_rng(seed)
    x = np.repeat([0.02, 0.06, 0.11, 0.22, 0.56, 1.1], 6)
    state = np.tile(["treated", "plain"], 18)
    y = np.where(state == "plain", saturate(x, 160.0, 0.05), saturate(x, 210.0, 0.06))
    return pd.DataFrame({"x": x, "who": state, "y": y + 7.0 * rng.standard_normal(36)})


def test_of_a_nonlinear_law_they_are_those_of_two_fits():
    frame = enzyme(3)
    found = sizes(ssf.diagnose_table(frame, "y ~ top*x/(half + x)", gain=False))
    of = {who: curve_fit(saturate, own["x"], own["y"], (200.0, 0.1))[0] for who, own in frame.groupby("who")}
    difference = of["plain"] - of["treated"]
    assert found["top"].estimate == pytest.approx(difference[0], rel=1e-3)
    assert found["half"].estimate == pytest.approx(difference[1], abs=1e-4)


def test_a_law_by_level_is_saved(tmp_path):
    frame = enzyme(3)
    fit = ssf.diagnose_table(frame, "y ~ top*x/(half + x)", gain=False).extended_law()
    fit.save(tmp_path / "law.json")
    again = ssf.load_table_fit(tmp_path / "law.json")
    pd.testing.assert_frame_equal(fit.predict(frame), again.predict(frame))
    with pytest.raises(
        ssf.InputError, match="column who, value 'Zoe': row 2: the law was fitted to treated, plain"
    ):
        fit.predict(frame.assign(who=["plain", "Zoe", *["plain"] * 34]))
    residual = frame["y"] - fit.predict(frame)["predicted"]
    for _, own in residual.groupby(frame["who"]):
        assert abs(own.mean()) < 2.0 * 7.0 / np.sqrt(len(own))


@pytest.mark.parametrize("version", [0, 1])
def test_derivatives_are_those_of_differences(version):
    frame = table(4)
    roles = TableRoles()
    rows = prepare_rows(frame, roles, ["x"])
    law = ssf.Law("y ~ a*exp(b*x/10)").bind_table(rows)
    (cause,) = (one for one in generic_causes(rows, law, roles) if one.name == "covariate:who")
    bound, trials = cause.trials(rows)[version]
    values = np.r_[[1.5, 0.8], trials.sum(axis=0)]
    extended = bound.extend(law)
    numeric = numeric_slopes(lambda values: extended.predict(rows, values), values)
    np.testing.assert_allclose(extended.jacobian(rows, values), numeric, rtol=1e-5, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "least"), [(4, 4), pytest.param(8, 7, marks=pytest.mark.nightly)])
def test_texts_that_do_nothing_are_not_named(number, least):
    seeds = range(10, 10 + number)
    verdicts = [ssf.diagnose_table(table(seed, n=60), LINE, gain=False).verdict for seed in seeds]
    assert verdicts.count("nothing wrong") >= least


@pytest.mark.nightly
def test_a_table_of_nothing_but_texts_is_explained_to_the_end():
    rng = np.random.default_rng(5)
    one, other = rng.integers(3, size=60), rng.integers(2, size=60)
    y = np.array([0.0, 1.0, -1.0])[one] + np.array([0.0, 0.8])[other] + 0.3 * rng.standard_normal(60)
    frame = pd.DataFrame(
        {"poison": np.array(["i", "ii", "iii"])[one], "treat": np.array(["A", "B"])[other], "y": y}
    )
    found = ssf.diagnose_table(frame, "y ~ mean")
    assert {finding.cause for finding in found.findings} == {"covariate:poison", "covariate:treat"}
    assert found.gain.extended < 0.4 * found.gain.baseline


def springs(sessions, stiffer=0.0, higher=0.0):
    """Some days of a spring, the last one with another stiffness or zero."""
    rng, day = np.random.default_rng(0), np.repeat(np.arange(1, sessions + 1), 20)
    x, last = rng.uniform(1.0, 30.0, len(day)), day == sessions
    force = (0.05 + stiffer * last) * x + 0.2 + higher * last + 0.01 * rng.standard_normal(len(day))
    return pd.DataFrame({"day": [f"d{one}" for one in day], "x": x, "F": force})


def named_in(frame, **options):
    (finding,) = ssf.diagnose_table(frame, "F ~ k*x + F0", session="day", shared="all", **options).findings
    return finding


def test_a_parameter_that_one_of_two_sessions_has_otherwise_is_that_of_least_squares():
    frame = springs(2, stiffer=0.005)
    finding = named_in(frame, gain=False)
    assert finding.cause == "parameters-by-session"
    (change,) = finding.parameters
    fit = smf.ols("F ~ x + x:C(day)", frame).fit()
    assert change.size.estimate == pytest.approx(fit.params["x:C(day)[T.d2]"], rel=1e-4)


@pytest.mark.slow
def test_one_of_several_sessions_with_another_parameter_is_told_and_saved(tmp_path):
    """As where one day a length is in another unit; an offset of each session errs by a fifth of that."""
    frame = springs(5, stiffer=0.45)
    diagnosis = ssf.diagnose_table(frame, "F ~ k*x + F0", session="day", shared="all")
    said = " ".join(str(diagnosis.summary()).split())
    assert "k is furthest from the mean of all in d5, by 0.360" in said
    assert diagnosis.gain.extended < 0.011 < 3.0 < diagnosis.gain.baseline
    fit = diagnosis.extended_law()
    fit.save(tmp_path / "law.json")
    restored = ssf.load_table_fit(tmp_path / "law.json").predict(frame)
    pd.testing.assert_frame_equal(restored, fit.predict(frame))
    tomorrow = ssf.load_table_fit(tmp_path / "law.json").predict(frame.head(1).assign(day="d6"))
    assert np.isfinite(tomorrow["predicted"]).all()


@pytest.mark.slow
def test_many_labels_have_other_parameters_as_in_a_mixed_model():
    """Of 24 labels with lines of their own, in noise whose size a mixed model estimates."""
    rng = np.random.default_rng(2)
    who, x = np.repeat(np.arange(24), 8), np.tile(np.arange(8.0), 24)
    a, b = 5.0 + rng.standard_normal(24), 1.0 + 0.4 * rng.standard_normal(24)
    y = a[who] + b[who] * x + 0.5 * rng.standard_normal(len(x))
    frame = pd.DataFrame({"x": x, "who": [f"w{k}" for k in who], "y": y})
    diagnosis = ssf.diagnose_table(frame, LINE)
    (finding,) = diagnosis.findings
    assert "other parameters for each who" in " ".join(str(diagnosis).split())
    mixed = smf.mixedlm("y ~ x", frame, groups="who", re_formula="~x").fit()
    assert diagnosis.gain.noise_floor == pytest.approx(np.sqrt(mixed.scale), rel=0.06)
    slopes = {one.name: one.size.estimate for one in finding.parameters if one.name.startswith("b[")}
    expected = {f"b[{who}]": effect["x"] for who, effect in mixed.random_effects.items()}
    assert set(slopes) == set(expected)
    assert [slopes[name] for name in expected] == pytest.approx(list(expected.values()), abs=0.08)


@pytest.mark.slow
def test_an_offset_of_one_session_is_no_other_parameter():
    assert named_in(springs(5, higher=0.05)).cause == "offset-by-session"


@pytest.mark.slow
def test_more_sessions_than_may_have_parameters_of_their_own_are_told():
    found = ssf.diagnose_table(springs(61), "F ~ k*x + F0", session="day", shared="all", gain=False)
    assert found.untestable["parameters-by-session"].startswith("the table has 61 sessions, and at most 60")
