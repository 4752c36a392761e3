"""Sizes in what people read of a table's diagnosis: of what is withdrawn, and of what is barely there."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit._format import format_measured
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.effect_interval import strength_interval
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.selection import refit_selection
from stickslip_fit.diagnosis.unknown_size import compare_causes, size_unknown
from stickslip_fit.diagnosis.withdrawal import withdraw_causes
from stickslip_fit.units import Interval


def withdraw(diagnosis, effect=None):
    """The diagnosis if its cause had doubled the error on held-out rows."""
    (finding,) = diagnosis.findings
    poor = replace(finding, gain=replace(finding.gain, extended=2.0 * finding.gain.baseline, given_before=()))
    poor = replace(poor, effect=effect or poor.effect)
    selection, findings = withdraw_causes(diagnosis.selection, [poor], [poor], diagnosis.table)
    return replace(diagnosis, findings=findings, selection=selection, verdict="unknown cause")


def test_what_is_withdrawn_is_said_with_its_own_size(named):
    answer, (found,) = withdraw(named), named.findings
    (unknown,) = answer.findings
    assert unknown.effect == found.effect
    assert unknown.closest == found.cause
    assert unknown.share == pytest.approx(1.0)
    assert re.search(
        r"^Viscous friction differs between directions \(dFv = 1\.\d+ N s/m\): of all that was searched this "
        r"fits best \(p = 0\.0\d+\), but held-out rows are not predicted better with it \(0\.\d+ N, without "
        r"it 0\.\d+ N\), so that viscous-by-direction is not named\.$",
        answer.summary().headline[0],
    )
    (table,) = [one for one in answer.summary().sections[1].tables if one.caption == "Candidate causes"]
    factors = {row[0]: row[2] for row in table.rows}
    assert factors["unknown"] == "> 1,000,000"


@pytest.mark.slow
def test_of_an_estimate_of_zero_the_most_that_it_may_be_is_told(days):
    """Barely detected: the estimate is 0, given that it was."""
    answer = withdraw(days, Interval(0.0, 0.0, 0.378))
    text = answer.summary().headline[0]
    assert "The response follows the column T, by at most 0.378 mV rms" in text
    (row,) = answer.summary().sections[0].tables[0].rows
    assert row[1] == "< 0.38"


@pytest.fixture(scope="module")
def days():
    rng = np.random.default_rng(3)
    x, warm = rng.uniform(0, 10, 180), rng.uniform(18, 24, 180)
    y = 2 * x + 5 + 0.3 * warm + 0.2 * rng.standard_normal(180)
    law = ssf.Law("y ~ slope*x + offset", units={"y": "mV"})
    return ssf.diagnose_table(pd.DataFrame({"x": x, "T": warm, "y": y}), law)


def test_below_its_threshold_an_effect_may_be_anything_up_to_its_length():
    """The alarm then came of more than this effect: conditioning on its own detection made it 0 to 0."""
    low, high = strength_interval(3.0, 1, 4.0), strength_interval(3.0, 1, 2.9)
    assert (low.low, low.estimate) == (0.0, pytest.approx(3.0))
    assert low.high == pytest.approx(3.0 + 1.96, abs=0.01)
    assert high.low == 0.0


def test_no_size_is_shown_as_zero_that_is_not_zero():
    """In units of either end of the range in which numbers are written out."""
    for unit in 10.0 ** np.arange(-12, 6):
        shown = format_measured(Interval(0.0021, 0.0, 0.9).times(unit))
        assert float(shown.split("×")[0].replace(",", "")) > 0, shown


@pytest.mark.slow
def test_structure_of_which_no_cause_is_named_is_told_by_the_cause_that_it_is_most_like(days):
    """Not by the likeliest unstructured alternative, which may have nothing to do with it."""
    (one,) = days.selection.selected
    causes = form_cause_set(one.misfit, UNKNOWN)
    unknown = replace(one, cause=UNKNOWN, version=None, start=np.zeros(0), cause_set=causes)
    finding = size_unknown(refit_selection(days.selection, (unknown,)), unknown, days.alpha)
    assert finding.carrier == "covariate:T to some extent"
    assert finding.effect.estimate == pytest.approx(days.findings[0].effect.estimate, rel=0.1)
    assert max(finding.explains.values()) == pytest.approx(1.0)
    text = replace(days, findings=(finding,)).summary().headline[0]
    assert "follows T to some extent, but by the evidence of one or two rows" in text
    assert "no cause that was searched" not in text


@pytest.mark.slow
def test_shares_of_a_structure_are_at_most_all_of_it():
    """Of a sudden change beside a law's parameters that all rows share."""
    rng = np.random.default_rng(7)
    t = np.arange(200.0)
    y = 2.0 * np.exp(-t / 60.0) + 0.3 * (t > 90) + 0.05 * rng.standard_normal(200)
    law = ssf.Law("y ~ a*exp(-t/b) + c", start={"a": 2.0, "b": 60.0}, shared="all")
    found = ssf.diagnose_table(pd.DataFrame({"t": t, "y": y}), law, time="t", gain=False)
    misfit = found.selection.selected[0].misfit
    shares = compare_causes(misfit, "sudden-change")["explains"]
    assert max(shares.values()) == pytest.approx(1.0)
