import pandas as pd
import pytest

from stickslip_fit.reporting import report

MOST = 4_500_000


@pytest.mark.nightly
@pytest.mark.parametrize("days", [22, 100])
def test_a_page_does_not_grow_with_the_log(campaign, read_page, read_table, days):
    """Years of sessions: shown are the latest, and of too many points a sample; the page says so."""
    once = campaign(("2012-03-05",))
    years = pd.concat(
        [
            once.assign(
                session=f"day {day:03d}",
                time=(pd.to_datetime(once["time"]) + pd.Timedelta(days=2 * day)).dt.strftime(
                    "%Y-%m-%dT%H:%M:%S"
                ),
            )
            for day in range(days)
        ]
    )
    log = read_table(years)
    html = report(log, sections=()).html
    page = read_page(html)
    sessions = page.tables["Sessions and traverses"]
    assert [row[0] for row in sessions] == [f"day {day:03d}" for day in range(days - 10, days)]
    assert len(html.encode()) < MOST
    assert f"The latest 10 of {days} sessions." in html
    assert ("chosen at random" in html) == (days == 100)  # 22 days have few enough points to draw them all
    assert f"day {days - 1:03d}" in html
    assert "day 005" not in page.text
