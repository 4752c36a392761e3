"""End-stop detection at good and bad signal-to-noise ratios, beside a fixed threshold."""

from dataclasses import dataclass, field, replace
from time import process_time

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.capture.audio import Recording, power_df
from stickslip_fit.capture.emulator.acoustics import Acoustics, synthesize_sound
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
    select_band,
    select_reference,
)

RATIOS = (-12, -9, -6, -3, -2, -1, 0, 1, 2, 3, 6, 9, 12)  # dB
STEPS, SECONDS = 5, 0.05  # of a check
TUNING_CHECKS = 100  # moving and at the stop
CHECKS_AT_STOP = 4
DRIFT_DB = 6.0  # dB up and down within two minutes
TRAVERSES, AT_ZERO, SOUNDED = 20_000, 100_000, 40
BATCH = 4_000
DISTURBED = {"bangs": 0.05, "speech": 0.03, "drift_db": DRIFT_DB}


@dataclass(frozen=True)
class PowerDistribution:
    """Distribution of the power of some bins, over that of the moving joint: `mean` times chi2(df) / df."""

    mean: float
    df: float

    def draw(self, number: int, rng: np.random.Generator) -> Array:
        """So many independent checks, shape (number,)."""
        return self.mean * rng.gamma(self.df / 2, 2 / self.df, number)


@dataclass(frozen=True)
class CheckPowers:
    """Distributions of the powers of an emulated manipulator."""

    band: PowerDistribution
    reference: PowerDistribution
    band_at_stop: PowerDistribution
    reference_at_stop: PowerDistribution


def compute_powers(acoustics: Acoustics, tuning: Tuning) -> CheckPowers:
    """Distributions of the powers that `Tuning.powers` would find in the sound.

    Of the tuning only the choice of the band matters; the levels are those of the acoustics.

    Notes
    -----
    A sum of powers of Gaussian noise with means m_k over bins is very nearly sum(m) chi2(n) / n, where
    n = 2 (sum m)^2 / sum(m^2), reduced by the window. Bangs, speech and drift are not included.
    """
    bins = tuning.frequencies[1:]
    moving = acoustics.room_density(bins) + acoustics.click_density(bins)
    rise = 1 + acoustics.stop_density(bins) / moving
    band = select_band(bins, tuning.frequency, tuning.width)
    reference = select_reference(bins, tuning.rate, tuning.frequency, tuning.width)
    means = (np.ones(band.sum()), np.ones(reference.sum()), rise[band], rise[reference])
    return CheckPowers(*(_make_distribution(part, tuning.samples) for part in means))


def _make_distribution(means: Array, samples: int) -> PowerDistribution:
    even = means.sum() ** 2 / (len(means) * np.sum(means**2))
    return PowerDistribution(float(means.mean()), float(even * power_df(len(means), samples)))


