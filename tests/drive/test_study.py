"""Random drives by a fitted law, stepped by the true one: where the tip ends, and where it is said to be.

The bounds are those of the claims, less three standard errors of the shares of so many drives.
"""

import numpy as np
import pytest

from benchmarks.drive import run


def least(share, drives):
    return share - 3 * np.sqrt(share * (1 - share) / drives)


@pytest.mark.nightly
def test_a_few_drives_end_where_they_are_said_to():
    found = run(campaigns=2, drives=5, seed=3)
    assert found.near >= least(0.95, 10)
    assert least(0.93, 10) <= found.covered
    assert found.radius < 6e-6
    assert found.cpu < 0.2e-3


@pytest.mark.nightly
def test_many_drives():
    drives = 400
    found = run(campaigns=20, drives=20, seed=4)
    assert found.near >= least(0.95, drives)
    assert least(0.95, drives) - 0.02 <= found.covered <= 0.97 + 0.01
    assert found.advised >= least(0.95, drives / 2)
    assert 0.2e-6 < found.tolerance < found.radius


@pytest.mark.nightly
def test_a_constant_step_size_ends_far_off():
    found = run(campaigns=10, drives=10, seed=5, constant=True)
    assert 0.10 <= found.off_path <= 0.15
    assert found.covered < 0.05


@pytest.mark.nightly
def test_a_hidden_warm_up_is_seen_by_the_extended_law_only():
    published = run(campaigns=10, drives=15, seed=6, warm=True)
    extended = run(campaigns=10, drives=15, seed=6, warm=True, fitted=True)
    assert published.covered < 0.3
    assert extended.covered >= least(0.95, 150) - 0.02
    assert extended.near >= least(0.95, 150)
