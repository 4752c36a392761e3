"""A cause that acts on one joint alone, or on each with another size, has its name, sizes and joints."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.laws import Configuration, ConstantStep, Prismatic
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

SIZE, TAU = 0.03, 2400.0


def read_warmed(joints, seed):
    """A log of joints 2 and 3 in which some warm up."""
    return read_changed(
        lambda table, seconds: SIZE * (1.0 - np.exp(-seconds / TAU)) * table["joint"].isin(joints), seed
    )


def read_changed(change, seed):
    """A log of joints 2 and 3 with a relative change of steps, by its table and seconds into a session."""
    hidden = hide("thesis", seed=seed)
    table = hidden.table.copy()
    time = pd.to_datetime(table["time"])
    seconds = (time - time.groupby(table["session"]).transform("min")).dt.total_seconds().to_numpy()
    factor = 1.0 + change(table, seconds)
    table["steps"] = (5 * np.round(table["steps"] / factor / 5)).astype(int)
    return read_hidden(replace(hidden, table=table), (2, 3))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "seed"),
    [(3, 4), pytest.param(2, 5, marks=pytest.mark.nightly), pytest.param(3, 6, marks=pytest.mark.nightly)],
)
def test_a_warm_up_of_one_joint_is_named_as_such(joint, seed, tmp_path):
    """With one size for all joints, neither joint has its own, and unknown structure is likelier."""
    log = read_warmed([joint], seed)
    found = ssf.diagnose(log, gain=False)
    (finding,) = found.findings
    assert (finding.cause, finding.joints) == ("thermal-warm-up", (joint,))
    for one, true in zip(finding.parameters, (SIZE, TAU), strict=True):
        error = (one.size.high - one.size.low) / 3.92
        assert one.size.estimate == pytest.approx(true, abs=3 * error)
    assert f"The steps of joint {joint} grow by" in str(found.summary())
    law = found.extended_law()
    law.save(tmp_path / "law.json")
    pd.testing.assert_frame_equal(
        ssf.load_result(tmp_path / "law.json").predict(log.rows), law.predict(log.rows), rtol=1e-9
    )


@pytest.mark.nightly
def test_a_warm_up_of_all_joints_has_one_size():
    (finding,) = ssf.diagnose(read_warmed([2, 3], 4), gain=False).findings
    assert (finding.cause, finding.version.is_restricted) == ("thermal-warm-up", False)


SIZES = {2: 0.008, 3: 0.03}


def change_as(name, table, seconds):
    """Relative change of a cause that has another size in each joint."""
    if name == "thermal-warm-up":
        course = 1.0 - np.exp(-seconds / TAU)
    elif name == "drift":
        course = seconds / 7200.0
    else:
        day = table["session"].unique()[1]
        course = (table["session"] == day) & (seconds > np.median(seconds[table["session"] == day]))
    return table["joint"].map(SIZES).fillna(0.0) * course


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param("drift", 11, marks=pytest.mark.nightly),
        *(pytest.param("thermal-warm-up", k, marks=pytest.mark.nightly) for k in (12, 13)),
        *(pytest.param("session-jump", k, marks=pytest.mark.nightly) for k in (14, 15)),
    ],
)
def test_a_cause_with_another_size_in_each_joint_has_these_sizes(name, seed, tmp_path):
    """With one size for all it describes neither joint, and what is left looks like noise or structure."""
    log = read_changed(partial(change_as, name), seed)
    found = ssf.diagnose(log, gain=False)
    (finding,) = found.findings
    assert finding.cause == name
    own = {
        one.joint: one.size.times(7200.0 if name == "drift" else 1.0)
        for one in finding.parameters
        if one.joint
    }
    assert {2, 3} <= own.keys()
    for joint, true in SIZES.items():
        error = (own[joint].high - own[joint].low) / 3.92
        assert own[joint].estimate == pytest.approx(true, abs=3.5 * error)
        assert error < 0.25 * SIZES[3]
    assert "(joint 2)" in str(found.summary())
    assert all(np.isfinite([one.size.low, one.size.high]).all() for one in finding.parameters)
    law = found.extended_law()
    law.save(tmp_path / "law.json")
    again, before = ssf.load_result(tmp_path / "law.json").predict(log.rows), law.predict(log.rows)
    assert again["steps"].tolist() == before["steps"].tolist()
    # The file has ten digits of a covariance, of which an error is a small difference.
    pd.testing.assert_frame_equal(again, before, rtol=1e-6)


def test_a_law_has_the_size_of_its_joint():
    """gamma of each joint is that with the cause alone, at its own size; the time constant is shared."""
    cause = ssf.causes.OfJoints(ssf.causes.ThermalWarmUp(), (2, 3))
    table = {"q1": 0.0, "q2": -1.0, "q3": 0.006, "theta": 0.0, "psi": 0.0, "session_seconds": 900.0}
    rows = {name: np.array([value]) for name, value in table.items()}
    for law, own, start, stop in (
        (Prismatic(), [976e-9, 0.3, 438e-9], 0.0, 0.012),
        (ConstantStep(2, Configuration("anywhere")), [1e-4], -1.0, 0.5),
    ):
        ends = rows | {"start": np.array([start]), "stop": np.array([stop])}
        apart, _ = ssf.causes.extend(law, cause).counts(ends, np.array([*own, 0.01, 0.03, TAU]))
        size = {2: 0.01, 3: 0.03}[law.joint]
        alone, _ = ssf.causes.extend(law, ssf.causes.ThermalWarmUp()).counts(
            ends, np.array([*own, size, TAU])
        )
        assert apart == pytest.approx(alone, rel=1e-12)


def test_a_cause_whose_size_is_of_joints_already_is_refused():
    with pytest.raises(ssf.InputError, match="no size that could differ by joint"):
        ssf.causes.OfJoints(ssf.causes.LoadNonlinearity(), (2, 3))
