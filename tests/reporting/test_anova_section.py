"""The section on factors: its numbers are the analysis's, and every reading is in its figures."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.anova import analyze_variance
from stickslip_fit.errors import InputError
from stickslip_fit.plotting.anova import draw_days, draw_directions, draw_rotations, factor_pictures
from stickslip_fit.reporting.sections import factors_section

ROTATION = tuple({"joint": 3, "q2_deg": -90.0, "theta_deg": theta} for theta in (0.0, -30.0, -90.0))
DAYS = ("2012-03-05", "2012-03-06", "2012-03-07")


@pytest.fixture(scope="module")
def turned(campaign, reported):
    return reported(campaign(DAYS, ROTATION, replicates=3))


@pytest.fixture(scope="module")
def found(turned):
    return analyze_variance(turned.log)


def asked(found, analysis):
    return [each for each in found.factor_tests if each.design.analysis == analysis]


def drawn(axis):
    """Heights of the readings, which have a marker of their own."""
    return np.sort(np.concatenate([line.get_ydata() for line in axis.lines if line.get_marker() == "o"]))


@pytest.mark.slow
def test_the_table_is_the_analysis(turned, found):
    caption = "Factors of joint 3 (prismatic)"
    names = turned.page.column(caption, "factor")
    seen = turned.page.column(caption, "difference (95 %)nm")
    sizes = [(each.effect.difference, each.effect.low, each.effect.high) for each in found.factor_tests]
    expected = ["{:.1f} ({:.1f} to {:.1f})".format(*(1e9 * size for size in each)) for each in sizes]
    assert [cell.replace("−", "-") for cell in seen] == expected
    assert names.count("day +") == names.count("day −") == 1
    assert names.count("direction") == 4
    assert names.count("normal-force +") == 4


def test_the_page_says_what_to_do(turned):
    assert "recalibrate each session" in turned.page.text.lower()
    assert "separate parameters for each direction: one set for both is off by" in turned.page.text
    captions = "Where the variation of joint 3 (prismatic) comes from"
    assert turned.page.column(captions, "source")[-1] == "direction, + minus −"


def test_every_reading_is_drawn_where_its_count_puts_it(turned, found):
    nm = 12e6 / (turned.log.usable["steps"] - 2.5)
    rows = turned.log.usable.assign(nm=nm)
    upright = rows[rows["theta"] == 0.0]
    sessions = list(turned.log.sessions)
    figure = draw_days(asked(found, "day"), sessions)
    for axis, sign in zip(figure.axes, "+-", strict=True):
        assert drawn(axis) == pytest.approx(np.sort(upright.loc[upright["direction"] == sign, "nm"]))
    both = draw_directions(asked(found, "direction"), sessions)
    assert drawn(both.axes[0]) == pytest.approx(np.sort(upright["nm"]))
    over = [each for each in asked(found, "normal-force") if each.design.session is None]
    for axis, sign in zip(draw_rotations(over).axes, "+-", strict=True):
        subset = rows[rows["direction"] == sign]
        less = subset["nm"] - subset.groupby("session")["nm"].transform("mean")
        assert drawn(axis) == pytest.approx(np.sort(less), abs=1e-6)


@pytest.mark.slow
def test_figures_stand_only_where_there_are_answers(found, campaign, read_table):
    keys = [picture.key for picture in factor_pictures(3, found.factor_tests)]
    assert keys == ["day-3", "direction-3", "normal-force-3"]
    one_day = analyze_variance(read_table(campaign(DAYS[:1], ROTATION)))
    assert [picture.key for picture in factor_pictures(3, one_day.factor_tests)] == [
        "direction-3",
        "normal-force-3",
    ]


@pytest.mark.slow
def test_a_log_that_answers_nothing_says_why(campaign, reported):
    page = reported(campaign(DAYS[:1], ROTATION[:1], directions=("+",), replicates=1)).page
    assert "all traverses are of one session" in page.text
    assert "driven in direction + only" in page.text
    assert "Factors of joint 3 (prismatic)" not in page.tables


@pytest.mark.slow
def test_of_many_sessions_the_latest_are_drawn_and_single_ones_not_listed(campaign, read_table):
    years = pd.concat(
        [
            campaign((f"2012-{month:02d}-{day:02d}",), ROTATION[:1], seed=31 * month + day)
            for month in range(1, 5)
            for day in range(1, 9)
        ]
    )
    part = factors_section(analyze_variance(read_table(years)))
    (alone,) = [table for table in part.tables if table.caption.startswith("Factors of")]
    assert part.figures[0].caption.endswith("The latest 30 sessions.")
    assert {row[1] for row in alone.rows} == {"all"}


@pytest.mark.slow
def test_more_answers_than_a_table_has_room_for_are_counted(campaign, read_table):
    days = tuple(f"2012-03-{day:02d}" for day in range(5, 14))
    part = factors_section(analyze_variance(read_table(campaign(days, ROTATION))))
    (alone,) = [table for table in part.tables if table.caption.startswith("Factors of")]
    assert {row[1] for row in alone.rows} == {"all"}
    assert "Not shown: 27 answers within single sessions." in alone.note


def test_a_notebook_is_given_the_axes_of_a_factor(found):
    both = found.plot_factor(3, "day")
    assert [axis.get_ylabel() for axis in both] == ["direction + (nm)", "direction − (nm)"]
    assert len(found.plot_factor(3, "direction")) == 1
    with pytest.raises(InputError, match=r"weather was not tested for joint 3; what was: .*joint 3's day"):
        found.plot_factor(3, "weather")
