"""What both dialects of the NanoControl have in common: channels and coarse steps."""

from __future__ import annotations

from collections.abc import Iterator

from stickslip_fit.errors import InputError

CHANNELS = {1: "A", 2: "B", 3: "C"}
STEP_PERIOD = 0.010  # s


def channel_of(joint: int) -> str:
    """The channel that drives a joint.

    Raises
    ------
    InputError
        For a joint that is none of 1, 2, 3.
    """
    if joint not in CHANNELS:
        raise InputError(f"joint {joint} is none of 1, 2, 3; correct the plan")
    return CHANNELS[joint]


def parts_of(steps: int, most: int) -> Iterator[int]:
    """A move in parts that a single command can hold.

    Examples
    --------
    >>> list(parts_of(-250, 100))
    [-100, -100, -50]
    """
    left = abs(steps)
    while left:
        part = min(left, most)
        left -= part
        yield part if steps > 0 else -part
