"""The built site: no warnings, links inside it lead somewhere, and nothing is fetched from elsewhere."""

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import SplitResult, unquote, urlsplit

import pytest

from stickslip_fit.causes import library
from stickslip_fit.logs.schema import FIELDS
from tests.docs.commands import all_options
from tests.docs.site import built_site

FETCHED = {"script": "src", "img": "src", "iframe": "src", "link": "href", "source": "srcset", "video": "src"}
NO_FETCH = ("index", "search", "next", "prev", "canonical")
FETCHED_BY_STYLE = re.compile(r"""(?:@import\s+|url\()\s*['"]?([^'")]+)""")


@pytest.mark.nightly
def test_the_site_is_whole_and_keeps_to_itself(tmp_path_factory):
    site = built_site(tmp_path_factory)
    pages = {path: _read(path) for path in sorted(site.rglob("*.html"))}
    _links_lead_somewhere(pages)
    _nothing_is_fetched_from_another_host(site, pages)
    _equations_are_drawn_without_a_script(site)
    _the_reference_has_every_option_cause_and_column(site)


@dataclass
class Page(HTMLParser):
    """What a page links to, what it fetches, and what in it can be linked to."""

    links: list[str] = field(default_factory=list)
    fetched: list[SplitResult] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        self.anchors |= {value for name in ("id", "name") if (value := known.get(name))}
        if tag == "a" and known.get("href"):
            self.links.append(str(known["href"]))
        elif FETCHED.get(tag) in known and known.get("rel") not in NO_FETCH:
            self.fetched.append(urlsplit(str(known[FETCHED[tag]])))


def _read(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text("utf-8"))
    return page


def _links_lead_somewhere(pages: dict[Path, Page]) -> None:
    broken = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                broken.append(f"{path.name}: {link}")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                broken.append(f"{path.name}: {link} (no such place)")
    assert not broken


def _nothing_is_fetched_from_another_host(site: Path, pages: dict[Path, Page]) -> None:
    asked = [each for page in pages.values() for each in page.fetched]
    styles = [path.read_text("utf-8") for path in site.rglob("*.css")]
    asked += [urlsplit(each) for style in styles for each in FETCHED_BY_STYLE.findall(style)]
    assert len(asked) > len(pages)
    assert not {each for each in asked if each.netloc or each.scheme not in ("", "data")}


def _equations_are_drawn_without_a_script(site: Path) -> None:
    page = (site / "explanation" / "laws.html").read_text("utf-8")
    assert page.count("<math") > 20
    assert "MathJax" not in page


def _the_reference_has_every_option_cause_and_column(site: Path) -> None:
    def shown(name: str) -> str:
        return re.sub("<[^>]*>", "", (site / "reference" / f"{name}.html").read_text("utf-8"))

    assert not [each for each in all_options() if each not in shown("command-line")]
    assert not [cause.name for cause in library() if cause.name not in shown("causes")]
    spellings = [spelling for each in FIELDS for spelling in each.spellings]
    assert not [each for each in spellings if each not in shown("log-format")]
