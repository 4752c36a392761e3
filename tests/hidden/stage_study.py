"""Logs whose steps are made by friction, diagnosed with the physical laws: what is named, what is read.

``python -m tests.hidden.stage_study --logs 40`` prints the rates; benchmarks/README.md quotes them.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import stickslip_fit as ssf
from stickslip_fit.diagnosis.stage_change import read_stage
from tests.hidden.slip import Bristles
from tests.hidden.stage import CHANGES, Stage, drive_stage

FAMILY = {  # what a change is called; friction and mass leave one trace
    "preload": "friction",
    "friction:humidity": "friction",
    "wear": "friction",
    "payload": "mass",
    "voltage": "voltage",
    "ramp-time": "ramp time",
}
SIZE = 0.1
WITHOUT_TRACE = {("friction", "voltage")}
COURSES = {
    *("session-jump", "payload-change", "wear", "humidity", "supply-voltage", "temperature", "drift"),
    *("thermal-warm-up", "end-stop-misfire"),
}
"""Causes that a change of a stage may be called, and gross errors, which are no physics."""
MIN_LIMITED = 0.5


@dataclass(frozen=True)
class StageCase:
    """A log to make; `change` is empty for none."""

    regime: str
    change: str
    lugre: bool
    seed: int


@dataclass(frozen=True)
class StageScore:
    """What became of a case.

    Attributes
    ----------
    case : StageCase
    found : tuple of str
    absent : bool
        Whether a cause was named that is no part of the physics.
    credible : tuple of str
        Of the first reading; empty without one.
    regimes : tuple of bool
        Of each joint and direction, whether its regime is right.
    """

    case: StageCase
    found: tuple[str, ...]
    absent: bool
    credible: tuple[str, ...]
    regimes: tuple[bool, ...]

    @property
    def holds(self) -> bool:
        """Whether the credible set holds the true change."""
        return FAMILY.get(self.case.change, "") in self.credible

    @property
    def is_family(self) -> bool:
        """Whether the likeliest change is of the true family."""
        same = {"mass": "friction"}
        first, true = self.credible[:1], FAMILY.get(self.case.change, "")
        return bool(first) and same.get(first[0], first[0]) == same.get(true, true)


def stage_cases(logs: int, first: int = 0) -> Iterator[StageCase]:
    """Regimes, changes and kinds of friction in turn; one in seven logs has no change."""
    changes = ("", *CHANGES)
    for seed in range(first, first + logs):
        regime = ("friction", "velocity")[seed % 2]
        yield StageCase(regime, changes[seed // 2 % len(changes)], seed % 4 > 1, seed)


def make_log(case: StageCase) -> ssf.Log:
    """The log of a case, written and read."""
    design = "many" if case.change == "friction:humidity" else "session"
    stage = Stage(case.regime, Bristles() if case.lugre else None)
    table = drive_stage(design, stage, case.change, SIZE, seed=case.seed).table
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        table.to_csv(path, index=False)
        return ssf.read_log(path)


def decide(log: ssf.Log) -> ssf.Diagnosis:
    """The diagnosis with the physical laws, without its gain."""
    return ssf.diagnose(log, laws=dict.fromkeys(log.joints, ssf.physical_law), gain=False)


def score_diagnosis(case: StageCase, found: ssf.Diagnosis) -> StageScore:
    """What a diagnosis of a case's log says, beside what is true."""
    stage = read_stage(found.selection, found.findings, found.require_log().machine)
    names = tuple(one.cause for one in found.findings)
    reading = stage[0] if stage else None
    limited = reading.fingerprint["friction_limited"] if reading else ()
    return StageScore(
        case,
        names,
        not set(names) <= COURSES,
        tuple(one.quantity for one in reading.credible) if reading else (),
        tuple((share > MIN_LIMITED) == (case.regime == "friction") for share in limited),
    )


def diagnose_stage(case: StageCase) -> StageScore:
    """Make a log, diagnose it with the physical laws, and measure the gain, after which causes may go."""
    return score_diagnosis(case, decide(make_log(case)).measure_gain())


def summarize_scores(scores: list[StageScore]) -> str:
    """Rates as text, over all scores."""
    changed = [one for one in scores if one.case.change]
    shown = [one for one in changed if (one.case.regime, one.case.change) not in WITHOUT_TRACE]
    read = [one for one in shown if one.credible]
    regimes = [right for one in read for right in one.regimes]
    same = [one for one in scores if not one.case.change]
    lines = {
        "a cause absent from the physics is named": [one.absent for one in scores],
        "without a change, anything is found": [bool(one.found) for one in same],
        "with one that leaves a trace, anything is found": [bool(one.found) for one in shown],
        "of these, read as a change of the stage": [bool(one.credible) for one in shown if one.found],
        "of these, the credible set holds it": [one.holds for one in read],
        "of these, the likeliest is of its family": [one.is_family for one in read],
        "regime of a joint and direction is right": regimes,
    }
    return "\n".join(f"{name}: {sum(own)} of {len(own)}" for name, own in lines.items())


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=None)
    arguments = parser.parse_args()
    done = []
    with ProcessPoolExecutor(arguments.processes) as pool:
        for score in pool.map(diagnose_stage, stage_cases(arguments.logs, arguments.first)):
            print(score.case, score.found, score.credible, score.regimes.count(False), flush=True)
            done.append(score)
    print(summarize_scores(done))
