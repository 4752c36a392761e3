"""Tables and page elements: what a result displays as text and as HTML.

Cells are plain text and are escaped by the templates, so that nothing in a log becomes markup. A page
allows only its own style and script, by a content security policy with their hashes.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, singledispatch
from importlib.resources import files
from itertools import groupby
from textwrap import fill
from typing import TYPE_CHECKING, Any, Protocol

from stickslip_fit._format import NO_BREAK_SPACE, keep_units

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup

WIDTH = 110
GAP = "  "  # between columns
_UNSAFE_IN_SCRIPT = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]+")


class Figure(Protocol):
    """A figure as a page holds it, see `report.figures.picture.Picture`; ``svg`` is None if it has none."""

    @property
    def key(self) -> str: ...
    @property
    def title(self) -> str: ...
    @property
    def caption(self) -> str: ...
    @property
    def svg(self) -> Markup | None: ...


@dataclass(frozen=True)
class Column:
    """A column's head.

    Attributes
    ----------
    head : str
    unit : str
        Stands below the head; empty where cells have none or carry their own.
    group : str
        Columns next to each other with the same group share a head above theirs.
    text : bool
        Whether cells are words (to the left) or numbers (to the right).
    """

    head: str
    unit: str = ""
    group: str = ""
    text: bool = False


def words(*heads: str) -> tuple[Column, ...]:
    """Columns of words."""
    return tuple(Column(head, text=True) for head in heads)


def numbers(*heads: str, unit: str = "", group: str = "") -> tuple[Column, ...]:
    """Columns of numbers in one unit, below one upper head."""
    return tuple(Column(head, unit, group) for head in heads)


@dataclass(frozen=True)
class Table:
    """A captioned table.

    Attributes
    ----------
    caption : str
    columns : tuple of Column
    rows : tuple of tuple of str
    stubs : int
        How many leading cells of a row name it.
    note : str
        Stands below: what a mark in a cell means, what was left out.
    folded : bool
        Whether the caption alone is shown: HTML opens the table at a click, text leaves it out unless full.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    stubs: int = 1
    note: str = ""
    folded: bool = False

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Upper heads with how many columns each spans; empty where no column has one."""
        spans = [(group, len(list(columns))) for group, columns in groupby(self.columns, lambda c: c.group)]
        return spans if any(group for group, _ in spans) else []

    def as_text(self, width: int = WIDTH) -> str:
        """Caption, aligned columns with their units, and the note."""
        heads = [[column.head for column in self.columns]]
        if any(column.unit for column in self.columns):
            heads.append([column.unit for column in self.columns])
        lines = [*heads, *self.rows]
        widths, above, place = _widths(lines), "", 0
        for group, span in self.groups:
            last = place + span - 1
            widths[last] += max(0, len(group) - sum(widths[place : last + 1]) - len(GAP) * (span - 1))
            above += group.ljust(sum(widths[place : last + 1]) + len(GAP) * span)
            place += span
        body = _aligned(lines, widths, [column.text for column in self.columns])
        return "\n".join(filter(None, [self.caption, above.rstrip(), *body, paragraph(self.note, width)]))


@dataclass(frozen=True)
class Section:
    """A part of a summary.

    Attributes
    ----------
    title : str
        Empty where the part needs none.
    paragraphs : tuple of str
    tables : tuple of Table
    figures : tuple of Figure
        Shown by pages alone.
    key : str
        Names the section in a page's addresses.
    """

    title: str = ""
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    key: str = ""


@dataclass(frozen=True)
class Summary:
    """What a result says to people.

    Attributes
    ----------
    title : str
    headline : tuple of str
        The answer, a paragraph each; text begins with it, the title stands below.
    sections : tuple of Section
    flags : tuple of str
        What is wrong or doubtful.
    provenance : tuple of (str, str)
        Where the numbers come from; HTML shows it folded, text leaves it to the saved files.
    """

    title: str
    headline: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()
    flags: tuple[str, ...] = ()
    provenance: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        return self.as_text()

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return self.as_html()

    @property
    def tables(self) -> list[Table]:
        """The tables of all sections, in order."""
        return [table for section in self.sections for table in section.tables]

    def as_text(self, width: int = WIDTH, *, full: bool = False) -> str:
        """For a terminal of `width` letters; a table may be wider. `full` shows folded tables too."""
        return "\n\n".join(filter(None, self._blocks(width, full)))

    def _blocks(self, width: int, full: bool) -> Iterator[str]:
        yield from (paragraph(each, width) for each in self.headline)
        yield self.title if self.flags or self.sections else ""
        yield "\n".join(paragraph(f"! {flag}", width, then="  ") for flag in self.flags)
        for section in self.sections:
            said = [paragraph(each, width) for each in section.paragraphs]
            yield "\n".join(filter(None, [section.title, *said]))
            yield from (table.as_text(width) for table in section.tables if full or not table.folded)

    def as_html(self) -> str:
        """A fragment that needs nothing but itself, on light and on dark ground."""
        return load_template("summary.html.j2").render(summary=self)


@singledispatch
def summarize(result: object) -> Summary:
    """What a result says; each package registers how for its own results, beside them."""
    raise TypeError(f"nothing is registered that summarizes a {type(result).__name__}")


class Summarized:
    """A result that shows itself by its summary, as text and in a notebook."""

    def summary(self) -> Summary:
        """What the result says: headline, sections with tables, flags, provenance."""
        return summarize(self)

    def __repr__(self) -> str:
        return self.summary().as_text()

    def _repr_html_(self) -> str:
        return self.summary().as_html()


def paragraph(text: str, width: int = WIDTH, first: str = "", then: str = "") -> str:
    """Fill lines, no number parted from its unit; line breaks in the text stay.

    Examples
    --------
    >>> print(paragraph("to within 7.5 µm", 14))
    to within
    7.5 µm
    """
    lines = [
        fill(keep_units(line), width, initial_indent=first, subsequent_indent=then, break_on_hyphens=False)
        for line in text.split("\n")
    ]
    return "\n".join(lines).replace(NO_BREAK_SPACE, " ")


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Lay out rows of cells under a header, the first `left` columns flush left, the others flush right.

    Examples
    --------
    >>> print(text_table(["joint", "rms"], [["2", "0.3 µrad"], ["3", "12.0 nm"]]))
    joint       rms
    2      0.3 µrad
    3       12.0 nm
    """
    lines = [header, *rows]
    return "\n".join(_aligned(lines, _widths(lines), [place < left for place in range(len(header))]))


