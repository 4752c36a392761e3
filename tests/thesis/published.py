"""The numbers that the thesis prints and what follows from them, and the thesis's text by place."""

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "data" / "published"
# Not part of the project, and beside it where there is one.
TEXT = next(
    (text for above in ROOT.parents if (text := above / "shared" / "thesis" / "thesis.md").exists()),
    ROOT / "thesis.md",
)


def read(name: str) -> Any:
    """One of the files, parsed."""
    return tomllib.loads((FOLDER / f"{name}.toml").read_text("utf-8"))


PRINTED: dict[str, dict[str, Any]] = {entry["name"]: entry for entry in read("published")["number"]}
DERIVED: dict[str, dict[str, Any]] = {entry["name"]: entry for entry in read("derived")["number"]}


def value(name: str) -> Any:
    """A printed or derived number; lists as arrays."""
    entry = PRINTED.get(name) or DERIVED[name]
    return np.array(entry["value"]) if isinstance(entry["value"], list) else entry["value"]


def places() -> set[str]:
    """Every place that the thesis numbers."""
    parts = read("places")
    named = {"Abstract"} | {f"Ch. {chapter}" for chapter in parts["chapters"]}
    named |= {f"Sec. {section}" for section in parts["sections"]}
    for kind, word in (("equations", "Eq."), ("figures", "Fig."), ("tables", "Table")):
        for chapter, count in parts[kind].items():
            named |= {f"{word} {chapter}.{number}" for number in range(1, count + 1)}
    return named


@cache
def text_at(place: str) -> str:
    """The thesis's text at a place, without spaces and markup: 4\\pi/3 is 4π/3, 10^{-7} is 10^-7."""
    text = TEXT.read_text("utf-8")
    kind, _, number = place.partition(" ")
    mark = re.escape(number)
    if kind == "Abstract":
        found = re.search(r"#### Abstract(.*?)## CONTENTS", text, re.S)
    elif kind == "Ch.":
        # An introduction ends where the chapter's first section begins, if it has any.
        found = re.search(rf"## CHAPTER {mark}\n(.*?)\n(?:## CHAPTER|## APPENDIX|### )", text, re.S)
    elif kind == "Sec.":
        spaced = mark.replace(r"A\.", r"A\. ?")
        found = re.search(rf"\n##+ {spaced} (.*?)\n(?:##+ (?:\d|A)\.|## CHAPTER|## REF)", text, re.S)
    elif kind == "Eq.":
        found = re.search(rf"(\$\$(?:(?!\$\$).)*\\tag{{{mark}}}.*?\$\$)", text, re.S)
    else:
        word = "Figure" if kind == "Fig." else kind
        # A figure's own words stand before its caption, a table's after it.
        before, after = (".{,300}", "") if kind == "Fig." else ("", r"\n\n.*?\n")
        found = re.search(rf"({before}\n{word} {mark}\.? [^\n]*{after})\n", text, re.S)
    assert found, f"{place} is not in the text"
    return plain(found[1])


def plain(text: str) -> str:
    """LaTeX without its markup."""
    text = re.sub(r"\\(?:mathrm|left|right|bar|,|;|quad|text)|[~$]", "", text)
    text = re.sub(r"\s", "", text)
    text = re.sub(r"\\[dt]?frac{([^{}]*)}{([^{}]*)}", r"\1/\2", text)
    for latex, sign in ((r"\pi", "π"), (r"\times", "x"), (r"\mu", "µ"), (r"\pm", "±"), (r"\%", "%")):
        text = text.replace(latex, sign)
    return re.sub(r"[{}\\]", "", text)


def printed_forms(entry: dict[str, Any]) -> list[str]:
    """How the thesis writes the numbers of an entry."""
    forms = entry.get("printed", entry["value"])
    forms = forms if isinstance(forms, list) else [forms]
    return [
        each if isinstance(each, str) else str(each) if isinstance(each, int) else f"{each:g}"
        for each in forms
    ]
