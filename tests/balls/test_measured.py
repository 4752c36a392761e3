"""Measured ball drops: free fall is wrong, and drag, each ball's own, and the camera's slant are why.

Linear drag alone is the best first step, and after it nothing more would be found: the slant is found
because the search also asks whether another drag, with another cause beside it, is likelier.
"""

import numpy as np
import pytest

import stickslip_fit as ssf
from benchmarks.ball_drops import fit_by_scipy, read_frames
from tests.balls.fall import LAW, SLANT, drags


@pytest.fixture(scope="module")
def frames():
    return read_frames()


@pytest.mark.nightly
def test_drag_of_each_ball_is_found_in_all_drops_together(frames):
    diagnosis = ssf.diagnose_table(
        frames, LAW, session="run", time="seconds", causes=[*drags(by="ball"), SLANT], gain=False
    )
    first, second = diagnosis.findings
    assert (first.cause, second.cause) == ("linear-drag", "slant")
    # The golf ball's drops say one drag, those of two whiffle balls the other, as decidedly.
    assert first.equivalent == ("quadratic-drag",)
    assert diagnosis.verdict == "cannot tell apart"
    values, _, _ = fit_by_scipy(frames, "linear-drag", slanted=True)
    (slant,) = second.parameters
    assert abs(slant.size.estimate - values["slant"]) < slant.size.high - slant.size.estimate
    assert second.effect.high < 0.2  # m beside drag; 0.54 m in free fall
    sizes = {one.name: one.size for one in first.parameters}
    whiffle = ["orange-whiffle-ball", "whiffle-ball-1", "whiffle-ball-2", "yellow-whiffle-ball"]
    for ball in whiffle:
        assert sizes[f"r[{ball}]"].estimate == pytest.approx(values[ball], rel=0.05)
    assert min(sizes[f"r[{ball}]"].low for ball in whiffle) > sizes["r[baseball]"].high
    fit = diagnosis.extended_law()
    assert np.sqrt(np.mean(fit.residuals["residual"] ** 2)) < 0.3


def test_drag_that_another_with_the_slant_beside_it_explains_as_well_is_not_told_apart(frames):
    """Of four whiffle balls and the volleyball: alone linear drag is ahead, with the slant quadratic drag."""
    light = frames[frames["ball"].str.contains("whiffle|volleyball")].reset_index(drop=True)
    diagnosis = ssf.diagnose_table(
        light, LAW, session="run", time="seconds", causes=[*drags(by="ball"), SLANT], gain=False
    )
    assert {"linear-drag", "quadratic-drag"} <= set(diagnosis.findings[0].cause_set)


@pytest.mark.nightly
def test_free_fall_alone_leaves_what_each_drop_has_of_its_own(frames):
    """Without drag among the candidates, what is left of 22 drops is smooth, and no noise that persists."""
    diagnosis = ssf.diagnose_table(frames, LAW, session="run", time="seconds", gain=False)
    assert [one.cause for one in diagnosis.findings] == ["unknown"]
    assert np.sqrt(np.mean(diagnosis.extended_law().residuals["residual"] ** 2)) < 0.2
