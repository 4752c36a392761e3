"""The report as a person reads it: in a browser, by mouse and keyboard, with and without its script."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd
import pytest

from stickslip_fit.logs import read_log
from stickslip_fit.reporting import report

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "reports" / "example.html"
CHARTS = ("departures", "sizes", "order")
DAY = "2012-03-06"

HOSTILE = (
    "<script>window.ran = 1; alert(1)</script>",
    '"><img src=x onerror="window.ran = 1; alert(2)">',
    "</script><svg onload=alert(3)>",
    "{{ 7 * 7 }} \u2028 ${alert(4)} `",
)
NOTE = "<b onmouseover=alert(5)>note</b>"
SETTINGS = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0},
    {"joint": 3, "q2_deg": -90.0, "psi_deg": 45.0},
)


@pytest.fixture(scope="module")
def rows():
    """The log behind the example, read without the package."""
    return pd.read_csv(ROOT / "data" / "reference" / "campaign.csv", comment="#")


@pytest.fixture
def example(page):
    page.goto(EXAMPLE.as_uri())
    return page


@pytest.fixture(scope="module")
def hostile(campaign, tmp_path_factory):
    """The report of a log that tries everything, in a file whose name does too."""
    days = tuple(f"2012-03-{day:02d}" for day in range(5, 5 + len(HOSTILE)))
    table = campaign(days, SETTINGS)
    table["session"] = table["session"].replace(dict(zip(days, HOSTILE, strict=True)))
    table["note"] = NOTE
    table["<i onclick=alert(6)>column</i>"] = range(len(table))
    return reported(table, tmp_path_factory.mktemp("hostile") / "<img src=x onerror=alert(7)>.csv")


def reported(table, path):
    """Where the report of a table is."""
    table.to_csv(path, index=False)
    written = path.with_name("report.html")
    report(read_log(path), sections=()).save(written)
    return written


def said(page):
    return page.locator("#said").inner_text()


def dots(page, chart, which):
    """How many points the paths of a chart draw."""
    paths = page.locator(f"#{chart} {which}").evaluate_all("all => all.map(path => path.getAttribute('d'))")
    return sum(path.count("M") for path in paths)


def chosen_joint(page, joint):
    page.locator(f"input[name=joint][value='{joint}']").check()


def widths(page):
    return page.evaluate("() => [document.documentElement.scrollWidth, window.innerWidth]")


@pytest.mark.parametrize("width", [1100, 390])
def test_the_page_fits_the_screen(example, width):
    example.set_viewport_size({"width": width, "height": 800})
    wide, screen = widths(example)
    assert wide <= screen
    assert example.locator("#explore").is_visible()
    assert example.locator("figure").count() >= 5


def test_all_points_of_a_joint_and_direction_are_drawn(example, rows):
    for joint in (1, 3):
        chosen_joint(example, joint)
        for sign, value in (("plus", "+"), ("minus", "-")):
            wanted = int(((rows["joint"] == joint) & (rows["direction"] == value)).sum())
            assert [dots(example, chart, f"path.{sign}") for chart in CHARTS] == [wanted] * 3
    example.locator("input[name=sign]").nth(1).check()
    assert dots(example, "departures", "path.minus") == 0
    assert dots(example, "departures", "path.plus") > 0


def test_a_traverse_that_is_pointed_at_is_told_as_the_log_has_it(example, rows):
    chosen_joint(example, 3)
    chart = example.locator("#order")
    chart.scroll_into_view_if_needed()
    spot = example.locator("#order path.plus").first.get_attribute("d").split("h0")[70]
    x, y = map(float, spot.removeprefix("M").split())
    chart.hover(position={"x": x + 1, "y": y + 1})
    assert example.locator("#tip").is_visible()
    text = said(example)
    moment = re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d", text)[0]
    row = rows[(rows["time"] == moment.replace(" ", "T")) & (rows["joint"] == 3)].iloc[0]
    assert f"Session {row['session']}, " in text
    assert f"direction {row['direction'].replace('-', '−')};" in text
    assert f"{row['steps']:,} steps, step size {12e6 / (row['steps'] - 2.5):.1f}" in text.replace("\xa0", " ")
    example.mouse.move(5, 5)
    assert not example.locator("#tip").is_visible()


def test_the_keyboard_goes_from_traverse_to_traverse(example, rows):
    example.locator("#session").focus()
    example.keyboard.press("Tab")
    assert example.evaluate("() => document.activeElement.id") == "departures"
    outline = example.locator("#departures").evaluate("each => getComputedStyle(each).outlineWidth")
    assert outline == "3px"
    first = said(example)
    example.keyboard.press("ArrowRight")
    second = said(example)
    example.keyboard.press("End")
    last = said(example)
    assert len({first, second, last}) == 3
    example.keyboard.press("Home")
    assert said(example) == first
    assert example.locator("#said").get_attribute("aria-live") == "polite"
    example.keyboard.press("Enter")
    session = re.match(r"Session ([^,]+),", first)[1]
    of_session = int(((rows["joint"] == 1) & (rows["session"] == session)).sum())
    assert [dots(example, chart, ".chosen path") for chart in CHARTS] == [of_session] * 3
    example.keyboard.press("Escape")
    assert dots(example, "order", ".chosen path") == 0


def test_a_click_follows_the_session_everywhere(example, rows):
    chosen_joint(example, 3)
    subset = rows[rows["session"] == DAY]
    example.locator("#order").scroll_into_view_if_needed()
    example.locator("#session").select_option(label=DAY)
    spot = example.locator("#order .chosen path.minus").get_attribute("d").split("h0")[40]
    example.locator("#session").select_option(label="none")
    x, y = map(float, spot.removeprefix("M").split())
    example.locator("#order").click(position={"x": x, "y": y})
    assert [dots(example, chart, ".chosen path") for chart in CHARTS] == [(subset["joint"] == 3).sum()] * 3
    assert example.locator("#readings [data-traverses] use.chosen").count() == len(subset)
    marked = example.locator("tr.chosen").evaluate_all("all => all.map(row => row.textContent)")
    assert len(marked) > 10
    assert all(DAY in text for text in marked)
    example.locator("#order").click(position={"x": x, "y": y})
    assert example.locator(".chosen path[d*=M], use.chosen, tr.chosen").count() == 0


def test_a_point_of_a_figure_answers_too(example, rows):
    figure = example.locator("#readings")
    figure.scroll_into_view_if_needed()
    group = figure.locator("[data-traverses]").last
    number = int(group.get_attribute("data-traverses").split(".")[2])
    box = group.locator("use").nth(2).bounding_box()
    example.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    row = rows.sort_values(["time", "joint"]).iloc[number]
    assert f"Session {row['session']}, {row['time'].replace('T', ' ')}" in said(example)
    example.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert example.locator("#session").evaluate("each => each.selectedOptions[0].text") == row["session"]


def test_everything_is_there_without_the_script(visit):
    seen = visit(java_script_enabled=False)
    page = seen.open(EXAMPLE)
    assert not page.locator("#explore").is_visible()
    page.locator("details").evaluate_all("all => all.forEach(each => { each.open = true; })")
    for kind in ("table", "figure svg"):
        tall = page.locator(kind).evaluate_all("all => all.map(each => each.getBoundingClientRect().height)")
        assert len(tall) >= 5
        assert min(tall) > 20
    assert page.locator("button").count() == 0
    assert seen.console == []
    assert seen.left == []


def test_tables_are_not_cut_where_there_is_room(visit):
    page = visit(viewport={"width": 1400, "height": 900}).open(EXAMPLE)
    page.get_by_role("button", name="Open all tables").click()
    assert page.locator("details:not([open])").count() == 0
    cut = page.locator(".scroll").evaluate_all(
        "all => all.filter(each => each.scrollWidth > each.clientWidth).map(each => each.ariaLabel)"
    )
    assert cut == []
    assert page.locator("figure").first.bounding_box()["y"] < 900


def test_a_table_is_saved_as_csv_and_a_figure_as_svg(example, tmp_path):
    with example.expect_download() as table:
        example.get_by_role("button", name=re.compile("^Save as CSV")).first.click()
    table.value.save_as(tmp_path / "table.csv")
    read = pd.read_csv(tmp_path / "table.csv")
    assert list(read.columns[:2]) == ["joint", "direction"]
    assert read.iloc[:, 2].dtype.kind == "i"
    with example.expect_download() as figure:
        example.get_by_role("button", name=re.compile("^Save as SVG")).first.click()
    figure.value.save_as(tmp_path / "figure.svg")
    assert ElementTree.parse(tmp_path / "figure.svg").getroot().tag == "{http://www.w3.org/2000/svg}svg"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(visit, axe, scheme):
    page = visit(color_scheme=scheme, reduced_motion="reduce").open(EXAMPLE)
    page.locator("#session").select_option(label=DAY)
    page.locator("#departures").focus()
    # Rows of a table are alike; axe takes its time over each.
    page.locator("tbody tr:nth-child(n+5)").evaluate_all("all => all.forEach(row => row.remove())")
    assert page.locator("tr.chosen").count() > 3
    assert axe(page) == []


def test_on_paper_there_are_no_controls_and_nothing_is_cut(visit):
    paper = {"width": 703, "height": 1000}  # what the margins leave of A4, at 96 pixels an inch
    page = visit(viewport=paper, color_scheme="dark").open(EXAMPLE)
    page.locator("#session").select_option(label=DAY)
    page.emulate_media(media="print")
    for control in ("nav", "#explore", "#tip"):
        assert not page.locator(control).is_visible()
    assert page.evaluate("() => getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    edges = page.locator("table, svg, p").evaluate_all("all => all.map(e => e.getBoundingClientRect().right)")
    assert max(edges) <= paper["width"]
    printed = page.pdf(prefer_css_page_size=True)
    assert 3 < len(re.findall(rb"/Type\s*/Page\b", printed)) <= 10


def test_motion_only_where_it_is_welcome(visit):
    for motion, wanted in (("reduce", "0s"), ("no-preference", "0.15s")):
        page = visit(reduced_motion=motion).open(EXAMPLE)
        point = page.locator("[data-traverses] use").first
        assert point.evaluate("each => getComputedStyle(each).transitionDuration") == wanted


def test_a_hostile_log_is_inert(page, hostile, axe):
    page.goto(hostile.as_uri())
    assert page.locator("h1").inner_text() == "Report: <img src=x onerror=alert(7)>.csv"
    options = page.locator("#session option").all_text_contents()
    assert options == ["none", *HOSTILE]
    page.locator("#quantity").select_option(label="<i onclick=alert(6)>column</i>")
    for chart in CHARTS:
        page.locator(f"#{chart}").focus()
        for _ in range(3):
            page.keyboard.press("ArrowRight")
        assert f"Note: {NOTE}" in said(page)
        assert f"Note: {NOTE}" in page.locator("#tip").text_content()
    page.keyboard.press("Enter")
    assert page.locator("tr.chosen").count() > 0
    assert page.locator("img, b, i, [onclick], [onload], [onerror], body svg script").count() == 0
    assert page.evaluate("() => window.ran") is None
    assert axe(page) == []


def test_a_log_of_one_traverse_of_a_joint_is_shown_too(page, campaign, tmp_path):
    table = campaign(("2012-03-05",), (SETTINGS[0], {"joint": 1}), ("+",), replicates=1)
    page.goto(reported(table, tmp_path / "few.csv").as_uri())
    for joint in (1, 3):
        chosen_joint(page, joint)
        page.locator("#sizes").focus()
        assert "2012-03-05" in said(page)
        assert dots(page, "sizes", "path.plus") == 1
        page.locator("#departures").focus()


def test_the_policy_stops_what_is_not_the_page_s_own(visit):
    seen = visit()
    page = seen.open(EXAMPLE)
    page.evaluate("""() => {
        const script = document.createElement("script");
        script.textContent = "window.ran = 1";
        document.body.append(script);
        document.body.insertAdjacentHTML("beforeend", "<img src=x onerror='window.ran = 2'>");
    }""")
    refused = page.evaluate("() => fetch('https://example.invalid').then(() => 'sent', () => 'refused')")
    assert refused == "refused"
    assert page.evaluate("() => window.ran") is None
    assert all("Content Security Policy" in line for line in seen.console)
    assert len(seen.console) >= 3
