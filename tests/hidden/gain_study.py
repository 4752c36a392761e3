"""The gain that a diagnosis reports with an interval, beside what a replicate of the same campaign gains.

``python -m tests.hidden.gain_study --kind single --strengths 6 12 25 --logs 60`` prints a table. A log is
diagnosed as a user would, and so is its replicate: the same campaign with fresh noise. The interval claims to
hold the gain that the replicate's diagnosis measures, by a search of its own; either is taken for the log.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from stickslip_fit.diagnosis import diagnose
from tests.hidden import outside, study
from tests.hidden.generate import Hidden
from tests.hidden.reading import read_hidden

KINDS = ("single", "pair", "outside")


@dataclass(frozen=True)
class GainScore:
    """The gain in a log with its interval, and what a replicate says; relative errors.

    Attributes
    ----------
    kind, effect, design, noise, strength, seed
    found, again : tuple of str
        What was found in the log and in the replicate.
    gain, low, high : float
    replicate : float
        The gain that the replicate's diagnosis measures.
    """

    kind: str
    effect: str
    design: str
    noise: str
    strength: float
    seed: int
    found: tuple[str, ...]
    again: tuple[str, ...]
    gain: float
    low: float
    high: float
    replicate: float

    @property
    def holds(self) -> bool:
        """Whether the interval holds what the replicate gained."""
        return self.low <= self.replicate <= self.high


@dataclass(frozen=True)
class GainCase:
    """A log to make, and its replicates."""

    kind: str
    strength: float
    seed: int
    make: Callable[[int], Hidden | None]


def gain_cases(kind: str, logs: int, strength: float, first: int) -> Iterator[GainCase]:
    """As many cases, over designs and noises in turn; of effects outside the library, each in turn."""
    if kind != "outside":
        for case in study.cases(kind, logs, (strength,), first):
            yield GainCase(kind, strength, case.seed, lambda number, case=case: study.make(case, number))
        return
    found = 0
    while found < logs:
        for one in outside.cases((strength,), first + found)[: logs - found]:
            found += 1
            yield GainCase(kind, strength, one.seed, one.make)


def score_gain(case: GainCase) -> list[GainScore]:
    """Diagnose a log and its replicate, and compare either with the other.

    Without one from which no law follows, which gains nothing and claims so.
    """
    hidden, fresh = case.make(0), case.make(1)
    if hidden is None or fresh is None:
        return []
    # No next experiment, which takes time and changes no gain.
    one, other = (
        diagnose(read_hidden(log), seed=case.seed + k, gain=False).measure_gain()
        for k, log in enumerate((hidden, fresh))
    )
    effects = " and ".join(f"{one['name']} ({one['form']})" for one in hidden.truth["effects"])
    return [
        GainScore(
            case.kind,
            effects,
            hidden.design,
            hidden.noise,
            case.strength,
            case.seed,
            tuple(finding.cause for finding in found.findings),
            tuple(finding.cause for finding in again.findings),
            found.gain.baseline - found.gain.extended,
            found.gain.low,
            found.gain.high,
            again.gain.baseline - again.gain.extended if again.gain else np.nan,
        )
        for found, again in ((one, other), (other, one))
        if found.gain is not None and any(finding.version is not None for finding in found.findings)
    ]


def main() -> None:
    """Score and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=KINDS, default="single")
    parser.add_argument("--logs", type=int, default=30)
    parser.add_argument("--strengths", nargs="+", type=float, default=[6.0, 12.0, 25.0])
    parser.add_argument("--first", type=int, default=0, help="seed of the first log")
    parser.add_argument("--out", type=Path, help="append each score as a line of JSON")
    chosen = parser.parse_args()
    for strength in chosen.strengths:
        scores = []
        for case in gain_cases(chosen.kind, chosen.logs, strength, chosen.first):
            for score in score_gain(case):
                scores.append(score)
                if chosen.out:
                    with chosen.out.open("a") as file:
                        file.write(json.dumps(asdict(score)) + "\n")
        report(scores)


def report(scores: list[GainScore]) -> None:
    """One line: how often the interval holds, and how wide it is."""
    if not scores:
        return
    n, width = len(scores), np.median([one.high - one.low for one in scores])
    above = sum(one.replicate > one.high for one in scores)
    print(
        f"{scores[0].kind} {scores[0].strength:g}: the interval holds what a replicate gains in "
        f"{sum(one.holds for one in scores)} of {n} ({above} above it); "
        f"median gain {100 * np.median([one.gain for one in scores]):.3f} %, width {100 * width:.3f} %",
        flush=True,
    )


if __name__ == "__main__":
    main()
