"""The thesis's procedures as plans: what is measured in which order, and what comes back from counts."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from stickslip_fit.estimation import fit_closed_form
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values, simulate
from tests.thesis.published import value

LAW = Path(__file__).parents[2] / "data" / "reference" / "law.toml"


@pytest.fixture
def write_plan(run, tmp_path):
    def write(procedure):
        path = tmp_path / f"{procedure}.toml"
        status, _, complained = run("plan", "--thesis", procedure, "-o", path)
        assert status == 0, complained
        return read_plan(path, load_machine()), path

    return write


def fitted(plan):
    rows = plan.traverses
    return rows[rows["status"] == "ok"]


def test_the_calibration_is_six_traverses_and_eight_and_joint_1_by_interchange(write_plan):
    plan, _ = write_plan("calibration")
    rows = fitted(plan).round(9)
    assert rows["joint"].value_counts().to_dict() == {3: 6, 2: 8, 1: 8}
    three = rows[rows["joint"] == 3][["q2", "theta", "psi"]].drop_duplicates().to_numpy()
    assert three == pytest.approx(np.radians([[-90, 0, 0], [0, -90, 0], [0, 0, 0]]))
    two = rows[rows["joint"] == 2]
    assert (two["direction"] == ["-", "+"] * 4).all()
    assert two["q3"].to_numpy()[::2] * 1e3 == pytest.approx([0, 12, 12, 0])
    assert np.degrees(two["theta"].to_numpy()[::2]) == pytest.approx([0, 0, -90, -90])
    one = rows[rows["joint"] == 1]
    assert sorted(set(zip(one["q3"], one["theta"], strict=True))) == sorted(
        set(zip(two["q3"], two["theta"], strict=True))
    )
    assert one["theta"].iloc[0] == two["theta"].iloc[-1]


def test_every_joint_is_driven_twice_back_and_forth_before_it_is_measured(write_plan):
    for procedure in ("calibration", "prismatic", "rotary"):
        rows = write_plan(procedure)[0].traverses
        for joint, subset in rows.groupby("joint"):
            n = 2 * int(value("warm_up_drives"))
            assert list(subset["status"][:n]) == ["excluded"] * n, joint
            assert (subset["status"][n:] == "ok").all()
            full = abs(subset["stop"] - subset["start"])[:n]
            assert full.to_numpy() == pytest.approx(load_machine().span(joint))


def test_the_sweeps_of_joint_3_follow_their_printed_order(write_plan):
    """One psi with the arm level, one q2 over all theta, and again: seven times, + before -."""
    rows = fitted(write_plan("prismatic")[0])
    assert list(rows["direction"]) == ["+", "-"] * (len(rows) // 2)
    places = np.degrees(rows[["q2", "theta", "psi"]].to_numpy()[::2]).round(6)
    psi, q2 = np.arange(-90, 91, 30), np.arange(0, -181, -30)
    expected = [
        place
        for k in range(7)
        for place in [(-90, 0, psi[k]), *((q2[k], theta, 0) for theta in (0, -30, -60, -90))]
    ]
    assert places == pytest.approx(np.array(expected))


def test_joint_2_is_measured_by_intervals_and_over_q3(write_plan):
    rows = fitted(write_plan("rotary")[0])
    length = np.degrees(abs(rows["stop"] - rows["start"])).round(6)
    assert length.value_counts().to_dict() == {30: 2 * 2 * 2 * 6, 240: 2 * 4}
    inertia = rows[length == 240]
    assert sorted(set((1e3 * inertia["q3"]).round(6))) == [0, 4, 8, 12]
    assert np.degrees(inertia["theta"]).to_numpy() == pytest.approx(-90)


def test_without_noise_the_calibration_returns_the_printed_parameters(write_plan, tmp_path):
    """Counts are whole numbers of checks: 5 steps of 12,346 are 0.04 %."""
    _, path = write_plan("calibration")
    law = tmp_path / "law.toml"
    lines = LAW.read_text("utf-8").splitlines()
    law.write_text("\n".join(line for line in lines if not line.startswith("day_to_day")), "utf-8")
    path.write_text(path.read_text("utf-8").replace("repeatability_pct = 0.27", "repeatability_pct = 0"))
    machine = load_machine()
    result = fit_closed_form(simulate(read_plan(path, machine), read_law_values(law, machine), machine))
    table = result.si.parameters.set_index(["joint", "direction", "name"])["estimate"]
    for name, scale in (("a", 1e-9), ("b", 1.0), ("c", 1e-9)):
        for direction, printed in zip("+-", value(name), strict=True):
            assert table.loc[3, direction, name].to_numpy() == pytest.approx(scale * printed, rel=2e-3)


def test_a_warm_up_drive_counts_as_history_and_is_not_fitted(write_plan, tmp_path):
    plan, _ = write_plan("prismatic")
    machine = load_machine()
    log = simulate(plan, read_law_values(LAW, machine), machine)
    assert (log.rows["status"] == "excluded").sum() == 4 * len(plan.sessions)
    assert len(log.usable) == len(log) - 4 * len(plan.sessions)
    first = log.usable.iloc[0]
    assert first["steps_before"] == log.rows["steps"][:4].sum()


def test_in_random_order_the_warm_up_stays_first(write_plan):
    _, path = write_plan("prismatic")
    path.write_text(path.read_text("utf-8").replace('"as-written"', '"random"'))
    rows = read_plan(path, load_machine()).rows()
    for _, subset in rows.groupby("session", observed=True):
        assert list(subset["status"][:4]) == ["excluded"] * 4
        assert (subset["status"][4:] == "ok").all()
    orders = [tuple(subset["psi"]) for _, subset in rows.groupby("session", observed=True)]
    assert all(one != other for one, other in pairwise(orders))


def test_a_procedure_takes_nothing_else(run, refused, tmp_path):
    status, out, complained = run("plan", "--thesis", "rotary", "log.csv")
    assert (status, out) == (2, "")
    assert "takes no LOG|PLAN" in complained
    assert "--thesis" in refused("plan")
    status, out, _ = run("plan", "--thesis", "calibration")
    assert status == 0
    assert out.startswith("# The calibration of the thesis")
