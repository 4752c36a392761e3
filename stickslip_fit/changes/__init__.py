"""Whether an actuator has changed from one log to another, beyond its scatter from day to day."""

from stickslip_fit.changes import _summary as _summary  # registers how changes are summarized
from stickslip_fit.changes.detection import Change, Changes, detect_changes
from stickslip_fit.changes.difference import SessionEstimates, compare_means
from stickslip_fit.changes.stage import StageDifference, read_stage_difference

__all__ = [
    "Change",
    "Changes",
    "SessionEstimates",
    "StageDifference",
    "compare_means",
    "detect_changes",
    "read_stage_difference",
]
