"""Held-out errors on real piezo motors, beside a smoothing spline of position on the same folds."""

import pytest

from benchmarks.cobra import ALLOWED, compare
from tests.cobra.maps import JOINTS, SHARED, positioners

pytestmark = pytest.mark.skipif(not SHARED.exists(), reason="the Cobra maps are not here")

EVERY = [
    (number, joint, cut)
    for number in (positioners() if SHARED.exists() else [])
    for joint in JOINTS
    for cut in (1, 2)
]


@pytest.mark.nightly
def test_a_profile_is_learned_from_traverses_that_never_repeat():
    """Of each session its own around one that they share: `unknown`, which has a law all the same."""
    line = compare("9", "theta", 2)
    assert line.causes == ("unknown",)
    assert line.extended < 0.7 * line.constant
    assert line.extended < ALLOWED * line.spline


@pytest.mark.nightly
@pytest.mark.parametrize(("number", "joint", "cut"), EVERY)
def test_every_motor_is_predicted_as_well_as_by_a_spline(number, joint, cut):
    line = compare(number, joint, cut)
    assert line.extended < ALLOWED * line.spline, line
    assert not line.silent, line
