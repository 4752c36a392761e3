"""The documentation's site as its readers have it before them."""

import pytest

from tests.docs.site import built_site

pytestmark = pytest.mark.nightly

PAGES = (
    "index",
    "tutorial",
    "howto/capture",
    "explanation/laws",
    "explanation/measured",
    "reference/causes",
    "reference/command-line",
    "generated/notebooks/05-what-the-simulation-gets-wrong",
)
IN_DARK = ("index", "howto/capture", PAGES[-1])
# The theme's two side bars have no names; pandas leaves the corner of its tables empty.
LEFT_OPEN = ("landmark-unique", "empty-table-header")


@pytest.fixture(scope="module")
def site(tmp_path_factory, browser):
    return built_site(tmp_path_factory)


@pytest.mark.parametrize(
    ("name", "colours"), [*((name, "light") for name in PAGES), *((name, "dark") for name in IN_DARK)]
)
def test_a_page_is_quiet_and_can_be_read_by_everybody(site, visit, axe, name, colours):
    seen = visit(color_scheme=colours)
    page = seen.open(site / f"{name}.html")
    assert page.locator("h1").first.inner_text()
    found = [each for each in axe(page) if not each.startswith(LEFT_OPEN)]
    assert found == []
    assert seen.console == []
    assert seen.left == []


def test_on_a_narrow_screen_nothing_is_wider_than_the_screen(site, visit):
    for name in PAGES:
        page = visit(viewport={"width": 400, "height": 800}).open(site / f"{name}.html")
        assert page.evaluate("document.documentElement.scrollWidth") <= 400, name


def test_the_search_finds_a_cause(site, visit):
    page = visit().page
    page.goto((site / "search.html").as_uri() + "?q=thermal-warm-up")
    page.get_by_role("link", name="The causes").first.wait_for(timeout=10_000)


def test_every_picture_is_there(site, visit):
    for name in PAGES:
        page = visit().open(site / f"{name}.html")
        missing = "all => all.filter(one => one.complete && !one.naturalWidth).map(one => one.src)"
        assert page.locator("img").evaluate_all(missing) == [], name
