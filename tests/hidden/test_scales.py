"""The size at which a cause is tried is a guess, and a guess that is ten times off finds it all the same."""

from __future__ import annotations

import numpy as np
import pytest

from stickslip_fit.causes import Cause, library
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.logs import read_log
from tests.hidden.generate import hide, testable

STRONG = 12.0
SHAPE = {"tau", "n0", "moment", "phi", "x0", "w"}  # parameters that are no sizes, of those that have one
DESIGN = {"wear": "many", "step-rate": "many", "load-hysteresis": "many", "bearing-runout": "many"}


def rescaled(cause: Cause, factor: float) -> Cause:
    """The same cause, tried at sizes that are some factor away."""

    def trials(self, rows):
        return [
            (version, resize(version, values)) for version, values in type(cause).trials(self, rows)
        ]

    def resize(version, values):
        null = np.array(version.null_values)
        sizes = [k for k, one in enumerate(version.parameters) if one.name == "phi" and k == 0 or one.name not in SHAPE]
        values = np.array(values, dtype=float)
        values[:, sizes] = null[sizes] + factor * (values[:, sizes] - null[sizes])
        return values

    kind = type(cause)
    other = object.__new__(type(kind.__name__, (kind,), {"trials": trials}))
    other.__dict__.update(cause.__dict__)
    return other


def names_found(cause: str, factor: float, path) -> tuple[str, ...]:
    """The first finding, with what is as likely, of a log in which a cause is hidden."""
    design = DESIGN.get(cause, "many")
    seed = next(seed for seed in range(40) if cause in testable(design, seed, STRONG))
    hide(design, (cause,), STRONG, seed=seed, forms={cause: "table"}).write(path)
    causes = [rescaled(one, factor) if one.name == cause else one for one in library()]
    findings = diagnose(read_log(path), causes=causes, gain=False).findings
    return (findings[0].cause, *findings[0].equivalent) if findings else ()


SCALABLE = [one.name for one in library() if one.name != "end-stop-misfire"]


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("cause", SCALABLE)
def test_a_cause_tried_at_a_tenth_or_ten_times_its_size_is_found(cause, factor, tmp_path):
    assert cause in names_found(cause, factor, tmp_path / "log.csv")
