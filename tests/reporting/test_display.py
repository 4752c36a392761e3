"""Logs and results as a notebook shows them, read the way a browser would."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes

from stickslip_fit.anova import analyze_formula, analyze_variance
from stickslip_fit.bayes import fit_bayes
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.strategies import ClosedForm, ConstantStepStrategy, compare_strategies
from tests.conftest import CALIBRATION_3

SCRIPT = "<script>alert(1)</script>"
IMAGE = '"><img src=x onerror=alert(2)>'
JINJA = "{{ 7 * 7 }}"
CLOSING = "</table></style></div>"
SCALE = {"nm": 1e9, "µrad": 1e6, "µrad/mm": 1e3, "1": 1.0}
CAPTION = "Parameters of joint 3 (prismatic)"


def number(cell):
    return float(cell.replace("−", "-"))


@pytest.fixture(scope="module")
def months(campaign, fitted):
    """Fourteen sessions of joint 3."""
    days = tuple(f"2012-03-{day:02d}" for day in range(1, 15))
    return fitted(campaign(days, CALIBRATION_3), name="a<b>&.csv")


@pytest.fixture(scope="module")
def shown(months, read_page):
    return read_page(months.fit._repr_html_())


def test_cells_are_the_parameters_in_peoples_units(months, shown):
    table = months.fit.si.parameters
    for line, cells in enumerate(
        zip(*(shown.column(CAPTION, head) for head in ("anm", "b", "cnm")), strict=True)
    ):
        session, direction = shown.tables[CAPTION][line][:2]
        subset = table[(table["session"] == session) & (table["direction"] == direction.replace("−", "-"))]
        for cell, row in zip(cells, subset.itertuples(), strict=True):
            value, error = cell.split(" ± ")
            digit = 0.5001 * 10.0 ** -len(error.partition(".")[2])
            assert abs(number(value) - row.estimate * SCALE[row.unit]) <= digit
            assert abs(number(error) - row.standard_error * SCALE[row.unit]) <= digit


def test_the_last_ten_sessions_are_shown_and_it_says_so(shown):
    sessions = dict.fromkeys(row[0] for row in shown.tables[CAPTION])
    assert list(sessions) == [f"2012-03-{day:02d}" for day in range(5, 15)]
    assert "The latest 10 of 14 sessions." in shown.text


def test_a_short_result_leaves_nothing_out(whole, read_page):
    page = read_page(whole.fit._repr_html_())
    assert "The latest" not in page.text
    assert [len(page.tables[caption]) for caption in page.tables] == [4, 4, 4]


def test_what_is_wrong_is_said_in_words(campaign, fitted, read_page):
    poor = fitted(campaign(settings=CALIBRATION_3[:1], replicates=1, sessions=("2012-03-05",)))
    page = read_page(poor.fit._repr_html_())
    assert page.column(CAPTION, "b") == ["not known", "not known"]
    for said in page.column(CAPTION, "remarks"):
        assert "b and c: cannot be known from this log" in said
        assert "too few replicates for error bars" in said
    assert "missing: a full traverse at q2 = 0°" in page.text
    assert "not_identified" not in page.text
    assert "nan" not in page.text.lower().split()


def test_parameters_that_all_sessions_share_are_shown_once(months, read_page):
    shared = fit_least_squares(months.log, shared=["b"])
    page = read_page(shared._repr_html_())
    of_all = [row for row in page.tables[CAPTION] if row[0] == "all sessions"]
    table = shared.si.parameters[shared.si.parameters["session"].isna()]
    assert [number(row[3].split(" ± ")[0]) for row in of_all] == pytest.approx(
        list(table["estimate"]), abs=1e-4
    )
    assert {row[3] for row in page.tables[CAPTION] if row[0] != "all sessions"} == {""}


def test_where_it_comes_from_is_folded_away(months, shown):
    tags = [tag for tag, _ in shown.elements]
    assert tags.index("details") > max(place for place, tag in enumerate(tags) if tag == "table")
    assert not any("open" in attributes for tag, attributes in shown.elements if tag == "details")
    source = months.fit.provenance
    for known in (source.log_sha256, source.machine_sha256, source.versions["numpy"], "a<b>&.csv"):
        assert known in shown.text


def test_the_fragment_needs_and_touches_nothing_but_itself(months):
    for html in (months.fit._repr_html_(), months.log._repr_html_()):
        assert not any(word in html for word in ("http:", "https:", "@import", "url(", "<script", "<link"))
        style = html.split("<style>")[1].split("</style>")[0]
        rules = [line.split("{")[0].strip() for line in style.splitlines() if "{" in line]
        assert rules
        assert all(rule.startswith((".stickslip-fit", "@media")) for rule in rules)


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [
        (SCRIPT, CLOSING),
        *(
            pytest.param(names, marks=pytest.mark.nightly)
            for names in ((IMAGE, JINJA), ("A</details>B", SCRIPT))
        ),
    ],
)
def test_hostile_session_names_are_shown_as_they_are_written(campaign, fitted, read_page, names):
    table = campaign(settings=CALIBRATION_3, replicates=3)
    table["session"] = table["session"].map(dict(zip(("2012-03-05", "2012-03-06"), names, strict=True)))
    found = fitted(table)
    for shown in (found.log, found.fit, found.calibration, analyze_variance(found.log)):
        page = read_page(shown._repr_html_())
        assert {*names} <= {cell for rows in page.tables.values() for row in rows for cell in row}
        assert not {"script", "img"} & {tag for tag, _ in page.elements}
        assert not any(key.startswith("on") for _, attributes in page.elements for key in attributes)


def test_a_log_shows_what_was_driven(campaign, read_page, read_table):
    table = campaign(tuple(f"2012-03-{day:02d}" for day in range(1, 15)), CALIBRATION_3)
    table["status"] = ["interrupted"] + ["ok"] * (len(table) - 1)
    log = read_table(table)
    page = read_page(log._repr_html_())
    sessions = page.tables["Sessions and traverses"]
    assert [row[0] for row in sessions] == list(log.sessions[-10:])
    assert {tuple(row[3:5]) for row in sessions} == {("6", "6")}
    assert "The latest 10 of 14 sessions." in page.text
    assert "1 interrupted traverse" in page.text
    assert log.sha256 in page.text


@pytest.fixture(scope="module")
def posterior(months):
    return fit_bayes(
        months.log.select(months.log.rows["session"] > "2012-03-10"), target_ess=400, progress=False
    )


def test_a_posterior_shows_its_draws_quality_and_its_priors(posterior, read_page):
    page = read_page(posterior._repr_html_())
    assert posterior.quality in page.text
    assert "campaign mean" in page.text
    assert page.text.count("Where this comes from") == 1
    assert len(page.tables[CAPTION]) == 8


@pytest.mark.slow
def test_a_posterior_that_has_not_converged_shows_no_numbers(months, read_page):
    log = months.log.select(months.log.rows["session"] > "2012-03-11")
    page = read_page(fit_bayes(log, max_steps=20, target_ess=10**6, progress=False)._repr_html_())
    assert all("not converged" in row[-1] for row in page.tables[CAPTION])
    assert all(row[2:5] == ["not known"] * 3 for row in page.tables[CAPTION])


@pytest.fixture(scope="module")
def plotted(months, posterior):
    return (
        months.fit.plot_corner(3, "+"), months.fit.plot_forest(3), months.fit.plot_control(),
        posterior.plot_corner(3, "-"), posterior.plot_forest(3), posterior.plot_control(),
    )  # fmt: skip


@pytest.mark.slow
def test_figures_show_themselves_in_a_notebook(plotted):
    """As pictures of a size, on white: ink on a dark notebook could not be read."""
    for shown in plotted[::2]:  # one of each kind
        picture, size = shown._repr_png_()
        assert picture.startswith(b"\x89PNG")
        assert size["width"] == pytest.approx(100 * shown.figure.get_figwidth(), abs=1)
        assert shown.figure.get_facecolor() == (1.0, 1.0, 1.0, 1.0)


def test_plots_give_the_axes_and_leave_nothing_open(plotted):
    """A figure that pyplot knew of would be shown a second time below its cell."""
    import matplotlib.pyplot as plt

    for shown in plotted:
        assert shown.size
        assert all(isinstance(axes, Axes) and axes.get_visible() for axes in shown)
        assert repr(shown) == f"{shown.size} panels of a figure"
    assert plt.get_fignums() == []
    assert plotted[0].size == 6, "the upper right of a corner is empty"


def test_what_is_changed_is_shown_changed_and_written(months, tmp_path):
    shown, before = months.log.plot(), months.log.plot()._repr_png_()[0]
    assert shown._repr_png_()[0] == before
    shown[0].set_title("of our own")
    assert shown._repr_png_()[0] != before
    shown.savefig(tmp_path / "log.svg")
    assert "of our own" in (tmp_path / "log.svg").read_text("utf-8")


@pytest.mark.slow
def test_what_shows_itself_prints_as_its_summary(months, posterior, factors):
    for shown in (months.log, months.fit, posterior, factors):
        text = str(shown)
        assert text == repr(shown) == str(shown.summary())
        assert len(text) < 20_000
        assert "2012-03-14" in text


def test_a_log_draws_every_usable_reading(months):
    (axes,) = months.log.plot()
    rows = months.log.usable
    drawn = np.concatenate([line.get_xydata() for line in axes.lines if line.get_marker() in "os"])
    step = 12e6 / (rows["steps"] - 2.5)
    assert drawn[np.argsort(drawn[:, 0]), 1] == pytest.approx(step.to_numpy())
    assert len(axes.get_xticklabels()) == 7, "14 sessions have no room for all their names"


@pytest.fixture(scope="module")
def factors(months):
    return analyze_variance(months.log)


def test_factors_are_shown_with_sizes_and_adjusted_p(factors, read_page):
    page = read_page(factors._repr_html_())
    table = page.tables["Factors of joint 3 (prismatic)"]
    assert len(table) == len(factors.factor_tests)
    cells = page.column("Factors of joint 3 (prismatic)", "difference (95 %)nm")
    sizes = [number(cell.split()[0]) for cell in cells]
    assert sizes == pytest.approx([1e9 * each.effect.difference for each in factors.factor_tests], abs=0.051)
    told = [row[7] for row in table]
    assert [cell.startswith("<") for cell in told] == [each.p_holm < 1e-4 for each in factors.factor_tests]
    assert "no change from session to session shows" in page.text


def test_a_log_of_which_nothing_can_be_asked_says_so(campaign, read_table, read_page):
    single = read_table(campaign(settings=CALIBRATION_3[:1], replicates=1, sessions=("2012-03-05",)))
    page = read_page(analyze_variance(single.select(single.rows["direction"] == "+"))._repr_html_())
    assert "Nothing can be answered from this log." in page.text
    assert not page.tables


def test_a_formula_shows_its_terms(months, read_page):
    (found,) = analyze_formula(months.log, "step_size ~ C(session) + direction")
    page = read_page(found._repr_html_())
    (table,) = page.tables.values()
    assert [row[0] for row in table] == ["C(session)", "direction", "residual"]
    assert float(table[1][4]) == pytest.approx(found.table["F"][1], rel=0.005)
    assert table[2][4:] == ["", "", "", ""]
    assert found.formula in page.text


@pytest.mark.slow
def test_a_comparison_has_its_verdicts_in_view(months, read_page):
    found = compare_strategies(
        months.log.select(months.log.rows["session"] > "2012-03-10"), [ConstantStepStrategy(), ClosedForm()]
    )
    caption = "Strategies for joint 3 (prismatic)"
    page = read_page(found._repr_html_())
    assert len(page.heads[caption]) == 9, "more do not fit a notebook"
    assert page.column(caption, "verdict") == ["worse", "least rms"]
    cost = found.cost().set_index("strategy")["seconds"]["closed form"] / 60
    assert float(page.column(caption, "timemin")[1]) == pytest.approx(cost, abs=0.51)


@pytest.mark.slow
def test_a_diagnosis_gives_its_numbers_as_tables(months):
    """Of a drift that was put into the counts, 3 % an hour."""
    log = months.log.select(months.log.rows["session"] > "2012-03-10")
    rows = log.rows.copy()
    rows["steps"] = (rows["steps"] * (1 + 0.03 * rows["session_seconds"] / 3600)).round().astype(int)
    found = diagnose(replace(log, rows=rows), gain=False)
    assert found.verdict != "nothing wrong"
    of = found.si.parameters
    assert set(of["cause"]) == {each.cause for each in found.findings if each.parameters}
    sizes = [one.size for each in found.findings for one in each.parameters]
    assert of[["estimate", "low", "high"]].to_numpy() == pytest.approx(
        np.array([(size.estimate, size.low, size.high) for size in sizes])
    )
    ranked = found.ranking
    assert dict(zip(ranked["cause"], ranked["untestable"], strict=True)).items() >= found.untestable.items()
    assert ranked["probability"].isna().sum() == len(found.untestable)
    assert ranked["probability"].dropna().is_monotonic_decreasing
    left = found.residuals
    assert list(left["steps"]) == list(rows["steps"])
    assert np.sqrt((left["before"] ** 2).mean()) == pytest.approx(found.misfit)
    assert (left["after"] ** 2).mean() < (left["before"] ** 2).mean() / 4
    assert repr(found) == str(found.summary())


def test_what_was_not_fitted_is_refused(months, posterior):
    for shown in (months.fit, posterior):
        with pytest.raises(
            InputError, match=r"joint 1, direction [+] was not fitted; fitted were 3 [+], 3 -"
        ):
            shown.plot_corner(1, "+")
        with pytest.raises(InputError, match="session 'never' was not fitted"):
            shown.plot_corner(3, "+", "never")
        with pytest.raises(InputError, match="joint 2 was not fitted"):
            shown.plot_forest(2)


def test_no_error_bars_no_corner(campaign, fitted):
    bare = fitted(campaign(settings=CALIBRATION_3, replicates=1, sessions=("2012-03-05",))).fit
    assert bare.si.parameters["estimate"].notna().all()
    with pytest.raises(InputError, match="make each calibration traverse twice"):
        bare.plot_corner(3, "+")
