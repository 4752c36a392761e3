"""The logs, made once and kept in a folder: file, what contenders get, a fresh replicate, and the truth."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.naming.columns import candidates
from benchmarks.naming.problem import Array, Problem
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation._groups import usable_rows
from stickslip_fit.logs import Log, read_log
from tests.hidden.catalogue import OUTSIDE
from tests.hidden.generate import Hidden, hide
from tests.hidden.physics import PARAMETERS, Place, place
from tests.hidden.study import DECOYS, Case, cases, make

STRENGTHS = (3.5, 6.0, 12.0, 25.0)
SIZES = {"tiny": (6, 3), "small": (99, 27), "nightly": (999, 120)}  # nulls, and logs of each other cell
SEEN = 1e-3  # share of a column that recalibration has to leave


def wanted(size: str) -> Iterator[Case]:
    """The cases of a size; no two campaigns are the same."""
    nulls, each = SIZES[size]
    yield from cases("nothing", nulls, first=100_000)
    for number, strength in enumerate(STRENGTHS):
        yield from cases("single", each, (strength,), first=200_000 + 10_000 * number)
    yield from cases("pair", each, (12.0,), first=300_000)
    yield from cases("outside", each, (12.0,), first=400_000)


def make_logs(size: str, folder: Path) -> list[Path]:
    """Make what is not there yet; the logs that could be made, in order."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for case in wanted(size):
        log = folder / f"{case.kind}-{case.strength:g}-{case.seed}.csv"
        truth = log.with_suffix(".json")
        if not truth.exists():
            truth.write_text(json.dumps(_made(case, log)))
        if json.loads(truth.read_text())["possible"]:
            made.append(log)
    return made


def _made(case: Case, log: Path) -> dict[str, object]:
    hidden = make(case)
    if hidden is None:
        return {"possible": False}
    hidden.write(log)
    problem, predicted = _problem(log)
    problem.save()
    fresh = np.log(_again(case, hidden).table["steps"].to_numpy() - 2.5) - predicted
    np.save(log.with_suffix(".fresh.npy"), fresh)
    effects = hidden.truth["effects"]
    baseline = float(np.sqrt(np.mean(fresh**2)))
    return {
        "possible": True, "kind": case.kind, "design": case.design, "noise": case.noise,
        "strength": case.strength, "baseline_pct": 100 * baseline,
        "causes": ["unknown" if each["name"] in OUTSIDE else each["cause"] for each in effects],
        "forms": [each["form"] for each in effects],
        "rms_pct": [each["effect_rms_pct"] for each in effects],
        "oracle_pct": 100 * _oracle(problem, hidden, fresh),
    }  # fmt: skip


def _again(case: Case, hidden: Hidden) -> Hidden:
    """The same campaign measured once more."""
    names = [act.name for act in hidden.acts]
    decoys = DECOYS if case.kind == "nothing" else ()
    return hide(case.design, names, case.strength or None, case.noise, decoys, case.seed, replicate=1)


def _oracle(problem: Problem, hidden: Hidden, fresh: Array) -> float:
    """Error on the replicate of the law with the true causes in their true forms, their sizes refitted."""
    true = np.stack([hidden.effect(act.name) for act in hidden.acts] or [np.zeros(len(fresh))], axis=1)
    true -= problem.basis @ (problem.basis.T @ true)
    departure = true @ np.linalg.lstsq(true, problem.y)[0]
    return float(np.sqrt(np.mean((fresh - departure) ** 2)))


def _problem(log_file: Path) -> tuple[Problem, Array]:
    """The problem, and what the baseline predicts for the logarithm of each row's steps."""
    log = read_log(log_file)
    rows = usable_rows(log)
    y, predicted, basis, places = _baseline(log, rows)
    kept = [
        (cause, number, column / np.sqrt(np.mean(column**2)))
        for number, (cause, columns) in enumerate(candidates(rows, places, np.exp(predicted)))
        for column in _off(basis, columns).T
        if column.any()
    ]
    names = ["session", "joint", "q1", "q2", "q3", "theta", "psi"]
    ends = np.sort(rows[["start", "stop"]].to_numpy(), axis=1)
    kinds = rows[names].astype({"session": str}).assign(low=ends[:, 0], high=ends[:, 1])
    return Problem(
        log_file,
        y - basis @ (basis.T @ y),
        basis,
        np.stack([column for _, _, column in kept], axis=1),
        np.array([cause for cause, _, _ in kept]),
        np.array([number for _, number, _ in kept]),
        kinds.groupby(list(kinds), dropna=False).ngroup().to_numpy(),
    ), predicted


def _baseline(log: Log, rows: pd.DataFrame) -> tuple[Array, Array, Array, list[Place]]:
    """What the published laws leave and predict, what recalibration can do, and the laws node by node."""
    y, predicted, blocks, places = np.zeros(len(rows)), np.zeros(len(rows)), [], []
    for joint, fit in fit_least_squares(log).joints.items():
        subset = np.flatnonzero(rows["joint"].to_numpy() == joint)
        its, block = rows.iloc[subset], fit.group_index(rows.iloc[subset])
        predicted[subset], slopes = fit.law.model(its)(fit.values[block])
        y[subset] = fit.law.response(its)[0] - predicted[subset]
        for each in np.unique(block):
            left, spread, _ = np.linalg.svd(
                slopes[block == each] / np.linalg.norm(slopes, axis=0), full_matrices=False
            )
            columns = np.zeros((len(rows), int(np.sum(spread > 1e-6 * spread[0]))))
            columns[subset[block == each]] = left[:, : columns.shape[1]]
            blocks.append(columns)
        ends = np.sort(its[["start", "stop"]].to_numpy(), axis=1).T
        where = {name: its[name].to_numpy(float) for name in ("q1", "q2", "q3", "theta", "psi")}
        values = dict.fromkeys(PARAMETERS[joint], np.zeros(len(subset)))
        values |= dict(zip(PARAMETERS[joint], fit.values[block].T, strict=True))
        forward = np.where(its["direction"].to_numpy(str) == "+", 1.0, -1.0)
        places.append(place(joint, subset, {**where, "low": ends[0], "high": ends[1]}, values, forward))
    return y, predicted, np.concatenate(blocks, axis=1), places


def _off(basis: Array, columns: Array) -> Array:
    """Columns with the basis taken out; zeros where next to nothing is left."""
    left = columns - basis @ (basis.T @ columns)
    return left * (np.linalg.norm(left, axis=0) > SEEN * np.linalg.norm(columns, axis=0))
