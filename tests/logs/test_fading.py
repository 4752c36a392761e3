"""Sums that fade, against sums over all pairs of rows, and followers, against a differential equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stickslip_fit.logs.fading import Fading

MINUTE = 60.0


@pytest.mark.parametrize("longest", [300.0, 30_000.0, 3_000_000.0])
def test_what_is_summed_fades_with_age_however_long_a_group_is(longest):
    """Exponentials of a month over a minute are no numbers."""
    rng = np.random.default_rng(4)
    seconds, group = np.sort(rng.uniform(0.0, longest, 400)), rng.integers(0, 3, 400)
    seconds[200:260] = seconds[200] + np.sort(rng.uniform(0.0, 200.0, 60))  # some close to each other
    seconds.sort()
    added = rng.standard_normal(400)
    age = seconds[:, None] - seconds
    earlier = (group[:, None] == group) & np.tri(400, k=-1, dtype=bool)
    wanted = np.where(earlier, np.exp(-np.abs(age) / MINUTE), 0.0) @ added
    found = Fading(seconds, group, MINUTE).sum_before(added)
    np.testing.assert_allclose(found, wanted, atol=1e-8)  # less than 1e-9 of an addition counts as 0


def test_rows_on_either_side_of_a_block_s_end_belong_together():
    end = 300.0 * MINUTE
    seconds = np.array([0.0, end - 30.0, end + 30.0, end + 60.0])
    found = Fading(seconds, np.zeros(4, int), MINUTE).sum_before(np.ones(4))
    np.testing.assert_allclose(found, [0.0, 0.0, np.exp(-1.0), np.exp(-1.5) + np.exp(-0.5)], atol=1e-12)


def test_what_follows_begins_with_the_first_value_that_is_known():
    seconds = MINUTE * np.arange(6.0)
    values = np.array([np.nan, 2.0, 5.0, np.nan, 1.0, 1.0])
    found = Fading(seconds, np.zeros(6, int), 2.0 * MINUTE).follow(values)
    known = np.array([2.0, 2.0, 5.0, 5.0, 1.0, 1.0])
    solved = solve_ivp(
        lambda t, y: (np.interp(t, seconds, known) - y) / (2.0 * MINUTE),
        (seconds[1], seconds[-1]),
        [2.0],
        t_eval=seconds[1:],
        max_step=1.0,
        rtol=1e-10,
        atol=1e-10,
    )
    np.testing.assert_allclose(found, [np.nan, *solved.y[0]], atol=1e-6)
