"""What a report says first: the diagnosis where there is one, and the accuracy without other reasons."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.anova import analyze_variance
from stickslip_fit.causes import Drift, ThermalWarmUp
from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import held_out_errors
from stickslip_fit.laws import expected_steps
from stickslip_fit.reporting import report
from stickslip_fit.reporting.headline import headline_table, write_headline
from tests.reporting.conftest import hours_in_session

SETTINGS = tuple(
    {"joint": 3, "q2_deg": q2, "theta_deg": theta} for q2 in (-90.0, -45.0, 0.0) for theta in (0.0, -90.0)
)
DATES = ("2012-03-05", "2012-03-06", "2012-03-07")
SHRINKS = 0.01  # an hour


@pytest.fixture(scope="module")
def made(campaign, fitted):
    """Three sessions in which steps shrink by 1 % an hour."""
    table = campaign(DATES, SETTINGS, replicates=2)
    steps = np.round(table["steps"] * (1.0 + SHRINKS * hours_in_session(table)) / 5.0).astype(int) * 5
    return fitted(table.assign(steps=steps), "drifting.csv")


@pytest.fixture(scope="module")
def found(made):
    return diagnose(made.log, causes=[Drift(), ThermalWarmUp()], alpha=0.02)


@pytest.fixture(scope="module")
def errors(made):
    return held_out_errors(made.log, made.calibration).si


def test_a_named_cause_comes_first_and_no_other_reason_is_given(made, found, errors):
    told = write_headline(made.log, made.calibration, errors, found)
    assert tuple(told[:2]) == found.summary().headline[:2]
    accuracy = told[2]
    assert "the extended law" in accuracy
    alone = " ".join(write_headline(made.log, made.calibration, errors))
    for guess in ("the law lacks something", "mostly have one sign"):
        assert guess not in " ".join(told)
    assert "the law lacks something" in alone or "mostly have one sign" in alone


def test_the_table_has_the_law_and_the_extended_law(made, found, errors):
    table = headline_table(made.log, made.calibration, made.fit, errors, found)
    heads = [(column.group, column.head) for column in table.columns]
    law, extended = (heads.index(("held-out traverses, rms", name)) for name in ("law", "extended law"))
    own = found.gain.by_joint
    assert len(table.rows) == len(own) == 2
    for row, (_, gain) in zip(table.rows, own.iterrows(), strict=True):
        assert float(row[law]) == pytest.approx(100 * gain["baseline"], rel=0.06)
        assert float(row[extended]) == pytest.approx(100 * gain["extended"], rel=0.06)
        assert float(row[extended]) < float(row[law])
    pooled = np.sqrt(np.average(own["extended"] ** 2, weights=own["traverses"]))
    assert pooled == pytest.approx(found.gain.extended)
    assert "extended law" not in [
        column.head for column in headline_table(made.log, made.calibration, made.fit, errors).columns
    ]


def test_a_dash_in_place_of_a_share_is_explained(made, errors, monkeypatch):
    known = headline_table(made.log, made.calibration, made.fit, errors)
    unknown = pd.Series(np.nan, errors.index)
    monkeypatch.setattr("stickslip_fit.reporting.headline.check_coverage", lambda *_: unknown)
    table = headline_table(made.log, made.calibration, made.fit, errors)
    assert all("–" in row for row in table.rows)
    assert "–: too few replicates" in table.note
    assert "too few replicates" not in known.note


def test_what_lies_outside_its_interval_is_not_called_explained_without_a_word(made, errors, monkeypatch):
    half = pd.Series(np.arange(len(errors)) % 2, errors.index, dtype=float)
    nothing = pd.DataFrame({"joint": [3], "p_value": [0.4]})
    monkeypatch.setattr("stickslip_fit.reporting.headline.check_coverage", lambda *_: half)
    monkeypatch.setattr("stickslip_fit.reporting.headline.assess_held_out", lambda *_: nothing)
    monkeypatch.setattr("stickslip_fit.reporting.headline._is_one_sided", lambda *_: False)
    told = " ".join(write_headline(made.log, made.calibration, errors))
    assert "no more than repeatability" in told
    assert re.search(
        r"in one direction only \d+(\.\d+)? % lie within the interval that should hold 95 %", told
    )
    assert "gives p = 0.40" in told


@pytest.mark.slow
def test_factors_are_told_without_the_cause(made, found, read_page):
    """Counts without the drift have no drift left, and no more scatter than was put in."""
    corrected = found.corrected_log().usable
    hours = corrected["session_seconds"].to_numpy() / 3600.0
    ratio = expected_steps(made.log.usable["steps"], 5) / expected_steps(corrected["steps"], 5)
    slope = np.polyfit(hours, np.log(ratio), 1)[0]
    assert slope == pytest.approx(SHRINKS, rel=0.2)
    drifting, clean = (
        {test.design.analysis: test for test in analyze_variance(log).factor_tests}
        for log in (made.log, found.corrected_log())
    )
    assert clean["day"].detectable < 0.5 * drifting["day"].detectable
    source = report(made.log, calibration=made.calibration, fit=made.fit, diagnosis=found, sections=()).html
    page = read_page(source)
    assert "is taken out of the counts first" in page.text
    assert {"Factors of joint 3 (prismatic), counts as they are", "What is wrong"} <= set(page.tables)
    assert ("a", {"href": "#diagnosis"}) in page.elements
    names = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(names) == len(set(names))


def test_only_a_log_has_counts_to_correct(found):
    with pytest.raises(InputError, match="not of a log"):
        replace(found, log=None).corrected_log()


def test_methods_can_be_cited_with_the_numbers_of_this_log(found):
    text = found.methods()
    assert f"The step counts of {len(found.log.usable)} traverses in 3 sessions" in text
    assert found.findings[0].cause in text
    body, references = text.split("References")
    for name, year in re.findall(r"([A-Z][a-z]+)(?: et al\.| and \w+)?,? (\d{4})", body):
        assert any(name in line and year in line for line in references.splitlines()), name
    assert len(references.strip().splitlines()) >= 6


def test_what_differs_by_session_takes_no_part_in_strategies(made, found, monkeypatch):
    """A session's own function cannot be known from the other sessions."""
    known = []

    def refuse(log, laws, causes, command):
        known.append(list(causes))
        raise InputError("not compared")

    monkeypatch.setattr("stickslip_fit.reporting.page._compare_strategies", refuse)
    monkeypatch.setattr("stickslip_fit.reporting.page._render", lambda *_, **__: "")
    (finding,) = [one for one in found.findings if one.version is not None]
    by_session = replace(finding, version=SmoothTerm(sessions=DATES))
    given = {"calibration": made.calibration, "fit": made.fit}
    for one in (finding, by_session):
        diagnosis = replace(found, findings=(one,))
        report(made.log, **given, diagnosis=diagnosis, sections=("strategies",))
    assert known == [[finding.version], []]
