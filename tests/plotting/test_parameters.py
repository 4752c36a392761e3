"""Control chart, forest and corner: what is drawn, against numbers got another way."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from stickslip_fit.bayes import fit_bayes
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation.prediction import control_chart
from stickslip_fit.plotting.parameters import control_picture, plot_control
from tests.conftest import CALIBRATION_3

NANO = np.array([1e9, 1.0, 1e9])  # a, b, c from SI to what is shown
DAYS = tuple(f"2012-03-{day:02d}" for day in range(1, 9))


@pytest.fixture(scope="module")
def days(campaign, fitted):
    """Eight sessions; the step size changes by 1 % from one to the next, and by 10 % to the last."""
    table = campaign(DAYS, CALIBRATION_3)
    factor = np.exp(0.01 * np.random.default_rng(3).standard_normal(len(DAYS)))
    factor[-1] *= 0.9
    table["steps"] = (
        table["steps"] / table["session"].map(dict(zip(DAYS, factor, strict=True))) // 5 * 5
    ).astype(int)
    return fitted(table)


@pytest.fixture(scope="module")
def posterior(days):
    return fit_bayes(days.log, target_ess=400, progress=False)


def panel(figure, title, row=0):
    """The axes of a parameter; the second row is direction -."""
    columns = [axes for axes in figure.axes if axes.get_title().split("\n")[0].split(" (")[0] == title]
    same = [axes for axes in figure.axes if axes.get_position().x0 == columns[0].get_position().x0]
    return sorted(same, key=lambda axes: -axes.get_position().y0)[row]


def drawn(axes, marker):
    """Places of all points with a marker, shape (n, 2)."""
    return np.concatenate([line.get_xydata() for line in axes.lines if line.get_marker() == marker])


def test_points_of_the_chart_are_the_estimates_and_those_outside_are_crosses(days):
    figure = plot_control(days.fit)
    chart = control_chart(days.fit)
    for row, direction in enumerate("+-"):
        for name, factor in zip("abc", NANO, strict=True):
            subset = chart[(chart["name"] == name) & (chart["direction"] == direction)]
            odd = subset["surprising"].to_numpy()
            axes, values = panel(figure, name, row), factor * subset["estimate"].to_numpy()
            for marker, which in (("o", ~odd), ("X", odd)):
                expected = np.column_stack([np.flatnonzero(which), values[which]])
                assert drawn(axes, marker) == pytest.approx(expected)
    crosses = [line for axes in figure.axes for line in axes.lines if line.get_marker() == "X"]
    assert sum(len(line.get_xdata()) for line in crosses) == chart["surprising"].sum() == 3
    assert {line.get_color() for line in crosses}.isdisjoint(
        line.get_color() for axes in figure.axes for line in axes.lines if line.get_marker() == "o"
    )


def test_limits_of_the_chart_are_those_of_the_fit_and_the_latest_stand_out(days):
    axes, chart = panel(plot_control(days.fit), "a"), control_chart(days.fit)
    subset = chart[(chart["name"] == "a") & (chart["direction"] == "+")].dropna(subset=["expected_low"])
    bars = {round(bar.get_x() + bar.get_width() / 2): bar for bar in axes.patches if bar.get_height() > 0}
    assert list(bars) == [3, 4, 5, 6, 7]
    for bar, row in zip(bars.values(), subset.itertuples(), strict=True):
        assert bar.get_y() == pytest.approx(1e9 * row.expected_low)
        assert bar.get_y() + bar.get_height() == pytest.approx(1e9 * row.expected_high)
    shades = [bar.get_facecolor() for bar in bars.values()]
    assert len(set(shades[:-1])) == 1
    assert shades[-1] != shades[0]


def test_every_estimate_is_in_view_however_wide_the_limits(days):
    for axes in plot_control(days.fit).axes:
        low, high = axes.get_ylim()
        for line in axes.lines:
            if line.get_marker() in ("o", "X"):
                assert all(low < y < high for y in line.get_ydata())


@pytest.mark.slow
def test_the_caption_names_what_is_outside(days):
    caption = control_picture(3, days.fit).caption
    assert (
        "Of 30 points with limits 3 are outside (crosses); in the latest session a (+), c (+) and a (−)"
        in caption
    )
    usual = days.log.select(days.log.rows["session"] < "2012-03-08")
    assert "Of 24 points with limits none is outside." in control_picture(3, fit_least_squares(usual)).caption


@pytest.mark.slow
def test_a_chart_of_all_joints_has_the_parameters_of_each(whole):
    titles = [axes.get_title().split(" (")[0] for axes in plot_control(whole.fit).axes]
    names = {parameter.name for fit in whole.fit.joints.values() for parameter in fit.law.parameters}
    assert names < set(titles)


def test_the_forest_has_every_session_in_order(days):
    axes = panel(days.fit.plot_forest(3).figure, "c", 1)
    subset = days.fit.si.parameters.query("name == 'c' and direction == '-'")
    assert drawn(axes, "o") == pytest.approx(np.column_stack([1e9 * subset["estimate"], range(8)]))
    ends = [path.vertices[:, 0] for path in axes.collections[0].get_paths()]
    assert np.array(ends) == pytest.approx(1e9 * subset[["low", "high"]].to_numpy())
    assert axes.get_ylim()[0] > axes.get_ylim()[1], "the first session is at the top"


def test_the_forest_of_a_posterior_shows_the_campaign_s_mean(posterior):
    axes = panel(posterior.plot_forest(3).figure, "a")
    mean = 1e9 * posterior.draws(3, "+", "mean")[:, 0]
    (band,) = axes.patches
    low, high = band.get_x(), band.get_x() + band.get_width()
    assert np.mean((mean > low) & (mean < high)) == pytest.approx(0.95, abs=0.005)


def test_what_all_sessions_share_is_a_band_of_the_forest(days):
    shared = fit_least_squares(days.log, shared=["b"])
    axes = panel(shared.plot_forest(3).figure, "b")
    (row,) = shared.si.parameters.query("name == 'b' and direction == '+'").itertuples()
    (band,) = axes.patches
    assert (band.get_x(), band.get_width()) == pytest.approx((row.low, row.high - row.low))
    assert len(drawn(axes, "o")) == 0


def cells(figure, count):
    """Axes of a corner plot by row and column."""
    return np.array(figure.axes[: count**2], dtype=object).reshape(count, count)


def inside(outline, draws):
    return np.mean(Outline(outline).contains_points(draws))


@pytest.mark.parametrize("df", [3, 2000])
def test_regions_of_the_corner_hold_what_they_say(days, df):
    """With few degrees of freedom the scale is uncertain too, and the ellipses have to be wider."""
    fit = days.fit.joints[3]
    known = {way: replace(found, df=df) for way, found in fit.repeatability.items()}
    doubted = replace(days.fit, joints={3: replace(fit, repeatability=known)})
    figure = doubted.plot_corner(3, "+", "2012-03-04").figure
    (index,) = np.flatnonzero((fit.groups["session"] == "2012-03-04") & (fit.groups["direction"] == "+"))
    rng, size = np.random.default_rng(0), 40_000
    scale = np.sqrt(rng.chisquare(df, (size, 1)) / df)
    draws = fit.values[index] + rng.multivariate_normal(np.zeros(3), fit.covariance[index], size) / scale
    draws *= NANO
    axes = cells(figure, 3)
    for row, column in ((1, 0), (2, 0), (2, 1)):
        small, large = (line.get_xydata() for line in axes[row, column].lines[:2])
        assert inside(small, draws[:, [column, row]]) == pytest.approx(0.68, abs=0.01)
        assert inside(large, draws[:, [column, row]]) == pytest.approx(0.95, abs=0.005)
    x, density = axes[1, 1].lines[-1].get_data()
    seen = np.mean((draws[:, 1] > x[0]) & (draws[:, 1] < x[-1]))
    assert np.trapezoid(density, x) == pytest.approx(seen, abs=0.005)


def test_contours_of_a_posterior_hold_what_they_say(posterior):
    figure = posterior.plot_corner(3, "-").figure
    draws = NANO * posterior.draws(3, "-", "parameters")[:, -1]
    axes = cells(figure, 3)
    for row, column in ((1, 0), (2, 0), (2, 1)):
        large, small = axes[row, column].collections[0].get_paths()
        for path, level in ((small, 0.68), (large, 0.95)):
            outline = max(path.to_polygons(), key=len)
            assert inside(outline, draws[:, [column, row]]) == pytest.approx(level, abs=0.03)


@pytest.mark.slow
def test_the_latest_session_is_drawn_unless_one_is_named(days, posterior):
    for shown in (days.fit, posterior):
        latest, named = (shown.plot_corner(3, "+", day).figure for day in (None, "2012-03-01"))
        assert "session 2012-03-08" in latest.texts[0].get_text()
        assert "session 2012-03-01" in named.texts[0].get_text()
        assert cells(latest, 3)[0, 0].get_xlim() != cells(named, 3)[0, 0].get_xlim()


def test_the_prior_is_drawn_beside_the_draws(posterior):
    """As the prior predicts a session: far wider than the counts leave it."""
    x, density = cells(posterior.plot_corner(3, "+").figure, 3)[0, 0].lines[-1].get_data()
    prior = posterior.priors.prior(3, "+")
    normal = (
        np.exp(-0.5 * ((x / 1e9 - prior.centre[0]) / prior.width[0]) ** 2)
        / np.sqrt(2 * np.pi)
        / prior.width[0]
    )
    assert density.mean() == pytest.approx(normal.mean() / 1e9, rel=0.3)
