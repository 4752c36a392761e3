"""The columns of a log and how each may be spelled, as the reader has them."""

from __future__ import annotations

from markdown import code, table

from stickslip_fit.logs.schema import FIELDS


def page() -> str:
    """A table of all columns."""
    rows = [
        (" or ".join(map(code, field.spellings)), "yes" if field.required else "", code(field.name))
        for field in FIELDS
    ]
    return table(["column in a file", "must be there", "in `Log.rows`"], rows)
