"""The committed example is what its command gives."""

import re
from pathlib import Path

import pytest

from stickslip_fit._summary import load_page_assets

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "reports" / "example.html"
COMMAND = "stickslip-fit report data/reference/campaign.csv -o reports/example.html"
HEADING = re.compile(r'<h2 id="([^"]+)"[^>]*>([^<]+)</h2>')
SECTIONS = [
    *("answer", "measured", "parameters", "accuracy", "factors", "diagnosis", "strategies", "one-by-one"),
    *("methods", "remarks", "provenance"),
]


@pytest.fixture(scope="module")
def example():
    return EXAMPLE.read_text("utf-8")


def test_it_is_made_by_the_command_that_the_readme_names(example):
    readme = (ROOT / "reports" / "README.md").read_text("utf-8")
    assert COMMAND in readme
    assert f"<dd>{COMMAND}</dd>" in example


def test_it_is_small_and_knows_nothing_of_the_machine_it_was_made_on(example):
    assert len(example.encode()) < 2_000_000
    assert not re.search(r"/(home|root|tmp|work|Users|usr)/", example)


def test_it_has_every_section_and_today_s_style_and_script(example):
    assert [key for key, _ in HEADING.findall(example)] == SECTIONS
    today = load_page_assets(script=True)
    assert f"<style>{today.style}</style>" in example, f"out of date: {COMMAND}"
    assert f"<script>{today.script}</script>" in example, f"out of date: {COMMAND}"


@pytest.mark.nightly
def test_its_words_are_what_the_command_gives(run, monkeypatch, tmp_path, read_page, example):
    (tmp_path / "data").symlink_to(ROOT / "data")
    (tmp_path / "reports").mkdir()
    monkeypatch.chdir(tmp_path)
    status, _, _ = run(*COMMAND.split()[1:])
    assert status == 0
    made = read_page((tmp_path / "reports" / "example.html").read_text("utf-8"))
    assert words(made.text) == words(read_page(example).text)
    assert set(made.tables) == set(read_page(example).tables)


def words(text):
    return re.sub(r"[\d.,±−+<>]+|sha256 [0-9a-f]+|(?<=versions ).*(?= command)", "", text).split()
