"""Pages for people: the report of a log, made by `report`, and texts for moves and session sheets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stickslip_fit.reporting.page import Report, report

__all__ = ["Report", "report"]


def __getattr__(name: str) -> Any:
    """What `page` has: it loads matplotlib, which texts do without."""
    if name in __all__:
        from stickslip_fit.reporting import page

        return getattr(page, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
