"""Hearing the end stop at good and bad signal-to-noise ratios, beside a plain fixed threshold."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from time import process_time

import numpy as np

from stickslip_fit.capture.audio import Recording
from stickslip_fit.capture.emulator.acoustics import (
    Acoustics,
    CheckPowers,
    PowerDistribution,
    compute_powers,
    synthesize_sound,
)
from stickslip_fit.capture.end_stop import (
    SequentialDetector,
    SequentialTest,
    begin_sequential_test,
    update_sequential_test,
)
from stickslip_fit.capture.protocols import Sound
from stickslip_fit.capture.tuning import (
    CHECKS_PER_TRAVERSE,
    FALSE_STOPS_PER_TRAVERSE,
    DetectionLimits,
    Tuning,
    choose_tuning,
    power_quantile,
)

RATIOS = (-12, -9, -6, -3, -2, -1, 0, 1, 2, 3, 6, 9, 12)  # dB
STEPS, SECONDS = 5, 0.05  # of a check
LISTEN = 100  # checks, moving and at the stop
AFTER = 4  # checks that are listened to at the stop
DRIFT = 6.0  # dB up and down within two minutes
TRAVERSES, AT_ZERO, SOUNDED = 20_000, 100_000, 40
BATCH = 4_000
DISTURBED = {"bangs": 0.05, "speech": 0.03, "drift_db": DRIFT}


@dataclass
class Running:
    """Our ear, for many traverses side by side."""

    limits: DetectionLimits
    evidence: SequentialTest = field(init=False)

    def begin(self, traverses: int) -> None:
        """Forget the traverses before."""
        self.evidence = begin_sequential_test(traverses)

    def check(self, band: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Whether each is at its stop."""
        self.evidence, verdict = update_sequential_test(self.limits, self.evidence, band, reference)
        return verdict.at_stop


