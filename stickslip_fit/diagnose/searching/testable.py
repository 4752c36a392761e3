"""Which causes a log could show at all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.searching.search import MISFIRE
from stickslip_fit.diagnose.shapes.candidates import effects, session_effects
from stickslip_fit.diagnose.shapes.hypothesis import NOTHING
from stickslip_fit.diagnose.shapes.within import Session, sessions

ENOUGH = 3.0  # strength at the largest plausible size


def untestable(bench: Bench, study: Study) -> dict[str, str]:
    """Causes that even at their largest plausible size would not show, and why."""
    found, every = {}, sessions(study)
    for cause in bench.causes:
        strength = largest_strength(cause, study, every)
        if strength < NOTHING:
            found[cause.name] = "this log's traverses show nothing of it, once each session is recalibrated"
        elif strength < ENOUGH:
            found[cause.name] = (
                f"even at its largest plausible size its strength in this log would be {strength:.1f}, less "
                f"than {ENOUGH:.0f}"
            )
    return found


def largest_strength(cause: Any, study: Study, every: Mapping[str, Session]) -> float:
    """Norm of a cause's largest plausible effect, in repeatabilities, recalibration taken out."""
    if cause.name == MISFIRE:
        return np.inf
    shapes = [(cause, np.array(cause.largest()))] if cause.largest() else cause.trials(study.rows)
    strengths = [0.0]
    for version, values in shapes:
        grown = values if cause.largest() else values * np.r_[cause.most, np.ones(values.shape[1] - 1)]
        if version.session:
            shown = session_effects(study, every[version.session], version, grown)
        else:
            shown = effects(study, version, grown)
        strengths.append(float(np.linalg.norm(shown, axis=0).max()))
    return max(strengths)
