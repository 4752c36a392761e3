"""P-values of held-out errors are uniform where the law holds, and small where it doesn't."""

import numpy as np
import pytest
from scipy import stats

from stickslip_fit.estimation import fit_closed_form
from stickslip_fit.estimation.prediction import assess_held_out


@pytest.fixture(scope="module")
def exact(campaign):
    """Counts without noise or rounding to checks."""
    return campaign(repeatability=0.0, check_every=1)


def misfit(exact, read_table, rng, added=0.0):
    """Of the same campaign with fresh noise, and with log steps added to some traverses."""
    rows = exact.copy()
    noisy = rows["steps"] * np.exp(0.0027 * rng.standard_normal(len(rows)) + added)
    rows["steps"], rows["check_every"] = 5 * np.ceil(noisy / 5).astype(int), 5
    log = read_table(rows)
    return assess_held_out(log, fit_closed_form(log))


@pytest.mark.slow
@pytest.mark.parametrize("campaigns", [5, pytest.param(200, marks=pytest.mark.nightly)])
def test_p_values_are_uniform_where_the_law_holds(exact, read_table, campaigns):
    rng = np.random.default_rng(8)
    found = [misfit(exact, read_table, rng) for _ in range(campaigns)]
    assert all(len(each) == 6 for each in found)
    p_values = np.concatenate([each["p_value"] for each in found])
    assert stats.kstest(p_values, "uniform").pvalue > 0.01
    assert np.sum(p_values < 0.01) <= stats.binom.ppf(0.999, len(p_values), 0.01)


def test_what_the_law_lacks_is_seen_where_it_acts(exact, read_table):
    odd = ((exact["joint"] == 3) & (exact["psi_deg"] != 0)).to_numpy() * 0.03
    found = misfit(exact, read_table, np.random.default_rng(1), odd).set_index(["joint", "direction"])
    assert (found.loc[3, "p_value"] < 1e-4).all()
    assert (found.loc[[1, 2], "p_value"] > 1e-3).all()


def test_without_replicates_there_is_nothing_to_compare_with(campaign, read_table):
    log = read_table(campaign(replicates=1, sessions=("2012-03-05",)))
    assert assess_held_out(log, fit_closed_form(log)).empty
