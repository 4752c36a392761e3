"""Many logs with known truth put through the diagnosis: how often it is right.

``python -m tests.hidden.study --logs 40`` prints a table; it is what the figures in benchmarks/README.md come
from. Of the kind `mixed` is one cause of the library beside an effect from outside of it.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from stickslip_fit.diagnosis import Diagnosis, diagnose
from stickslip_fit.logs import read_log
from tests.hidden.catalogue import OUTSIDE
from tests.hidden.generate import Hidden, UnreachableError, hide, testable
from tests.hidden.strength import Ruler

DESIGNS = ("session", "thesis", "many")
NOISES = ("gaussian", "t5", "uneven")
STRENGTHS = (3.5, 6.0, 8.0, 12.0, 25.0)
DECOYS = ("walk", "noise")


@dataclass(frozen=True)
class Case:
    """A log to make."""

    kind: str
    design: str
    noise: str
    strength: float
    seed: int


@dataclass(frozen=True)
class Score:
    """What the diagnosis made of a case."""

    case: Case
    truth: tuple[str, ...]
    forms: tuple[str, ...]
    p_value: float
    found: tuple[str, ...]
    equivalent: tuple[str, ...]
    brier: float
    silence: float
    inside: bool | None
    closest: str
    seconds: float


def cases(kind: str, logs: int, strengths: tuple[float, ...] = STRENGTHS, first: int = 0) -> Iterator[Case]:
    """As many cases of each strength, over designs and noises in turn."""
    for strength in strengths if kind != "nothing" else (0.0,):
        for number in range(logs):
            seed = first + number
            yield Case(kind, DESIGNS[number % 3], NOISES[(number // 3) % 3], strength, seed)


def make(case: Case, replicate: int = 0) -> Hidden | None:
    """The log of a case; None where its effect cannot be as strong."""
    rng = np.random.default_rng([case.seed, int(10 * case.strength), len(case.kind)])
    names: tuple[str, ...] = ()
    if case.kind == "outside":
        names = (str(rng.choice(list(OUTSIDE))),)
    elif case.kind != "nothing":
        able = testable(case.design, case.seed, case.strength, case.noise)
        number = 2 if case.kind == "pair" else 1
        if len(able) < number:
            return None
        names = tuple(map(str, rng.choice(able, number, replace=False)))
        if case.kind == "mixed":
            names = (*names, str(rng.choice(list(OUTSIDE))))
    decoys = DECOYS if case.kind == "nothing" else ()
    try:
        return hide(
            case.design, names, case.strength or None, case.noise, decoys, case.seed, replicate=replicate
        )
    except UnreachableError:
        return None


def score(case: Case, hidden: Hidden) -> Score:
    """Put a log through the diagnosis as a user would."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        hidden.write(path)
        began = time.perf_counter()
        found = diagnose(read_log(path), seed=case.seed, gain=False)
    effects = hidden.truth["effects"]
    truth = tuple("unknown" if each["name"] in OUTSIDE else each["cause"] for each in effects)
    brier, silence = _brier(found, truth)
    return Score(
        case, truth, tuple(str(each["form"]) for each in effects), found.p_value,
        tuple(each.cause for each in found.findings),
        found.findings[0].equivalent if found.findings else (),
        brier, silence, _inside(found, hidden, truth),
        found.findings[0].closest if found.findings else "", time.perf_counter() - began,
    )  # fmt: skip


def _brier(found: Diagnosis, truth: tuple[str, ...]) -> tuple[float, float]:
    told = {cause: value or 0.0 for cause, value in found.inclusion.items()}
    causes = set(told) | set(truth)
    brier = sum((told.get(cause, 0.0) - (cause in truth)) ** 2 for cause in causes)
    return float(brier), float(len(truth))


def _inside(found: Diagnosis, hidden: Hidden, truth: tuple[str, ...]) -> bool | None:
    """Whether the interval of a rightly named effect holds its true size; None where it was not named."""
    if not found.findings or found.findings[0].cause not in truth:
        return None
    first, effects = found.findings[0], hidden.truth["effects"]
    size = effects[truth.index(first.cause)]["effect_rms_pct"]
    if first.cause == "unknown" and len(found.findings) == 1:
        # What has no name is everything that is hidden, but single counts.
        changes = [hidden.effect(act.name) for act in hidden.acts if act.effect.absorbed]
        size = 100 * Ruler(hidden.campaign).rms_left(np.sum(changes, axis=0))
    return bool(first.effect.low * 100 <= size <= first.effect.high * 100)


def main() -> None:
    """Score and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kinds", nargs="+", default=["nothing", "single", "pair", "outside"])
    parser.add_argument("--logs", type=int, default=30)
    parser.add_argument("--strengths", nargs="+", type=float, default=list(STRENGTHS))
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    for kind in chosen.kinds:
        scores: list[Score] = []
        for case in cases(kind, chosen.logs, tuple(chosen.strengths), chosen.first):
            hidden = make(case)
            if hidden is None:
                continue
            scores.append(score(case, hidden))
            if chosen.out:
                with chosen.out.open("a") as file:
                    file.write(json.dumps(asdict(scores[-1])) + "\n")
        report(kind, scores)


def report(kind: str, scores: list[Score]) -> None:
    """A line for each strength."""
    for strength in dict.fromkeys(each.case.strength for each in scores):
        subset = [each for each in scores if each.case.strength == strength]
        n = len(subset)
        alarm = sum(bool(each.found) for each in subset)
        first = sum(bool(each.found) and each.found[0] in each.truth for each in subset)
        in_set = sum(
            bool(each.found) and bool({each.found[0], *each.equivalent} & set(each.truth)) for each in subset
        )
        both = sum(set(each.truth) <= set(each.found) for each in subset)
        more = sum(len(each.found) > len(each.truth) for each in subset)
        rivals = np.mean([len(each.equivalent) for each in subset])
        known = [each.inside for each in subset if each.inside is not None]
        print(
            f"{kind:8s} {strength:5.1f}  n {n:4d}  alarm {alarm / n:.3f}  named {first / n:.3f}  "
            f"in set {in_set / n:.3f}  all {both / n:.3f}  more {more / n:.3f}  rivals {rivals:.2f}  "
            f"Brier {np.mean([each.brier for each in subset]):.3f}  "
            f"interval {np.mean(known) if known else np.nan:.3f}  "
            f"s {np.mean([each.seconds for each in subset]):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
