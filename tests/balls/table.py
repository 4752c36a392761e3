"""What each ball's drops say; ``python -m tests.balls.table`` prints it, as filmed and straightened."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from stickslip_fit.diagnosis import Diagnosis, Gain
from stickslip_fit.diagnosis.gain import estimate_gain, select_in_fold
from stickslip_fit.diagnosis.pipeline import diagnose_problem
from stickslip_fit.units import Interval
from tests.balls.camera import bend, straightened
from tests.balls.causes import AIR
from tests.balls.fall import G
from tests.balls.measured import measured
from tests.balls.problem import later_half_of_the_last_drop, make_problem

ALPHA = 0.01


@dataclass(frozen=True)
class Judged:
    """A ball's diagnosis, and what it gains on half a drop that was held out; NaN where nothing is named."""

    diagnosis: Diagnosis
    gain: Gain

    @property
    def k(self) -> Interval | None:
        """Quadratic drag over mass, 1/m; None where that is not the first finding."""
        first = self.diagnosis.findings[:1]
        return first[0].parameters[0].size if first and first[0].cause == "quadratic-drag" else None


def judged(rows: pd.DataFrame) -> Judged:
    """Diagnose the drops of one ball."""
    found = diagnose_problem(*make_problem(rows), alpha=ALPHA)
    splits = later_half_of_the_last_drop(found.selection.problem.rows)
    again = partial(select_in_fold, alpha=ALPHA)
    return Judged(
        found, estimate_gain(found.selection, found.findings, splits, again, alpha=ALPHA, workers=1)[0]
    )


def drag_coefficient(k: float, rows: pd.DataFrame) -> float:
    """C_D of a ball of this weight and size; NaN where they were not written down."""
    weight, circumference = rows[["weight", "circumference"]].iloc[0]
    return float(2 * weight * k / (AIR * circumference**2 / (4 * np.pi)))


def line(ball: str, rows: pd.DataFrame) -> str:
    """A row of the table."""
    one = judged(rows)
    named = " + ".join("/".join((each.cause, *each.equivalent)) for each in one.diagnosis.findings)
    text = f"{ball:20s} {one.gain.baseline:6.2f} -> {one.gain.extended:5.2f} m  {named}"
    if one.k is None:
        return text
    longest, shortest = 1 / one.k.low, 1 / one.k.high
    length = f"{1 / one.k.estimate:.1f} m ({shortest:.1f} to {longest:.1f})"
    fastest, coefficient = np.sqrt(G / one.k.estimate), drag_coefficient(one.k.estimate, rows)
    return f"{text}; drag length {length}, terminal {fastest:.1f} m/s, C_D {coefficient:.2f}"


def main() -> None:
    """Print both tables."""
    frames = measured()
    straight = straightened(frames, slant := bend(frames))
    for title, each in (("as filmed", frames), (f"straightened by {slant:.4f}/m", straight)):
        print(title)
        for ball, rows in each.groupby("ball", sort=False):
            print(" ", line(str(ball), rows))


if __name__ == "__main__":
    main()
