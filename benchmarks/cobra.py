"""Real piezo motors: held-out errors of a diagnosis beside a smoothing spline of position, on the same folds.

For each positioner, joint and cut of the Cobra motor maps (`tests/cobra/maps.py` makes logs of them). The
spline's model of log steps per unit of length is a level for each session and direction, and a cubic
smoothing spline of the traverse's middle for each direction. It is fitted to the training rows of a fold,
with the penalty that predicts them best in an inner cross-validation, and predicts the fold's held-out rows.

`--new-day K` keeps the latest version of each map as a new session: K traverses of it calibrate the law that
the earlier ones extended, the others are predicted; beside it the law alone, and the spline of the earlier
sessions with levels from the same K traverses.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from stickslip_fit import fit
from stickslip_fit.diagnosis import Diagnosis, diagnose
from stickslip_fit.diagnosis.gain import hold_out_configurations
from stickslip_fit.logs import Log, read_log
from stickslip_fit.machine import load_machine
from tests.cobra.maps import JOINTS, MACHINE, SHARED, positioners, write_cut

PENALTIES = np.logspace(-7, 3, 31)
INNER_FOLDS = 5
LATEST = "final"  # version of a map
ALLOWED = 1.05  # our error over the spline's
USEFUL = 0.8  # error of a spline, of that of a constant step, below which something is wrong


@dataclass(frozen=True)
class Line:
    """Errors of one log on the rows that its diagnosis holds out, relative; seconds of CPU."""

    positioner: str
    joint: str
    cut: int
    verdict: str
    causes: tuple[str, ...]
    constant: float
    extended: float
    spline: float
    seconds: float

    @property
    def silent(self) -> bool:
        """Whether the diagnosis finds nothing wrong where a spline lowers the error by a fifth."""
        return self.verdict == "nothing wrong" and self.spline < USEFUL * self.constant

    @property
    def holds(self) -> bool:
        """Whether the diagnosis predicts as well as the spline and is not silent."""
        return self.extended <= ALLOWED * self.spline and not self.silent

    def __str__(self) -> str:
        return (
            f"{self.positioner:>3s} {self.joint:5s} {self.cut}  constant {100 * self.constant:5.1f} %  "
            f"ours {100 * self.extended:5.1f} %  spline {100 * self.spline:5.1f} %  "
            f"ratio {self.extended / self.spline:.3f}  {'ok ' if self.holds else '!! '} {self.verdict}: "
            f"{', '.join(self.causes)}  {self.seconds:.1f} s"
        )


class SmoothingSpline:
    """Levels and a cubic smoothing spline of x in [0, 1], for any penalty, as the Bayesian model that it is.

    G. Wahba, Spline Models for Observational Data (SIAM, 1990), Ch. 1: the spline is the posterior mean of a
    line with a flat prior and an integrated Wiener process, whose covariance is `kernel`.
    """

    def __init__(self, x: np.ndarray, level: np.ndarray, y: np.ndarray) -> None:
        self.x, self.levels, self.y = x, np.unique(level), y
        self.line = self._line(x, level)
        basis, triangle = np.linalg.qr(self.line, mode="complete")
        free = basis[:, np.linalg.matrix_rank(triangle) :]
        self.covariance = kernel(x, x)
        self.values, vectors = np.linalg.eigh(free.T @ self.covariance @ free)
        self.directions = free @ vectors

    def predict(self, penalty: float, x: np.ndarray, level: np.ndarray) -> np.ndarray:
        """At other positions and levels, under a penalty."""
        weights = self.directions @ ((self.directions.T @ self.y) / (self.values + penalty))
        rest = self.y - self.covariance @ weights - penalty * weights
        line = np.linalg.lstsq(self.line, rest, rcond=None)[0]
        return self._line(x, level) @ line + kernel(x, self.x) @ weights

    def _line(self, x: np.ndarray, level: np.ndarray) -> np.ndarray:
        return np.column_stack([level[:, None] == self.levels, x]).astype(float)


def kernel(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Covariance of an integrated Wiener process at x and z, shape (n, m)."""
    first, last = np.minimum.outer(x, z), np.maximum.outer(x, z)
    return first**2 * (3.0 * last - first) / 6.0


