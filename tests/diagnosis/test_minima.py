"""Roots and minima, beside those of scipy."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.special import ndtr, polygamma

from stickslip_fit.diagnosis.minima import find_root, minimize_between, minimize_simplex


@pytest.mark.parametrize(
    ("function", "low", "high"),
    [
        (lambda x: float(ndtr(x) - 1e-3), -40.0, 3.0),
        (lambda x: float(polygamma(1, x)) - 0.01, 1.0, 2000.0),
        (lambda x: x**3 - 2.0, -1.0, 300.0),
        (lambda x: 1.0 if x > 0.3 else -1.0, 0.0, 1.0),
    ],
)
def test_a_root_is_that_of_brent(function, low, high):
    found = find_root(function, low, high)
    assert found == pytest.approx(brentq(function, low, high), rel=1e-9, abs=1e-9)
    assert low <= found <= high


def test_a_minimum_between_two_numbers_is_that_of_brent():
    def function(x):
        return np.log1p(np.exp(2 * x)) - 20 * np.exp(2 * x) / (1 + np.exp(2 * x))

    known = minimize_scalar(function, bounds=(-1.0, 8.0), method="bounded", options={"xatol": 1e-9})
    assert minimize_between(function, -1.0, 8.0) == pytest.approx(known.x, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_simplex_moves_as_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    start = np.vstack([x := rng.normal(0, 2, 3), x + 0.2 * np.eye(3)])

    def function(values):
        x, y, z = values
        return float(np.abs(x - y) + (y - z**2) ** 2 + 0.1 * (z - 1) ** 2)

    options = {"initial_simplex": start, "xatol": 1e-4, "fatol": 1e-6, "maxiter": 1000, "maxfev": 10_000}
    known = minimize(function, x, method="Nelder-Mead", options=options)
    values, least = minimize_simplex(function, start, 1e-4, 1e-6, 1000)
    assert values == pytest.approx(known.x, abs=1e-12)
    assert least == pytest.approx(known.fun, abs=1e-12)
