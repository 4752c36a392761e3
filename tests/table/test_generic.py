"""The generic causes: each adds what it says, has exact derivatives, and is there where its columns are."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles, generic_causes, prepare_rows
from tests.differences import numeric_slopes
from tests.table.signals import LAW, ROLES, signal

ALWAYS = {"outliers"}
BY_TIME = {"drift", "warm-up", "sudden-change"}
BY_PLACE = {"position", "periodic-in-position"}
COVARIATE = {"covariate:temp"}


def prepared(shared=(), **roles):
    frame = signal(np.random.default_rng(6), "white", 2, 40)
    rows = prepare_rows(frame, TableRoles(**roles))
    law = ssf.Law(LAW, shared=shared).bind_table(rows, session=roles.get("session"))
    return rows, law, {one.name: one for one in generic_causes(rows, law, TableRoles(**roles))}


EVERY = sorted(prepared(shared="all", **ROLES)[2])


@pytest.mark.parametrize(
    ("roles", "names"),
    [
        ({}, ALWAYS | {f"covariate:{column}" for column in ("temp", "t", "q", "way", "run")}),
        (
            {"time": "t", "position": "q", "session": "run"},
            ALWAYS | BY_TIME | BY_PLACE | COVARIATE | {"covariate:way"},
        ),
        (
            ROLES,
            ALWAYS
            | {"offset-by-direction"}
            | {name + end for name in BY_TIME | BY_PLACE | COVARIATE for end in ("", "-by-direction")},
        ),
    ],
)
def test_a_cause_is_there_where_its_columns_are(roles, names):
    assert set(prepared(**roles)[2]) == names


def test_sessions_may_differ_where_parameters_are_shared():
    assert "offset-by-session" in prepared(shared="all", **ROLES)[2]
    assert "offset-by-session" not in prepared(**ROLES)[2]


@pytest.mark.parametrize("name", [name for name in EVERY if name != "outliers"])
def test_a_law_with_a_cause_has_exact_derivatives_and_none_without_effect(name):
    rows, law, causes = prepared(shared="all", **ROLES)
    cause = causes[name]
    version, trials = cause.trials(rows)[0]
    extended, p = version.extend(law), len(law.parameters)
    own = np.broadcast_to(law.start_values(rows, law.response(rows)[0]), (len(rows), p))

    def predict(values):
        return extended.predict(rows, np.hstack([own, np.tile(values, (len(rows), 1))]))

    assert len(extended.parameters) == p + trials.shape[1]
    np.testing.assert_allclose(predict(np.array(version.null_values)), law.predict(rows, own))
    trial = trials[len(trials) // 2]
    np.testing.assert_allclose(
        version.changes(law, rows, own, trial[None])[:, 0],
        predict(trial) - law.predict(rows, own),
        atol=1e-12,
    )
    slopes = extended.jacobian(rows, np.hstack([own, np.tile(trial, (len(rows), 1))]))[:, p:]
    steady = [not parameter.sudden for parameter in version.parameters]
    numeric = numeric_slopes(predict, trial, 1e-6 * np.array(version.scale))
    np.testing.assert_allclose(slopes[:, steady], numeric[:, steady], rtol=1e-5, atol=1e-8)


def test_an_effect_by_direction_has_the_opposite_sign_in_either():
    rows, law, causes = prepared(**ROLES)
    own = np.zeros((len(rows), len(law.parameters)))
    for name in ("drift", "position", "covariate:temp"):
        _, trials = causes[name].trials(rows)[0]
        plain, signed = (
            causes[one].changes(law, rows, own, trials) for one in (name, f"{name}-by-direction")
        )
        np.testing.assert_allclose(signed, rows["way"].to_numpy()[:, None] * plain)


def test_every_cause_says_what_it_is():
    for cause in prepared(shared="all", **ROLES)[2].values():
        for text in (cause.phrase, cause.physics, cause.shows_best):
            assert text
            assert text[0].islower() == (text is not cause.physics)
        assert all(parameter.meaning for parameter in cause.parameters)


def test_columns_that_cannot_be_followed_are_explained():
    frame = signal(np.random.default_rng(6), "white", 2, 40)
    frame = frame.assign(
        batch=np.where(frame["run"] == "r0", 1.0, 2.0),
        gaps=np.where(np.arange(80) % 9, 1.0, np.nan),
        same=4.0,
        who="me",
        note=[f"row {k}" for k in range(80)],
    )
    untestable = ssf.diagnose_table(frame, LAW, session="run", gain=False).untestable
    assert "same within every session" in untestable["covariate:batch"]
    assert "9 of its cells are empty" in untestable["covariate:gaps"]
    assert "the same in every row" in untestable["covariate:same"]
    assert "the same in every row" in untestable["covariate:who"]
    assert "80 different texts in 80 rows" in untestable["covariate:note"]


@pytest.mark.parametrize(("law", "usable"), [("y ~ a + b*x", False), ("y ~ A*exp(-x/tau)", True)])
def test_what_is_the_same_in_a_session_can_be_followed_where_its_parameters_do_not_absorb_it(law, usable):
    x = np.tile(np.linspace(0.0, 3.0, 30), 2)
    frame = pd.DataFrame({"run": np.repeat(["a", "b"], 30), "x": x, "volts": np.repeat([5.0, 9.0], 30)})
    frame["y"] = frame["volts"] * np.exp(-x) + 0.01 * np.random.default_rng(0).standard_normal(60)
    roles = TableRoles(session="run")
    rows = prepare_rows(frame, roles)
    names = {one.name for one in generic_causes(rows, ssf.Law(law).bind_table(rows), roles)}
    assert ("covariate:volts" in names) == usable


@pytest.mark.slow
def test_a_change_in_a_table_without_sessions_is_told_in_the_unit_of_its_time():
    """The Nile's annual flow fell by about 248 (1e8 m³) after 1898 (G. W. Cobb, Biometrika 65:243, 1978)."""
    from statsmodels.datasets import nile

    flow = nile.load_pandas().data
    law = ssf.Law("volume ~ a", units={"volume": "1e8 m³", "a": "1e8 m³", "year": "years"})
    found = ssf.diagnose_table(flow, law, time="year", gain=False)
    text = "The response falls by 248 1e8 m³, 27.5 years after the first row, and stays so"
    assert found.summary().headline[0].startswith(text)
    (moment,) = (one.size for one in found.findings[0].parameters if one.name == "moment")
    assert 24 < moment.low < 27 < 28 < moment.high < 32  # the posterior is within 1896 to 1902
    by_order = ssf.diagnose_table(flow, law, time="order", gain=False).summary().headline[0]
    assert "27.5 rows after the first row" in by_order


