"""NIST's 11 analyses of variance, as far as the doubles of their data allow."""

import numpy as np
import pytest

from benchmarks.nist_anova import FILES, NAMES, Certified, by_formula, digits, exact, ours, read
from stickslip_fit.anova.contrasts import build_comparison, sums_of_squares

LIMITED = {"AtmWtAg": 10.0, "SmLs04": 9.9, "SmLs05": 9.9, "SmLs06": 9.9} | dict.fromkeys(
    ("SmLs07", "SmLs08", "SmLs09"), 3.9
)
ROUNDED = 13.0  # digits that working in doubles leaves of exact arithmetic on the same doubles


@pytest.fixture(scope="module")
def problems() -> list[Certified]:
    found = [read(path) for path in FILES]
    assert len(found) == 11
    return found


def test_every_certified_value_is_met_as_far_as_the_data_s_doubles_allow(problems):
    for problem in problems:
        for name, found, certified in zip(NAMES, ours(problem), problem.certified, strict=True):
            assert digits(found, certified) >= LIMITED.get(problem.name, ROUNDED), (problem.name, name)


def test_a_formula_has_the_certified_f(problems):
    for problem in problems:
        if len(problem.values) < 2000:
            found = digits(by_formula(problem), problem.certified[0])
            assert found >= LIMITED.get(problem.name, ROUNDED), problem.name


def test_the_arithmetic_is_exact_to_the_last_digits_on_those_doubles(problems):
    for problem in problems:
        if len(problem.values) > 2000:
            continue  # the same levels as the smaller sets; rational arithmetic takes too long
        for name, found, true in zip(NAMES, ours(problem), exact(problem), strict=True):
            assert digits(found, true) >= ROUNDED, (problem.name, name)


def test_integers_with_thirteen_leading_digits_in_common_lose_nothing(problems):
    """As SmLs07, but counted in whole tenths, which doubles hold exactly."""
    problem = next(problem for problem in problems if problem.name == "SmLs07")
    tenths = np.round((problem.values - 1e12) * 10) + 1e13
    found = sums_of_squares(tenths, build_comparison(problem.group))
    assert digits(float(found.statistic), problem.certified[0]) >= 14
    assert digits(float(found.within), 100 * problem.certified[2]) >= 14
