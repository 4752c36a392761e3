"""Which change of the stage stands behind a change of an actuator: from what each does to a and c."""

from __future__ import annotations

import pytest

from stickslip_fit.changes import detect_changes, read_stage_difference
from stickslip_fit.changes._summary import summarize_changes

FRICTION = {"friction", "mass"}
SIZE = 0.1
# a and c times; quantities, regime, and the size of the first of them
GROWN, TWICE = 1 + SIZE, (1 + SIZE) ** 2
CASES = {
    "friction, friction-limited": ((GROWN, 1.0), FRICTION, "friction-limited", SIZE),
    "ramp time, friction-limited": ((TWICE, TWICE), {"ramp time"}, "friction-limited", SIZE),
    "voltage, velocity-limited": ((GROWN, TWICE), {"voltage"}, "velocity-limited", SIZE),
    "friction, velocity-limited": ((1.0, 1 / TWICE), {*FRICTION, "ramp time"}, "velocity-limited", SIZE),
}


def compare(make_log, scale, change=0.0):
    return detect_changes(make_log(6), make_log(6, month=4, seed=1, scale=scale, change=change))


@pytest.mark.parametrize("case", CASES)
def test_a_change_of_a_and_c_is_read(make_log, case):
    scale, quantities, regime, size = CASES[case]
    changes = compare(make_log, scale)
    found = read_stage_difference(changes)
    assert {one.quantity for one in found.credible} == quantities
    assert found.regime == regime
    first = next(one for one in found.credible if one.quantity in ("friction", "ramp time", "voltage"))
    assert first.size.low < size < first.size.high
    assert f"{regime} steps" in summarize_changes(changes).headline[-1]


def test_a_change_of_one_direction_alone_is_no_change_of_the_stage(make_log):
    changes = compare(make_log, (1.0, 1.0), change=0.1)
    assert changes.significant
    assert read_stage_difference(changes).credible == ()
    assert summarize_changes(changes).headline[-1].startswith("No single change of friction")


def test_where_nothing_changed_nothing_is_read(make_log):
    assert read_stage_difference(compare(make_log, (1.0, 1.0))) is None
