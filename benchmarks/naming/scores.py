"""How right the answers are: alarms, names, sets, probabilities, intervals, and the errors they save."""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ALARMS = 0.01
LOUD = 12.0  # strength from which sets and gains are scored
MISFIRE = "end-stop-misfire"
TRIVIAL = {"nothing": -1.0, "most frequent": 1.0}
SILENT = {"found": [], "threshold": 0.0, "inclusion": {}, "quiet": {}, "rivals": [], "interval_pct": None}
COLUMNS = (
    "contender", "alarm", "false", "decoy", "3.5", "6", "12", "25", "in set", "set size", "more",
    "pair", "unknown", "misnamed", "Brier", "interval", "gain", "s",
)  # fmt: skip


@dataclass(frozen=True)
class Scored:
    """An answer beside the truth, at some threshold.

    Attributes
    ----------
    truth : dict
        Of the log.
    named : tuple of str
        Findings, first one first.
    said : dict
        The answer as it was written down.
    """

    truth: dict[str, Any]
    named: tuple[str, ...]
    said: dict[str, Any]

    @property
    def right(self) -> bool:
        """Whether the first finding is a true cause."""
        return bool(self.named) and self.named[0] in self.truth["causes"]

    @property
    def within(self) -> set[str]:
        """The first finding and what the contender cannot tell from it."""
        return {self.named[0], *self.said["rivals"]} if self.named else set()

    @property
    def brier(self) -> float:
        """Squared error of the probabilities, summed over causes."""
        told = {**self.said["quiet"], **{cause: self.said["inclusion"][cause] for cause in self.named}}
        causes = {*told, *self.truth["causes"]}
        return float(sum((told.get(each, 0.0) - (each in self.truth["causes"])) ** 2 for each in causes))

    @property
    def error_pct(self) -> float:
        """On the fresh replicate."""
        if not self.named:
            return float(self.truth["baseline_pct"])
        errors = self.said["errors_pct"]
        return float(errors[min(len(self.named), len(errors)) - 1])

    @property
    def covered(self) -> bool | None:
        """Whether the interval holds the true effect; None where there is no right name or no interval."""
        if not self.right or self.said["interval_pct"] is None:
            return None
        low, high = self.said["interval_pct"]
        return bool(low <= self.truth["rms_pct"][self.truth["causes"].index(self.named[0])] <= high)


def table(folder: Path, logs: Sequence[Path], files: Sequence[Path]) -> str:
    """Every contender at its default threshold, and at one recalibrated on the logs with nothing hidden."""
    truths = {log.stem: json.loads(log.with_suffix(".json").read_text()) for log in logs}
    rows = []
    for said in [*_trivial(truths), *(_read(file, truths) for file in files if file.exists())]:
        contender = next(iter(said.values()))["contender"]
        rows.append([contender, "default", *_row(_scored(truths, said, None))])
        if contender not in TRIVIAL:
            again = _scored(truths, said, _recalibrated(truths, said))
            rows.append([contender, "recalibrated", *_row(again)])
    lines = [COLUMNS, ["---"] * len(COLUMNS), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _read(file: Path, truths: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """A contender's answers by log; one that failed said nothing."""
    lines = (json.loads(line) for line in file.read_text().splitlines())
    return {line["log"]: SILENT | line for line in lines if line["log"] in truths}


def _trivial(truths: dict[str, Any]) -> Iterable[dict[str, dict[str, Any]]]:
    """Silence, and blaming always what is to blame most often."""
    causes = [truth["causes"][0] for truth in truths.values() if truth["kind"] == "single"]
    names, counts = np.unique(causes, return_counts=True)
    common = str(names[np.argmax(counts)])
    for contender, loud in TRIVIAL.items():
        said = {"contender": contender, "found": [(common, loud)], "inclusion": {common: 1.0}, "seconds": 0.0}
        yield {log: SILENT | said | {"errors_pct": [truth["baseline_pct"]]} for log, truth in truths.items()}


def _recalibrated(truths: dict[str, Any], said: dict[str, dict[str, Any]]) -> float:
    """The loudness that the stated share of the nulls exceeds."""
    loud = sorted(
        max((each for _, each in line["found"]), default=-np.inf)
        for log, line in said.items()
        if truths[log]["kind"] == "nothing"
    )
    return loud[-1 - round(ALARMS * len(loud))]


def _scored(truths: dict[str, Any], said: dict[str, dict[str, Any]], threshold: float | None) -> list[Scored]:
    return [
        Scored(
            truths[log],
            tuple(
                cause
                for cause, loud in line["found"]
                if loud > (line["threshold"] if threshold is None else threshold)
            ),
            line,
        )
        for log, line in said.items()
    ]


def _row(scored: list[Scored]) -> list[str]:
    def of(kind: str, least: float = 0.0, most: float = np.inf) -> list[Scored]:
        subset = [each for each in scored if each.truth["kind"] == kind]
        return [each for each in subset if least <= each.truth["strength"] <= most]

    single, loud, nulls = of("single"), of("single", LOUD), of("nothing")
    known = [each.covered for each in single if each.covered is not None]
    gains = [each for each in (*loud, *of("pair")) if MISFIRE not in each.truth["causes"]]
    saved = sum(each.truth["baseline_pct"] - each.error_pct for each in gains)
    possible = sum(each.truth["baseline_pct"] - each.truth["oracle_pct"] for each in gains)

    def share(among: list[Scored], what: Callable[[Scored], bool | float]) -> str:
        return f"{np.mean([what(each) for each in among]):.2f}" if among else ""

    return [
        share(nulls, lambda each: bool(each.named)),
        share(nulls, lambda each: any(cause.startswith("covariate:sensor") for cause in each.named)),
        *(share(of("single", each, each), lambda one: one.right) for each in (3.5, 6.0, 12.0, 25.0)),
        share(loud, lambda each: bool(each.within & set(each.truth["causes"]))),
        share([each for each in loud if each.named], lambda each: len(each.within)),
        share(single, lambda each: len(each.named) > 1),
        share(of("pair"), lambda each: set(each.truth["causes"]) <= set(each.named)),
        share(of("outside"), lambda each: bool(each.named) and each.named[0] == "unknown"),
        share(of("outside"), lambda each: bool(each.named) and each.named[0] != "unknown"),
        share(single, lambda each: each.brier),
        f"{np.mean(known):.2f} of {len(known)}" if known else "",
        f"{saved / possible:.2f}" if possible else "",
        f"{np.median([each.said['seconds'] for each in scored]):.2f}",
    ]
