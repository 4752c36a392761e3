"""Small studies on plans that take no file of the project."""

import numpy as np
import pytest

from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values
from stickslip_fit.strategies import ClosedForm, ConstantStepStrategy, IOptimal, LeastSquares
from stickslip_fit.studies import Scenario, StudyPlan
from tests.conftest import Truth

HEAD = """
check_every = {check_every}
[sessions]
first_date = 2012-03-05
count = {sessions}
start = "06:00"
[timing]
pause_s = [5, 20]
[noise]
repeatability_pct = {repeatability_pct}
"""
JOINT_3 = """
[[sweep]]
joint = 3
q2_deg = [-90, 0]
theta_deg = [0, -90]
[[sweep]]
joint = 3
q2_deg = [-30, -60, -150]
theta_deg = [0, -45]
[[sweep]]
joint = 3
q2_deg = -90
psi_deg = [-60, 45]
"""
ROTARY = """
[[sweep]]
joint = 2
q3_mm = [0, 12]
theta_deg = [0, -90]
[[sweep]]
joint = 2
q3_mm = [3, 9]
psi_deg = [-45, 30]
ranges_deg = [[0, -90]]
[[sweep]]
joint = 1
q2_deg = -90
q3_mm = [0, 12]
theta_deg = [0, -90]
[[sweep]]
joint = 1
q2_deg = -45
q3_mm = 6
theta_deg = [-30, -60]
ranges_deg = [[-60, 60]]
"""


def law_file(day_to_day_pct: float) -> str:
    """The laws of the campaigns that tests make without the laws' code."""
    truth = Truth()
    keys = {
        3: ("a_nm", "b", "c_nm"),
        2: ("gamma0_q3_0_urad", "gamma0_q3_12_urad", "d_q3_0_urad", "d_q3_12_urad"),
        1: ("gamma0_reach_0_urad", "gamma0_urad_per_mm", "d_reach_0_urad", "d_urad_per_mm"),
    }
    lines = []
    for joint, values in ((1, truth.base), (2, truth.elbow), (3, truth.prismatic)):
        for direction, own in values.items():
            lines += ["[[law]]", f"joint = {joint}", f'direction = "{direction}"']
            lines += [f"{key} = {value}" for key, value in zip(keys[joint], own, strict=True)]
            lines.append(f"day_to_day_pct = {day_to_day_pct}")
    return "\n".join(lines)


@pytest.fixture(scope="session")
def machine():
    return load_machine()


@pytest.fixture(scope="session")
def study(machine, tmp_path_factory):
    """A maker of study plans."""

    def make(sweeps=JOINT_3, *, sessions=2, check_every=5, repeatability=0.0027, day_to_day_pct=2.0, **given):
        folder = tmp_path_factory.mktemp("study")
        plan, law = folder / "plan.toml", folder / "law.toml"
        head = HEAD.format(sessions=sessions, check_every=check_every, repeatability_pct=100 * repeatability)
        plan.write_text(head + sweeps)
        law.write_text(law_file(day_to_day_pct))
        usual = {
            "name": "small",
            "scenarios": (Scenario("nothing hidden"),),
            "strategies": (ConstantStepStrategy(), ClosedForm(), LeastSquares(IOptimal(), 2)),
            "campaigns": 20,
            "moves": 0,
            "between_campaigns": 0.05,
            "between_sessions": 0.01,
        }
        return StudyPlan(
            plan=read_plan(plan, machine),
            truth=read_law_values(law, machine),
            machine=machine,
            repeatability={(joint, way): repeatability for joint in (1, 2, 3) for way in "+-"},
            **usual | given,
        )

    return make


def hidden(name: str, cause, *sizes: float) -> Scenario:
    """A scenario with one cause."""
    return Scenario(name, (cause,), np.array(sizes))
