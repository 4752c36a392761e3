"""A wrong zero of the response or of a column: named with its size, no candidate where the law has it."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles, generic_causes, prepare_rows
from stickslip_fit.causes.generic import GenericCause
from stickslip_fit.estimation import _table_law_json


def spring():
    x = np.linspace(0.01, 0.1, 20)
    force = 25.0 * x + 0.06 + 0.012 * np.random.default_rng(12).standard_normal(20)
    return pd.DataFrame({"x": x, "F": force}), "F ~ k*x"


def lens():
    u = np.linspace(0.15, 0.6, 25)
    v = 0.1 * u / (u - 0.1) + 0.0005 * np.random.default_rng(1).standard_normal(25)
    return pd.DataFrame({"u": u + 0.006, "v": v}), "v ~ f*u/(u - f)"


@pytest.mark.parametrize(
    ("make", "name", "size"),
    [
        # In each run an offset is named in test_generic.py.
        pytest.param(spring, "offset", 0.06, marks=pytest.mark.nightly),
        (lens, "zero-of:u", -0.006),
    ],
)
def test_a_wrong_zero_is_named_with_its_size_and_saved(make, name, size, tmp_path):
    frame, law = make()
    diagnosis = ssf.diagnose_table(frame, law)
    (finding,) = diagnosis.findings
    (parameter,) = finding.parameters
    assert finding.cause == name
    assert parameter.size.low < size < parameter.size.high
    assert diagnosis.gain.extended < 0.5 * diagnosis.gain.baseline
    extended = diagnosis.extended_law()
    assert parameter.size.low < extended.parameters["estimate"].iloc[-1] < parameter.size.high
    extended.save(tmp_path / "law.json")
    restored = ssf.load_table_fit(tmp_path / "law.json")
    pd.testing.assert_frame_equal(restored.predict(frame), extended.predict(frame))


@pytest.mark.nightly
def test_a_zero_is_not_named_for_a_function_of_its_column_that_it_does_not_have():
    """A resistance in series with a diode: a function of the current, which no zero of it comes near."""
    current, noise = np.geomspace(1e-4, 0.1, 60), 0.001 * np.random.default_rng(3).standard_normal(60)
    frame = pd.DataFrame({"I": current, "V": 0.05 * np.log(current) + 1.2 * current + noise})
    diagnosis = ssf.diagnose_table(frame, "V ~ n*log(I) + c")
    (finding,) = diagnosis.findings
    assert (finding.cause, finding.carrier) == ("unknown", "I")
    assert diagnosis.gain.extended < 0.0015
    series = [ssf.Cause("series", "+ R*I", "R in V/A")]
    assert (
        ssf.diagnose_table(frame, "V ~ n*log(I) + c", causes=series, gain=False).findings[0].cause == "series"
    )


@pytest.mark.parametrize(
    ("law", "names"),
    [
        ("y ~ a + b*x", set()),  # the zero of x is in a
        ("y ~ b*x", {"offset"}),  # and would be an offset here
        ("y ~ A*exp(-x/tau) + c", set()),  # and in A here
        ("y ~ g*x**2", {"offset", "zero-of:x"}),
    ],
)
def test_what_a_parameter_absorbs_is_no_candidate(law, names):
    x = np.linspace(1.0, 5.0, 30)
    frame = pd.DataFrame({"x": x, "y": np.exp(-x) + 0.1 * np.random.default_rng(0).standard_normal(30)})
    rows, roles = prepare_rows(frame, TableRoles()), TableRoles()
    bound = ssf.Law(law).bind_table(rows)
    found = {one.name for one in generic_causes(rows, bound, roles)}
    assert found - {"outliers"} == names


def test_every_kind_of_generic_cause_can_be_saved():
    def kinds_of(kind):
        return {kind}.union(*map(kinds_of, kind.__subclasses__()))

    unsaved = {one.__module__ for one in kinds_of(GenericCause)} - set(_table_law_json._MODULES)
    assert not {name for name in unsaved if name.startswith("stickslip_fit.")}
