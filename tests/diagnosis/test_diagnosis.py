"""What a diagnosis offers after naming: the gain, the extended law, the next experiment."""

from dataclasses import replace

import pytest

from stickslip_fit.causes import Drift, ThermalWarmUp
from stickslip_fit.diagnosis import diagnose, next_experiment
from stickslip_fit.errors import InputError
from tests.diagnosis.conftest import ALPHA


@pytest.mark.slow
def test_the_gain_is_measured_afterwards_as_well(drifting):
    """In one step and in two."""
    one_joint = drifting.select((drifting.rows["joint"] == 3) & (drifting.rows["session"] == "2012-03-05"))
    causes = [Drift(), ThermalWarmUp()]
    whole = diagnose(one_joint, causes=causes, alpha=ALPHA)
    named = diagnose(one_joint, causes=causes, alpha=ALPHA, gain=False)
    assert named.gain is None
    afterwards = named.measure_gain(workers=1)
    assert afterwards.gain.low == whole.gain.low > 0
    assert afterwards.findings[0].gain.extended == whole.findings[0].gain.extended < whole.gain.baseline


def test_what_needs_a_log_says_so(named):
    without = replace(named, log=None)
    assert (without.log_file, without.log_sha256) == ("", "")
    doubtful = replace(named.findings[0], equivalent=("thermal-warm-up",))
    for ask in (without.extended_law, lambda: next_experiment(replace(without, findings=(doubtful,)))):
        with pytest.raises(InputError, match="not of a log"):
            ask()


def test_the_extended_law_holds_the_named_cause(named, drifting):
    law = named.extended_law()
    table = law.si.parameters.set_index("name")
    (parameter,) = named.findings[0].parameters
    assert table.loc[f"drift.{parameter.name}", "estimate"] == pytest.approx(parameter.size.estimate, rel=0.1)
    assert len(law.residuals) == len(drifting.usable)
