"""A study plan from its file: every fault at once, each with what to do."""

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.studies import read_study
from tests.studies.conftest import HEAD, JOINT_3, ROTARY, law_file

GOOD = """
plan = "plan.toml"
law = "law.toml"
campaigns = 50
seed = 7
good_enough_pct = 0.5
strategies = ["closed form", "Bayes, 2 I-optimal"]
[spread]
campaigns_pct = 4
sessions_pct = 1
[noise]
repeatability_pct = 0.5
kind = "uneven"
[moves]
count = 5
length_mm = 0.5
[[scenario]]
name = "nothing"
[[scenario]]
name = "warm and late"
[[scenario.cause]]
name = "thermal-warm-up"
A = "3 %"
tau = "40 min"
[[scenario.cause]]
name = "end-stop-latency"
L = "50 steps"
"""


@pytest.fixture
def read(tmp_path, machine):
    def call(text, sweeps=JOINT_3 + ROTARY):
        head = HEAD.format(sessions=2, check_every=5, repeatability_pct='{"3+" = 0.2, "3-" = 0.3}')
        (tmp_path / "plan.toml").write_text(head + sweeps)
        (tmp_path / "law.toml").write_text(law_file(0.0))
        (tmp_path / "study.toml").write_text(text)
        return read_study(tmp_path / "study.toml", machine)

    return call


def test_every_key_is_understood(read):
    found = read(GOOD)
    assert (found.name, found.campaigns, found.seed, found.moves) == ("study", 50, 7, 5)
    assert (found.good_enough, found.between_campaigns, found.between_sessions) == (0.005, 0.04, 0.01)
    assert (found.length, found.scatter) == (0.5e-3, "uneven")
    assert [strategy.name for strategy in found.strategies] == ["closed form", "Bayes, 2 I-optimal"]
    assert found.repeatability == {(joint, way): 0.005 for joint in (1, 2, 3) for way in "+-"}
    nothing, both = found.scenarios
    assert nothing.causes == ()
    assert [cause.name for cause in both.causes] == ["thermal-warm-up", "end-stop-latency"]
    np.testing.assert_allclose(both.sizes, [0.03, 2400.0, 50.0])


def test_what_the_campaign_plan_says_of_scatter_holds_without_another_word(read):
    text = GOOD.replace("[noise]\nrepeatability_pct = 0.5\n", "[noise]\n").replace("count = 5", "count = 0")
    assert read(text, JOINT_3).repeatability == {(3, "+"): 0.002, (3, "-"): 0.003}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('plan = "plan.toml"', "", "column plan: name a file in quotes"),
        ('"plan.toml"', '"none.toml"', "none.toml: cannot be read"),
        ("campaigns = 50", "campaigns = 0", "column campaigns, value '0': give a whole number from 1"),
        ('"closed form"', '"close form"', "value '.close form, .*give a list of different ones of 'const"),
        ('kind = "uneven"', 'kind = "odd"', "column noise.kind, value 'odd': give one of 'gaussian', 't5', "),
        ("sessions_pct = 1", "sessions_pct = 40", "column spread.sessions_pct, value '40': .* in %, 0 to 10"),
        ("count = 5", "counts = 5", "column moves.counts, value '5': is no key of this table"),
        ('tau = "40 min"', 'tau = "40 km"', "column scenario 2 cause 1 tau, value '40 km': give"),
        ('"end-stop-latency"', '"late"', "column scenario 2 cause 2 name, value 'late': give one of"),
        ('"warm and late"', '"nothing"', "column scenario, .*give names that differ; these are nothing"),
        (
            'name = "end-stop-latency"\nL = "50 steps"',
            'name = "humidity"\nmean = "50 %"\nk = "1 %/%"',
            "value 'warm and late': humidity needs humidity, which no plan has",
        ),
        (
            'name = "end-stop-latency"\nL = "50 steps"',
            'name = "session-jump"\nsession = "Mon"\nA = "1 %"\nmoment = "60 min"',
            "session-jump happens in session 'Mon'; the plan's are '2012-03-05', '2012-03-06'",
        ),
        ("repeatability_pct = 0.5\n", "", 'column plan, .* has no "1\\+", which it drives'),
    ],
)  # fmt: skip
def test_faults_are_named(old, new, said, read):
    assert old in GOOD
    with pytest.raises(InputError, match=said):
        read(GOOD.replace(old, new))


def test_moves_need_all_joints(read):
    with pytest.raises(InputError, match="does not calibrate all joints both ways; set count = 0"):
        read(GOOD, JOINT_3)


def test_all_faults_are_told_together(read):
    with pytest.raises(InputError) as caught:
        read(GOOD.replace("seed = 7", "seed = -1").replace("tau", "tao").replace("length_mm", "length_km"))
    assert len(caught.value.problems) >= 4
