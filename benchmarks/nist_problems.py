"""The 27 nonlinear regression problems of NIST's Statistical Reference Datasets.

The files come with the wheel of refnx; the formulas are read from them, and differentiated by sympy.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import refnx
import sympy

FILES = sorted((Path(refnx.__file__).parent / "analysis" / "tests" / "NIST_STRD").glob("*.dat"))


@dataclass(frozen=True)
class Problem:
    """One data set: response, predictors, formula, starts and certified values."""

    name: str
    y: np.ndarray
    x: np.ndarray
    formula: str
    starts: np.ndarray
    certified: np.ndarray
    errors: np.ndarray

    def model(self) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """The formula and its derivatives as the core of least squares wants them."""
        names = [f"b{index + 1}" for index in range(len(self.certified))]
        predictors = ["x"] if len(self.x) == 1 else ["x1", "x2"]
        known = {name: sympy.Symbol(name) for name in (*names, *predictors)} | {"arctan": sympy.atan}
        formula = sympy.sympify(self.formula, locals=known)
        arguments = [known[name] for name in (*names, *predictors)]
        slopes = [sympy.diff(formula, known[name]) for name in names]
        evaluate = sympy.lambdify(arguments, [formula, *slopes], "numpy")

        def model(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            with np.errstate(all="ignore"):
                found = evaluate(*values.T, *self.x)
            whole = np.stack([np.broadcast_to(np.asarray(part, float), self.y.shape) for part in found])
            return whole[0], whole[1:].T

        return model


def read(path: Path) -> Problem:
    """One problem from its file."""
    text = path.read_text()
    response, formula = re.search(r"\n\s*(y|log\[y\])\s*=(.*?)\+\s*e\s*\n", text, re.S).groups()
    lines = [line.split("=")[1].split() for line in re.findall(r"^\s*b\d+\s*=.*$", text, re.M)]
    table = np.array([[float(cell) for cell in line] for line in lines if len(line) == 4])
    rows = text[text.rindex("\nData:") :].splitlines()[2:]
    data = np.array([[float(cell) for cell in row.split()] for row in rows if row.strip()])
    y = np.log(data[:, 0]) if response.startswith("log") else data[:, 0]
    formula = formula.replace("[", "(").replace("]", ")").replace("\n", " ").strip()
    return Problem(path.stem, y, data[:, 1:].T, formula, table[:, :2].T, table[:, 2], table[:, 3])


def digits(found: np.ndarray, certified: np.ndarray) -> float:
    """Correct digits of the worst parameter."""
    with np.errstate(all="ignore"):
        off = np.max(np.abs(found / certified - 1.0))
    return float(-np.log10(off)) if off > 0 else 16.0
