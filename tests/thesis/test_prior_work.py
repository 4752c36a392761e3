"""Chapters 1 and 2: the maker's numbers beside the thesis's own, and what it prints of others' models."""

import numpy as np
import pytest

from stickslip_fit.machine import load_machine
from tests.thesis.published import read, value


def test_fine_steps_give_the_reach_and_coarse_steps_do_not():
    """5 nm from 1e-7 rad; coarse steps of 75 to 115 µrad are a quarter of 20 µm there."""
    reach = value("fine_step_rotary") * 1e-9 / value("fine_resolution_rotary")
    assert reach * 1e3 == pytest.approx(value("reach"))
    machine = load_machine()
    assert machine.a1 + machine.l2 == pytest.approx(reach)

    assert value("piezo_range_rotary") * reach * 1e6 == pytest.approx(value("tip_move_of_the_piezo_range"))
    assert value("tip_move_of_the_piezo_range") == value("coarse_step_rotary")[0]
    assert value("piezo_range_rotary") * machine.l2 * 1e6 == pytest.approx(value("coarse_step_rotary")[1])

    coarse = value("gamma0_span") * reach  # µm
    assert coarse == pytest.approx(value("tip_move_of_a_coarse_step"))
    assert value("coarse_step_rotary")[0] > 3 * value("tip_move_of_a_coarse_step").max()
    assert value("coarse_step_rotary") / value("gamma0") * 1e3 == pytest.approx(
        value("reach_of_the_coarse_steps"), abs=0.5
    )


def test_the_pulse_lasts_one_period():
    assert 1 / value("pulse_frequency") == pytest.approx(value("pulse_duration"), abs=0.005)


def test_a_coarse_step_of_joint_3_is_of_the_order_that_the_maker_gives():
    orders = [value(name) for name in ("coarse_step_prismatic", "step_order_prismatic", "coarse_step_order")]
    assert value("a") * 1e-3 == pytest.approx(orders[:2], abs=0.15)
    assert len(set(orders)) == 1


def test_sigma0_jumps_as_printed():
    """Peng and Chen's sigma0(Me) is continuous to 1 % at 0.253 with Me in the third term."""
    low, high = value("sigma0_branch_points")
    first, second, third = (value(f"sigma0_{which}_branch") for which in ("first", "second", "third"))
    at_low = [np.polyval(branch, low) for branch in (first, second)]
    assert at_low == pytest.approx(value("sigma0_at_first_branch_point"), abs=0.5)

    as_printed = third @ [high**3, high**2, high**2, 1.0]
    assert [np.polyval(second, high), as_printed] == pytest.approx(
        value("sigma0_at_second_branch_point"), abs=0.5
    )
    assert as_printed > 6 * np.polyval(second, high)
    mended = np.polyval(third, high)
    assert mended == pytest.approx(value("sigma0_mended"), abs=0.5)
    assert mended == pytest.approx(np.polyval(second, high), rel=0.01)


def test_chang_and_li_as_printed_count_the_slider_twice():
    """Friction is inner: stage and slider together must gain momentum by spring and damper only."""
    stage, slider, friction, outer = 0.3, 0.05, 0.2, 1.7
    slider_acceleration = friction / slider

    def momentum_gained(inertia):
        return stage * (outer - friction) / inertia + slider * slider_acceleration

    assert momentum_gained(stage) == pytest.approx(outer)
    assert momentum_gained(stage + slider) < 0.9 * outer


def test_the_conclusion_is_in_the_last_chapter():
    assert value("chapter_of_the_conclusion") != max(read("places")["chapters"])
