"""Normal force: does it matter how the load across the joint is directed (thesis Section 5.2).

Turning the base about the axis of a joint leaves the load along it as it is and turns the force on its guide
or bearing. Such orientations are told apart here, and only they: what the load along the axis does is the
business of the laws.
"""

from __future__ import annotations

import pandas as pd

from stickslip_fit.anova.question import Choose, Question, Refusal
from stickslip_fit.anova.readings import TURNED, describe, place
from stickslip_fit.anova.within import within_sessions

NO_ROTATION = (
    "no session has two orientations of the base that differ by a rotation about the joint's axis alone, "
    "with the load along it the same (joint 3: drive at q2 -90 deg, psi 0 deg and several theta)"
)


def normal_force(rows: pd.DataFrame, span: float, choose: Choose) -> list[Question | Refusal]:
    """One question for each direction; parameters as of `day.day`."""
    joint = int(rows["joint"].iloc[0])
    together = rows.groupby([*TURNED, "session", "direction"], dropna=False)["orientation"]
    compared = rows.assign(compared=together.transform("nunique") > 1).groupby(TURNED, dropna=False)
    turned = compared["compared"].transform("any")
    if not turned.any():
        return [Refusal("normal-force", joint, None, None, None, NO_ROTATION)]
    asked: list[Question | Refusal] = []
    for here in choose(rows[turned], TURNED):
        varied = [name for name in ("theta", "psi") if here[name].nunique() > 1]
        fixed = [name for name in ("q1", "q2", "q3", "theta", "psi") if name not in varied]
        names = {key: _name(part.iloc[0], varied) for key, part in here.groupby("orientation")}
        configuration = f"{describe(here.iloc[0], span, fixed)}; {' and '.join(varied)} turned"
        labelled = here.assign(level=here["orientation"].map(names))
        for sign in ("+", "-"):
            driven = labelled[labelled["direction"] == sign]
            if driven["level"].nunique() > 1:
                asked += within_sessions("normal-force", "orientation", driven, sign, configuration)
            elif len(driven):
                reason = f"direction {sign} was driven in one of these orientations only"
                asked.append(Refusal("normal-force", joint, sign, None, configuration, reason))
    return asked


def _name(row: pd.Series, varied: list[str]) -> str:
    return ", ".join(place(name, row[name]) for name in varied)
