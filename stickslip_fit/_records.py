"""Frozen records, many of which differ in a field or two."""

from __future__ import annotations

from dataclasses import Field
from typing import Any, ClassVar, Protocol


class _Record(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


def vary[T: _Record](record: T, **changes: Any) -> T:
    """As `dataclasses.replace`, nearly three times as fast, of a frozen dataclass that checks no field.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Wave:
    ...     period: float
    ...     harmonics: int = 1
    >>> vary(Wave(2.5), harmonics=3)
    Wave(period=2.5, harmonics=3)
    """
    varied, own = object.__new__(type(record)), record.__dict__
    # Without what the record has computed from its fields.
    varied.__dict__.update({name: own[name] for name in record.__dataclass_fields__} | changes)
    return varied
