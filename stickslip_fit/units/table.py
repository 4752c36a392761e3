"""Tables of text whose columns line up."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Lay out rows of cells under a header.

    Parameters
    ----------
    header : sequence of str
    rows : sequence of sequences of str
    left : int, optional
        How many columns, from the first, are set flush left; the others flush right.

    Examples
    --------
    >>> print(text_table(["joint", "rms"], [["2", "0.3 µrad"], ["3", "12.0 nm"]]))
    joint       rms
    2      0.3 µrad
    3       12.0 nm
    """
    lines = [list(header), *(list(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column < left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
