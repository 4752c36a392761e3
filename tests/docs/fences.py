"""Code blocks of a Markdown page, with where they stand and which file they show."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FENCE = re.compile(r"^(?P<indent> *)(?P<marks>```+)(?P<info>[^`]*)$")
FILE = re.compile(r"`([\w.-]+\.(?:toml|csv))`")


@dataclass(frozen=True)
class Fence:
    """A code block.

    Attributes
    ----------
    line : int
        Of its first line of code, counted from 1.
    language : str
    words : tuple of str
        What else the opening line says.
    text : str
        Without the indentation of a list.
    shows : str
        The file that the line right above names, if that ends in a colon or in "is".
    """

    line: int
    language: str
    words: tuple[str, ...]
    text: str
    shows: str


def fences(page: Path) -> Iterator[Fence]:
    """Every code block of a page, in order; directives such as ``{toctree}`` are none."""
    lines = page.read_text("utf-8").splitlines()
    opened: tuple[int, re.Match[str]] | None = None
    for number, line in enumerate(lines):
        match = FENCE.match(line)
        if opened is None:
            opened = (number, match) if match else None
        elif line.strip() == opened[1]["marks"]:
            first, opening = opened
            opened = None
            language, *words = opening["info"].split() or [""]
            if not language.startswith("{"):
                indent = len(opening["indent"])
                text = "".join(f"{each[indent:]}\n" for each in lines[first + 1 : number])
                yield Fence(first + 2, language, tuple(words), text, _shown(lines[:first]))
    assert opened is None, f"{page}, line {opened[0] + 1}: a code block that does not end"


def _shown(above: list[str]) -> str:
    """The file that the paragraph right above introduces."""
    paragraph: list[str] = []
    for line in reversed(above):
        if line.strip():
            paragraph.insert(0, line.strip())
        elif paragraph:
            break
    said = " ".join(paragraph)
    if not said.endswith((":", " is")):
        return ""
    named = FILE.findall(said)
    return named[-1] if named else ""
