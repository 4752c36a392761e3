"""The data files about the thesis: their shape, their places, and the digits in the thesis itself."""

import re
import sys
from importlib import import_module

import pytest

from tests.thesis.published import DERIVED, PRINTED, ROOT, TEXT, places, plain, printed_forms, read, text_at

PLACES = places()
needs_text = pytest.mark.skipif(not TEXT.exists(), reason="the thesis's text is not part of the project")


@pytest.fixture
def errata_page(monkeypatch):
    """The module that writes the page; its neighbour `markdown` has a namesake among the libraries."""
    others = {
        name: sys.modules.pop(name) for name in list(sys.modules) if name.partition(".")[0] == "markdown"
    }
    monkeypatch.syspath_prepend(ROOT / "docs" / "_ext")
    yield import_module("errata_page")
    for name in ("errata_page", "markdown"):
        del sys.modules[name]
    sys.modules.update(others)


def test_names_are_unique():
    names = [entry["name"] for file in ("published", "derived") for entry in read(file)["number"]]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("entry", PRINTED.values(), ids=PRINTED)
def test_a_printed_number_has_unit_place_and_meaning(entry):
    assert entry.keys() - {"printed"} == {"name", "value", "unit", "place", "what"}
    assert entry["place"] in PLACES
    values = entry["value"] if isinstance(entry["value"], list) else [entry["value"]]
    assert len(printed_forms(entry)) == len(values)
    assert all(isinstance(each, int | float) for each in values)
    assert entry["unit"]
    assert entry["what"]


def test_every_chapter_with_numbers_has_entries():
    chapters = {re.sub(r"^\w+\.? ?", "", entry["place"])[:1] for entry in PRINTED.values()}
    assert chapters >= {*"1245678A"}  # chapter 3 prints none


@needs_text
@pytest.mark.parametrize("place", sorted(PLACES - {"Ch. 2", "Ch. 4", "Ch. 5", "Ch. 6"}))
def test_a_place_is_in_the_thesis(place):
    text = TEXT.read_text("utf-8").replace("А", "A")  # a Cyrillic letter in some tags of the scan
    kind, _, number = place.partition(" ")
    if kind == "Eq." and re.fullmatch(r"A\.(15|16|7[6-9]|8\d|90)", number):
        pytest.skip("this number is not readable in the scan")
    pattern = {"Eq.": r"\tag{{{}}}", "Fig.": "Figure {}", "Table": "Table {}"}.get(kind)
    if pattern is None:
        assert text_at(place)
    else:
        assert pattern.format(number) in text


@needs_text
@pytest.mark.parametrize("entry", PRINTED.values(), ids=PRINTED)
def test_the_digits_of_a_printed_number_are_in_the_thesis_at_its_place(entry):
    text = text_at(entry["place"])
    for form in printed_forms(entry):
        # Not as a part of a longer number.
        assert re.search(rf"(?<!\d)(?<!\d\.){re.escape(form.lstrip('-'))}(?![\d]|\.\d)", text), (form, text)


@needs_text
def test_the_digits_are_looked_for_where_the_entry_says():
    """A right number at a wrong place, and a wrong number at a right one, are seen."""
    assert "972" in text_at("Fig. 4.13")
    assert "972" not in text_at("Sec. 4.2")
    assert "973" not in text_at("Fig. 4.13")
    assert plain(r"$\frac{4 \pi}{3}$ and $10^{-7}$") == "4π/3and10^-7"


@pytest.mark.parametrize("entry", DERIVED.values(), ids=DERIVED)
def test_a_derived_number_has_its_calculation_and_a_test_that_makes_it(entry):
    assert entry.keys() == {"name", "value", "unit", "from", "calculation", "test"}
    assert entry["from"]
    assert set(entry["from"]) <= PRINTED.keys() | DERIVED.keys()
    assert _names_its_number(entry["test"], entry["name"])


ERRATA = read("errata")
ENTRIES = [*ERRATA["erratum"], *ERRATA["confirmed"], *ERRATA["implied"]]


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["place"])
def test_an_erratum_has_places_and_a_test(entry):
    assert entry.keys() - {"finding"} == {"place", "claim", "test"}
    assert set(entry["place"].split(", ")) <= PLACES
    assert _function(entry["test"])


def test_the_page_has_every_entry_with_its_numbers(errata_page):
    page = errata_page.page()
    for entry in ENTRIES:
        assert f"| {entry['place']} |" in page
    assert "at ±9.2 µrad it gives 26.5 and -19.5 µrad; exact solving at $\\gamma_0$ = 95 µrad" in page
    assert "p = 0.4 and 0.9: the normal force" in page
    assert "20 % and 100 nm (abstract, 6.1)" in page


@needs_text
def test_the_spring_of_adriaens_has_no_displacement():
    assert "doty+k_s=F_s" in text_at("Sec. 2.2")


@needs_text
def test_section_4_2_measures_joint_3_and_speaks_of_the_rotary_ones():
    section = text_at("Sec. 4.2")
    assert "forprismaticjoint3" in section
    assert "calibrationontherotaryjoints" in section


def _function(test: str) -> str:
    """The source of a test given as file::function."""
    file, _, name = test.partition("::")
    found = re.search(
        rf"\ndef {name}\(.*?(?=\n\ndef |\n\n@|\n\nclass |\Z)", (ROOT / file).read_text("utf-8"), re.S
    )
    assert found, test
    return found[0]


def _names_its_number(test: str, name: str) -> bool:
    return f'"{name}"' in _function(test)
