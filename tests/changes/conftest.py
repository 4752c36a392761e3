"""Simulated logs of joint 3 with any sessions, scatter from day to day and change of a parameter."""

import numpy as np
import pytest

from stickslip_fit.laws import Prismatic
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import LawValues, simulate

TRUTH = {"+": np.array([976e-9, 0.30, 438e-9]), "-": np.array([903e-9, 0.27, -405e-9])}
PLAN = """\
replicates = 2
[sessions]
dates = [{dates}]
[noise]
repeatability_pct = 0.27
[[sweep]]
joint = 3
q2_deg = [-90, 0]
theta_deg = [-90, 0]
psi_deg = [{psi}]
"""


@pytest.fixture(scope="session")
def make_log(tmp_path_factory):
    """A log of so many days of a month, in which `a` of direction + is so much larger than it should be.

    `scale` multiplies a and c of both directions; `truth` are a law and its values in place of the usual;
    `psi` are the angles, which without others than 0 leave two loads in either direction.
    """
    folder = tmp_path_factory.mktemp("plans")

    def make(days, *, month=3, seed=0, change=0.0, day_to_day=0.005, scale=(1.0, 1.0), truth=None, psi="0"):
        path = folder / f"{days}-{month}.toml"
        path.write_text(
            PLAN.format(dates=", ".join(f"2012-{month:02d}-{day:02d}" for day in range(5, 5 + days)), psi=psi)
        )
        values = {(3, way, None): value.copy() for way, value in TRUTH.items()}
        values[3, "+", None][0] *= 1 + change
        for value in values.values():
            value[[0, 2]] *= scale
        law = Prismatic()
        if truth is not None:
            law, own = truth
            values = dict.fromkeys(values, own)
        made = LawValues({3: law}, values, {(3, way): day_to_day for way in TRUTH})
        return simulate(read_plan(path, load_machine()), made, load_machine(), seed)

    return make
