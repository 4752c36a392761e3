"""Causes as formulas: in tables, against hand-written equations; in logs, against the library's own."""

import re

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit import InputError, Law
from stickslip_fit._function import NumericFunction
from stickslip_fit.causes import Drift, ThermalWarmUp, ThetaOffset, restore_formula_cause
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.laws import Elbow, Prismatic
from stickslip_fit.machine import published_load
from tests.differences import numeric_slopes
from tests.docs.commands import ROOT

BASE = np.array([2.0, 3.0, 0.5, 0.1])
MOTOR = "F ~ M*acc + Fv*vel + Fc*sign(vel) + offset"


@pytest.fixture(scope="module")
def frame():
    rng = np.random.default_rng(0)
    n = 240
    frame = pd.DataFrame({"acc": rng.normal(size=n), "vel": rng.normal(size=n), "t": np.arange(n) / 10})
    frame["ball"] = np.where(np.arange(n) % 3 == 0, "red", "blue")
    noise = 0.02 * rng.normal(size=n)
    return frame.assign(F=2 * frame.acc + 3 * frame.vel + 0.5 * np.sign(frame.vel) + 0.1 + noise)


@pytest.fixture(scope="module")
def law(frame):
    return Law(MOTOR).bind_table(frame)


def squares(vel, k):
    return k * vel**2


def motor(f, vel=None):
    vel = f.vel if vel is None else vel
    return 2 * f.acc + 3 * vel + 0.5 * np.sign(vel) + 0.1


