"""Logs made by friction before and after a change of the stage, read by `changed`.

``python -m tests.hidden.changed_study --logs 30`` prints the rates; benchmarks/README.md quotes them.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import stickslip_fit as ssf
from stickslip_fit.changes import read_stage_difference
from tests.hidden.designs import DAYS
from tests.hidden.slip import Bristles
from tests.hidden.stage import Stage, drive_days

TRUE = {"preload": "friction", "payload": "mass", "voltage": "voltage", "ramp-time": "ramp time", "": ""}
SIZES = 0.05, 0.15
DAY_TO_DAY = 0.01


@dataclass(frozen=True)
class ChangedScore:
    """What became of a log.

    Attributes
    ----------
    change : str
        Empty for none.
    alarm : bool
        Whether anything changed significantly.
    credible : tuple of str
    is_family, holds_size : bool
        Whether the likeliest change is of the true family, and the interval of the true one holds its size.
    regime : str
    right : bool
        Whether every joint and direction of the old log has this regime.
    """

    change: str
    alarm: bool
    credible: tuple[str, ...] = ()
    is_family: bool = False
    holds_size: bool = False
    regime: str = ""
    right: bool = False


def read_change(regime: str, seed: int, law: str) -> ChangedScore:
    """Make a log, compare its halves, read the change."""
    rng, change = np.random.default_rng(seed), tuple(TRUE)[seed % len(TRUE)]
    size = float(rng.uniform(*SIZES) * rng.choice([-1, 1]))
    stage = Stage(regime, Bristles() if seed % 4 == 3 else None, DAY_TO_DAY)
    hidden = drive_days(stage, change, size, seed)
    since = sorted(set(hidden.campaign.labels))[DAYS // 2]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        hidden.write(path)
        old, new = ssf.read_log(path, until=since), ssf.read_log(path, since=since)
    laws = dict.fromkeys(old.joints, ssf.physical_law) if law == "physical" else None
    changes = ssf.detect_changes(old, new, laws=laws)
    found = read_stage_difference(changes)
    if found is None or not change:
        return ChangedScore(change, bool(changes.significant))
    true, trace = TRUE[change], {"mass": "friction"}
    (interval,) = (one.size for one in found.changes if one.quantity == true)
    ratios = [
        float(np.mean((v["throw"] / v["friction"] / v["ramp"] ** 2)[place.forward == way]))
        for place in hidden.campaign.places
        for v in [place.values]
        for way in (1, -1)
    ]
    return ChangedScore(
        change,
        True,
        tuple(one.quantity for one in found.credible),
        found.changes[0].trace == trace.get(true, true),
        interval.low < size < interval.high,
        found.regime,
        all((ratio > 1) == found.regime.startswith("friction") for ratio in ratios),
    )


def summarize_changed(scores: list[ChangedScore]) -> str:
    """Rates as text."""
    changed = [one for one in scores if one.change]
    found = [one for one in changed if one.alarm]
    lines = {
        "without a change, an alarm": [one.alarm for one in scores if not one.change],
        "with one, an alarm": [one.alarm for one in changed],
        "of these, read as one change of the stage": [bool(one.credible) for one in found],
        "of these, the credible set holds it": [TRUE[one.change] in one.credible for one in found],
        "of these, the likeliest is of its family": [one.is_family for one in found],
        "of these, the interval holds its size": [one.holds_size for one in found],
        "where a regime is said, it is right": [one.right for one in found if one.regime],
    }
    return "\n".join(f"{name}: {sum(own)} of {len(own)}" for name, own in lines.items())


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--regime", default="any")
    parser.add_argument("--law", choices=("published", "physical"), default="physical")
    arguments = parser.parse_args()
    done = []
    for seed in range(arguments.first, arguments.first + arguments.logs):
        done.append(read_change(arguments.regime, seed, arguments.law))
        print(seed, done[-1], flush=True)
    print(summarize_changed(done))
