"""What an emulator may hide, small enough to reason about."""

from pathlib import Path

from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.logs.plan import Noise, Plan
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values

MACHINE = load_machine()
LAWS = """
[[law]]
joint = 3
direction = "+"
a_nm = 9760
b = 0.30
c_nm = 4380
day_to_day_pct = {day_to_day}
[[law]]
joint = 3
direction = "-"
a_nm = 9030
b = 0.30
c_nm = -4050
day_to_day_pct = {day_to_day}
[[law]]
joint = 2
direction = "+"
gamma0_q3_0_urad = 950
gamma0_q3_12_urad = 900
d_q3_0_urad = -150
d_q3_12_urad = -198
[[law]]
joint = 2
direction = "-"
gamma0_q3_0_urad = 950
gamma0_q3_12_urad = 900
d_q3_0_urad = 196
d_q3_12_urad = 259
"""
PLAN = """
seed = 3
check_every = 5
replicates = {replicates}
[sessions]
dates = [2012-03-05, 2012-03-06]
[noise]
repeatability_pct = 0
[[sweep]]
joint = 3
q2_deg = [-90, 0]
theta_deg = [0, -45]
[[sweep]]
joint = 2
q3_mm = [0, 12]
"""


def truth_of(folder: Path, more: str = "", day_to_day: float = 0.0, noise: float = 0.0) -> HiddenLaws:
    """Laws of joints 2 and 3, their steps ten times as large as usual, with [[cause]] tables."""
    path = folder / "law.toml"
    path.write_text(LAWS.format(day_to_day=day_to_day) + more, encoding="utf-8")
    spread = {(joint, direction): noise for joint in (2, 3) for direction in "+-"}
    return HiddenLaws(read_law_values(path, MACHINE), MACHINE, Noise(spread), seed=1)


def plan_of(folder: Path, replicates: int = 2) -> Plan:
    """Joints 3 and 2, both directions in turn, two sessions."""
    path = folder / "plan.toml"
    path.write_text(PLAN.format(replicates=replicates), encoding="utf-8")
    return read_plan(path, MACHINE)
