"""Laws of tables: formulas and functions, start values, and one message for each law that cannot be used."""

import re

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit import InputError, Law
from stickslip_fit.estimation.table_law import fit_table_law, minimize_table_law
from stickslip_fit.laws import restore_formula_law
from stickslip_fit.units import from_si

MOTOR = "F ~ M*acc + Fv*vel + Fc*sign(vel) + offset"
UNITS = {"F": "N", "M": "kg", "acc": "m/s^2", "Fv": "N s/m", "vel": "m/s", "Fc": "N", "offset": "N"}
TRUE = {"M": 2.0, "Fv": 3.0, "Fc": 0.5, "offset": 0.1}


def friction(acc, vel, M, Fv, Fc, offset):
    return M * acc + Fv * vel + Fc * np.sign(vel) + offset


def sigmoid(x, height, width):
    return height * np.abs(np.tanh(x / width))


def raises(x, a):
    raise ZeroDivisionError("the motor is off")


def shortens(x, a):
    return (a * x)[:3]


def units(names, **others):
    return {name: UNITS[name] for name in names.split()} | others


@pytest.fixture
def frame():
    rng = np.random.default_rng(1)
    n = 80
    frame = pd.DataFrame({"acc": rng.normal(size=n), "vel": rng.normal(size=n)})
    frame["F"] = friction(frame.acc, frame.vel, **TRUE)
    frame["run"] = np.repeat(["one", "two"], n // 2)
    frame["T"] = np.where(frame.run == "one", 20.0, 21.0)
    return frame.assign(vel2=2 * frame.vel, t=np.arange(n) / 10, label="x", negative=-1.0)


@pytest.mark.parametrize("formula", [MOTOR, friction], ids=["formula", "function"])
def test_a_linear_law_needs_no_start_values(frame, formula):
    law = Law(formula, units=UNITS, response="" if isinstance(formula, str) else "F").bind_table(frame)
    y, rounding = law.response(frame)
    assert (law.response_name, law.response_unit, law.n_shared) == ("F", "N", 0)
    assert law.parameter_names == ("M", "Fv", "Fc", "offset")
    np.testing.assert_allclose(law.start_values(frame, y), list(TRUE.values()), rtol=1e-12)
    assert not rounding.any()
    values = np.tile([1.0, 2.0, 3.0, 4.0], (len(frame), 1))
    by_hand = np.stack([frame.acc, frame.vel, np.sign(frame.vel), np.ones(len(frame))], axis=1)
    np.testing.assert_allclose(law.jacobian(frame, values), by_hand, rtol=1e-12)
    np.testing.assert_allclose(
        law.predict(frame, values), friction(frame.acc, frame.vel, 1, 2, 3, 4), rtol=1e-12
    )


def test_units_of_a_table_are_shown_as_they_are(frame):
    law = Law("F ~ a*vel + b", units={"a": "mm", "b": "furlong"}).bind_table(frame)
    assert [parameter.unit for parameter in law.parameters] == ["mm", "furlong"]
    assert from_si(3.0, law.parameters[0].unit) == 3.0


def test_what_is_shared_comes_last_and_has_one_value(frame):
    shifted = frame.assign(F=frame.F + 0.4 * (frame.run == "two"), session=frame.run)
    law = Law(MOTOR, shared=["M", "Fv", "Fc"]).bind_table(shifted, session="run")
    assert (law.parameter_names, law.n_shared) == (("offset", "M", "Fv", "Fc"), 3)
    y = law.response(shifted)[0]
    values = fit_table_law(law, shifted, y, np.full(len(y), 0.1))
    expected = np.column_stack(
        [np.where(shifted.run == "one", 0.1, 0.5), *(np.full(len(y), x) for x in (2, 3, 0.5))]
    )
    np.testing.assert_allclose(values, expected, rtol=1e-9)


def test_a_nonlinear_law_is_fitted_from_its_bounds(frame):
    frame = frame.assign(F=3.0 * (1 - np.exp(-frame.t / 1.7)) + 0.2)
    law = Law("F ~ A*(1 - exp(-t/tau)) + c", bounds={"tau": (0.1, 1000)}).bind_table(frame)
    fit = minimize_table_law(law, frame, law.response(frame)[0], np.full(len(frame), 0.01))
    assert fit.converged.all()
    np.testing.assert_allclose(fit.values[0], [3.0, 1.7, 0.2], rtol=1e-6)


UNBOUNDED = {
    "decay": ("A*exp(-t/tau) + c", (2.0, 0.3, 1.0)),
    "peak": ("A/(1 + ((t - t0)/w)**2) + c", (2.0, 0.35, 0.05, 0.3)),
    "step": ("low + A/(1 + exp(-(t - t0)/w))", (1.0, 3.0, 0.55, 0.06)),
    "wave": ("c + A*exp(-t/tau)*sin(2*pi*f*t + phi)", (1.0, 2.0, 0.6, 8.0, 0.7)),
}


@pytest.mark.parametrize(
    ("case", "unit"),
    [
        pytest.param("wave", 1e-6, marks=pytest.mark.slow),
        *((case, unit) for case in ("decay", "peak", "step") for unit in (1e-6, 1.0, 1e4)),
    ],
)
def test_a_nonlinear_law_is_fitted_without_start_values_or_bounds_in_any_unit(case, unit):
    formula, true = UNBOUNDED[case]
    t, known = np.linspace(0.01, 1.0, 100), {"pi": np.pi, "exp": np.exp, "sin": np.sin}
    law = Law(f"y ~ {formula}")
    names = [name for name in law.names if name != "t"]
    by_name = dict(zip(names, true, strict=True))
    exact = eval(formula, known | by_name | {"t": t})
    y = exact + 0.02 * exact.std() * np.random.default_rng(2).standard_normal(len(t))
    frame = pd.DataFrame({"t": t * unit, "y": y})
    bound = law.bind_table(frame)
    found = bound.predict(frame, fit_table_law(bound, frame, y, np.ones(len(t))))
    assert np.sum((y - found) ** 2) <= np.sum((y - exact) ** 2)


@pytest.mark.slow
def test_every_session_of_many_has_the_least_squares_of_its_own():
    t, rng = np.linspace(0.0, 5e-4, 15), np.random.default_rng(3)
    taus = rng.uniform(5e-5, 2e-4, 30)
    y = np.concatenate([2.0 * np.exp(-t / tau) + 0.5 for tau in taus]) + 0.005 * rng.standard_normal(450)
    frame = pd.DataFrame({"t": np.tile(t, 30), "y": y, "run": np.repeat(np.arange(30), 15)})
    frame["session"] = frame["run"]
    law = Law("y ~ A*exp(-t/tau) + c").bind_table(frame, session="run")
    values = fit_table_law(law, frame, y, np.ones(450))[::15]
    tau = values[:, law.parameter_names.index("tau")]
    np.testing.assert_allclose(tau, taus, rtol=0.1)


def test_derivatives_of_a_function_fall_back_on_differences(frame):
    law = Law(sigmoid, response="F", start={"width": 0.5})
    bound = law.bind_table(frame.rename(columns={"t": "x"}).assign(x=lambda rows: rows.x - 3))
    rows = pd.DataFrame({"x": np.array([-2.0, -0.3, 0.5, 1.0]), "F": 0.0})
    slopes = bound.jacobian(rows, np.array([2.0, 0.8]))
    z = rows.x / 0.8
    np.testing.assert_allclose(slopes[:, 0], np.abs(np.tanh(z)), rtol=1e-8)
    np.testing.assert_allclose(slopes[:, 1], -2 * np.sign(z) * z / 0.8 / np.cosh(z) ** 2, rtol=1e-6)


def test_the_left_side_may_be_an_expression(frame):
    frame = frame.assign(F=np.exp(0.3 + 0.2 * frame.vel))
    law = Law("log(F) ~ a + b*vel").bind_table(frame)
    assert law.response_name == "log(F)"
    np.testing.assert_allclose(law.start_values(frame, law.response(frame)[0]), [0.3, 0.2], rtol=1e-10)


def test_columns_of_any_name(frame):
    frame = frame.rename(columns={"vel": "vel (m/s)"})
    law = Law('F ~ a*Q("vel (m/s)") + b').bind_table(frame)
    assert law.columns == ("vel (m/s)", "F")
    assert np.isfinite(law.start_values(frame, law.response(frame)[0])).all()


def test_laws_are_described_and_restored():
    law = Law(MOTOR, units=UNITS, bounds={"M": (0, None)}, start={"Fc": 1}, shared=["M"], name="motor")
    again = restore_formula_law(law.describe())
    assert (again.text, again.describe()) == (law.text, law.describe())
    with pytest.raises(InputError, match=r"cannot be saved: .* into a file of its own"):
        Law(lambda x, a: a * x, response="y").describe()
    function = Law(ssf.laws.traverse_length, response="y")
    description = function.describe()
    assert restore_formula_law(description, {description["function"]: friction}).formula is friction
    with pytest.raises(InputError, match="no code is run because a file names it"):
        restore_formula_law(description)


BAD = {
    "unknown column": (dict(formula="F ~ a*acceleration", units={"a": "kg"}), "has acceleration.*mean acc"),
    "unknown response": (dict(formula="G ~ a*acc"), "has G, which is no column"),
    "never used": (dict(formula="F ~ a*acc", start={"mass": 1.0}), "mass is declared and never used"),
    "cancels": (dict(formula="F ~ a*acc + b - b"), "b cancels out"),
    "column as parameter": (dict(formula="F ~ a*acc", bounds={"acc": (0, 1)}), "acc is a column"),
    "both sides": (dict(formula="F ~ a*F"), "F stands on both sides"),
    "product": (dict(formula="F ~ M*accel*acc"), "M and accel occur only as a product.*did you mean acc"),
    "no column": (dict(formula="F ~ M*zeit"), "Names that are no column are parameters, here M and zeit"),
    "ratio": (dict(formula="F ~ a*vel/b"), "a and b occur only as a ratio"),
    "sum": (dict(formula="F ~ M*vel + Fv*vel2 + c"), re.escape("only M + 2*Fv is determined")),
    "two sums": (dict(formula="F ~ a*(vel + acc) + b*vel + c*acc"), "only .* and .* are determined"),
    "other": (dict(formula="F ~ a*exp(b + c*vel)"), "a change of (a and b|b and a) together"),
    "no effect": (dict(formula="F ~ a*step(vel - 100) + b"), "a has no effect on any row"),
    "units": (dict(formula="F ~ M*acc", units=units("M acc", F="V")), "M \\* acc is kg m/s\\^2, F is V"),
    "factor": (dict(formula="F ~ M*acc", units=units("M acc", F="mN")), "factor of 1000; .*0.001 \\* in"),
    "degrees": (dict(formula="F ~ Fc*sin(vel)", units=units("F Fc", vel="deg")), "takes rad.*; .*0.01745"),
    "sums": (dict(formula="F ~ Fc*abs(acc + vel)", units=units("F Fc acc vel")), "vel is m/s, acc is"),
    "exponent": (dict(formula="F ~ Fc*exp(-t/tau)", units=units("F Fc", t="s", tau="min")), "tau is s/min"),
    "not finite": (dict(formula="F ~ a*log(vel)"), "first in row \\d+ of the table \\(vel = -.*a = "),
    "response not finite": (dict(formula="log(negative) ~ a*vel"), "log\\(negative\\) is no number in row 1"),
    "not numbers": (dict(formula="F ~ a*label"), "column label: is not of numbers"),
    "no parameters": (dict(formula="F ~ 2*vel"), "has no parameters"),
    "raises": (dict(formula=raises, response="negative"), "raises raised .*Error: the motor is off"),
    "wrong shape": (dict(formula=shortens, response="negative"), "returned shape \\(3,\\)"),
    "no response": (dict(formula=friction), "give response="),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_law_that_cannot_be_used_gets_one_message(frame, case):
    fields, message = BAD[case]
    frame = frame.assign(x=frame.vel)
    with pytest.raises(InputError, match=message):
        Law(**fields).bind_table(frame)


def test_a_number_with_decimals_converts_units_and_a_count_has_none(frame):
    degrees = Law("F ~ Fc*sin(0.0174533*vel)", units=units("Fc", F="1", vel="deg") | {"Fc": "1"})
    bound = degrees.bind_table(frame)
    assert (bound.response_unit, bound.parameters[0].unit) == ("", "")


def test_what_is_the_same_within_every_session_is_told_apart_only_if_shared(frame):
    with pytest.raises(InputError, match=re.escape("within each session: only c + 20*k is determined")):
        Law("F ~ a*vel + k*T + c").bind_table(frame, session="run")
    with pytest.raises(InputError, match="within each session"):
        Law("F ~ a*vel + k*T + c", shared=["k"]).bind_table(frame, session="run")
    assert Law("F ~ a*vel + k*T + c", shared=["k", "c"]).bind_table(frame, session="run").n_shared == 2
    assert Law("F ~ a*vel + k*T + c").bind_table(frame).n_shared == 0


@pytest.mark.parametrize(
    "column",
    [
        pd.Series([1, None, 3], dtype="Float64"),
        pd.Series([True, False, True]),
        pd.Series(["1", "2", "3"]),
        pd.Series(pd.to_datetime(["2026-01-01"] * 3)),
        pd.Series([1j, 2j, 3j]),
    ],
    ids=["nullable", "bool", "text", "times", "complex"],
)
def test_columns_of_any_type_are_numbers_or_refused(column):
    frame = pd.DataFrame({"x": column, "y": [1.0, 2.0, 4.0]})
    if column.dtype == bool:
        assert Law("y ~ a + b*x").bind_table(frame).predict(frame, np.array([1.0, 2.0])).tolist() == [3, 1, 3]
    else:
        with pytest.raises(InputError, match=r"column x: (is not of numbers|1 of 3 rows)"):
            Law("y ~ a + b*x").bind_table(frame)


def test_empty_cells_are_counted_and_placed(frame):
    frame.loc[[3, 9], "vel"] = np.nan
    with pytest.raises(InputError, match="column vel: 2 of 80 rows have no number here, first row 4"):
        Law(MOTOR).bind_table(frame)


def test_all_faults_of_names_come_at_once(frame):
    with pytest.raises(InputError) as caught:
        Law("G ~ a*acceleration", units={"a": "kg"}, start={"mass": 1}).bind_table(frame)
    assert len(caught.value.problems) == 3


@pytest.mark.parametrize(
    "fields", [{"bounds": {"a": (2, 1)}}, {"bounds": {"a": 3}}, {"start": {"a": "x"}}, {"units": 3}]
)
def test_faulty_declarations_are_refused_at_once(fields):
    with pytest.raises(InputError):
        Law("F ~ a*x", **fields)


def test_units_that_are_not_known_are_not_checked(frame):
    law = Law("F ~ M*acc", units={"F": "quanta", "M": "kg", "acc": "m/s^2"}).bind_table(frame)
    assert law.parameters[0].unit == "kg"
    assert Law("F ~ h - 9.81/2*t**2*k", units={"F": "m", "h": "m", "t": "s", "k": "1"}).bind_table(frame)
