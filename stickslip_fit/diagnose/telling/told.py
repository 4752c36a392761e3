"""What the cause of a finding does in its log, and what a lab can do about it."""

from __future__ import annotations

from typing import Any

from stickslip_fit._format import format_percent
from stickslip_fit.causes import EndStopMisfire
from stickslip_fit.causes.parameters import plain_description
from stickslip_fit.diagnose.diagnosis import Finding


def what_happens(finding: Finding) -> str:
    """What a named cause does, without a full stop.

    Parameters
    ----------
    finding : Finding
        Of any cause; one that doesn't describe itself, not being a `Cause`, is told by its phrase. Without
        parameters, the size of the effect stands for theirs.
    """
    cause = _cause(finding)
    if hasattr(cause, "describe"):
        text = cause.describe(finding.parameters)
    else:
        text = plain_description(getattr(cause, "phrase", finding.cause), finding.parameters)
    return text if finding.parameters else f"{text}, by {format_percent(finding.effect.estimate)} rms"


def what_to_do(finding: Finding) -> str:
    """What cures it, as the beginning of a sentence; empty where nothing but the extended law does."""
    return getattr(_cause(finding), "remedy", "")


def _cause(finding: Finding) -> Any:
    """The cause as it acts in the log; counts that misfired are left out of it, and need no version."""
    return EndStopMisfire() if finding.cause == EndStopMisfire.name else finding.version