def choose_penalty(x: np.ndarray, level: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> float:
    """The penalty that predicts best in an inner cross-validation."""
    fold, squares = rng.permutation(np.arange(len(x)) % INNER_FOLDS), np.zeros(len(PENALTIES))
    for number in range(INNER_FOLDS):
        kept, left = fold != number, fold == number
        spline = SmoothingSpline(x[kept], level[kept], y[kept])
        for k, penalty in enumerate(PENALTIES):
            squares[k] += np.sum((y[left] - spline.predict(penalty, x[left], level[left])) ** 2)
    return float(PENALTIES[np.argmin(squares)])


def predict_spline(
    rows: pd.DataFrame, y: np.ndarray, train: np.ndarray, held: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Held-out log step sizes by the spline of their direction."""
    middle = (rows["start"] + rows["stop"]).to_numpy(float) / 2
    x = (middle - middle.min()) / np.ptp(middle)
    level = pd.factorize(rows["session"].astype(object))[0]
    direction, predicted = rows["direction"].to_numpy(object), np.zeros(len(held))
    for one in np.unique(direction):
        own, wanted = train[direction[train] == one], direction[held] == one
        best = choose_penalty(x[own], level[own], y[own], rng)
        spline = SmoothingSpline(x[own], level[own], y[own])
        predicted[wanted] = spline.predict(best, x[held[wanted]], level[held[wanted]])
    return predicted


def log_lengths(rows: pd.DataFrame) -> np.ndarray:
    """Of traverses, shape (n,)."""
    return np.log((rows["stop"] - rows["start"]).abs().to_numpy(float))


def spline_error(diagnosis: Diagnosis) -> float:
    """Rms error of the spline on the rows that the diagnosis holds out, from the same training rows."""
    problem = diagnosis.selection.problem
    rows, rng = problem.rows, np.random.default_rng(0)
    y = log_lengths(rows) - problem.responses
    errors = [
        y[split.held_out] - predict_spline(rows, y, split.train, split.held_out, rng)
        for split in hold_out_configurations(diagnosis.selection)
    ]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def read_cut(positioner: str, joint: str, cut: int) -> Log:
    """One joint's log."""
    with TemporaryDirectory() as folder:
        machine, path = Path(folder) / "cobra.toml", Path(folder) / "log.csv"
        machine.write_text(MACHINE, encoding="utf-8")
        write_cut(positioner, cut, path, only=joint)
        return read_log(path, machine=load_machine(machine))


def compare(positioner: str, joint: str, cut: int) -> Line:
    """Diagnose one log, and measure the spline on its folds."""
    log, began = read_cut(positioner, joint, cut), time.process_time()
    diagnosis = diagnose(log)
    seconds, gain = time.process_time() - began, diagnosis.gain
    assert gain is not None
    causes = tuple(finding.cause for finding in diagnosis.findings)
    errors = gain.baseline, gain.extended, spline_error(diagnosis)
    return Line(positioner, joint, cut, diagnosis.verdict, causes, *errors, seconds)


def compare_new_day(positioner: str, joint: str, number: int) -> np.ndarray:
    """Rms errors in a new session: law alone, law with known causes, spline with new levels; shape (3,)."""
    log, rng = read_cut(positioner, joint, 1), np.random.default_rng(int(positioner))
    rows, new = log.rows, (log.rows["session"] == LATEST).to_numpy()
    direction, begun = rows["direction"].to_numpy(object), np.zeros(len(rows), dtype=bool)
    for one in np.unique(direction):
        own = np.flatnonzero(new & (direction == one))
        begun[own[np.linspace(0, len(own) - 1, number // 2).round().astype(int)]] = True
    y = log_lengths(rows) - np.log(rows["steps"].to_numpy(float))
    middle, level = rows[["start", "stop"]].mean(axis=1).to_numpy(), pd.factorize(rows["session"])[0]
    x, spline = (middle - middle.min()) / np.ptp(middle), np.zeros(len(rows))
    for one in np.unique(direction):
        own = direction == one
        known = x[own & ~new], level[own & ~new], y[own & ~new]
        smooth, penalty = SmoothingSpline(*known), choose_penalty(*known, rng)
        spline[own] = smooth.predict(penalty, x[own], np.full(np.sum(own), level[own][0]))
        spline[own] += np.mean((y - spline)[own & begun])
    diagnosis, begin = diagnose(log.select(~new), gain=False), log.select(begun)
    law = diagnosis.extended_law() if diagnosis.findings else None
    fits = fit(begin), fit(begin, causes_from=law)
    rest = rows[new & ~begun]
    predicted = [log_lengths(rest) - np.log(one.predict(rest)["steps"].to_numpy(float)) for one in fits]
    wanted = y[new & ~begun]
    return np.sqrt([np.mean((wanted - one) ** 2) for one in (*predicted, spline[new & ~begun])])


def main() -> None:
    """Print a line for each positioner, joint and cut, and how many hold."""
    parser = argparse.ArgumentParser()
    parser.add_argument("positioners", nargs="*")
    parser.add_argument(
        "--new-day", type=int, metavar="K", help="traverses of the latest version, at least 4"
    )
    chosen = parser.parse_args()
    if not SHARED.exists():
        print("the Cobra motor maps are not here: nothing to compare")
        return
    if chosen.new_day:
        errors = []
        for positioner in chosen.positioners or positioners():
            for joint in JOINTS:
                errors.append(compare_new_day(positioner, joint, chosen.new_day))
                told = "law alone {:.1f} %  known causes {:.1f} %  spline {:.1f} %".format(*100 * errors[-1])
                print(f"{positioner:>3s} {joint:5s} {told}", flush=True)
        mean = 100 * np.sqrt(np.mean(np.square(errors), axis=0))
        print("rms: law alone {:.1f} %, known causes {:.1f} %, spline {:.1f} %".format(*mean))
        return
    lines = []
    for positioner in chosen.positioners or positioners():
        for joint in JOINTS:
            for cut in (1, 2):
                lines.append(compare(positioner, joint, cut))
                print(lines[-1], flush=True)
    print(f"{sum(line.holds for line in lines)} of {len(lines)} hold")


if __name__ == "__main__":
    main()
