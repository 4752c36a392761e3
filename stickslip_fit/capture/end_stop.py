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
from stickslip_fit.capture.protocols import AudioSource, Detection, EndStopDetector, Sound
from stickslip_fit.capture.tuning import COLOUR_MEMORY, GAIN_MEMORY, DetectionLimits, Tuning
from stickslip_fit.errors import InputError


@dataclass(frozen=True, eq=False)
class SequentialTest:
    """State of the sequential test of n traverses.

    Attributes
    ----------
    gain : array, shape (n,)
        Running mean of the reference's power.
    colour : array, shape (n,)
        Running mean of the band's power over the gain.
    checks : array of int, shape (n,)
        In the running means.
    previous_rise : array, shape (n,)
        The capped rise of the check before, 0 where it was masked.
    masked : array of int, shape (n,)
        Consecutive masked checks up to now.
    uncertain : array of int, shape (n,)
        The same, up to the check before.
    """

    gain: Array
    colour: Array
    checks: Int64Array
    previous_rise: Array
    masked: Int64Array
    uncertain: Int64Array


@dataclass(frozen=True, eq=False)
class CheckDecision:
    """Result of one check of n traverses.

    Attributes
    ----------
    rise : array, shape (n,)
        Power in the band over its baseline.
    at_stop : array of bool, shape (n,)
        This check and the one before make a stop.
    uncertain : array of int, shape (n,)
        Masked checks right before those two: the stop may have been reached in any of them.
    """

    rise: Array
    at_stop: BoolArray
    uncertain: Int64Array


def begin_sequential_test(number: int) -> SequentialTest:
    """The state at the beginning of so many traverses."""
    zeros, none = np.zeros(number), np.zeros(number, dtype=np.int64)
    return SequentialTest(zeros, zeros, none, zeros, none, none)


def update_sequential_test(
    limits: DetectionLimits, test: SequentialTest, band: Array, reference: Array
) -> tuple[SequentialTest, CheckDecision]:
    """Add one check to a sequential test.

    A stop takes two consecutive checks, neither of which counts for more than its cap: one bang, however
    loud, is none. A rise that the reference shares is attributed to the room; where the reference rises
    much, the check is masked and counts for nothing. Before the first check the ratio of band and reference
    is expected to be that of the tuning; so a joint that begins at its stop is noticed, whatever the gain.

    Parameters
    ----------
    test : SequentialTest
        Of n traverses.
    band, reference : array, shape (n,)
        Powers of the check, over those of the joint moving freely in the tuning.
    """
    known = test.checks > 0
    gain = np.where(known, test.gain, reference)
    colour = np.where(known, test.colour, 1.0)
    checks = np.maximum(test.checks, 1)
    rise, reference_rise = band / (gain * colour), reference / gain
    masked = reference_rise > limits.masked[checks]
    own_rise = rise / np.maximum(reference_rise / limits.reference_rise, 1.0)
    capped = np.where(masked, 0.0, np.minimum(own_rise, limits.max_rise[checks]))
    at_stop = test.previous_rise + capped >= 2 * limits.pair_threshold[checks]
    quiet = ~masked & (own_rise < limits.min_rise[checks])
    longer = np.minimum(checks + 1, COLOUR_MEMORY)
    updated = SequentialTest(
        gain=np.where(quiet, gain + (reference - gain) / np.minimum(longer, GAIN_MEMORY), gain),
        colour=np.where(quiet, colour + (band / gain - colour) / longer, colour),
        checks=np.where(quiet, longer, checks),
        previous_rise=capped,
        masked=np.where(masked, test.masked + 1, 0),
        uncertain=test.masked,
    )
    return updated, CheckDecision(rise, at_stop, test.uncertain)


MAX_MASKED_CHECKS = 40  # consecutive checks, 2 s
MAX_SOUND_SECONDS = 2.0  # of a longer sound only the end is analysed
MAX_OVERLAP = 0.2  # share of a check that may have been heard before
MAX_UNCERTAIN_CHECKS = 2  # masked checks at the stop with which the count is still trusted


class SequentialDetector(EndStopDetector):
    """An `EndStopDetector` that applies the sequential test to the sound of a source.

    The sound is cut into checks as long as those of the tuning, the newest ones where it is no multiple.
    A shorter sound waits for the next; a small lack is filled with the sound before it.

    Raises
    ------
    InputError
        If the source has another rate than the tuning.
    """

    def __init__(self, source: AudioSource, tuning: Tuning) -> None:
        if source.rate != tuning.rate:
            raise InputError(
                f"the detector was tuned at {tuning.rate:,} samples per second and the sound has "
                f"{source.rate:,}; tune it again"
            )
        self.source = source
        self.tuning = tuning
        self.begin()

    def begin(self) -> None:
        self._test = begin_sequential_test(1)
        self._sound = np.zeros(0, np.float32)
        self._new = 0
        self._calls = 0
        self._call = self._call_before = 0  # in which this piece and the one before came

    def check(self, seconds: float) -> Detection:
        self._calls += 1
        seconds = min(seconds, MAX_SOUND_SECONDS)
        samples = self.source.read(seconds)
        fault = find_fault(samples, round(seconds * self.source.rate))
        if fault:
            return Detection(False, np.nan, fault)
        detection = Detection(False, np.nan)
        for piece in self._pieces(samples.values):
            detection = self._test_piece(piece)
            if detection.at_stop or detection.fault:
                break
        return detection

    def close(self) -> None:
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

    def _test_piece(self, piece: Sound) -> Detection:
        band, reference = self.tuning.powers(piece[None])
        if is_dead(band[0], reference[0]):
            fault = "the microphone is dead: hardly anything is heard; see that it is plugged in"
            return Detection(False, np.nan, fault)
        self._call_before, self._call = self._call, self._calls
        self._test, decision = update_sequential_test(self.tuning.limits, self._test, band, reference)
        level, late = float(10 * np.log10(decision.rise[0])), self._call - self._call_before
        at_stop, uncertain = bool(decision.at_stop[0]), int(decision.uncertain[0])
        fault = ""
        if at_stop and uncertain > MAX_UNCERTAIN_CHECKS:
            fault = (
                f"the room was too loud for {uncertain} checks when the stop was reached, so that the count "
                "is not to be trusted; repeat the traverse"
            )
        elif not at_stop and self._test.masked[0] >= MAX_MASKED_CHECKS:
            fault = "the room has become too loud to hear the stop; repeat the traverse"
        return Detection(at_stop, level, fault, late if at_stop else 0)
