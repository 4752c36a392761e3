"""The verb that writes the whole report."""

import pytest

from tests.conftest import CALIBRATION_3
from tests.reporting.test_poor_logs import PSI

SECTIONS = {"diagnosis": "What the simulation gets wrong", "strategies": "Which calibration to choose"}
DAYS = tuple(f"2012-03-{day:02d}" for day in range(1, 6))


@pytest.fixture
def written(run, tmp_path, read_page):
    """Write a table's report as the command line does, and read it."""

    def write(table, *options):
        table.to_csv(tmp_path / "log.csv", index=False)
        status, out, err = run("report", tmp_path / "log.csv", "-o", tmp_path / "page.html", *options)
        assert (status, err) == (0, "")
        assert out == f"report written to {tmp_path / 'page.html'}\n"
        return read_page((tmp_path / "page.html").read_text("utf-8"))

    return write


def headings(page):
    return {attributes["id"] for tag, attributes in page.elements if tag == "h2"}


def test_the_page_is_complete(written, campaign):
    page = written(campaign(settings=CALIBRATION_3 + PSI))
    assert {"answer", "measured", "parameters", "accuracy", "factors", *SECTIONS} <= headings(page)
    assert {"methods", "remarks", "provenance"} <= headings(page)
    assert "Mean step size of each traverse" in page.text
    strategies = page.column("Strategies for joint 3 (prismatic)", "strategy")
    assert {"constant step", "closed form", "Bayes, 2 I-optimal"} <= set(strategies)
    assert page.text.index("Nothing is wrong that this log can show") < page.text.index("Error on traverses")


@pytest.fixture(scope="module")
def single(campaign):
    """One session, in which each traverse is made once."""
    return campaign(("2012-03-05",), CALIBRATION_3, replicates=1)


@pytest.mark.slow
def test_what_is_not_wanted_is_left_out(written, single):
    page = written(single, "--no-diagnosis", "--no-strategies")
    assert {"answer", "parameters"} <= headings(page)
    assert not headings(page) & set(SECTIONS)


@pytest.mark.slow
def test_a_section_that_cannot_be_says_why_and_costs_nothing_else(written, single):
    page = written(single)
    assert set(SECTIONS) <= headings(page)
    assert (
        "This log cannot say: joint 3: nothing shows how well a traverse repeats, so that no difference "
        "between strategies could be judged; log some traverses twice."
    ) in page.text
    assert "Nothing can be said of this log" in page.text
    assert "Sessions and traverses" in page.tables


@pytest.mark.nightly
def test_many_sessions_are_compared_by_the_latest(written, campaign, monkeypatch):
    monkeypatch.setattr("stickslip_fit.reporting.page.MAX_COMPARED_SESSIONS", 3)
    page = written(campaign(DAYS, CALIBRATION_3 + PSI[:1]), "--no-diagnosis")
    assert "Compared on the latest 3 of 5 sessions" in page.text
