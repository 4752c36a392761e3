"""The columns of a log and how each may be spelled, as the reader has them."""

from math import isfinite

from markdown import code, table

from stickslip_fit.logs.schema import FIELDS, Field
from stickslip_fit.units import SUFFIXES, from_si


def page() -> str:
    """A table of all columns."""
    rows = [
        (
            " or ".join(map(code, field.spellings)),
            "yes" if field.required else "",
            limits(field),
            code(field.name),
        )
        for field in FIELDS
    ]
    return table(["column in a file", "must be there", "limits", "in `Log.rows`"], rows)


def limits(field: Field) -> str:
    """Lowest and highest value, in the usual unit."""
    low, high = field.limits
    if not isfinite(low):
        return ""
    unit = SUFFIXES[field.suffixes[0]] if field.suffixes else "1"
    return f"{from_si(low, unit):g} to {from_si(high, unit):g}{'' if unit == '1' else f' {unit}'}"
