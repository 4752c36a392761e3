"""Tables as CSV, to compute with, and as LaTeX, to print."""

from __future__ import annotations

import csv
import io
import re
import unicodedata
from collections.abc import Iterable, Sequence
from itertools import count
from typing import Protocol

from stickslip_fit._format import MINUS, MISSING

NUMBER = r"[+-]?(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?:e[+-]?\d+)?"
ONE = re.compile(NUMBER)
UNCERTAIN = re.compile(rf"({NUMBER}) ± ({NUMBER})")
INTERVAL = re.compile(rf"({NUMBER}) to ({NUMBER})")
WITH_UNIT = re.compile(rf"(.*{NUMBER}) ([^\d\s]\S*)")
EMPTY = ("", MISSING)
LATEX = {
    **{each: f"\\{each}" for each in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"<": "$<$", ">": "$>$", "|": r"\textbar{}", '"': r"\textquotedbl{}"},
    **{
        MINUS: "$-$",
        "–": "--",
        "—": "---",
        "…": r"\dots{}",
        "±": r"$\pm$",
        "×": r"$\times$",
        "·": r"$\cdot$",
    },
    **{
        "µ": r"\textmu{}",
        "μ": r"\textmu{}",
        "°": r"\textdegree{}",
        "²": "$^2$",
        "³": "$^3$",
        "√": r"$\surd$",
    },
    **{"≤": r"$\leq$", "≥": r"$\geq$", "≈": r"$\approx$", "→": r"$\to$", "’": "'", "“": "``", "”": "''"},
    **{
        letter: f"$\\{unicodedata.name(letter).split()[-1].lower()}$"
        for letter in "αβγδεθκλμνξπρστφχψωΔΩ"
        if letter not in "μΔΩ"
    },
    **{"Δ": r"$\Delta$", "Ω": r"$\Omega$"},
}


class Head(Protocol):
    """The head of a column, as `_summary.Column`."""

    @property
    def head(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def group(self) -> str: ...
    @property
    def text(self) -> bool: ...


class Cells(Protocol):
    """A table, as `_summary.Table`."""

    @property
    def caption(self) -> str: ...
    @property
    def columns(self) -> Sequence[Head]: ...
    @property
    def rows(self) -> Sequence[Sequence[str]]: ...
    @property
    def note(self) -> str: ...
    @property
    def groups(self) -> Sequence[tuple[str, int]]: ...


def table_as_csv(table: Cells) -> str:
    """A line of heads with their units, then the rows.

    Numbers are plain: no separator of thousands, a hyphen for minus, nothing where a value is missing. A
    column of estimates with their uncertainty becomes two columns, and so does one of intervals.
    """
    columns = []
    for place, column in enumerate(table.columns):
        columns += _split(column, [row[place] for row in table.rows])
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([head for head, _ in columns])
    writer.writerows(zip(*(cells for _, cells in columns), strict=True))
    return buffer.getvalue()


def _split(column: Head, cells: Sequence[str]) -> list[tuple[str, list[str]]]:
    """A column as one or two columns of a file, each with its head."""
    plain, own = [cell.replace(MINUS, "-") for cell in cells], column.unit
    name = f"{column.group}: {column.head}" if column.group else column.head
    if not column.text and not own and (own := _common_unit(plain)):
        plain = [cell.removesuffix(f" {own}") for cell in plain]
    unit = f" ({own})" if own else ""
    filled = [cell for cell in plain if cell not in EMPTY]
    for pattern, heads in (
        (UNCERTAIN, (f"{name}{unit}", f"{name}, standard error{unit}")),
        (INTERVAL, (f"{name}, low{unit}", f"{name}, high{unit}")),
    ):
        if not column.text and filled and all(map(pattern.fullmatch, filled)):
            found = [pattern.fullmatch(cell) for cell in plain]
            return [
                (head, [match[part].replace(",", "") if match else "" for match in found])
                for part, head in enumerate(heads, start=1)
            ]
    if column.text:
        return [(f"{name}{unit}", list(cells))]
    numbers = [cell.replace(",", "") if ONE.fullmatch(cell) else cell for cell in plain]
    return [(f"{name}{unit}", ["" if cell in EMPTY else cell for cell in numbers])]


def _common_unit(cells: Sequence[str]) -> str:
    """The unit that stands behind the numbers of all cells that are not empty; empty where they differ."""
    found = [WITH_UNIT.fullmatch(cell) for cell in cells if cell not in EMPTY]
    units = {match[2] if match else "" for match in found}
    return units.pop() if len(units) == 1 else ""


def table_as_latex(table: Cells) -> str:
    """A `table` with its caption, for the package booktabs."""
    shape = "".join("l" if column.text else "r" for column in table.columns)
    lines = [r"\begin{table}", r"\centering", rf"\caption{{{escape_latex(table.caption)}}}"]
    lines += [rf"\begin{{tabular}}{{{shape}}}", r"\toprule"]
    if table.groups:
        upper, rules, first = [], [], 1
        for group, span in table.groups:
            upper.append(rf"\multicolumn{{{span}}}{{c}}{{{escape_latex(group)}}}")
            rules += [rf"\cmidrule(lr){{{first}-{first + span - 1}}}"] if group else []
            first += span
        lines += [_latex_row(upper), " ".join(rules)]
    lines.append(_latex_row(escape_latex(column.head) for column in table.columns))
    if any(column.unit for column in table.columns):
        lines.append(_latex_row(escape_latex(column.unit) for column in table.columns))
    lines.append(r"\midrule")
    lines += [_latex_row(map(escape_latex, row)) for row in table.rows]
    lines += [r"\bottomrule", r"\end{tabular}"]
    lines += [rf"\par\smallskip{{\footnotesize {escape_latex(table.note)}}}"] if table.note else []
    return "\n".join([*lines, r"\end{table}", ""])


def _latex_row(cells: Iterable[str]) -> str:
    # A bracket after a row's end would be read as its option.
    return " & ".join(f"{{{cell}}}" if cell.startswith("[") else cell for cell in cells) + r" \\"


def escape_latex(text: str) -> str:
    r"""Text in which no letter is a command, and all are ones that pdfLaTeX has.

    Examples
    --------
    >>> escape_latex("gamma0_q3_0: 5 % ± 3 µrad")
    'gamma0\\_q3\\_0: 5 \\% $\\pm$ 3 \\textmu{}rad'
    """
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    return "".join(LATEX.get(letter, letter) for letter in printable)


def csv_names(captions: Iterable[str]) -> list[str]:
    """A file's name for each table, from its caption; no two alike."""
    names: list[str] = []
    for caption in captions:
        stem = re.sub(r"[^a-z0-9]+", "-", caption.lower()).strip("-")[:60] or "table"
        candidates = (f"{stem}-{number}.csv" if number > 1 else f"{stem}.csv" for number in count(1))
        names.append(next(name for name in candidates if name not in names))
    return names
