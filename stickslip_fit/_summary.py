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
from dataclasses import dataclass, replace
from functools import cache, singledispatch
from importlib.resources import files
from itertools import groupby
from textwrap import fill
from typing import TYPE_CHECKING, Any, Protocol

from stickslip_fit._export import csv_names, table_as_csv, table_as_latex
from stickslip_fit._format import NO_BREAK_SPACE, keep_units

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup

WIDTH = 110
SCREEN = 25  # lines
GAP = "  "  # between columns
ROOM_FOR_TITLES = 2  # an empty line, and one that names what is left out
_UNSAFE_IN_SCRIPT = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]+")


class Figure(Protocol):
    """A figure of a page; ``svg`` is None if it has none."""

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
    """The head of a column.

    Attributes
    ----------
    unit : str
        Below the head; empty where cells have none or contain their own.
    group : str
        Adjacent columns of one group share an upper head.
    text : bool
        Whether cells are text (flush left) or numbers (flush right).
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
    stubs : int
        Number of leading cells that name a row.
    note : str
        Below the table: what a mark in a cell means, what was left out.
    folded : bool
        Whether the caption alone is shown: HTML opens the table at a click, text leaves it out unless full.
    short : slice or None
        The rows that stand for all of them where there is no room; None if none do.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    stubs: int = 1
    note: str = ""
    folded: bool = False
    short: slice | None = None

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
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        upper, first = "", 0
        for group, span in self.groups:
            end = first + span
            widths[end - 1] += max(0, len(group) - sum(widths[first:end]) - len(GAP) * (span - 1))
            upper += group.ljust(sum(widths[first:end]) + len(GAP) * span)
            first = end
        body = _aligned(lines, widths, [column.text for column in self.columns])
        return "\n".join(filter(None, [self.caption, upper.rstrip(), *body, paragraph(self.note, width)]))

    def as_csv(self) -> str:
        """Heads with units, then rows: plain numbers, with ± and intervals as two columns each."""
        return table_as_csv(self)

    def as_latex(self) -> str:
        """A `table` environment for the LaTeX package booktabs."""
        return table_as_latex(self)

    def shortened(self) -> Table:
        """The rows alone that stand for all; the table as it is where none do."""
        rows = self.rows[self.short] if self.short is not None else self.rows
        if len(rows) == len(self.rows):
            return self
        assert self.short is not None
        which = "the last" if (self.short.start or 0) < 0 else "the first"
        return replace(self, caption=f"{self.caption} ({which} {len(rows)} of {len(self.rows):,})", rows=rows)


@dataclass(frozen=True)
class Section:
    """A part of a summary.

    Attributes
    ----------
    title : str
        May be empty.
    figures : tuple of Figure
        Shown on pages only.
    key : str
        The section's anchor on a page.
    conclusion : str
        What the section says, in one line before its paragraphs.
    folded : tuple of Section
        What a page shows folded, by its title; text leaves it out unless full.
    """

    title: str = ""
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    key: str = ""
    conclusion: str = ""
    folded: tuple[Section, ...] = ()

    def blocks(self, width: int, *, full: bool = False) -> Iterator[str]:
        """Title with paragraphs, then the tables; `full` for folded ones, too."""
        paragraphs = [paragraph(text, width) for text in (self.conclusion, *self.paragraphs) if text]
        tables = [table for table in self.tables if full or not table.folded]
        if paragraphs or tables:
            yield "\n".join(filter(None, [self.title, *paragraphs]))
        yield from (table.as_text(width) for table in tables)
        for section in self.folded if full else ():
            yield from section.blocks(width, full=full)

    def named_blocks(self, width: int, *, short: bool = False) -> list[tuple[str, str]]:
        """Paragraphs and open tables with their names; `short` tables have the rows that stand for all."""
        parts = [("remarks", "\n".join(paragraph(text, width) for text in self.paragraphs))]
        tables = [table.shortened() if short else table for table in self.tables if not table.folded]
        parts += [(table.caption, table.as_text(width)) for table in tables]
        return [part for part in parts if part[1]]


@dataclass(frozen=True)
class Summary:
    """A result for display.

    Attributes
    ----------
    headline : tuple of str
        The main results, as paragraphs; text begins with them, followed by the title.
    flags : tuple of str
        Warnings.
    provenance : tuple of (str, str)
        Sources with their hashes; HTML shows them folded, text omits them.
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

    def as_screen(self) -> tuple[str, tuple[str, ...]]:
        """What fits on a screen: headline and flags, then sections without a title; and what is left out.

        Tables and paragraphs follow in order up to the first that has no room; tables give only some rows
        where these stand for all. The headline and the flags are whole even where they are longer.

        Returns
        -------
        text : str
        left_out : tuple of str
            Captions of tables, titles of sections.
        """
        head = ["\n".join(paragraph(text) for text in self.headline)]
        head.append("\n".join(paragraph(f"! {flag}", then="  ") for flag in self.flags))
        head = list(filter(None, head))
        folded = [table.caption for table in self.tables if table.folded]
        everything = list(
            filter(None, [*head, *(block for one in self.sections for block in one.blocks(WIDTH))])
        )
        if _count_lines(everything) <= SCREEN - (ROOM_FOR_TITLES if folded else 0):
            return "\n\n".join(everything), tuple(folded)
        main = [section for section in self.sections if not section.title]
        left_out = [table.caption for section in main for table in section.tables if table.folded]
        left_out += [section.title for section in self.sections if section.title]
        whole = [block for section in main for _, block in section.named_blocks(WIDTH)]
        if _count_lines([*head, *whole]) <= SCREEN - (ROOM_FOR_TITLES if left_out else 0):
            return "\n\n".join([*head, *whole]), tuple(left_out)
        shown, room = list(head), SCREEN - ROOM_FOR_TITLES
        parts = [part for section in main for part in section.named_blocks(WIDTH, short=True)]
        while parts and _count_lines([*shown, parts[0][1]]) <= room:
            shown.append(parts.pop(0)[1])
        every_row = () if set(shown) <= {*head, *whole} else ("every row",)
        return "\n\n".join(shown), (*every_row, *(title for title, _ in parts), *left_out)

    def as_csv(self) -> dict[str, str]:
        """The tables as CSV, each by the name of a file."""
        names = csv_names(table.caption for table in self.tables)
        return dict(zip(names, map(table_as_csv, self.tables), strict=True))

    def as_latex(self) -> str:
        """All tables for LaTeX's input command; they need the package booktabs."""
        return "\n".join(["% \\usepackage{booktabs}", *map(table_as_latex, self.tables)])

    def _blocks(self, width: int, full: bool) -> Iterator[str]:
        yield from (paragraph(text, width) for text in self.headline)
        yield self.title if self.flags or self.sections else ""
        yield "\n".join(paragraph(f"! {flag}", width, then="  ") for flag in self.flags)
        for section in self.sections:
            yield from section.blocks(width, full=full)

    def as_html(self) -> str:
        """A self-contained fragment, for light and dark backgrounds."""
        return load_template("summary.html.j2").render(summary=self)


