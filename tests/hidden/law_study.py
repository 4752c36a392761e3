"""The physical and the published laws on logs whose true law is known: errors, regimes, r, and what is named.

``python -m tests.hidden.law_study WHAT --logs 20`` prints the rates; benchmarks/README.md quotes them.
"""

import argparse
from collections.abc import Callable, Iterator

import numpy as np

import stickslip_fit as ssf
from stickslip_fit.estimation import profile_ratio
from stickslip_fit.law_comparison import compare_laws
from stickslip_fit.law_comparison.comparison import CERTAIN, MODEL_SPREAD
from tests.hidden.generate import Hidden, hide
from tests.hidden.reading import read_hidden
from tests.hidden.slip import Bristles
from tests.hidden.stage import GRAVITY, Stage, drive_stage
from tests.hidden.stage_study import SIZE, stage_cases

DESIGNS = ("session", "thesis", "many")
Found = dict[str, list[bool | float]]


BENDS = (0.002, 0.005, 0.008)  # of LuGre's bristles, as shares of the throw


def true_share(hidden: Hidden, direction: str) -> float:
    """Mean over sessions of weight over friction of joint 3."""
    (place,) = (place for place in hidden.campaign.places if place.joint == 3)
    own = (place.forward > 0).ravel() == (direction == "+")
    return float(np.mean(GRAVITY / place.values["friction"][own]))


def judge_drive(regime: str, bristles: Bristles | None, seed: int) -> Iterator[tuple[bool, bool, bool]]:
    """Of either direction of joint 3: regime certain and right, certain and wrong, and r in its interval."""
    hidden = drive_stage(DESIGNS[seed % 3], Stage(regime, bristles), seed=seed)
    log = read_hidden(hidden)
    for way, profile in profile_ratio(3, log.usable[log.usable["joint"] == 3], log.machine).items():
        _, low, high = profile.share_interval(spread=MODEL_SPREAD)
        right = profile.friction_limited if regime == "friction" else 1 - profile.friction_limited
        yield right > CERTAIN, right < 1 - CERTAIN, low < true_share(hidden, way) < high


def shares(seed: int) -> Found:
    """Regime and r of joint 3, half of the logs with LuGre's friction."""
    regime = ("friction", "velocity")[seed % 2]
    bristles = Bristles(BENDS[seed % 3]) if seed // 2 % 2 else None
    kind = f"{regime}, {'LuGre' if bristles else 'Coulomb'}"
    found: Found = {}
    names = ("regime certain and right", "regime certain and wrong", "r in its interval")
    for judged in judge_drive(regime, bristles, seed):
        for name, holds in zip(names, judged, strict=True):
            found.setdefault(f"{kind}: {name}", []).append(holds)
    return found


def published(seed: int) -> Found:
    """Logs of the published law."""
    found: Found = {}
    for one in compare_laws(read_hidden(hide(DESIGNS[seed % 3], seed=seed))).joints:
        for law in ("published", "physical"):
            found.setdefault(f"joint {one.joint}: {law} preferred", []).append(one.errors.better == law)
    return found


def errors(seed: int) -> Found:
    """Held-out errors over the noise of friction-limited logs."""
    design = DESIGNS[seed % 3]
    hidden = drive_stage(design, Stage("friction", Bristles() if seed % 2 else None), seed=seed)
    found: Found = {}
    for one in compare_laws(read_hidden(hidden)).joints:
        noise = np.sqrt(np.mean(hidden.campaign.repeatability[hidden.campaign.plan.joint == one.joint] ** 2))
        for where in ("", f", {design}"):
            found[f"joint {one.joint}{where}: physical over noise"] = [one.errors.physical.rms / noise]
        found[f"joint {one.joint}: published over noise"] = [one.errors.published.rms / noise]
    return found


def folds(seed: int) -> Found:
    """Held-out errors over the noise by the folds and new sessions of a diagnosis, nothing being changed."""
    hidden = drive_stage(DESIGNS[seed % 3], Stage("friction", Bristles() if seed % 2 else None), seed=seed)
    log = read_hidden(hidden)
    diagnosis = ssf.diagnose(log, laws={joint: ssf.physical_law for joint in log.joints})
    found: Found = {"anything is named": [bool(diagnosis.findings)]}
    for where, gain in (("fold", diagnosis.gain), ("new session", diagnosis.gain_new_session)):
        for _, one in gain.by_joint.groupby("joint") if gain else ():
            mean = np.average(one["baseline"] ** 2, weights=one["traverses"])
            joint = one["joint"].iloc[0]
            noise = np.mean(hidden.campaign.repeatability[hidden.campaign.plan.joint == joint] ** 2)
            found[f"joint {joint}: {where} over noise"] = [np.sqrt(mean / noise)]
    return found


def baseline(seed: int) -> Found:
    """Stages diagnosed with the published law: what is named."""
    (case,) = stage_cases(1, seed)
    design = "many" if case.change == "friction:humidity" else "session"
    stage = Stage(case.regime, Bristles() if case.lugre else None)
    found = ssf.diagnose(read_hidden(drive_stage(design, stage, case.change, SIZE, seed=seed)), gain=False)
    print(case, [one.cause for one in found.findings])
    return {f"{name} is named": [True] for name in sorted({one.cause for one in found.findings})}


STUDIES: dict[str, Callable[[int], Found]] = {
    one.__name__: one for one in (shares, published, errors, folds, baseline)
}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=STUDIES)
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    total: Found = {}
    for number in range(arguments.first, arguments.first + arguments.logs):
        for name, values in STUDIES[arguments.what](number).items():
            total.setdefault(name, []).extend(values)
        print(number, flush=True)
    for name, values in sorted(total.items()):
        if isinstance(values[0], bool | np.bool_):
            print(f"{name}: {sum(values)} of {len(values)}")
        else:
            low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
            print(f"{name}: median {middle:.2f}, {low:.2f} to {high:.2f}, of {len(values)}")
