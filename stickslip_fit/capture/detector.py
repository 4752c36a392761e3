"""The ear that listens to a source: sound in, stops and faults out."""

from __future__ import annotations

import numpy as np

from stickslip_fit.capture.ear import Heard
from stickslip_fit.capture.evidence import Verdict, hear, nothing_heard
from stickslip_fit.capture.faults import fault_of, is_dead
from stickslip_fit.capture.source import Sound, Source
from stickslip_fit.capture.tuning import Tuning
from stickslip_fit.errors import InputError

DROWNED = 40  # checks running, 2 s: so long the room may be too loud
LONGEST = 2.0  # s; of a longer sound only the end is listened to
SLACK = 0.2  # of a check may have been heard before
UNHEARD = 2  # checks at the stop that may be drowned and the count still be trusted


class Detector:
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

    def __init__(self, source: Source, tuning: Tuning) -> None:
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
        self._evidence = nothing_heard(1)
        self._sound = np.zeros(0, np.float32)
        self._new = 0
        self._look = self._look_before = 0  # of this piece and of the one before
        self._looks = 0

    def check(self, seconds: float) -> Heard:
        """What the last so many seconds of sound say."""
        self._looks += 1
        seconds = min(seconds, LONGEST)
        samples = self.source.read(seconds)
        fault = fault_of(samples, round(seconds * self.source.rate))
        if fault:
            return Heard(False, np.nan, fault)
        heard = Heard(False, np.nan)
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
        whole = min(int(self._new / length + SLACK), len(sound) // length)
        if whole:
            self._new = 0
        self._sound = sound[-length:]
        return sound[len(sound) - whole * length :].reshape(whole, length)

    def _hear(self, piece: Sound) -> Heard:
        band, reference = self.tuning.powers(piece[None])
        if is_dead(band[0], reference[0]):
            return Heard(
                False, np.nan, "the microphone is dead: hardly anything is heard; see that it is plugged in"
            )
        self._look_before, self._look = self._look, self._looks
        self._evidence, verdict = hear(self.tuning.limits, self._evidence, band, reference)
        level = float(10 * np.log10(verdict.rise[0]))
        if verdict.at_stop[0]:
            return self._at_stop(level, verdict)
        if self._evidence.drowned[0] >= DROWNED:
            return Heard(False, level, "the room has become too loud to hear the stop; repeat the traverse")
        return Heard(False, level)

    def _at_stop(self, level: float, verdict: Verdict) -> Heard:
        unheard = int(verdict.unheard[0])
        late = self._look - self._look_before
        if unheard <= UNHEARD:
            return Heard(True, level, checks_late=late)
        fault = (
            f"the room was too loud for {unheard} checks when the stop was reached, so that the count is not "
            "to be trusted; repeat the traverse"
        )
        return Heard(True, level, fault, late)
