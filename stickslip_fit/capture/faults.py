"""What is wrong with a sound, so that nothing can be heard in it."""

from __future__ import annotations

import numpy as np

from stickslip_fit.capture.source import Samples

FULL_SCALE = 0.999
CLIPPED = 4  # samples of a check at full scale
DEAD = 1e-3  # of the power that was tuned to: what a microphone that is unplugged leaves is fainter


def fault_of(samples: Samples, expected: int) -> str:
    """A sentence on what is wrong and what to do, or nothing.

    Parameters
    ----------
    samples : Samples
    expected : int
        How many there should be; half of them will do, since some sources round.

    Examples
    --------
    >>> fault_of(Samples(np.zeros(2400, np.float32)), 2400)
    'the microphone is dead: it gives one value only; see that it is plugged in and not muted'
    """
    values = samples.values
    if samples.overflowed:
        return "sound was lost before it was listened to; close other programs and try again"
    if len(values) < expected / 2:
        return "the sound has ended; see that the microphone is still plugged in"
    if not np.all(np.isfinite(values)):
        return "the sound holds values that are no numbers; choose another device"
    if len(values) and np.ptp(values) == 0:
        return "the microphone is dead: it gives one value only; see that it is plugged in and not muted"
    if np.count_nonzero(np.abs(values) >= FULL_SCALE) >= CLIPPED:
        return "the sound clips; turn the microphone's gain down and tune again"
    return ""


def is_dead(band: float, reference: float) -> bool:
    """Whether powers over those that were tuned to are those of no microphone at all."""
    return band < DEAD and reference < DEAD
