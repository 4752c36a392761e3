"""Plans and laws small enough to work out by hand."""

import pytest

from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values, simulate

LAW = """
[[law]]
joint = 3
direction = "+"
a_nm = 976
b = 0.30
c_nm = 438
day_to_day_pct = {day_to_day}
[[law]]
joint = 3
direction = "-"
a_nm = 903
b = 0.30
c_nm = -405
day_to_day_pct = {day_to_day}
"""
PLAN = """
seed = {seed}
replicates = {replicates}
check_every = {check_every}
order = "{order}"
[sessions]
dates = [{dates}]
[noise]
kind = "{kind}"
repeatability_pct = {repeatability}
[[sweep]]
joint = 3
{sweep}
"""
USUAL = {
    "seed": 1,
    "replicates": 1,
    "check_every": 5,
    "order": "as-written",
    "dates": "2012-03-05, 2012-03-06, 2012-03-07",
    "kind": "gaussian",
    "repeatability": 0.27,
    "sweep": "q2_deg = [-90, 0]",
}


@pytest.fixture(scope="session")
def machine():
    return load_machine()


@pytest.fixture
def plan_of(tmp_path, machine):
    """A plan for joint 3: level and upright, both directions, three sessions; or as the settings say."""

    def read(**settings):
        path = tmp_path / "plan.toml"
        path.write_text(PLAN.format(**USUAL | settings), encoding="utf-8")
        return read_plan(path, machine)

    return read


@pytest.fixture
def law_of(tmp_path, machine):
    """Joint 3's law, with more tables if there are any."""

    def read(day_to_day=0.0, more=""):
        path = tmp_path / "law.toml"
        path.write_text(LAW.format(day_to_day=day_to_day) + more, encoding="utf-8")
        return read_law_values(path, machine)

    return read


@pytest.fixture
def rows_of(plan_of, law_of, machine):
    """The rows of the log that a plan and a law make."""

    def make(day_to_day=0.0, more="", **settings):
        return simulate(plan_of(**settings), law_of(day_to_day, more), machine).rows

    return make
