"""The page that puts the thesis's claims to a simulated campaign, against independent arithmetic."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

EXTENSIONS = Path(__file__).parents[2] / "docs" / "_ext"


@pytest.fixture(scope="module")
def page():
    sys.path.insert(0, str(EXTENSIONS))
    try:
        import thesis_figures
    finally:
        sys.path.remove(str(EXTENSIONS))
    return thesis_figures


@pytest.fixture(scope="module")
def claims(page):
    return {claim.figure: claim for claim in page.claims()}


def test_every_figure_with_results_is_there(claims):
    assert " ".join(claims) == "4.4 4.6 4.8 4.10 4.13 5.1 5.5 5.6 5.7 6.2 6.4 6.5 6.6 6.7 7.1 7.2"


def test_what_the_printed_parameters_contradict_does_not_hold(claims):
    """a, b and c of Fig. 4.13 by hand: at q2 = -180 deg a step in - is (1 - b)(a + c)."""
    assert {figure for figure, claim in claims.items() if not claim.holds} - {"5.1"} == {"6.5", "7.1", "7.2"}
    worst = 100 * (899 / ((1 - 0.25) * (899 - 436)) - 1)
    assert worst == pytest.approx(158.9, abs=0.05)
    shown = float(claims["7.1"].shows.split("constant step ")[1].removesuffix(" %"))
    assert shown == pytest.approx(worst, abs=3)


def test_d_depends_on_gamma0_as_the_integral_says(page):
    def excess(d, gamma0):
        steps, _ = quad(lambda zeta: 1 / (gamma0 + d * np.sin(zeta)), -np.pi / 6, 7 * np.pi / 6)
        return 4 * np.pi / 3 / steps - gamma0 - 9.2e-6

    for gamma0 in (75e-6, 115e-6):
        (ours,) = page.solve_d(gamma0, np.array([9.2e-6]))
        assert ours == pytest.approx(brentq(excess, 0, 60e-6, args=(gamma0,)), rel=1e-6)


def test_days_that_do_not_differ_are_significant_as_often_as_alpha_says(page):
    assert page.share_significant(0.0) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 20_000))
    assert page.share_significant(1.838) > 0.8