@dataclass
class SequentialDetection:
    """The sequential test, for many traverses side by side."""

    limits: DetectionLimits
    test: SequentialTest = field(init=False)

    def begin(self, traverses: int) -> None:
        """Begin new traverses."""
        self.test = begin_sequential_test(traverses)

    def check(self, band: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Whether each is at its stop."""
        self.test, decision = update_sequential_test(self.limits, self.test, band, reference)
        return decision.at_stop


@dataclass
class FixedThreshold:
    """A threshold on the band's power, set once, that one check must exceed."""

    threshold: float

    def begin(self, traverses: int) -> None:
        """Nothing to reset."""

    def check(self, band: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Whether each is at its stop."""
        return band > self.threshold


Detector = SequentialDetection | FixedThreshold


@dataclass(frozen=True)
class Outcome:
    """Detections in many traverses.

    Attributes
    ----------
    false_stops : float
        Share of the traverses with a stop detected before it was there.
    at : array of int, shape (n,)
        By how many checks at the stop it was found, `CHECKS_AT_STOP` + 1 where it was not.
    """

    false_stops: float
    at: np.ndarray

    @property
    def late(self) -> float:
        """Share of the stops not found at the first or second check."""
        return float(np.mean(self.at > 2))


def simulate_traverses(
    detector: Detector,
    powers: CheckPowers,
    traverses: int,
    rng: np.random.Generator,
    *,
    checks: int = CHECKS_PER_TRAVERSE,
    drift_db: float = 0.0,
    pushed: np.ndarray | None = None,
) -> Outcome:
    """Many traverses by the powers of their checks.

    Parameters
    ----------
    pushed : array, shape (traverses,), optional
        Share of the last of the moving checks that is at the stop already; without it, none.
    """
    detector.begin(traverses)
    phase = rng.uniform(0, 2 * np.pi, traverses)
    false_stops = np.zeros(traverses, bool)
    at = np.full(traverses, CHECKS_AT_STOP + 1)
    for check in range(checks + CHECKS_AT_STOP):
        share = float(check >= checks) if pushed is None or check != checks - 1 else pushed
        gain = 10 ** (drift_db / 10 * np.sin(2 * np.pi * check * SECONDS / 120 + phase))
        band = draw_powers(powers.band, powers.band_at_stop, share, traverses, rng)
        reference = draw_powers(powers.reference, powers.reference_at_stop, share, traverses, rng)
        heard = detector.check(gain * band, gain * reference)
        if check < checks - (pushed is not None):
            false_stops |= heard
        else:
            at = np.where(heard & (at > CHECKS_AT_STOP), check - checks + 1, at)
    return Outcome(float(false_stops.mean()), at)


def draw_powers(
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


def tune(acoustics: Acoustics, rng: np.random.Generator) -> Tuning:
    """As before a session, from five seconds each."""
    calm = replace(acoustics, bangs=0.0, speech=0.0, drift_db=0.0)
    states = [np.full(STEPS * TUNING_CHECKS, pushing) for pushing in (False, True)]
    moving, at_stop = (synthesize_sound(calm, 0.0, np.ones(len(state)), state, rng) for state in states)
    return choose_tuning(moving, at_stop, calm.rate, SECONDS)


def record(acoustics: Acoustics, began: float, checks: int, rng: np.random.Generator) -> Sound:
    """The sound of a traverse that meets its stop after so many checks, made ten seconds at a time."""
    pushing = np.arange(STEPS * (checks + CHECKS_AT_STOP)) >= STEPS * checks
    parts = np.split(pushing, range(1000, len(pushing), 1000))
    times = began + acoustics.period * np.arange(0, len(pushing), 1000)
    return np.concatenate(
        [
            synthesize_sound(acoustics, at, np.ones(len(part)), part, rng)
            for at, part in zip(times, parts, strict=True)
        ]
    )


def first_detection(detector: SequentialDetector) -> tuple[int, bool]:
    """The check at which a detector stops, and whether for a fault."""
    detector.begin()
    check = 0
    while True:
        check += 1
        heard = detector.check(SECONDS)
        if heard.at_stop or heard.fault:
            return check, bool(heard.fault)


def main() -> None:
    """Print the operating curve, the effect of bangs and speech, and the share of a core."""
    rng = np.random.default_rng(20261121)
    at_zero = tune(Acoustics(0.0), rng)
    print("late: not found at the first or second check at the stop, per 1,000 stops")
    print(f"false: traverses of {STEPS * CHECKS_PER_TRAVERSE:,} steps with a false stop, per 1,000")
    print("      --- sequential ---   sequential, drift   ---- threshold ---   threshold, drift")
    print("  dB     late     false      late     false      late     false      late     false")
    for ratio in RATIOS:
        columns = ((detector, drift) for detector in ("sequential", "threshold") for drift in (0.0, DRIFT_DB))
        row = "".join(cell(ratio, *column, at_zero, rng) for column in columns)
        print(f"{ratio:4d}{row}", flush=True)
    for ratio in (0, 3, 6, 12):
        print(mid_check_stops(ratio, rng), flush=True)
    for ratio in (0, 6, 12):
        print(disturbed(ratio, rng), flush=True)
    print(speed(rng))


def cell(ratio: int, name: str, drift: float, at_zero: Tuning, rng: np.random.Generator) -> str:
    """Two figures of the table; averaged over several tunings."""
    acoustics = Acoustics(float(ratio))
    set_once = FixedThreshold(power_quantile(FALSE_STOPS_PER_TRAVERSE / CHECKS_PER_TRAVERSE, at_zero.df))
    outcomes = []
    for _ in range(max((AT_ZERO if ratio == 0 else TRAVERSES) // BATCH, 1)):
        tuning = tune(acoustics, rng) if name == "sequential" else at_zero
        detector = SequentialDetection(tuning.limits) if name == "sequential" else set_once
        outcomes.append(
            simulate_traverses(detector, compute_powers(acoustics, tuning), BATCH, rng, drift_db=drift)
        )
        stops = simulate_traverses(
            detector, compute_powers(acoustics, tuning), 5 * BATCH, rng, checks=80, drift_db=drift
        )
        outcomes.append(Outcome(np.nan, stops.at))
    late, false_stops = (
        1e3 * np.nanmean([getattr(outcome, part) for outcome in outcomes]) for part in ("late", "false_stops")
    )
    return f"  {late:8.2f}  {false_stops:8.2f}"


def mid_check_stops(ratio: int, rng: np.random.Generator) -> str:
    """Counts where the stop is met at any step of a check."""
    acoustics = Acoustics(float(ratio))
    tuning = tune(acoustics, rng)
    pushed = rng.integers(1, STEPS + 1, 10 * BATCH) / STEPS
    detector = SequentialDetection(tuning.limits)
    outcome = simulate_traverses(
        detector, compute_powers(acoustics, tuning), 10 * BATCH, rng, checks=80, pushed=pushed
    )
    off = STEPS * (outcome.at - 1)  # the count leaves out the later check of the two
    right = np.mean(off == 0)
    return (
        f"{ratio:4d} dB, the stop met at any step of a check: counts right {100 * right:.1f} %, "
        f"off by {off.mean():+.2f} steps on average, {off.std():.2f} standard deviation"
    )


def disturbed(ratio: int, rng: np.random.Generator) -> str:
    """Whole sounds with three bangs and two talks a minute and a drift."""
    tuning = tune(Acoustics(float(ratio)), rng)
    right = false_stops = late = refused = 0
    for number in range(SOUNDED):
        acoustics = Acoustics(float(ratio), seed=number, **DISTURBED)
        sound = record(acoustics, float(rng.uniform(0, 120)), CHECKS_PER_TRAVERSE, rng)
        at, fault = first_detection(SequentialDetector(Recording(sound, acoustics.rate), tuning))
        refused += fault
        false_stops += not fault and at <= CHECKS_PER_TRAVERSE
        right += not fault and CHECKS_PER_TRAVERSE < at <= CHECKS_PER_TRAVERSE + 2
        late += not fault and at > CHECKS_PER_TRAVERSE + 2
    return (
        f"{ratio:4d} dB, bangs, speech and drift, {SOUNDED} whole sounds: {right} right, {late} late, "
        f"{false_stops} false, {refused} broken off with a fault"
    )


def speed(rng: np.random.Generator) -> str:
    """Share of a core at 10 ms a step."""
    acoustics = Acoustics(6.0)
    tuning = tune(acoustics, rng)
    sound = record(acoustics, 0.0, 1000, rng)
    detector = SequentialDetector(Recording(sound, acoustics.rate), tuning)
    detector.check(SECONDS)
    began = process_time()
    at, _ = first_detection(detector)
    took = (process_time() - began) / at
    return f"a check takes {took * 1e6:.0f} µs of {SECONDS * 1e3:.0f} ms: {took / SECONDS:.1%} of one core"


if __name__ == "__main__":
    main()
