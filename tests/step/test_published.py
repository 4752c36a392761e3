"""Numbers of the works that the thesis reviews (Sec. 2.2), as docs/explanation/step.md quotes them."""

import numpy as np
import pytest

from stickslip_fit.step import drive_ratio, is_friction_limited, step_size

GRAVITY = 9.80665


def test_lockwoods_eight_percent_fits_both_regimes():
    load = GRAVITY * np.array([-1.0, 0.0, 1.0])
    friction = 25 * GRAVITY
    limited = step_size(friction, 1e-4, 1e-5, load)
    assert is_friction_limited(friction, 1e-4, 1e-5, load).all()
    assert (limited[0] - limited[2]) / (2 * limited[1]) == pytest.approx(0.08, rel=0.01)
    friction = 5 * GRAVITY
    amplitude = 0.4 * friction * 1e-4**2
    reached = step_size(friction, 1e-4, amplitude, load)
    assert drive_ratio(friction, 1e-4, amplitude) / 5 == pytest.approx(0.08)
    assert not is_friction_limited(friction, 1e-4, amplitude, load).any()
    assert (reached[0] - reached[2]) / (2 * reached[1]) == pytest.approx(0.08, rel=0.05)


def test_the_branches_of_peng_and_chens_stiffness_join_if_the_misprint_is_read_as_meant():
    first, second = np.poly1d([-5.07e5, 1.25e5, 287, 90.8]), np.poly1d([4.71e5, -3.35e5, 7.22e4, -3.66e3])
    assert second(0.157) == pytest.approx(first(0.157), rel=0.02)
    meant = np.poly1d([-2.29e4, 4.06e4, -2.29e4, 4.36e3])
    printed = np.poly1d([-2.29e4, 4.06e4 - 2.29e4, 0, 4.36e3])
    assert meant(0.253) == pytest.approx(second(0.253), rel=0.005)
    assert printed(0.253) > 6 * second(0.253)
