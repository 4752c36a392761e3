"""Intervals and verdicts over many simulated logs of joint 3, each of a few sessions."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.laws import Prismatic, expected_steps, traverse_length
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values, simulate
from stickslip_fit.strategies import AtRandom, ClosedForm, LeastSquares, compare_strategies
from stickslip_fit.strategies.base import solve_law
from stickslip_fit.strategies.statistics import (
    INDISTINGUISHABLE,
    SESSION_UNIT,
    add_errors,
    compare_pairs,
    summarize_errors,
)

PLAN = """
seed = 4
[sessions]
first_date = 2012-03-05
count = {sessions}
[noise]
repeatability_pct = 0.27
kind = "{kind}"
[[sweep]]
joint = 3
directions = ["+"]
q2_deg = [-90, -60, -30, 0]
theta_deg = [-90, 0]
replicates = 2
"""
LAW = """
[[law]]
joint = 3
direction = "+"
a_nm = 976
b = 0.3
c_nm = 438
day_to_day_pct = 1.8
"""
A_LOG = 5  # sessions


def simulated(sessions, folder, kind):
    (folder / "plan.toml").write_text(PLAN.format(sessions=sessions, kind=kind))
    (folder / "law.toml").write_text(LAW)
    machine = load_machine()
    plan = read_plan(folder / "plan.toml", machine)
    return simulate(plan, read_law_values(folder / "law.toml", machine), machine)


def all_at_once(log):
    """Errors of the thesis's calibration and of two random choices of six, all sessions in one solution."""
    rows, rng = log.usable, np.random.default_rng(2)
    first = ~rows.duplicated(["session", "q2", "theta"])
    upright, side = abs(rows["q2"]) < 1e-9, rows["theta"] < -1
    level = abs(rows["q2"] + np.pi / 2) < 1e-9
    made = {"thesis": first & (upright | (level & ~side))}
    for name in ("one", "other"):
        drawn = pd.Series(rng.random(len(rows)), rows.index).where(first).groupby(rows["session"]).rank()
        made[name] = drawn <= 6
    held_out = ~first
    parts = []
    for name, subset in made.items():
        found = solve_law(Prismatic(), rows[subset], 0.0027)
        held = rows[held_out]
        group = pd.Index(found.groups.table["session"]).get_indexer(held["session"])
        steps = np.exp(Prismatic().predict(held, found.values[group]))
        seen = expected_steps(held["steps"], held["check_every"])
        part = held.assign(strategy=name, traverse=held.index)
        parts.append(
            part.assign(measured=traverse_length(held) / seen, predicted=traverse_length(held) / steps)
        )
    return by_log(add_errors(pd.concat(parts, ignore_index=True)), log)


def one_by_one(log):
    """The same from strategies as they are used."""
    equals = [LeastSquares(AtRandom(seed), 3) for seed in (1, 2)]
    thesis, one, other = (
        Named(each, name)
        for each, name in zip([ClosedForm(), *equals], ["thesis", "one", "other"], strict=True)
    )
    return by_log(
        compare_strategies(log, [thesis, one, other], session_selector=lambda sessions, session: ()).shared,
        log,
    )


class Named:
    """A strategy under another name."""

    def __init__(self, strategy, name):
        self.name, self.choose, self.calibrate = name, strategy.choose, strategy.calibrate


def by_log(errors, log):
    order = {session: place for place, session in enumerate(log.sessions)}
    return errors.assign(log=errors["session"].map(order) // A_LOG)


def check(errors):
    """Coverage of rms and bias over logs of a few sessions, and false alarms between two equals."""
    whole = summarize_errors(errors, ["strategy"], SESSION_UNIT).set_index("strategy")
    each = summarize_errors(errors, ["log", "strategy"], SESSION_UNIT)
    chance = 3 * np.sqrt(0.95 * 0.05 / each["log"].nunique())
    for strategy, subset in each.groupby("strategy"):
        for name in ("rms", "rms_relative", "bias_relative", "typical_worst", "typical_worst_relative"):
            truth = whole.loc[strategy, name]
            covered = ((subset[f"{name}_low"] <= truth) & (truth <= subset[f"{name}_high"])).mean()
            assert 0.945 - chance < covered, (strategy, name, covered)
            if "bias" in name:
                assert covered < 0.955 + chance, (strategy, name, covered)
            else:
                needed = 1.96 * np.log(subset[name] / truth).std()
                assert np.log(subset[f"{name}_high"] / subset[name]).median() < 2 * needed, (strategy, name)
    equals = errors[errors["strategy"] != "thesis"]
    verdicts = [compare_pairs(subset, SESSION_UNIT)["verdict"].iloc[0] for _, subset in equals.groupby("log")]
    assert np.mean([verdict != INDISTINGUISHABLE for verdict in verdicts]) < 0.05 + chance


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "logs"),
    [
        ("gaussian", 150),
        *(
            pytest.param(*one, marks=pytest.mark.nightly)
            for one in (("t5", 100), ("gaussian", 2000), ("t5", 2000))
        ),
    ],
)
def test_intervals_cover_and_equals_are_called_so(kind, logs, tmp_path):
    check(all_at_once(simulated(logs * A_LOG, tmp_path, kind)))


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["gaussian", "t5"])
def test_intervals_cover_for_strategies_as_they_are_used(kind, tmp_path):
    check(one_by_one(simulated(400 * A_LOG, tmp_path, kind)))
