"""SI inside, people's units at the edge."""

from stickslip_fit.units.format import format_uncertain, format_value
from stickslip_fit.units.table import text_table
from stickslip_fit.units.unit import SUFFIXES, UNITS, Unit, from_si, to_si

__all__ = ["SUFFIXES", "UNITS", "Unit", "format_uncertain", "format_value", "from_si", "text_table", "to_si"]
