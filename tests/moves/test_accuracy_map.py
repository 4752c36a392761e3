"""The accuracy map against moves planned one by one, and its radius against draws."""

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit import InputError
from stickslip_fit.moves.error_ellipsoid import error_radius

Z_95 = 1.96


@pytest.fixture(scope="module")
def fit(campaign, read_table):
    return ssf.fit(read_table(campaign()))


def test_each_place_is_a_planned_move_from_the_nearest_stops(fit):
    found = ssf.map_accuracy(fit, grid=(5, 4))
    ranges = fit.machine.ranges
    for row, q2 in enumerate(found.q2):
        for column, q3 in enumerate(found.q3):
            goal = np.array([ranges[1][0], q2, q3])
            start = [min(ranges[joint], key=lambda end: abs(end - goal[joint - 1])) for joint in (1, 2, 3)]
            move = ssf.plan_move(fit, start, goal)
            assert found.error[row, column] == pytest.approx(
                float(error_radius(move.tip_covariance)), abs=1e-12
            )
            goal[0] = 0.0
            move = ssf.plan_move(fit, [ranges[1][0], *start[1:]], goal)
            assert found.error_far[row, column] == pytest.approx(float(error_radius(move.tip_covariance)))


def test_places_are_those_of_the_tip(fit):
    table = ssf.map_accuracy(fit, grid=(9, 3)).table
    level = table.query("abs(q2_deg + 90) < 1e-6").iloc[0]
    assert (level["radius_mm"], level["height_mm"]) == pytest.approx((50.0, 0.0), abs=1e-9)
    upright = table.query("abs(q2_deg) < 1e-6 and q3_mm == 12").iloc[0]
    assert (upright["radius_mm"], upright["height_mm"]) == pytest.approx((12.5, 49.5), abs=1e-9)


@pytest.mark.parametrize("sds", [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0.5, 0.2), (3, 2, 0.1)])
def test_the_radius_holds_95_percent_of_draws(sds):
    draws = np.random.default_rng(5).standard_normal((200_000, 3)) * sds
    inside = np.mean(np.linalg.norm(draws, axis=1) < error_radius(np.diag(np.square(sds, dtype=float))))
    assert inside == pytest.approx(0.95, abs=0.006)


def test_a_joint_without_calibration_stays_still_and_it_says_so(campaign, read_table):
    table = campaign()
    found = ssf.map_accuracy(ssf.fit(read_table(table[table["joint"] == 3])), grid=(3, 3))
    assert found.still == (1, 2)
    assert np.isnan(found.error_far).all()
    assert "Joints 1 and 2 have no calibration here and are left out." in " ".join(str(found).split())
    assert len(found.plot()) == 2, "the map and its colour scale"


def test_another_machine_is_refused(fit, tmp_path):
    machine = tmp_path / "slide.toml"
    machine.write_text(
        'name = "slide"\n[[joint]]\nname = "x"\nkind = "prismatic"\nrange_mm = [0, 20]\n', "utf-8"
    )
    lines = ["session,time,joint,direction,steps,q1_mm,theta_deg,psi_deg"]
    lines += [f"a,2026-03-02T08:{k:02d}:00,1,{'+-'[k % 2]},{20_000 + 5 * k},,0,0" for k in range(8)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", "utf-8")
    result = ssf.fit(ssf.read_log(tmp_path / "log.csv", machine=ssf.load_machine(machine)))
    with pytest.raises(InputError, match="moves and positions of the tip"):
        ssf.map_accuracy(result)
