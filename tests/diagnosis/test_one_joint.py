"""A cause that acts on one joint alone has its name, its size and its joint."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

SIZE, TAU = 0.03, 2400.0


def read_warmed(joints, seed):
    """A log in which some joints warm up; the other one does not."""
    hidden = hide("thesis", seed=seed)
    table = hidden.table.copy()
    time = pd.to_datetime(table["time"])
    seconds = (time - time.groupby(table["session"]).transform("min")).dt.total_seconds().to_numpy()
    factor = 1.0 + SIZE * (1.0 - np.exp(-seconds / TAU)) * table["joint"].isin(joints)
    table["steps"] = (5 * np.round(table["steps"] / factor / 5)).astype(int)
    return read_hidden(replace(hidden, table=table))


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


def test_a_warm_up_of_all_joints_has_one_size():
    (finding,) = ssf.diagnose(read_warmed([1, 2, 3], 4), gain=False).findings
    assert (finding.cause, finding.version.joint) == ("thermal-warm-up", 0)
