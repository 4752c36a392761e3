"""Names of a formula that are almost columns, or columns that look like parameters."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf


@pytest.fixture(scope="module")
def table():
    rng = np.random.default_rng(0)
    frame = pd.DataFrame(
        {"t": np.arange(40.0), "temperature": rng.uniform(0, 5, 40), "a": rng.standard_normal(40)}
    )
    return frame.assign(y=2 + 0.3 * frame["temperature"] + 0.1 * rng.standard_normal(40))


@pytest.mark.parametrize("name", ["Temperature", "temperatur", "temprature", "temperatrue", "TEMPERATUR"])
def test_a_column_with_a_wrong_letter_or_case_is_named(table, name):
    with pytest.raises(ssf.InputError) as caught:
        ssf.fit_table(table, f"y ~ p + b*{name}")
    told = f"no column {name}; the table has temperature (columns: t, temperature, a, y). If {name} is"
    assert str(caught.value).startswith(told)


def test_a_column_with_a_unit_in_its_name_is_told_as_a_formula_writes_it(table):
    named = table.rename(columns={"temperature": "temperature (K)", "y": "y [N]", "t": "t (s)"})
    for law, told in (
        ("y ~ p", 'did you mean Q("y [N]")?'),
        ('Q("y [N]") ~ p + b*temperature', 'no column temperature; the table has Q("temperature (K)")'),
    ):
        with pytest.raises(ssf.InputError) as caught:
            ssf.fit_table(named, law)
        assert told in str(caught.value)
    with pytest.raises(ssf.InputError, match=r"did you mean t \(s\)\?"):
        ssf.fit_table(named, 'Q("y [N]") ~ p', time="t")
    assert len(ssf.fit_table(named, 'Q("y [N]") ~ p + b*Q("temperature (K)")').parameters) == 2


def test_a_wrong_case_is_named_even_where_a_fit_would_do(table):
    with pytest.raises(ssf.InputError, match="no column T; the table has t "):
        ssf.fit_table(table, "y ~ T")


def test_a_parameter_may_differ_from_a_column_by_its_case_where_both_are_used_or_it_is_declared(table):
    assert ssf.fit_table(table, "y ~ p + T*t").parameters["name"].tolist() == ["p", "T"]
    assert ssf.fit_table(table, ssf.Law("y ~ T", start={"T": 1.0})).parameters["name"].tolist() == ["T"]


@pytest.mark.parametrize("given", [{"law": "Y ~ p"}, {"law": "y ~ p", "time": "T"}])
def test_a_response_or_role_in_the_wrong_case_is_found(table, given):
    with pytest.raises(ssf.InputError, match=r"did you mean (y|t)\?"):
        ssf.fit_table(table, **given)


@pytest.mark.slow
def test_a_column_that_looks_like_a_parameter_is_said_to_be_one(table):
    answer = ssf.diagnose_table(table, "y ~ a + b*temperature", gain=False)
    assert answer.table.notes == ("a of the law is the column of that name, and no parameter.",)
    assert not ssf.diagnose_table(table, "y ~ p + b*temperature", gain=False).table.notes
