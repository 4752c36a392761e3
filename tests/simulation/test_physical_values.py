"""Physical laws in law files: against the closed form of one step, integrated here, and against their fit."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation.drive_ratio import physical_law
from stickslip_fit.simulation import read_law_values, simulate
from stickslip_fit.step import step_size

GRAVITY = 9.81
GUIDE = 0.012
# A stage by what drives it; the law file has what its counts show.
FRICTION, RAMP_TIME = 46.0, 1.5e-4
AMPLITUDES = {"friction-limited": 2.0e-6, "velocity-limited": 0.5e-6}


def prismatic(amplitude, direction="+", more=""):
    unit = FRICTION * RAMP_TIME**2
    return f"""
[[law]]
joint = 3
direction = "{direction}"
a_nm = {min(amplitude, unit) * 1e9}
b = 0.3
r = {GRAVITY / FRICTION}
lambda = {amplitude / unit}
{more}"""


def read(tmp_path, machine, text):
    (tmp_path / "law.toml").write_text(text)
    return read_law_values(tmp_path / "law.toml", machine)


@pytest.mark.parametrize("amplitude", AMPLITUDES.values(), ids=AMPLITUDES)
def test_counts_of_joint_3_are_those_of_its_steps(tmp_path, machine, amplitude):
    law = read(tmp_path, machine, prismatic(amplitude))
    rows = pd.DataFrame(
        {"q2": [-np.pi / 2, 0.0, -1.0], "theta": 0.1, "psi": [0.0, 0.0, 0.4], "start": 0.0, "stop": GUIDE}
    )
    load = np.cos(rows["psi"] - rows["q2"]) * np.cos(rows["theta"])
    steps = (1 - 0.3 * np.abs(np.cos(rows["q2"]))) * step_size(FRICTION, RAMP_TIME, amplitude, GRAVITY * load)
    predicted = law.laws[3].predict(rows, np.tile(law.values[3, "+", None], (3, 1)))
    assert np.exp(predicted) == pytest.approx(GUIDE / steps, rel=1e-12)


@pytest.mark.parametrize("ratio", [2.4, 1.05, 0.5])
def test_counts_of_joint_2_are_the_integral_over_its_steps(tmp_path, machine, ratio):
    """Inertia 1.1, full load over friction 0.12 at that inertia, where the law's weights are 0 and 1."""
    unit, gain, share = 95e-6 / min(ratio, 1.0), 0.1, 0.12
    text = f"""
[[law]]
joint = 2
direction = "-"
gamma0_urad = 95
inertia = {gain if ratio > 0.75 else 0.0}
r_q3_0 = 0.05
r_q3_12 = {share}
lambda = {ratio}
"""
    law, start, stop = read(tmp_path, machine, text), 0.3, -3.2
    rows = pd.DataFrame({"q3": [GUIDE], "theta": 0.2, "psi": 0.3, "start": start, "stop": stop})
    inertia = 1 + gain if ratio > 0.75 else 1.0
    friction = unit / RAMP_TIME**2 / inertia

    def rate(q):
        load = np.sin(0.3 - q) * np.cos(0.2)
        against = -share * friction * load  # the traverse is in negative direction
        return 1 / float(step_size(friction, RAMP_TIME, ratio * unit, against))

    expected = quad(rate, stop, start, limit=400, epsrel=1e-10)[0]
    values = law.values[2, "-", None]
    assert len(values) == len(law.laws[2].parameters)
    assert np.exp(law.laws[2].predict(rows, values[None])) == pytest.approx(expected, rel=1e-8)


def test_a_fit_of_the_simulated_log_has_the_file_s_parameters_and_lambda(tmp_path, machine, plan_of):
    amplitude = AMPLITUDES["friction-limited"]
    text = prismatic(amplitude) + prismatic(amplitude, "-", "day_to_day_pct = 0")
    plan = plan_of(repeatability=0.01, replicates=4, sweep="q2_deg = [-90, -60, -30, 0]\npsi_deg = [0, 90]")
    log = simulate(plan, read(tmp_path, machine, text), machine)
    fit = fit_least_squares(log, laws={3: physical_law})
    table = fit.parameters.set_index(["name"])
    assert np.allclose(table.loc["r", "estimate"], GRAVITY / FRICTION, rtol=0.01)
    assert np.allclose(table.loc["a", "estimate"], FRICTION * RAMP_TIME**2 * 1e9, rtol=2e-3)
    assert fit.joints[3].law.ratios == (10.0, 10.0)  # no count tells lambda above 1 + r from a greater one


FAULTS = [
    (prismatic(1e-6).replace("r =", "c_nm ="), {"law 1 r", "law 1 c_nm"}, "is no key|give a number"),
    (prismatic(1e-6).replace("lambda = ", "lambda = -"), {"law 1 lambda"}, "give a number, 0.01 to 100"),
    (prismatic(1e-6) + prismatic(2e-6, more='session = "a"'), {"law 2 lambda"}, "it is one number"),
    (
        prismatic(1e-6) + '[[law]]\njoint = 3\ndirection = "-"\na_nm = 9e2\nb = 0\nc_nm = -400\n',
        {"law 2 joint"},
        "of joint 3 is with lambda; write all of them alike",
    ),
]


@pytest.mark.parametrize(("text", "columns", "message"), FAULTS)
def test_a_fault_is_named_with_its_key(tmp_path, machine, text, columns, message):
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, machine, text)
    assert {problem.column for problem in caught.value.problems} == columns
