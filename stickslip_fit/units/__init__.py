"""SI inside, people's units at the edge."""

from stickslip_fit.units.unit import JOINTS, PRISMATIC, SUFFIXES, UNITS, Interval, Unit, from_si, to_si

__all__ = ["JOINTS", "PRISMATIC", "SUFFIXES", "UNITS", "Interval", "Unit", "from_si", "to_si"]
