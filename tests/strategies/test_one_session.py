"""Intervals over the configurations of one session: they hold for more configurations of that session."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.strategies.statistics import (
    CONFIGURATION_UNIT,
    add_errors,
    compare_pairs,
    summarize_errors,
)

A, B, C, TRAVEL = 976e-9, 0.30, 438e-9, 0.012
REPEATABILITY = 0.0027
MORE = 3000  # configurations that stand for all
PARTS = ["session", "strategy"]


def step_size(q2, theta, a=A, b=B, c=C):
    """Eq. 4.5 with the base level about y."""
    return (1 - b * np.abs(np.cos(q2))) * (a - c * np.cos(q2) * np.cos(theta))


def scatter(rng, shape, kind):
    """Of log steps, the same spread whatever the tails."""
    if kind == "gaussian":
        return REPEATABILITY * rng.standard_normal(shape)
    return REPEATABILITY * rng.standard_t(5, shape) * np.sqrt(3 / 5)


def calibrated(rng, sessions, kind):
    """a, b and c of each session from its three traverses (Eqs. 6.2 to 6.4), each shape (sessions, 1)."""
    q2, theta = np.radians([-90.0, 0.0, 0.0]), np.radians([0.0, -90.0, 0.0])
    seen = step_size(q2, theta) * np.exp(-scatter(rng, (sessions, 3), kind))
    plain, recoiling, loaded = seen.T[..., None]
    return plain, 1 - recoiling / plain, plain * (1 - loaded / recoiling)


def simulated(sessions, configurations, replicates, kind, uneven):
    """Errors of two calibrations by the same recipe, and what they would be over all configurations.

    Returns
    -------
    errors : DataFrame
        As `with_errors` returns it.
    truth : DataFrame, by session and strategy
        The rms, bias and typical_worst, and mean_rms: a configuration's rms, on average.
    """
    rng = np.random.default_rng(configurations * 10 + replicates)

    def measured(shape):
        q2, theta = rng.uniform(-3.66, 0.52, shape), rng.uniform(-1.57, 0.0, shape)
        wide = np.where(uneven & (rng.random(shape) < 0.5), 2.0, 1.0)
        noise = wide[..., None] * scatter(rng, (*shape, replicates), kind)
        return q2, theta, step_size(q2, theta)[..., None] * np.exp(-noise)

    q2, theta, seen = measured((sessions, configurations))
    more_q2, more_theta, more_seen = measured((1, MORE))
    tables, truths = [], []
    for name in ("one", "other"):
        values = calibrated(rng, sessions, kind)
        predicted = np.broadcast_to(step_size(q2, theta, *values)[..., None], seen.shape)
        where = (np.repeat(each.ravel(), replicates) for each in (q2, theta))
        there = dict(zip(("q2", "theta"), where, strict=True))
        table = pd.DataFrame({**there, "measured": seen.ravel(), "predicted": predicted.ravel()})
        session = np.repeat(np.arange(sessions), configurations * replicates)
        tables.append(table.assign(session=session, strategy=name, traverse=table.index))
        off = step_size(more_q2, more_theta, *values)[..., None] - more_seen
        truth = {
            "rms": np.sqrt(np.mean(off**2, axis=(1, 2))),
            "bias": np.mean(off, axis=(1, 2)),
            "typical_worst": np.mean(np.max(np.abs(off), axis=2), axis=1),
            "mean_rms": np.mean(np.sqrt(np.mean(off**2, axis=2)), axis=1),
        }
        truths.append(pd.DataFrame(truth).assign(session=np.arange(sessions), strategy=name))
    alike = dict.fromkeys(("q1", "q3", "psi", "start"), 0.0)
    errors = pd.concat(tables, ignore_index=True).assign(direction="+", **alike, stop=TRAVEL)
    return add_errors(errors), pd.concat(truths).set_index(PARTS)


def check(errors, truth):
    """Coverage of each strategy's errors and of their difference."""
    found = summarize_errors(errors, PARTS, CONFIGURATION_UNIT).set_index(PARTS)
    chance = 3 * np.sqrt(0.95 * 0.05 / errors["session"].nunique())
    for name in ("rms", "bias", "typical_worst"):
        inside = (found[f"{name}_low"] <= truth[name]) & (truth[name] <= found[f"{name}_high"])
        for strategy, subset in inside.groupby(level="strategy"):
            assert subset.mean() > 0.94 - chance, (name, strategy, subset.mean())
    inside = []
    for session, subset in errors.groupby("session"):
        pair = compare_pairs(subset, CONFIGURATION_UNIT).iloc[0]
        apart = truth.loc[(session, "one"), "mean_rms"] - truth.loc[(session, "other"), "mean_rms"]
        inside.append(pair["difference_low"] <= apart <= pair["difference_high"])
    assert abs(np.mean(inside) - 0.95) < 0.02 + chance, np.mean(inside)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "uneven", "sessions"),
    [
        ("t5", True, 40),
        *(pytest.param(*one, 80, marks=pytest.mark.nightly) for one in (("gaussian", False), ("t5", True))),
    ],
)
def test_intervals_over_configurations_cover(kind, uneven, sessions):
    check(*simulated(sessions, 40, 1, kind, uneven))


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "uneven"), [("gaussian", False), ("t5", False), ("t5", True)])
@pytest.mark.parametrize("configurations", [6, 12, 40, 100])
@pytest.mark.parametrize("replicates", [1, 2])
def test_intervals_cover_in_many_sessions(configurations, replicates, kind, uneven):
    check(*simulated(2000, configurations, replicates, kind, uneven))
