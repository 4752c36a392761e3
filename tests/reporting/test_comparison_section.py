"""The report's section on calibration strategies."""

import re

import pytest

from stickslip_fit.causes import ThermalWarmUp
from stickslip_fit.reporting import report
from stickslip_fit.reporting.sections import strategies_section
from stickslip_fit.strategies import (
    ClosedForm,
    ConstantStepStrategy,
    IOptimal,
    LeastSquares,
    WithCauses,
    causes_from_other_sessions,
    compare_strategies,
)
from stickslip_fit.strategies._summary import JointStrategies, strategies_table
from tests.conftest import CALIBRATION, SWEEPS

JOINT_3 = tuple(each for each in CALIBRATION + SWEEPS if each["joint"] == 3)
DATES = ("2012-03-05", "2012-03-06", "2012-03-07")
HOSTILE = "<b>third</b>"


@pytest.fixture(scope="module")
def made(campaign, fitted):
    """Three sessions, the last named like markup and without a calibration traverse."""
    table = campaign(DATES, JOINT_3)
    table["session"] = table["session"].replace(DATES[-1], HOSTILE)
    lacking = (table["session"] == HOSTILE) & (table["q2_deg"] == 0) & (table["theta_deg"] == 0)
    return fitted(table[~lacking])


@pytest.fixture(scope="module")
def found(made):
    return compare_strategies(made.log, [ConstantStepStrategy(), ClosedForm(), LeastSquares(IOptimal(), 2)])


@pytest.fixture(scope="module")
def source(made, found):
    return report(made.log, calibration=made.calibration, fit=made.fit, comparison=found, sections=()).html


@pytest.mark.slow
def test_the_section_shows_the_answer_the_numbers_and_the_picture(source, read_page, found):
    page = read_page(source)
    assert ("a", {"href": "#strategies"}) in page.elements
    assert "Least rms:" in page.text
    caption = "Strategies for joint 3 (prismatic)"
    assert page.tables[caption] == [list(row) for row in strategies_table(JointStrategies(found, 3)).rows]
    accuracy = found.accuracy().set_index("strategy")
    errors = "Joint 3 (prismatic): errors of the step size"
    for strategy, rms in zip(page.column(errors, "strategy"), page.column(errors, "rmsnm"), strict=True):
        assert float(rms.replace(",", "")) == pytest.approx(1e9 * accuracy.loc[strategy, "rms"], abs=0.051)
    assert ("figure", {"id": "pareto"}) in page.elements
    for part in (
        "where each strategy errs most",
        "claims, implies, and what is reached",
        "the thesis claims",
    ):
        assert any(name.startswith("Joint 3 (prismatic)") and name.endswith(part) for name in page.tables)


def test_what_was_left_out_is_said_with_its_reason_and_stays_text(source, read_page, found):
    page = read_page(source)
    (row,) = page.tables["Left out"]
    assert row[:4] == ["closed form", "3", "+ and −", HOSTILE]
    assert "lacks a full traverse at q2 = 0°, theta = 0°" in row[4]
    assert "b" not in {tag for tag, _ in page.elements}
    assert found.sessions(3) == DATES[:2]


def test_names_are_unique_and_nothing_is_fetched(source, read_page):
    names = [attributes["id"] for _, attributes in read_page(source).elements if "id" in attributes]
    assert len(names) == len(set(names))
    assert not re.search(r"https?:|@import|url\((?!#)", source)


@pytest.mark.slow
def test_one_session_says_what_its_intervals_are_over(made):
    log = made.log.select(made.log.rows["session"] == DATES[0])
    section = strategies_section(compare_strategies(log, [ConstantStepStrategy(), ClosedForm()]))
    assert "are over its configurations, since there is one session" in section.paragraphs[0]
    assert "Left out" not in [table.caption for table in section.tables]


@pytest.mark.slow
@pytest.mark.parametrize("sessions", [1, 2])
def test_causes_are_in_a_law_where_other_sessions_give_their_size(made, sessions):
    log = made.log.select(made.log.rows["session"].isin(DATES[:sessions]))
    known = causes_from_other_sessions(log, [ThermalWarmUp()])
    section = strategies_section(
        compare_strategies(log, [ConstantStepStrategy(), ClosedForm(), WithCauses(ClosedForm(), known)]),
        causes=["thermal-warm-up"],
    )
    (overview,) = (table for table in section.tables if table.caption == "Strategies")
    left_out = sessions == 1
    assert any("of the size that the other sessions give" in text for text in section.paragraphs) != left_out
    assert (overview.rows[-1][1:] == ("–", "–", "left out")) == left_out
    assert ("Left out: the table of that name says why" in overview.note) == left_out
