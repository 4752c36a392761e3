import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.simulation import read_law_values

ELBOW = """
[[law]]
joint = 2
direction = "-"
gamma0_q3_0_urad = 95
gamma0_q3_12_urad = 90
d_q3_0_urad = 19.6
d_q3_12_urad = 25.91
"""
BASE = """
[[law]]
joint = 1
direction = "+"
gamma0_reach_0_urad = 97
gamma0_urad_per_mm = -0.05
d_reach_0_urad = -1
d_urad_per_mm = -0.35
day_to_day_pct = 1.5
"""


def test_every_parameter_is_read_in_its_unit(law_of):
    law = law_of(1.8, ELBOW + BASE)
    assert law.values[3, "+", None] == pytest.approx([976e-9, 0.3, 438e-9], rel=1e-15)
    assert law.values[2, "-", None] == pytest.approx([95e-6, 90e-6, 19.6e-6, 25.91e-6], rel=1e-15)
    # µrad/mm is rad/m a thousand times over.
    assert law.values[1, "+", None] == pytest.approx([97e-6, -0.05e-3, -1e-6, -0.35e-3], rel=1e-15)
    day_to_day = {(3, "+"): 0.018, (3, "-"): 0.018, (2, "-"): 0.0, (1, "+"): 0.015}
    assert law.day_to_day == pytest.approx(day_to_day)
    assert {joint: law.laws[joint].joint for joint in law.laws} == {1: 1, 2: 2, 3: 3}


def test_each_row_has_the_values_of_its_direction_and_session(law_of, plan_of):
    own = '[[law]]\njoint = 3\ndirection = "-"\nsession = "2012-03-06"\na_nm = 1\nb = 0\nc_nm = 0\n'
    rows = plan_of().rows().sample(frac=1, random_state=1)
    values, shared = law_of(0, own).of_rows(rows, 3)
    for (_, row), found, usual in zip(rows.iterrows(), values, shared, strict=True):
        special = (row["session"], row["direction"]) == ("2012-03-06", "-")
        a = 1e-9 if special else {"+": 976e-9, "-": 903e-9}[row["direction"]]
        assert found[0] == pytest.approx(a)
        assert usual != special


FAULTS = [
    (ELBOW.replace("95", "-95"), "law 3 gamma0_q3_0_urad", "-95", "give a number in µrad, 0 or more"),
    (ELBOW.replace("= 95", "= 'much'"), "law 3 gamma0_q3_0_urad", "much", "give a number in µrad"),
    (ELBOW.replace("d_q3_0_urad = 19.6", ""), "law 3 d_q3_0_urad", None, "give a number in µrad"),
    (ELBOW.replace("d_q3_0_urad", "d_q3_0_mrad") + "d_q3_0_urad = 1", "law 3 d_q3_0_mrad", "19.6", "no key"),
    (ELBOW.replace('"-"', '"down"'), "law 3 direction", "down", "give one of '+', '-'"),
    (ELBOW.replace("joint = 2", ""), "law 3 joint", None, "give one of 1, 2, 3"),
    (ELBOW + ELBOW, "law 4 direction", "-", "an earlier [[law]] has this joint and direction"),
    (ELBOW + "day_to_day_pct = 30", "law 3 day_to_day_pct", "30", "in %, 0 to 20"),
    (ELBOW + "session = 5", "law 3 session", "5", "give a text in quotes"),
    (ELBOW + "session = 'a'\nday_to_day_pct = 1", "law 3 day_to_day_pct", "1", "is no key of this table"),
]


@pytest.mark.parametrize(("more", "column", "value", "message"), FAULTS)
def test_a_fault_is_named_with_its_key_and_value(law_of, more, column, value, message):
    with pytest.raises(InputError) as caught:
        law_of(0, more)
    (problem,) = caught.value.problems
    assert (problem.column, problem.value) == (column, value)
    assert message in problem.message


def test_a_file_without_laws_says_what_it_needs(tmp_path, machine):
    (tmp_path / "law.toml").write_text("cause = []")
    with pytest.raises(InputError, match=r"give at least one table \[\[law\]\]"):
        read_law_values(tmp_path / "law.toml", machine)


def test_values_from_elsewhere_need_no_file(law_of, plan_of):
    from stickslip_fit.laws import Prismatic
    from stickslip_fit.simulation import LawValues

    sessions = {"2012-03-05": 1.0, "2012-03-06": 2.0, "2012-03-07": 3.0}
    fitted = {(3, way, label): np.full(3, x) for label, x in sessions.items() for way in "+-"}
    rows = plan_of().rows()
    values, shared = LawValues({3: Prismatic()}, fitted).of_rows(rows, 3)
    assert list(values[:, 2]) == [sessions[label] for label in rows["session"]]
    assert not shared.any()
