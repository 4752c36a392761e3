"""SequentialDetector: detects the end stop in the sound of a traverse by a sequential test.

A stop is detected when the mean power of two consecutive checks in the tuned band exceeds its
threshold. The contribution of each check is capped, so that one loud noise is no stop. Neighbouring
bands serve as reference: a check in which they are too loud as well is masked and counts for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit._typing import Array, BoolArray, Int64Array
from stickslip_fit.capture.audio import find_fault, is_dead
from stickslip_fit.capture.protocols import AudioSource, Detection, Sound
from stickslip_fit.capture.tuning import COLOUR_MEMORY, GAIN_MEMORY, DetectionLimits, Tuning
from stickslip_fit.errors import InputError


@dataclass(frozen=True, eq=False)
class SequentialTest:
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
    checks: Int64Array
    before: Array
    masked: Int64Array
    uncertain: Int64Array


@dataclass(frozen=True, eq=False)
class CheckDecision:
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
    at_stop: BoolArray
    uncertain: Int64Array


def begin_sequential_test(number: int) -> SequentialTest:
    """The beginning of so many traverses."""
    zeros, none = np.zeros(number), np.zeros(number, dtype=np.int64)
    return SequentialTest(zeros, zeros, none, zeros, none, none)


def update_sequential_test(
    limits: DetectionLimits, evidence: SequentialTest, band: Array, reference: Array
) -> tuple[SequentialTest, CheckDecision]:
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
    masked = rise_outside > limits.masked[checks]
    own = rise / np.maximum(rise_outside / limits.reference_rise, 1.0)
    counts = np.where(masked, 0.0, np.minimum(own, limits.max_rise[checks]))
    at_stop = evidence.before + counts >= 2 * limits.pair_threshold[checks]
    quiet = ~masked & (own < limits.least[checks])
    longer = np.minimum(checks + 1, COLOUR_MEMORY)
    heard = SequentialTest(
        gain=np.where(quiet, gain + (reference - gain) / np.minimum(longer, GAIN_MEMORY), gain),
        colour=np.where(quiet, colour + (band / gain - colour) / longer, colour),
        checks=np.where(quiet, longer, checks),
        before=counts,
        masked=np.where(masked, evidence.masked + 1, 0),
        uncertain=evidence.masked,
    )
    return heard, CheckDecision(rise, at_stop, evidence.uncertain)


MAX_MASKED_CHECKS = 40  # checks running, 2 s: so long the room may be too loud
MAX_SOUND_SECONDS = 2.0  # s; of a longer sound only the end is listened to
MAX_OVERLAP = 0.2  # of a check may have been heard before
MAX_UNCERTAIN_CHECKS = 2  # checks at the stop that may be drowned and the count still be trusted


class SequentialDetector:
    """Hears the stop in the sound of a source; an `Ear`.

    The sound is cut into checks as long as those it was tuned with, the newest ones where it is no multiple.
    What is shorter waits for the sound after it; a little that is lacking is taken from the sound before it.

    Parameters
    ----------
    source : Source
    tuning : Tuning

    Raises
    ------
    InputError
        If the source has another rate than the tuning.
    """

    def __init__(self, source: AudioSource, tuning: Tuning) -> None:
        if source.rate != tuning.rate:
            raise InputError(
                f"the ear was tuned at {tuning.rate:,} samples per second and the sound has {source.rate:,}; "
                "tune it again"
            )
        self.source = source
        self.tuning = tuning
        self.begin()

    def begin(self) -> None:
        """A new traverse: forget the one before."""
        self._evidence = begin_sequential_test(1)
        self._sound = np.zeros(0, np.float32)
        self._new = 0
        self._look = self._look_before = 0  # of this piece and of the one before
        self._looks = 0

    def check(self, seconds: float) -> Detection:
        """What the last so many seconds of sound say."""
        self._looks += 1
        seconds = min(seconds, MAX_SOUND_SECONDS)
        samples = self.source.read(seconds)
        fault = find_fault(samples, round(seconds * self.source.rate))
        if fault:
            return Detection(False, np.nan, fault)
        heard = Detection(False, np.nan)
        for piece in self._pieces(samples.values):
            heard = self._hear(piece)
            if heard.at_stop or heard.fault:
                break
        return heard

    def close(self) -> None:
        """Let go of the source."""
        self.source.close()

    def _pieces(self, values: Sound) -> Sound:
        """The sound that is new, in checks, shape (checks, samples of one)."""
        length = self.tuning.samples
        sound = np.concatenate([self._sound, values])
        self._new += len(values)
        whole = min(int(self._new / length + MAX_OVERLAP), len(sound) // length)
        if whole:
            self._new = 0
        self._sound = sound[-length:]
        return sound[len(sound) - whole * length :].reshape(whole, length)

    def _hear(self, piece: Sound) -> Detection:
        band, reference = self.tuning.powers(piece[None])
        if is_dead(band[0], reference[0]):
            return Detection(
                False, np.nan, "the microphone is dead: hardly anything is heard; see that it is plugged in"
            )
        self._look_before, self._look = self._look, self._looks
        self._evidence, verdict = update_sequential_test(self.tuning.limits, self._evidence, band, reference)
        level = float(10 * np.log10(verdict.rise[0]))
        if verdict.at_stop[0]:
            return self._at_stop(level, verdict)
        if self._evidence.masked[0] >= MAX_MASKED_CHECKS:
            return Detection(
                False, level, "the room has become too loud to hear the stop; repeat the traverse"
            )
        return Detection(False, level)

    def _at_stop(self, level: float, verdict: CheckDecision) -> Detection:
        uncertain = int(verdict.uncertain[0])
        late = self._look - self._look_before
        if uncertain <= MAX_UNCERTAIN_CHECKS:
            return Detection(True, level, late_checks=late)
        fault = (
            f"the room was too loud for {uncertain} checks when the stop was reached, so that the count is not "
            "to be trusted; repeat the traverse"
        )
        return Detection(True, level, fault, late)