@dataclass
class Fixed:
    """A threshold on the band's power, set once, that one check must exceed."""

    threshold: float

    def begin(self, traverses: int) -> None:
        """There is nothing to forget."""

    def check(self, band: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Whether each is at its stop."""
        return band > self.threshold


Judge = Running | Fixed


@dataclass(frozen=True)
class Found:
    """What a judge made of traverses.

    Attributes
    ----------
    imagined : float
        Share of the traverses in which a stop was imagined before it was there.
    at : array of int, shape (n,)
        By how many checks at the stop it was found, `AFTER` + 1 where it was not.
    """

    imagined: float
    at: np.ndarray

    @property
    def late(self) -> float:
        """Share of the stops not found at the first or second check."""
        return float(np.mean(self.at > 2))


def rehearse(
    judge: Judge,
    powers: CheckPowers,
    traverses: int,
    rng: np.random.Generator,
    *,
    checks: int = CHECKS_PER_TRAVERSE,
    drift_db: float = 0.0,
    pushed: np.ndarray | None = None,
) -> Found:
    """Many traverses by the powers of their checks.

    Parameters
    ----------
    pushed : array, shape (traverses,), optional
        Share of the last of the moving checks that is at the stop already; without it, none.
    """
    judge.begin(traverses)
    phase = rng.uniform(0, 2 * np.pi, traverses)
    imagined = np.zeros(traverses, bool)
    at = np.full(traverses, AFTER + 1)
    for check in range(checks + AFTER):
        share = float(check >= checks) if pushed is None or check != checks - 1 else pushed
        gain = 10 ** (drift_db / 10 * np.sin(2 * np.pi * check * SECONDS / 120 + phase))
        band = mixed(powers.band, powers.band_at_stop, share, traverses, rng)
        reference = mixed(powers.reference, powers.reference_at_stop, share, traverses, rng)
        heard = judge.check(gain * band, gain * reference)
        if check < checks - (pushed is not None):
            imagined |= heard
        else:
            at = np.where(heard & (at > AFTER), check - checks + 1, at)
    return Found(float(imagined.mean()), at)


def mixed(
    moving: PowerDistribution,
    at_stop: PowerDistribution,
    share: float | np.ndarray,
    traverses: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Powers of checks of which a share is at the stop."""
    if np.ndim(share) == 0:
        return (at_stop if share else moving).draw(traverses, rng)
    mean = 1 + share * (at_stop.mean - 1)
    return mean * moving.draw(traverses, rng)


def tuned(acoustics: Acoustics, rng: np.random.Generator) -> Tuning:
    """As before a session, from five seconds each."""
    calm = replace(acoustics, bangs=0.0, speech=0.0, drift_db=0.0)
    ways = [np.full(STEPS * LISTEN, pushing) for pushing in (False, True)]
    moving, at_stop = (synthesize_sound(calm, 0.0, np.ones(len(way)), way, rng) for way in ways)
    return choose_tuning(moving, at_stop, calm.rate, SECONDS)


def recorded(acoustics: Acoustics, began: float, checks: int, rng: np.random.Generator) -> Sound:
    """The sound of a traverse that meets its stop after so many checks, made ten seconds at a time."""
    pushing = np.arange(STEPS * (checks + AFTER)) >= STEPS * checks
    parts = np.split(pushing, range(1000, len(pushing), 1000))
    times = began + acoustics.period * np.arange(0, len(pushing), 1000)
    return np.concatenate(
        [
            synthesize_sound(acoustics, at, np.ones(len(part)), part, rng)
            for at, part in zip(times, parts, strict=True)
        ]
    )


def listened(detector: SequentialDetector) -> tuple[int, bool]:
    """The check at which a detector stops, and whether for a fault."""
    detector.begin()
    check = 0
    while True:
        check += 1
        heard = detector.check(SECONDS)
        if heard.at_stop or heard.fault:
            return check, bool(heard.fault)


def main() -> None:
    """Print the operating curve, what bangs and speech do, and the share of a core."""
    rng = np.random.default_rng(20261121)
    at_zero = tuned(Acoustics(0.0), rng)
    print("late: not found at the first or second check at the stop, per 1,000 stops")
    print(f"imagined: traverses of {STEPS * CHECKS_PER_TRAVERSE:,} steps with an imagined stop, per 1,000")
    print("      ------ ours ------   -- ours, drift --   ---- threshold ---   threshold, drift")
    print("  dB     late  imagined      late  imagined      late  imagined      late  imagined")
    for ratio in RATIOS:
        print(f"{ratio:4d}" + "".join(cell(ratio, judge, drift, at_zero, rng)
              for judge in ("ours", "threshold") for drift in (0.0, DRIFT)), flush=True)  # fmt: skip
    for ratio in (0, 3, 6, 12):
        print(anywhere(ratio, rng), flush=True)
    for ratio in (0, 6, 12):
        print(disturbed(ratio, rng), flush=True)
    print(speed(rng))


def cell(ratio: int, name: str, drift: float, at_zero: Tuning, rng: np.random.Generator) -> str:
    """Two figures of the table; several tunings for each, so that none is a lucky one."""
    acoustics = Acoustics(float(ratio))
    set_once = Fixed(power_quantile(FALSE_STOPS_PER_TRAVERSE / CHECKS_PER_TRAVERSE, at_zero.df))
    found = []
    for _ in range(max((AT_ZERO if ratio == 0 else TRAVERSES) // BATCH, 1)):
        tuning = tuned(acoustics, rng) if name == "ours" else at_zero
        judge = Running(tuning.limits) if name == "ours" else set_once
        found.append(rehearse(judge, compute_powers(acoustics, tuning), BATCH, rng, drift_db=drift))
        stops = rehearse(judge, compute_powers(acoustics, tuning), 5 * BATCH, rng, checks=80, drift_db=drift)
        found.append(Found(np.nan, stops.at))
    late, imagined = (
        1e3 * np.nanmean([getattr(each, part) for each in found]) for part in ("late", "imagined")
    )
    return f"  {late:8.2f}  {imagined:8.2f}"


def anywhere(ratio: int, rng: np.random.Generator) -> str:
    """What becomes of a count where the stop is met at any of a check's steps."""
    acoustics = Acoustics(float(ratio))
    tuning = tuned(acoustics, rng)
    pushed = rng.integers(1, STEPS + 1, 10 * BATCH) / STEPS
    judge = Running(tuning.limits)
    found = rehearse(judge, compute_powers(acoustics, tuning), 10 * BATCH, rng, checks=80, pushed=pushed)
    off = STEPS * (found.at - 1)  # the count leaves out the later check of the two
    right = np.mean(off == 0)
    return (f"{ratio:4d} dB, the stop met at any step of a check: counts right {100 * right:.1f} %, "
            f"off by {off.mean():+.2f} steps on average, {off.std():.2f} standard deviation")  # fmt: skip


def disturbed(ratio: int, rng: np.random.Generator) -> str:
    """Whole sounds with three bangs and two talks a minute and a drift."""
    detector_of = tuned(Acoustics(float(ratio)), rng)
    right = imagined = late = refused = 0
    for number in range(SOUNDED):
        acoustics = Acoustics(float(ratio), seed=number, **DISTURBED)
        sound = recorded(acoustics, float(rng.uniform(0, 120)), CHECKS_PER_TRAVERSE, rng)
        at, fault = listened(SequentialDetector(Recording(sound, acoustics.rate), detector_of))
        refused += fault
        imagined += not fault and at <= CHECKS_PER_TRAVERSE
        right += not fault and CHECKS_PER_TRAVERSE < at <= CHECKS_PER_TRAVERSE + 2
        late += not fault and at > CHECKS_PER_TRAVERSE + 2
    return (f"{ratio:4d} dB, bangs, speech and drift, {SOUNDED} whole sounds: {right} right, {late} late, "
            f"{imagined} imagined, {refused} broken off with a fault")  # fmt: skip


def speed(rng: np.random.Generator) -> str:
    """Share of a core at 10 ms a step."""
    acoustics = Acoustics(6.0)
    tuning = tuned(acoustics, rng)
    sound = recorded(acoustics, 0.0, 1000, rng)
    detector = SequentialDetector(Recording(sound, acoustics.rate), tuning)
    detector.check(SECONDS)
    began = process_time()
    at, _ = listened(detector)
    took = (process_time() - began) / at
    return f"a check takes {took * 1e6:.0f} µs of {SECONDS * 1e3:.0f} ms: {took / SECONDS:.1%} of one core"


if __name__ == "__main__":
    main()
