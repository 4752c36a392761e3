"""From the powers of checks to stops: one step of the sequential test, for many traverses side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.capture.limits import COLOUR_MEMORY, GAIN_MEMORY, Limits

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What has been heard of n traverses so far.

    Attributes
    ----------
    gain : array, shape (n,)
        Running mean of the reference's power.
    colour : array, shape (n,)
        Running mean of the band's power over the gain.
    checks : array of int, shape (n,)
        In the running means.
    before : array, shape (n,)
        The rise that the check before counts for, 0 where it was drowned by the room.
    drowned : array of int, shape (n,)
        Checks running that were drowned, up to now.
    unheard : array of int, shape (n,)
        The same, up to the check before.
    """

    gain: Array
    colour: Array
    checks: Counts
    before: Array
    drowned: Counts
    unheard: Counts


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a check says of n traverses.

    Attributes
    ----------
    rise : array, shape (n,)
        Power in the band over its baseline.
    at_stop : array of bool, shape (n,)
        This check and the one before make a stop.
    unheard : array of int, shape (n,)
        Checks right before those two that were drowned by the room: the stop may have been reached in any
        of them.
    """

    rise: Array
    at_stop: Flags
    unheard: Counts


def nothing_heard(number: int) -> Evidence:
    """The beginning of so many traverses."""
    zeros, none = np.zeros(number), np.zeros(number, dtype=np.int64)
    return Evidence(zeros, zeros, none, zeros, none, none)


def hear(limits: Limits, evidence: Evidence, band: Array, reference: Array) -> tuple[Evidence, Verdict]:
    """Add one check to the evidence.

    A stop is what two running checks hear, neither of which counts for more than its cap: one bang, however
    loud, is none. What the band rises with its neighbours, the reference, is the room's and not the stop's;
    where they rise much, the check is drowned and counts for nothing.
    Before anything is known of a traverse the band is expected to sound as it did when it was tuned,
    relative to the reference; so a joint that begins at its stop is noticed, whatever the gain.

    Parameters
    ----------
    limits : Limits
    evidence : Evidence
        Of n traverses.
    band, reference : array, shape (n,)
        Powers of the check, over those of the joint moving freely when the ear was tuned.

    Returns
    -------
    Evidence, Verdict
    """
    known = evidence.checks > 0
    gain = np.where(known, evidence.gain, reference)
    colour = np.where(known, evidence.colour, 1.0)
    checks = np.maximum(evidence.checks, 1)
    rise, rise_outside = band / (gain * colour), reference / gain
    drowned = rise_outside > limits.drowned[checks]
    own = rise / np.maximum(rise_outside / limits.reference_rise, 1.0)
    counts = np.where(drowned, 0.0, np.minimum(own, limits.cap[checks]))
    at_stop = evidence.before + counts >= 2 * limits.pair[checks]
    quiet = ~drowned & (own < limits.least[checks])
    longer = np.minimum(checks + 1, COLOUR_MEMORY)
    heard = Evidence(
        gain=np.where(quiet, gain + (reference - gain) / np.minimum(longer, GAIN_MEMORY), gain),
        colour=np.where(quiet, colour + (band / gain - colour) / longer, colour),
        checks=np.where(quiet, longer, checks),
        before=counts,
        drowned=np.where(drowned, evidence.drowned + 1, 0),
        unheard=evidence.drowned,
    )
    return heard, Verdict(rise, at_stop, evidence.unheard)
