"""What pages say in passing: options that exist, a citation to be read, the version of the package."""

import re
import shlex

import pytest
import yaml

from stickslip_fit import __version__
from tests.docs.commands import ROOT, all_options, lines, make_targets, parse
from tests.docs.fences import fences
from tests.docs.test_pages import LONG, PAGES

OF_OTHERS = {"--help"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_options_that_a_page_mentions_exist(page):
    mentioned = set(re.findall(r"`(--[a-z][a-z-]*)", page.read_text("utf-8")))
    assert mentioned <= all_options() | OF_OTHERS


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_targets_of_make_that_a_page_mentions_exist(page):
    assert set(re.findall(r"`make ([a-z]+)", page.read_text("utf-8"))) <= make_targets()


@pytest.mark.parametrize("page", [page for page in PAGES if page.name in LONG], ids=lambda page: page.name)
def test_what_is_run_by_night_can_be_read(page):
    for fence in fences(page):
        if fence.language == "python":
            compile(fence.text, str(page), "exec")
        elif fence.language in ("sh", "console"):
            commands = re.sub(r"^\$ ", "", fence.text, flags=re.MULTILINE)
            for line in lines(commands, fence.line):
                if line.text.startswith("stickslip-fit ") and "refused" not in fence.words:
                    parse(shlex.split(line.text)[1:])


def test_commands_that_stand_indented_in_other_readmes_can_be_parsed():
    said = (ROOT / "data" / "reference" / "README.md").read_text("utf-8")
    commands = [line for line in said.splitlines() if line.startswith("    stickslip-fit ")]
    assert commands
    for command in lines("\n".join(commands), 1):
        parse(command.text.split()[1:])


def test_the_guide_to_a_report_names_its_sections():
    """In the order of the page."""
    guide = (ROOT / "docs/howto/read-a-report.md").read_text("utf-8")
    page = (ROOT / "reports/example.html").read_text("utf-8")
    named, there = re.findall(r"\*\*(.+?)\.\*\*", guide), re.findall(r"<h2[^>]*>([^<{]+)</h2>", page)
    assert len(named) > 5
    assert [each for each in there if each in named] == named


def test_the_citation_names_what_a_reference_manager_asks_for():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    assert cited["version"] == __version__
    assert cited["license"] == "BSD-3-Clause"
    assert cited["references"][0]["authors"] == [{"family-names": "Damani", "given-names": "A."}]


def test_the_changelog_has_this_version():
    assert re.search(
        rf"^## {re.escape(__version__)}\b", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE
    )


def test_the_pictures_are_small():
    pictures = list((ROOT / "docs" / "pictures").glob("*.png"))
    assert len(pictures) == 2
    assert max(each.stat().st_size for each in pictures) < 150_000
