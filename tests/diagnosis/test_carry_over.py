"""What a traverse departs by carries over to the next: found, fitted, predicted one step ahead, simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.estimation import load_result
from stickslip_fit.logs import read_log
from stickslip_fit.logs.history import add_departures
from tests.hidden.outside import OutsideCase, baseline, rms, true_form
from tests.hidden.reading import drop_lab_columns, read_hidden

CASE = OutsideCase("unknown:history", "residual before, one way", "session", "gaussian", 12.0, 100)


@pytest.fixture(scope="module")
def hidden():
    """A log and a replicate of it, as they are hidden, without columns that act on nothing."""
    made = (CASE.make(), CASE.make(replicate=1))
    return [replace(one, table=drop_lab_columns(one.table)) for one in made]


@pytest.fixture(scope="module")
def logs(hidden, tmp_path_factory):
    read = []
    for one in hidden:
        path = tmp_path_factory.mktemp("hidden") / "log.csv"
        one.write(path)
        read.append(read_log(path))
    return read


@pytest.fixture(scope="module")
def found(logs):
    return diagnose(logs[0], seed=1)


@pytest.fixture(scope="module")
def law(found):
    return found.extended_law()


@pytest.mark.slow
def test_it_is_unknown_with_the_carry_over_as_its_term_and_nothing_besides(found, hidden):
    (finding,) = found.findings
    assert (finding.cause, finding.carrier) == ("unknown", "memory-by-direction, + only")
    assert finding.term == "k * departure before, joint 1 and 2 and 3, + only"
    (truth,), (size,) = hidden[0].truth["effects"][0]["parameters"], finding.parameters
    # A larger step makes fewer, of both traverses: the shares have the same sign.
    assert size.size.low < truth["value"] < size.size.high
    assert finding.effect.low < hidden[0].truth["effects"][0]["effect_rms_pct"] / 100 < finding.effect.high
    assert found.gain.extended < 0.85 * found.gain.baseline


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, 2])
def test_its_size_has_in_it_what_calibration_absorbed_of_the_departures_before(seed):
    hidden = replace(CASE, seed=seed).make()
    (finding,) = diagnose(read_hidden(hidden), gain=False).findings
    assert finding.effect.low < hidden.truth["effects"][0]["effect_rms_pct"] / 100 < finding.effect.high


@pytest.mark.slow
def test_the_law_predicts_a_replicate_from_the_counts_before(law, logs, hidden):
    fresh = hidden[1]
    predicted = np.log(law.predict(logs[1].rows)["steps"].to_numpy())
    saved = rms(fresh, baseline(hidden[0])) - rms(fresh, predicted)
    assert saved > 0.7 * (rms(fresh, baseline(hidden[0])) - rms(fresh, true_form(*hidden)))


@pytest.mark.slow
def test_each_prediction_is_that_without_carry_over_and_a_share_of_the_departure_before(law, logs):
    rows = logs[1].rows
    plain = law.si.predict(rows.drop(columns="steps"))  # a plan, whose traverses have no counts before them
    predicted, k = law.si.predict(rows), law.joints[1].values[0, -1]
    expected, departure = [], 0.0
    for number, row in enumerate(rows.itertuples()):
        carried = k * departure if row.direction == "+" and number else 0.0
        expected.append(plain["steps"].iloc[number] / (1.0 + carried))
        noise = law.joints[row.joint].repeatability[row.direction].value
        share = 1.0 / (1.0 + (predicted["relative_error"].iloc[number] / noise) ** 2)
        departure = share * (expected[-1] / (row.steps - 2.5) - 1.0)
    np.testing.assert_allclose(predicted["steps"], expected, rtol=1e-8)
    assert np.std(np.log(predicted["steps"] / plain["steps"])) > 1e-3


@pytest.mark.slow
def test_a_traverse_whose_predecessor_is_not_among_the_rows_is_expected_not_to_follow(law, logs):
    rows = logs[1].rows
    plain = law.si.predict(rows.drop(columns="steps"))["steps"]
    every_other = rows.iloc[::2]
    pd.testing.assert_series_equal(law.si.predict(every_other)["steps"], plain.iloc[::2])


@pytest.mark.slow
def test_a_saved_law_predicts_the_same(law, logs, tmp_path):
    law.save(tmp_path / "law.json")
    assert law.provenance.log_files == logs[0].files  # not as changed
    again = load_result(tmp_path / "law.json").predict(logs[1].rows)
    pd.testing.assert_frame_equal(again, law.predict(logs[1].rows))


def test_departures_of_any_joint_and_of_the_same(logs):
    rows = logs[0].rows
    departures = np.arange(len(rows)) + 1.0
    found = add_departures(rows, departures)
    session, joint = rows["session"].tolist(), rows["joint"].tolist()
    any_joint, same_joint = found["departure_before"].tolist(), found["joint_departure_before"].tolist()
    for number in range(len(rows)):
        before = [k for k in range(number) if session[k] == session[number]]
        own = [k for k in before if joint[k] == joint[number]]
        assert any_joint[number] == (departures[before[-1]] if before else 0.0)
        assert same_joint[number] == (departures[own[-1]] if own else 0.0)