@pytest.mark.slow
@pytest.mark.parametrize(
    ("roles", "cause"), [({}, "covariate:place"), ({"position": "place"}, "unknown")], ids=["column", "place"]
)
def test_a_narrow_peak_along_a_column_is_in_the_law(roles, cause, tmp_path):
    """A polynomial that bends as sharply swings between the rows."""
    rng = np.random.default_rng(3)

    def table():
        x, place = rng.uniform(-1.0, 1.0, (2, 150))
        y = 1.0 + 2.0 * x + 0.5 * np.exp(-(((place - 0.2) / 0.15) ** 2))
        return pd.DataFrame({"x": x, "place": place, "y": y}), 0.05 * rng.standard_normal(150)

    frame, noise = table()
    found = ssf.diagnose_table(frame.assign(y=frame["y"] + noise), "y ~ a + b*x", gain=False, **roles)
    assert [one.cause for one in found.findings] == [cause]
    found.extended_law().save(tmp_path / "law.json")
    fresh, _ = table()
    predicted = ssf.load_table_fit(tmp_path / "law.json").predict(fresh)["predicted"]
    assert np.sqrt(np.mean((predicted - fresh["y"]) ** 2)) < 0.6 * 0.05


@pytest.mark.slow
def test_a_column_without_a_name_that_numbers_the_rows_is_no_candidate(tmp_path):
    """As R and pandas write it before all others; rows may well stand in the order of their values."""
    x = np.linspace(0.0, 1.0, 60)
    frame = pd.DataFrame({"x": x, "y": x + x**2 + 0.02 * np.random.default_rng(4).standard_normal(60)})
    frame.to_csv(tmp_path / "table.csv")
    for table in (tmp_path / "table.csv", pd.read_csv(tmp_path / "table.csv")):
        found = ssf.diagnose_table(table, "y ~ a + b*x", gain=False)
        assert [(one.cause, one.carrier) for one in found.findings] == [("unknown", "x")]
        assert any("numbers the rows" in reason for reason in found.untestable.values())


