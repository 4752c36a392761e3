"""Extended laws as JSON, there and back."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.causes import describe, extend, restore
from stickslip_fit.errors import InputError
from tests.causes.by_hand import ROWS
from tests.causes.table import CASES, LAWS, MACHINE, NAMED, own_values

LABELS = [case.label for case in CASES]


def through_json(law):
    return restore(json.loads(json.dumps(describe(law), allow_nan=False)), MACHINE)


@pytest.mark.parametrize("label", LABELS)
def test_a_cause_bound_to_a_log_comes_back_the_same(label):
    case = NAMED[label]
    joint = case.cause.joints[-1]
    rows = ROWS[ROWS["joint"] == joint]
    law = extend(LAWS[joint], case.cause.bind(rows, MACHINE))
    back = through_json(law)
    assert back.causes == law.causes
    assert back.parameters == law.parameters
    size = np.array([2 * step for step in law.causes[0].scale])
    values = np.concatenate([own_values(rows), np.tile(size, (len(rows), 1))], axis=1)
    np.testing.assert_array_equal(back.predict(rows, values), law.predict(rows, values))


def test_several_causes_keep_their_order():
    law = extend(extend(LAWS[2], NAMED["drift"].cause), NAMED["cable-torque"].cause)
    assert [cause.name for cause in through_json(law).causes] == ["drift", "cable-torque"]


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_published_laws_are_described_as_ever(joint):
    back = through_json(LAWS[joint])
    assert (back.name, back.joint) == (LAWS[joint].name, joint)


def test_a_cause_that_nobody_knows_is_told_by_name():
    described = describe(extend(LAWS[3], NAMED["drift"].cause))
    described["causes"][0]["name"] = "gremlins"
    with pytest.raises(InputError, match="gremlins"):
        restore(described, MACHINE)


def test_the_machine_a_cause_was_bound_to_is_kept():
    wide = replace(NAMED["cable-torque"].cause, ranges=((1, -0.4, 0.6), (2, -2.5, 0.5)))
    assert through_json(extend(LAWS[2], wide)).causes[0].ranges == wide.ranges


def test_a_cable_of_an_earlier_version_is_refused_in_one_sentence():
    described = describe(extend(LAWS[2], NAMED["cable-torque"].cause))
    (cause,) = described["causes"]
    del cause["ranges"]
    cause["middle"] = [[1, 0.0], [2, -1.5]]
    with pytest.raises(InputError, match="'cable-torque' of an earlier version"):
        restore(described, MACHINE)
