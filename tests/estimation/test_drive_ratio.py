"""lambda and what its choice leaves open: against fits with one lambda at a time, by least squares."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.estimation.drive_ratio import physical_law, profile_ratio, ratio_changes
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.laws.physical import PhysicalPrismatic
from stickslip_fit.machine import load_machine
from stickslip_fit.step import step_size

MACHINE = load_machine()
FRICTION, RAMP_TIME, TRUE_RATIO, NOISE = 46.0, 1.5e-4, 0.95, 0.004
KEPT = 2  # directions that stand for all plausible lambdas


@pytest.fixture(scope="module")
def rows():
    """One session of joint 3, made step by step from the closed form at a lambda near 1."""
    rng = np.random.default_rng(4)
    q2, psi = (angle.ravel() for angle in np.meshgrid(np.linspace(-1.6, 0.0, 6), [0.0, 1.5, 3.1]))
    table = pd.DataFrame({"q2": q2, "psi": psi, "theta": 0.0, "q1": 0.0, "q3": np.nan})
    both = pd.concat([table.assign(direction=way) for way in "+-"], ignore_index=True)
    forward = (both["direction"] == "+").to_numpy()
    load = np.cos(both["psi"] - both["q2"]) * np.where(forward, 1, -1)
    amplitude = TRUE_RATIO * FRICTION * RAMP_TIME**2
    step = (1 - 0.3 * np.abs(np.cos(both["q2"]))) * step_size(FRICTION, RAMP_TIME, amplitude, 9.81 * load)
    start, stop = np.where(forward, 0.0, 0.012), np.where(forward, 0.012, 0.0)
    counts = 0.012 / step * np.exp(NOISE * rng.standard_normal(len(both)))
    return both.assign(
        joint=3, session="a", start=start, stop=stop, steps=counts.round(), check_every=1, status="ok"
    )


def test_what_lambda_leaves_open_spans_the_fits_with_other_lambdas(rows):
    law = physical_law(3, rows, MACHINE)
    changes = dict(zip("+-", ratio_changes(law, rows, MACHINE), strict=True))
    own = fit_joint(law, rows, MACHINE)[1]
    for way, others in zip("+-", law.plausible, strict=True):
        places, columns = changes[way]
        assert (rows["direction"].iloc[places] == way).all()
        assert 1 <= columns.shape[1] <= KEPT
        basis = np.linalg.qr(columns)[0]
        differences = []
        for ratio in others:
            fit = fit_joint(PhysicalPrismatic((ratio, ratio)), rows, MACHINE)[1]
            differences.append((own - fit)[places])
        total = np.array(differences)
        left = total - (total @ basis) @ basis.T
        assert np.sum(total**2) > 0
        assert np.sum(left**2) < 0.1 * np.sum(total**2)


def test_a_law_that_is_given_leaves_nothing_open(rows):
    assert ratio_changes(PhysicalPrismatic((0.9, 10.0)), rows, MACHINE) == []


def test_many_lambdas_at_once_are_fitted_as_one_at_a_time(rows):
    profiles = profile_ratio(3, rows, MACHINE, ratios=(0.5, 0.8, 0.95, 1.1), refinements=0)
    for k, ratio in enumerate(profiles["+"].ratios):
        residual = fit_joint(PhysicalPrismatic((ratio, ratio)), rows, MACHINE)[1]
        for way, profile in profiles.items():
            alone = float(np.sum(residual[rows["direction"] == way] ** 2))
            assert profile.squares[k] == pytest.approx(alone, rel=1e-3)
