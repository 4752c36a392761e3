"""Which change of a stage is likeliest, for one who knows the stage: no diagnosis can be right more often.

The exact posterior over changes of friction (or mass), voltage and ramp time, given the generator's own
steps, the true course in time, and the noise. Either every parameter of the stage is known, or none: each
session and direction is calibrated anew, as in a diagnosis.

``python -m tests.hidden.stage_optimum --logs 84 --first 5000`` prints how often the likeliest is the true
one; benchmarks/README.md quotes it.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from tests.hidden.effect import change
from tests.hidden.generate import CHECK_EVERY
from tests.hidden.seeds import stream
from tests.hidden.slip import Bristles
from tests.hidden.stage import CHANGES, QUANTITIES, Stage, drive_stage, make_change
from tests.hidden.stage_study import FAMILY, SIZE, WITHOUT_TRACE, StageCase, stage_cases
from tests.hidden.strength import recalibrations

PRIOR_SD = 0.15  # of the logarithm of a change
KNOTS, SIZES = np.linspace(-0.25, 0.25, 7), np.linspace(-0.25, 0.25, 501)
SAME = {"mass": "friction"}
WEIGHTS = {"friction": 2.0, "voltage": 1.0, "ramp time": 1.0}  # friction and mass are two changes of four


@dataclass(frozen=True)
class Optimum:
    """Posteriors by change, all three as likely beforehand.

    Attributes
    ----------
    strength : float
        Of the true change, see `strength.Ruler`.
    known, calibrated : dict of str to float
        With the stage known, and with each session and direction calibrated anew.
    """

    strength: float
    known: dict[str, float]
    calibrated: dict[str, float]


def compute_optimum(case: StageCase) -> Optimum:
    """The posteriors of a case with a change."""
    design = "many" if case.change == "friction:humidity" else "session"
    stage = Stage(case.regime, Bristles() if case.lugre else None)
    hidden = drive_stage(design, stage, case.change, SIZE, seed=case.seed)
    campaign, counts = hidden.campaign, hidden.table["steps"].to_numpy(float)
    departure = np.log((counts - CHECK_EVERY / 2) / campaign.counts)
    sd = np.hypot(campaign.repeatability, CHECK_EVERY / np.sqrt(12) / counts)
    basis = recalibrations(campaign, 1 / sd)
    true, strength = SAME.get(FAMILY[case.change], FAMILY[case.change]), np.nan
    log_known, log_calibrated = {}, {}
    for quantity in WEIGHTS:
        effect = make_change(case.change, QUANTITIES[quantity])(campaign, stream(case.seed, case.change))
        assert effect is not None
        effects = CubicSpline(KNOTS, [change(campaign, effect, size) / sd for size in KNOTS])(SIZES)
        if quantity == true:
            at = effects[np.argmin(np.abs(SIZES - SIZE))]
            strength = float(np.linalg.norm(at - basis @ (basis.T @ at)))
        left = departure / sd - effects
        prior = -0.5 * (np.log1p(SIZES) / PRIOR_SD) ** 2
        free = left - (left @ basis) @ basis.T
        log_known[quantity] = float(logsumexp(prior - 0.5 * np.sum(left**2, axis=1)))
        log_calibrated[quantity] = float(logsumexp(prior - 0.5 * np.sum(free**2, axis=1)))
    return Optimum(strength, _normalize(log_known), _normalize(log_calibrated))


def likeliest(posterior: Mapping[str, float], weights: Mapping[str, float]) -> str:
    """The likeliest change, with other weights beforehand."""
    return max(posterior, key=lambda quantity: posterior[quantity] * weights[quantity])


def _normalize(logs: Mapping[str, float]) -> dict[str, float]:
    total = logsumexp(list(logs.values()))
    return {name: float(np.exp(value - total)) for name, value in logs.items()}


def _tell(rights: Mapping[str, list[bool]]) -> str:
    return "\n".join(f"{name}: {sum(own)} of {len(own)}" for name, own in rights.items())


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=84)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    rights: dict[str, list[bool]] = {}
    even = dict.fromkeys(WEIGHTS, 1.0)
    for case in stage_cases(arguments.logs, arguments.first):
        if case.change not in CHANGES or (case.regime, case.change) in WITHOUT_TRACE:
            continue
        found, true = compute_optimum(case), SAME.get(FAMILY[case.change], FAMILY[case.change])
        print(case, f"strength {found.strength:.1f}", found.calibrated, flush=True)
        for name, posterior in (("known", found.known), ("calibrated", found.calibrated)):
            for prior, weights in (("three", even), ("friction and mass", WEIGHTS)):
                right = likeliest(posterior, weights) == true
                rights.setdefault(f"{name}, {prior} as likely, {case.regime}", []).append(right)
    print(_tell(rights))