def test_levels_that_are_tried_at_once_change_what_each_trial_alone_does():
    """Also in a row whose label has no parameters, and of trials that differ in some levels alone."""
    rng = np.random.default_rng(5)
    frame = pd.DataFrame({"x": rng.uniform(1.0, 2.0, 30), "ball": np.tile(["a", "b", "c"], 10)})
    frame["y"] = 1.0 + frame["x"]
    law = ssf.Law("y ~ u + v*x").bind_table(frame, session=None)
    decay = ssf.Cause("decay", "+ p*exp(-x/tau)", "p, tau", by="ball", bounds={"tau": (0.1, 3.0)})
    cause = decay.bind_table(law, frame)
    rows = frame.assign(ball=frame["ball"].where(frame.index != 4, "d"))
    values, null = np.tile([1.0, 1.0], (30, 1)), np.array(cause.null_values)
    trials = np.stack([null, null, *(null + rng.uniform(0.1, 1.0, (4, len(null))))])
    trials[1, 0], trials[3, 1], trials[4, [0, 3]] = 0.5, null[1], trials[5, [0, 3]]
    changes = cause.changes(law, rows, values, trials)
    extended, before = cause.extend(law), law.predict(rows, values)
    for trial, change in zip(trials, changes.T, strict=True):
        alone = extended.predict(rows, np.hstack([values, np.tile(trial, (30, 1))])) - before
        np.testing.assert_allclose(change, alone, atol=1e-12)
    assert np.ptp(changes[0]) > 0
    assert not changes[4].any()


def jump(n=120, at=80):
    rng = np.random.default_rng(1)
    x = rng.choice([10.0, 20.0, 50.0], n)
    y = 2.0 + x + 1.0 * (np.arange(n) >= at) + 0.4 * rng.standard_normal(n)
    return pd.DataFrame({"x": x, "y": y})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "time"),
    [
        pytest.param(lambda rows: np.arange(1, 121), "order", marks=pytest.mark.nightly),
        # A number was left out.
        pytest.param(lambda rows: np.arange(120) + (np.arange(120) > 50), "order", marks=pytest.mark.nightly),
        (lambda rows: 100.0 - rows["t"] / 60.0, "t"),
    ],
    ids=["row number", "a number left out", "the time in another unit"],
)
def test_a_column_that_is_the_time_takes_no_evidence_from_it(column, time):
    rows = jump().assign(t=np.cumsum(np.random.default_rng(2).uniform(5.0, 9.0, 120)))
    rows = rows.assign(no=column(rows)) if time == "t" else rows.drop(columns="t").assign(no=column(rows))
    found, alone = (
        ssf.diagnose_table(frame, "y ~ a + x", time=time, gain=False)
        for frame in (rows, rows.drop(columns="no"))
    )
    assert found.findings[0].cause == "sudden-change"
    assert found.inclusion["sudden-change"] == alone.inclusion["sudden-change"] > 0.9
    assert "no cause of its own" in found.untestable["covariate:no"]


def test_without_a_time_a_column_that_numbers_the_rows_is_a_column_like_others():
    rows = jump()
    found = ssf.diagnose_table(rows.assign(no=np.arange(120)), "y ~ a + x", gain=False)
    assert [one.cause for one in found.findings] == ["covariate:no"]


@pytest.mark.slow
def test_a_constant_is_ahead_of_a_change_after_few_rows_and_every_likely_cause_is_told():
    """A background that the law of a decay lacks; a change 70 s after the first row fits as well."""
    rng, t = np.random.default_rng(2), 20.0 * np.arange(90)
    counts = (8400.0 * np.exp(-t / 220.0) + 120.0 + 30.0 * rng.standard_normal(90)).round()
    frame = pd.DataFrame({"t_s": t, "counts": counts})
    found = ssf.diagnose_table(frame, "counts ~ N0*exp(-t_s/tau)", time="t_s", gain=False)
    (finding,) = found.findings
    assert finding.cause_set == ("offset", "sudden-change", "warm-up")
    likely = {cause for cause in finding.cause_set if found.inclusion[cause] > 0.05}
    assert likely == set(finding.cause_set)
    said = " ".join(str(found).split("If it is the first")[0].split())
    assert all(f"({cause})" in said for cause in likely)
