"""The measurement log and the plan of a campaign: read, checked, given its history, written."""

from typing import TYPE_CHECKING, Any

from stickslip_fit.logs.history import add_history
from stickslip_fit.logs.log import Log, write_log
from stickslip_fit.logs.plan import Plan
from stickslip_fit.logs.reader import read_log

if TYPE_CHECKING:
    from stickslip_fit.logs.plan_reader import read_plan

__all__ = ["Log", "Plan", "add_history", "read_log", "read_plan", "write_log"]


def __getattr__(name: str) -> Any:
    # The models of a plan file take time to build, which few commands need.
    if name == "read_plan":
        from stickslip_fit.logs.plan_reader import read_plan

        return read_plan
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
