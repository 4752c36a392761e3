"""Correct digits on NIST's 27 nonlinear problems, beside scipy and lmfit; each with analytic derivatives.

A number is the worst parameter's correct digits from the first and the second start; `!` marks a failure
that the solver itself reports.
"""

from __future__ import annotations

import warnings

import lmfit
import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from benchmarks.nist_problems import FILES, Problem, digits, read
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.estimation._optimize import minimize


def ours(problem: Problem, begin: np.ndarray) -> tuple[np.ndarray, bool]:
    """The core that fits the laws."""
    groups = Groups(
        pd.DataFrame({"session": [""], "direction": ["+"]}), np.zeros(len(problem.y), dtype=np.intp)
    )
    weight, start = np.ones(len(problem.y)), begin[None, :]
    found = minimize(
        problem.model(), problem.y, weight, groups, start, np.abs(start), rank_tol=1e-14, tolerance=1e-10
    )
    return found.values[0], bool(found.converged[0] and found.rank[0] == len(begin))


def by_scipy(problem: Problem, begin: np.ndarray) -> tuple[np.ndarray, bool]:
    """MINPACK through scipy, tolerances at their tightest."""
    model = problem.model()

    def at(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return model(np.broadcast_to(p, (len(problem.y), len(p))))

    try:
        found = least_squares(
            lambda p: at(p)[0] - problem.y, begin, jac=lambda p: at(p)[1],
            method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=10_000,
        )  # fmt: skip
    except ValueError:
        return begin, False
    return found.x, bool(found.success)


def by_lmfit(problem: Problem, begin: np.ndarray) -> tuple[np.ndarray, bool]:
    """MINPACK through lmfit, its own numerical derivatives, as its users run it."""
    model = problem.model()
    parameters = lmfit.Parameters()
    for index, value in enumerate(begin):
        parameters.add(f"b{index}", value=value)

    def misfit(p: lmfit.Parameters) -> np.ndarray:
        values = np.array([p[f"b{index}"].value for index in range(len(begin))])
        return model(np.broadcast_to(values, (len(problem.y), len(begin))))[0] - problem.y

    try:
        found = lmfit.minimize(misfit, parameters, xtol=1e-15, ftol=1e-15, max_nfev=10_000)
    except ValueError:
        return begin, False
    return np.array([found.params[f"b{index}"].value for index in range(len(begin))]), bool(found.success)


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    solvers = {"ours": ours, "scipy": by_scipy, "lmfit": by_lmfit}
    solved = {name: [0, 0] for name in solvers}
    print(f"{'':10}" + "".join(f"{name:>16}" for name in solvers))
    for problem in map(read, FILES):
        cells = []
        for name, solver in solvers.items():
            marks = []
            for start in (0, 1):
                values, succeeded = solver(problem, problem.starts[start])
                right = digits(values, problem.certified)
                solved[name][start] += right >= 8
                marks.append(f"{max(right, 0.0):.1f}" if succeeded else f"{max(right, 0.0):.1f}!")
            cells.append("  ".join(f"{mark:>5}" for mark in marks))
        print(f"{problem.name:10}" + "".join(f"{cell:>16}" for cell in cells))
    print(f"{'8 digits':10}" + "".join(f"{first:>11} {second:>4}" for first, second in solved.values()))


if __name__ == "__main__":
    main()
