"""Amounts written as text: a number with its unit."""

from __future__ import annotations

import re
import sys
from typing import Any

_PATTERN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?) *(.*)")


def parse_quantity(entry: Any) -> tuple[float, str]:
    """Number and unit of a text such as "3 %"; a bare number has the unit 1.

    Examples
    --------
    >>> parse_quantity("-0.14 ms"), parse_quantity(3)
    ((-0.14, 'ms'), (3.0, '1'))
    """
    if type(entry) in (int, float) and abs(entry) <= sys.float_info.max:
        return float(entry), "1"
    match = _PATTERN.fullmatch(entry.strip()) if isinstance(entry, str) else None
    if match is None:
        raise ValueError("no number")
    unit = match[2].replace("urad", "µrad").replace("^2", "²")
    return float(match[1]), unit or "1"
