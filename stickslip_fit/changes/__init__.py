"""Whether an actuator has changed from one log to another, beyond its scatter from day to day."""

from stickslip_fit.changes import _summary as _summary  # registers how changes are summarized
from stickslip_fit.changes.detection import Change, Changes, detect_changes
from stickslip_fit.changes.difference import SessionEstimates, compare_means

__all__ = ["Change", "Changes", "SessionEstimates", "compare_means", "detect_changes"]