def join_summaries(title: str, parts: Sequence[Summary]) -> Summary:
    """Several results as one: their headlines, flags and sections one after another."""
    return Summary(
        title,
        tuple(text for part in parts for text in part.headline),
        tuple(section for part in parts for section in part.sections),
        tuple(flag for part in parts for flag in part.flags),
        parts[0].provenance if parts else (),
    )


@singledispatch
def summarize(result: object) -> Summary:
    """The summary of a result; each package registers its own results."""
    raise TypeError(f"nothing is registered that summarizes a {type(result).__name__}")


class Summarized:
    """A result whose summary is its display, as text and in a notebook."""

    def summary(self) -> Summary:
        """The result as headline, sections with tables, flags and provenance."""
        return summarize(self)

    def __repr__(self) -> str:
        return self.summary().as_text()

    def _repr_html_(self) -> str:
        return self.summary().as_html()


def _count_lines(blocks: Sequence[str]) -> int:
    """Of blocks with an empty line between each."""
    return "\n\n".join(blocks).count("\n") + 1


def paragraph(text: str, width: int = WIDTH, then: str = "") -> str:
    """Fill lines, no number parted from its unit; line breaks in the text stay.

    Examples
    --------
    >>> print(paragraph("to within 7.5 µm", 14))
    to within
    7.5 µm
    """
    lines = [
        fill(keep_units(line), width, subsequent_indent=then, break_on_hyphens=False)
        for line in text.split("\n")
    ]
    return "\n".join(lines).replace(NO_BREAK_SPACE, " ")


def _aligned(lines: Sequence[Sequence[str]], widths: Sequence[int], left: Sequence[bool]) -> list[str]:
    def align(cell: str, width: int, flush_left: bool) -> str:
        text = _CONTROL.sub(" ", cell)
        return text.ljust(width) if flush_left else text.rjust(width)

    return [GAP.join(map(align, line, widths, left)).rstrip() for line in lines]


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
    """Style and script (may be empty) of a page, and the Content-Security-Policy that allows only them."""

    style: Markup
    script: Markup
    policy: str


def load_page_assets(style_sheet: str = "report.css", *, script: bool) -> PageAssets:
    """A style sheet, and the report's script where the page has one."""
    style, code = _read_asset(style_sheet), _read_asset("report.js" if script else "")
    scripts = _csp_hash(code) if script else "'none'"
    policy = (
        f"default-src 'none'; style-src {_csp_hash(style)}; script-src {scripts}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return PageAssets(style, code, policy)


def embed_json(content: Any) -> Markup:
    r"""Data as JSON for a script element, which no character of it can end.

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