TAU = {"tau": (5, 100)}
TABLE = {
    "term": (ssf.Cause("c", "+ d*abs(vel)", "d in N s/m"), [0.3], lambda f, d: motor(f) + d * abs(f.vel)),
    "function": (ssf.Cause("c", squares, "k"), [0.3], lambda f, k: motor(f) + k * f.vel**2),
    "factor": (
        ssf.Cause("c", "* (1 - A*expm1(-t/tau))", "tau in s, A in %", bounds=TAU),
        [0.03, 12.0],
        lambda f, A, tau: motor(f) * (1 + A * (1 - np.exp(-f.t / tau))),
    ),
    "column": (
        ssf.Cause("c", "vel = vel + d*acc", "d in s"), [0.02], lambda f, d: motor(f, f.vel + d * f.acc)
    ),
    "response and parameters": (
        ssf.Cause("c", "+ k*F*M", "k"), [0.2], lambda f, k: motor(f) * (1 + 2 * k)
    ),
    "two amplitudes": (
        ssf.Cause("c", "+ (a*t + b*t**2)*exp(-t/tau)", "tau in s, a, b", bounds=TAU),
        [0.1, 0.01, 12.0],
        lambda f, a, b, tau: motor(f) + (a * f.t + b * f.t**2) * np.exp(-f.t / tau),
    ),
    "nonlinear": (
        ssf.Cause("c", "+ exp(-k*t) - 1", "k", bounds={"k": (-0.1, 0.1)}),
        [0.03],
        lambda f, k: motor(f) + np.exp(-k * f.t) - 1,
    ),
    "by": (
        ssf.Cause("c", "+ k*t", "k", by="ball"),
        [0.2, -0.1],
        lambda f, blue, red: motor(f) + np.where(f.ball == "red", red, blue) * f.t,
    ),
    "nonlinear by": (
        ssf.Cause("c", "+ exp(-k*t) - 1", "k", by="ball", bounds={"k": (-0.1, 0.1)}),
        [0.03, -0.02],
        lambda f, blue, red: motor(f) + np.exp(-np.where(f.ball == "red", red, blue) * f.t) - 1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLE)
def test_a_cause_of_a_table_does_what_its_formula_says(law, frame, case):
    cause, values, by_hand = TABLE[case]
    bound = cause.bind_table(law, frame)
    extended, everything = bound.extend(law), np.concatenate([BASE, values])
    expected = by_hand(frame, *values)
    np.testing.assert_allclose(extended.predict(frame, everything), expected, rtol=1e-12, atol=1e-12)
    changes = bound.changes(law, frame, np.tile(BASE, (len(frame), 1)), np.array([values, bound.null_values]))
    np.testing.assert_allclose(changes, np.stack([expected - motor(frame), 0 * expected], axis=1), atol=1e-12)
    numerical = numeric_slopes(lambda values: extended.predict(frame, values), everything)
    np.testing.assert_allclose(extended.jacobian(frame, everything), numerical, rtol=1e-6, atol=1e-6)
    assert extended.n_shared == len(values)


@pytest.mark.parametrize("case", TABLE)
def test_trials_have_the_size_of_the_scatter(law, frame, case):
    bound = TABLE[case][0].bind_table(law, frame)
    versions = bound.trials(frame)
    for version, trials in versions:
        changes = version.changes(law, frame, np.tile(BASE, (len(frame), 1)), trials)
        assert trials.shape[1] == len(bound.parameters) == len(version.null_values)
        assert bound.combine_trials == (case in ("two amplitudes", "by", "nonlinear by"))
        if case == "column":
            assert (trials[:, 0] / trials[0, 0]).tolist() == [1.0, 10.0, -10.0]
            changes = changes[:, :1]
        if "nonlinear" not in case:
            acts = np.where(changes == 0, np.nan, changes)
            np.testing.assert_allclose(np.sqrt(np.nanmean(acts**2, axis=0)), 0.02, rtol=0.35)
    assert len(versions) == (9 if case == "two amplitudes" else 1)


def test_causes_of_a_table_act_one_after_the_other(law, frame):
    column = ssf.Cause("lag", "vel = vel + d*acc", "d").bind_table(law, frame)
    term = ssf.Cause("slip", "+ k*vel**2", "k").bind_table(law, frame)
    seen = ssf.Cause("seen", "+ s*F**2", "s").bind_table(law, frame)
    factor = ssf.Cause("gain", "* (1 + g*t)", "g").bind_table(law, frame)
    extended = factor.extend(term.extend(seen.extend(column.extend(law))))
    assert [one.name for one in extended.cause_parameters] == ["lag.d", "seen.s", "slip.k", "gain.g"]
    values = np.concatenate([BASE, [0.02, 0.03, 0.3, 0.01]])
    vel = frame.vel + 0.02 * frame.acc
    slipped = motor(frame, vel) + 0.3 * vel**2
    expected = (slipped + 0.03 * slipped**2) * (1 + 0.01 * frame.t)
    np.testing.assert_allclose(extended.predict(frame, values), expected, rtol=1e-12)
    numerical = numeric_slopes(lambda values: extended.predict(frame, values), values)
    np.testing.assert_allclose(extended.jacobian(frame, values), numerical, atol=1e-6)


def test_sizes_are_in_the_unit_of_the_parameter(law, frame):
    cause = ssf.Cause("c", "* (1 + A*t)", "A in %", size=2.0).bind_table(law, frame)
    assert cause.scale == (0.02,)
    cause = ssf.Cause("c", "+ k*t + m*t**2", "k in mm, m", size={"k": 2.0}).bind_table(law, frame)
    assert cause.scale[0] == 2.0
    assert cause.parameters[0].unit == "mm"


BAD = {
    "k*t": "what it does is not said; it begins with",
    "+ k*exp(": "cannot be read",
    "+ k*velo": "velo is no column.*did you mean vel",
    "+ k*M + M*t": "with its parameters at 0 it still has an effect",
    "* k*t": re.escape("'* (1 + k*x)' in place of '* k*x'"),
    "+ exp(k*t) - 1": "trials need bounds",
    "+ t": "its parameter k is never used",
    "+ t - k + k": "its parameter k cancels out",
    "steps + k": "a table has no steps",
    "t = t + k": "t is no column that the law .* uses",
    "acc = acc + k*F": "the response F is not known before the law",
    "+ k*log(t - 100)": "is no number in row 1",
}


@pytest.mark.parametrize("formula", BAD)
def test_a_cause_that_cannot_be_used_gets_one_message(law, frame, formula):
    with pytest.raises(InputError, match=BAD[formula]):
        ssf.Cause("c", formula, "k").bind_table(law, frame)


def test_more_causes_that_cannot_be_used(law, frame):
    for fields, message in (
        ({"parameters": "M"}, "M is also a column or a parameter of the law"),
        ({"parameters": "k, k"}, "declared twice"),
        ({"parameters": "k in"}, "cannot be read"),
        ({"parameters": "k", "bounds": {"k": (2, 1)}}, "a lower and a higher number"),
        ({"parameters": "k", "bounds": {"z": (1, 2)}}, "z is none of its parameters"),
        ({"parameters": "k", "size": 0}, "size must be a number other than 0"),
        ({"parameters": "k", "by": "vel"}, "the column vel has 240 values; by= takes at most 100"),
        ({"parameters": "k", "by": "bal"}, "bal is no column.*did you mean ball"),
    ):
        with pytest.raises(InputError, match=message):
            ssf.Cause("c", "+ M*t" if fields["parameters"] == "M" else "+ k*t", **fields).bind_table(
                law, frame
            )


def test_units_of_causes_are_checked_where_all_are_declared(frame):
    units = {"F": "N", "M": "kg", "acc": "m/s^2", "Fv": "N s/m", "vel": "m/s", "Fc": "N", "offset": "N"}
    law = Law(MOTOR, units=units).bind_table(frame)
    assert ssf.Cause("c", "+ d*abs(vel)", "d in N s/m").bind_table(law, frame)
    with pytest.raises(InputError, match=r"d \* abs\(vel\) is m N/s, F is N"):
        ssf.Cause("c", "+ d*abs(vel)", "d in N").bind_table(law, frame)


@pytest.fixture(scope="module")
def log():
    return ssf.read_log(ROOT / "data/reference")


MINUTES = {"tau": (1, 60)}
LOG = {
    "warm-up": (
        ssf.Cause("w", "* (1 - A*expm1(-session_seconds/tau))", "A in %, tau in min", bounds=MINUTES),
        ThermalWarmUp(), [0.02, 700.0],
    ),
    "drift": (ssf.Cause("d", "* (1 + k*session_seconds)", "k in %/h"), Drift(), [5e-6]),
    "tilt": (ssf.Cause("t", "theta = theta + delta", "delta in deg"), ThetaOffset(), [0.03]),
}  # fmt: skip


@pytest.mark.parametrize("case", LOG)
@pytest.mark.parametrize("joint", [2, 3])
def test_a_cause_of_a_log_does_what_the_librarys_own_does(log, case, joint):
    formula, own, values = LOG[case]
    law, base = (
        (Prismatic(), [1e-6, 0.3, 4e-8]) if joint == 3 else (Elbow(log.machine), [1e-4, 1e-4, 1e-6, 1e-6])
    )
    rows = log.rows[log.rows.joint == joint].iloc[:40]
    bound, own = formula.bind(log.rows, log.machine), own.bind(log.rows, log.machine)
    table, own_values = {name: rows[name].to_numpy() for name in rows}, np.tile(base, (len(rows), 1))
    trial = np.array([values])
    changes = bound.changes(law, table, own_values, trial)
    assert np.abs(changes).max() > 1e-5
    np.testing.assert_allclose(changes, own.changes(law, table, own_values, trial), rtol=1e-9, atol=1e-15)
    everything = np.hstack([own_values, np.tile(values, (len(rows), 1))])
    slopes = bound.extend(law).jacobian(table, everything)
    np.testing.assert_allclose(slopes, own.extend(law).jacobian(table, everything), rtol=1e-4, atol=1e-6)


def test_a_count_and_a_term_of_a_log(log):
    rows = log.rows[log.rows.joint == 3].iloc[:40]
    table, base = {name: rows[name].to_numpy() for name in rows}, np.tile([1e-6, 0.3, 4e-8], (len(rows), 1))
    law, steps = Prismatic(), np.exp(Prismatic().predict(rows, base[0]))
    count = ssf.Cause("L", "steps + L*direction", "L in steps").bind(log.rows, log.machine)
    sign = np.where(rows.direction == "+", 1, -1)
    expected = np.log(steps + 7 * sign) - np.log(steps)
    np.testing.assert_allclose(count.changes(law, table, base, np.array([[7.0]]))[:, 0], expected, rtol=1e-7)
    term = ssf.Cause("T", "+ k*load**2", "k in nm", joints=(3,)).bind(log.rows, log.machine)
    size = 0.012 / steps
    load = published_load(3, 0.0, rows.q2, rows.theta, rows.psi)
    expected = -np.log((size + 1e-8 * load**2) / size)
    np.testing.assert_allclose(term.changes(law, table, base, np.array([[1e-8]]))[:, 0], expected, atol=1e-9)


def test_a_cause_that_varies_along_the_traverse_is_integrated(log):
    rows = log.rows[log.rows.joint == 3].iloc[:4]
    table, base = {name: rows[name].to_numpy() for name in rows}, np.tile([1e-6, 0.3, 4e-8], (len(rows), 1))
    cause = ssf.Cause("p", "* (1 + k*q/0.012)", "k in %", joints=(3,)).bind(log.rows, log.machine)
    assert cause.varies_along_traverse
    changes = cause.changes(Prismatic(), table, base, np.array([[0.1]]))
    np.testing.assert_allclose(changes, np.log(np.log1p(0.1) / 0.1), rtol=1e-9)


def test_causes_of_a_log_that_cannot_be_used(log):
    for formula, parameters, message in (
        ("* (1 + k*humdity)", "k in %", "did you mean humidity"),
        ("* (1 + k*humidity)", "k in furlong", "the unit 'furlong' of k is not known"),
        ("* k", "k", "it still has an effect"),
        ("foo = q + k", "k in nm", "foo is nothing that the log has"),
        ("* (1 + k*steps)", "k in %", "steps is neither in the log nor a parameter"),
        ("* (1 + A*exp(-session_seconds/tau))", "A, tau in min", "trials need bounds"),
    ):
        with pytest.raises(InputError, match=message):
            ssf.Cause("c", formula, parameters).bind(log.rows, log.machine)


def test_causes_are_described_and_restored():
    cause = ssf.Cause("w", "* (1 - A*expm1(-t/tau))", "A in %, tau in s", bounds=TAU, size=2, by="ball")
    again = restore_formula_cause(cause.describe())
    assert (again.declared, again.text, again.by, again.size) == (cause.declared, cause.text, "ball", 2)
    with pytest.raises(InputError, match="cannot be saved"):
        ssf.Cause("c", lambda t, k: k * t, "k").describe()


def test_a_law_with_causes_of_formulas_is_saved_and_loaded(log):
    import json

    bound = [
        LOG["warm-up"][0].bind(log.rows, log.machine),
        ssf.Cause("d", "steps + L", "L in steps", by="direction").bind(log.rows, log.machine),
    ]
    law = bound[1].extend(bound[0].extend(Prismatic()))
    again = ssf.causes.restore(json.loads(json.dumps(ssf.causes.describe(law))), log.machine)
    assert [one.name for one in again.parameters] == [one.name for one in law.parameters]
    rows = log.rows[log.rows.joint == 3].iloc[:20]
    values = np.array([1e-6, 0.3, 4e-8, 0.02, 600.0, 3.0, -5.0])
    np.testing.assert_array_equal(again.predict(rows, values), law.predict(rows, values))
    cause = ssf.Cause("c", squares, "k")
    assert restore_formula_cause(cause.describe(), {cause.describe()["function"]: squares}).formula is squares


@pytest.mark.parametrize("size", [None, 0.005, 5.0])
def test_a_cause_is_found_whatever_size_is_said_to_matter(size):
    rng = np.random.default_rng(2)
    x, z = rng.normal(size=(2, 300))
    noise, run = 0.1 * rng.normal(size=300), np.repeat(["a", "b"], 150)
    response = 2 * (x + 0.05 * z) + (x + 0.05 * z) ** 2 + 0.5 * z + noise
    frame = pd.DataFrame({"x": x, "z": z, "F": response, "run": run})
    causes = [
        ssf.Cause("cross", "x = x + d*z", "d", size=size),
        ssf.Cause("cube", "+ k*x**3", "k", size=size),
        ssf.Cause("gain", "* (1 + g*z)", "g in %", size=size),
    ]
    law = Law("F ~ a*x + b*x**2 + c*z")
    diagnosis = ssf.diagnose_table(frame, law, session="run", causes=causes, gain=False)
    (finding,) = diagnosis.findings
    assert finding.cause == "cross"
    size = finding.parameters[0].size
    assert size.low < 0.05 < size.high


def test_a_formula_is_a_candidate_of_a_diagnosis_beside_the_librarys():
    log = ssf.read_log("tests/golden/log.csv")
    cable = ssf.Cause("cable", "* (1 + k*sin(theta))", "k in %", phrase="a cable pulls as the base turns")
    problem, missing = problem_from_log(log, causes=(*ssf.causes.library(), cable))
    assert "cable" in {cause.name for cause in problem.causes}
    assert "cable" not in missing


def relaxation(t, rate):
    """(1 - exp(-rate t)) / rate - t, which without a rate is 0 / 0, and then is none."""
    return (1.0 - np.exp(-rate * t)) / rate - t


@pytest.mark.parametrize("formula", [relaxation, "+ (1 - exp(-rate*t))/rate - t"])
def test_a_formula_that_is_0_by_0_without_its_parameter_has_its_limit_there(formula, frame, law):
    bound = ssf.Cause("relaxation", formula, "rate in 1/s", bounds={"rate": (0, 2)}).bind_table(law, frame)
    extended = bound.extend(law)
    values = np.append(BASE, 0.0)
    predicted, slopes = extended.model(frame)(values)
    size = float(np.abs(extended.predict(frame, np.append(BASE, 1.0)) - law.predict(frame, BASE)).max())
    np.testing.assert_allclose(predicted, law.predict(frame, BASE), atol=1e-5 * size)
    np.testing.assert_allclose(slopes[:, -1], -(frame["t"] ** 2) / 2, rtol=0.02, atol=0.1)  # by its series


def test_a_formula_that_has_no_limit_without_its_parameter_is_refused(frame, law):
    cause = ssf.Cause("pole", "+ exp(-t)/rate", "rate in 1/s", bounds={"rate": (0, 2)})
    with pytest.raises(InputError, match="with its parameters at 0 it still has an effect"):
        cause.bind_table(law, frame)


def test_a_fit_that_reaches_0_leaves_it_again():
    """Below 1e-6 the function is its limit, without a derivative: a fit from 0 would stay there."""

    def guarded(x, k):
        return np.where(np.abs(k) < 1e-6, 0.0, np.expm1(k * x))

    x, k = np.array([0.5, 1.0, 0.5, 1.0]), np.array([0.0, 0.0, 0.02, 0.02])  # of two balls
    slopes = NumericFunction(guarded).function(("k",))({"x": x, "k": k})[1][:, 0]
    np.testing.assert_allclose(slopes, x * np.exp(k * x), rtol=1e-4)


@pytest.mark.parametrize("formula", ["+ a*vel**2", "+ a*F**2", "+ a*expm1(0.1*acc)*M", "* (1 + a*vel)"])
@pytest.mark.parametrize("other", [None, "+ b*acc**2", "+ b*F**2", "* (1 + b*acc)"])
def test_changes_are_those_of_the_extended_law(formula, other, frame, law):
    """However the formula is evaluated, and whatever is in the law besides."""
    cause, values = ssf.Cause("tried", formula, "a in 1").bind_table(law, frame), BASE
    known = law
    if other is not None:
        known, values = ssf.Cause("known", other, "b in 1").bind_table(law, frame).extend(law), [*BASE, 0.02]
    each = np.tile(values, (len(frame), 1))
    (change,) = cause.changes(known, frame, each, np.array([[0.03]])).T
    whole = cause.extend(known).predict(frame, np.append(values, 0.03)) - known.predict(frame, each)
    np.testing.assert_allclose(change, whole, rtol=1e-9, atol=1e-12)
