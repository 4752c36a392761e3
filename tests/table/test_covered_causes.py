"""A second cause that bends the response as other forms of the first one do."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

import stickslip_fit as ssf
from stickslip_fit.diagnosis.covered_causes import find_covered
from stickslip_fit.diagnosis.extension import extend_problem

BOWL = ssf.Cause("bowl", "+ a*x**2", "a in 1")
QUARTIC = ssf.Cause("quartic", "+ s*x**4", "s in 1")  # as the square of a bowl
SIZES = {"a": 2.0, "s": 0.2}


def table(seed, s, rows=200):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2.0, 2.0, rows)
    y = 1.0 + 0.5 * x + SIZES["a"] * x**2 + s * x**4 + rng.normal(0.0, 0.5, rows)
    return pd.DataFrame({"x": x, "y": y})


def diagnose(seed, s):
    return ssf.diagnose_table(table(seed, s), "y ~ c + b*x", causes=[BOWL, QUARTIC], gain=False)


@pytest.mark.slow
@pytest.mark.parametrize("number", [3, pytest.param(40, marks=pytest.mark.nightly)])
def test_a_cause_like_the_square_of_another_is_found_beside_it(number):
    """The bowl alone would be 0.7 too large, eleven times half its interval."""
    right, inside = 0, 0
    for seed in range(number):
        found = diagnose(seed, SIZES["s"])
        if [one.cause for one in found.findings] == ["bowl", "quartic"]:
            sizes = {one.name: one.size for finding in found.findings for one in finding.parameters}
            inside += sum(sizes[name].low < truth < sizes[name].high for name, truth in SIZES.items())
            right += found.findings[1].p_value < 0.01
    assert right >= binom.ppf(0.01, number, 0.95)
    assert inside >= binom.ppf(0.001, 2 * right, 0.95)


@pytest.mark.slow
@pytest.mark.parametrize("number", [4, pytest.param(200, marks=pytest.mark.nightly)])
def test_a_bowl_alone_has_nothing_beside_it(number):
    wrong = sum([one.cause for one in diagnose(seed, 0.0).findings] != ["bowl"] for seed in range(number))
    assert wrong <= binom.ppf(0.99, number, 0.01)


def test_without_another_cause_nothing_is_covered():
    """As in a table of nothing but the time, whose causes are all in the law or count as known beside it."""
    signal = table(0, SIZES["s"]).assign(t=np.arange(200.0))
    found = ssf.diagnose_table(signal, "y ~ c + b*x", time="t", causes=[BOWL, QUARTIC], gain=False)
    problem, (bowl, _) = found.selection.problem, found.selection.law_causes
    covered = find_covered(extend_problem(problem, [bowl]), 0.01)
    assert covered is not None
    assert covered[0].cause == "quartic"
    alone = replace(problem, causes=problem.causes[:1], alternatives=lambda linearized: ())
    assert [cause.name for cause in alone.causes] == ["bowl"]
    assert find_covered(extend_problem(alone, [bowl]), 0.01) is None
