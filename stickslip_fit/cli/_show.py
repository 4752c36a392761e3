"""How every command shows its result: one screen, all of it, or its tables in files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit._io import make_folder, write_atomically
from stickslip_fit.cli._files import Output

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from stickslip_fit._summary import Summary

Full = Annotated[bool, typer.Option("--full", help="Print all tables and remarks, not one screen.")]
Csv = Annotated[
    Path | None,
    typer.Option("--csv", metavar="DIR", help="Also save every table in this folder, as CSV."),
    Output(folder=True),
]
Latex = Annotated[
    Path | None,
    typer.Option("--latex", metavar="FILE", help="Also save every table here, as LaTeX (booktabs)."),
    Output(),
]
MAX_TITLES = 57  # letters, so that they stand on one line


@dataclass(frozen=True)
class Display:
    """How a result is shown.

    Attributes
    ----------
    full : bool
        Print everything.
    csv, latex : Path or None
        Folder and file for the tables.
    """

    full: Full = False
    csv: Csv = None
    latex: Latex = None


def show(summary: Summary, display: Display, sources: Sequence[Path] = (), saved: Iterable[str] = ()) -> None:
    """Print a summary, and save its tables where that is asked for.

    Parameters
    ----------
    sources : sequence of Path
        Files that the command read, none of which is replaced.
    saved : iterable of str
        Lines that say which other files were written.
    """
    # Saved before anything is printed: the reader of the output may close it.
    lines = [*saved, *save_tables(summary, display, sources)]
    if display.full:
        text = summary.as_text(full=True)
    else:
        text, left_out = summary.as_screen()
        if left_out:
            lines.insert(0, name_left_out(left_out))
    print("\n\n".join(filter(None, [text, "\n".join(lines)])))


def save_json(save: Callable[[Path], object], path: Path | None) -> list[str]:
    """Save a result where that is asked for; a line that says where."""
    if path is None:
        return []
    save(path)
    return [f"saved to {path}"]


def save_chart(draw: Callable[[], Figure], path: Path | None, key: str, what: str = "chart") -> list[str]:
    """Draw a chart where that is asked for; a line that says where."""
    if path is None:
        return []
    from stickslip_fit.plotting._style import write_figure

    write_figure(draw(), path, key)
    return [f"{what} written to {path}"]


def save_tables(summary: Summary, display: Display, sources: Sequence[Path]) -> list[str]:
    """Write the tables as asked for; a line for each kind."""
    from stickslip_fit._format import pluralize

    lines, number = [], pluralize(len(summary.tables), "table")
    if display.csv is not None:
        make_folder(display.csv)
        for name, text in summary.as_csv().items():
            write_atomically(display.csv / name, text, sources=sources)
        lines.append(f"{number} saved in {display.csv}")
    if display.latex is not None:
        write_atomically(display.latex, summary.as_latex(), sources=sources)
        lines.append(f"{number} saved to {display.latex}")
    return lines


def name_left_out(titles: Sequence[str]) -> str:
    """A line on what --full shows beside.

    Examples
    --------
    >>> print(name_left_out(["Sums of squares", "Cautions"]))
    --full adds: Sums of squares; Cautions. --csv DIR, --latex FILE: every table.
    """
    named: list[str] = []
    for title in titles:
        if named and len("; ".join([*named, title])) > MAX_TITLES:
            break
        named.append(title)
    more = len(titles) - len(named)
    text = "; ".join(named) + (f"; {more} more" if more else "")
    return f"--full adds: {text}. --csv DIR, --latex FILE: every table."