def _aligned(lines: Sequence[Sequence[str]], widths: Sequence[int], left: Sequence[bool]) -> list[str]:
    return [
        GAP.join(
            _CONTROL.sub(" ", cell).ljust(width) if flush_left else _CONTROL.sub(" ", cell).rjust(width)
            for cell, width, flush_left in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in lines
    ]


def _widths(lines: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(*lines, strict=True)]


@cache
def load_template(name: str) -> Template:
    """A template by its file's name."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("stickslip_fit"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["keep_units"] = keep_units
    return environment.get_template(name)


@dataclass(frozen=True)
class PageAssets:
    """Style and script of a page, and the policy that allows nothing but them.

    Attributes
    ----------
    style, script : Markup
        The script is empty where a page has none.
    policy : str
        Content-Security-Policy: nothing is fetched, no other script runs.
    """

    style: Markup
    script: Markup
    policy: str


def load_page_assets(*, script: bool) -> PageAssets:
    """The report's style, and its script where the page has one."""
    style, code = _read_asset("report.css"), _read_asset("report.js" if script else "")
    scripts = _csp_hash(code) if script else "'none'"
    policy = (
        f"default-src 'none'; style-src {_csp_hash(style)}; script-src {scripts}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return PageAssets(style, code, policy)


def embed_json(content: Any) -> Markup:
    r"""Data as JSON that can stand in a script element: no letter of it ends the element or begins another.

    Examples
    --------
    >>> embed_json({"session": "</script>"})
    Markup('{"session":"\\u003c/script\\u003e"}')
    """
    from markupsafe import Markup

    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Markup(text.translate(_UNSAFE_IN_SCRIPT))


def _read_asset(name: str) -> Markup:
    from markupsafe import Markup

    return Markup(files("stickslip_fit").joinpath("templates", name).read_text("utf-8") if name else "")


def _csp_hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
