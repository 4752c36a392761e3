"""Correct digits on NIST's 11 analyses of variance, beside scipy and statsmodels.

A number is the correct digits of F. The last column is what exact arithmetic on the doubles that the files'
decimals become can reach at best.
"""

import re
import warnings
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.stats

from stickslip_fit.anova.contrasts import build_comparison, sums_of_squares
from stickslip_fit.anova.formula import anova_rows, model_terms

FILES = sorted((Path(scipy.stats.__file__).parent / "tests" / "data" / "nist_anova").glob("*.dat"))
NAMES = ("F", "between", "within", "R squared", "residual deviation")
_NUMBER = re.compile(r"-?\d\.\d+E[+-]\d+")


@dataclass(frozen=True)
class Certified:
    """One data set with its certified values, in the order of `NAMES`."""

    name: str
    group: np.ndarray
    values: np.ndarray
    certified: tuple[float, ...]


def read(path: Path) -> Certified:
    """One data set from its file."""
    lines = path.read_text().splitlines()
    table = np.array([line.split() for line in lines[60:] if line.strip()], dtype=float)
    between, _, statistic, within, _, r_squared, deviation = (
        float(text) for line in lines[40:48] for text in _NUMBER.findall(line)
    )
    certified = (statistic, between, within, r_squared, deviation)
    return Certified(path.stem, table[:, 0], table[:, 1], certified)


def ours(problem: Certified) -> tuple[float, ...]:
    """The core behind the named analyses."""
    found = sums_of_squares(problem.values, build_comparison(problem.group))
    share = found.between / found.total
    return tuple(
        float(value)
        for value in (found.statistic, found.between, found.within, share, np.sqrt(found.variance))
    )


def exact(problem: Certified) -> tuple[float, ...]:
    """Rational arithmetic on the doubles of the data, rounded once at the end."""
    groups: dict[float, list[Fraction]] = {}
    for group, value in zip(problem.group, problem.values, strict=True):
        groups.setdefault(float(group), []).append(Fraction(float(value)))
    n = len(problem.values)
    middle = sum(sum(group) for group in groups.values()) / n
    means = {key: sum(group) / len(group) for key, group in groups.items()}
    between = sum(len(group) * (means[key] - middle) ** 2 for key, group in groups.items())
    within = sum((value - means[key]) ** 2 for key, group in groups.items() for value in group)
    variance = within / (n - len(groups))
    statistic = between / (len(groups) - 1) / variance
    deviation = float(variance) ** 0.5
    return (float(statistic), float(between), float(within), float(between / (between + within)), deviation)


def by_scipy(problem: Certified) -> float:
    """F by scipy's one-way analysis."""
    groups = [problem.values[problem.group == one] for one in np.unique(problem.group)]
    return float(scipy.stats.f_oneway(*groups).statistic)


def by_formula(problem: Certified) -> float:
    """F by the table of a formula."""
    rows = pd.DataFrame({"y": problem.values, "group": problem.group})
    between, within = anova_rows(*model_terms(rows, "y ~ C(group)", sums_to_zero=False), kind=1)
    return between.sum_of_squares / between.df / (within.sum_of_squares / within.df)


def by_statsmodels(problem: Certified) -> float:
    """F by statsmodels' formula and its table, of values less their median."""
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    data = pd.DataFrame({"y": problem.values - np.median(problem.values), "group": problem.group})
    return float(anova_lm(ols("y ~ C(group)", data).fit())["F"].iloc[0])


def digits(found: float, certified: float) -> float:
    """Correct digits, at most 15."""
    off = abs(found / certified - 1.0)
    return min(15.0, -np.log10(off)) if off > 0 else 15.0


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    print(f"{'':10}{'ours':>8}{'formula':>9}{'scipy':>8}{'statsmodels':>13}{'limit':>8}")
    for problem in map(read, FILES):
        values = (ours(problem)[0], by_formula(problem), by_scipy(problem), by_statsmodels(problem))
        cells = [max(0.0, digits(value, problem.certified[0])) for value in (*values, exact(problem)[0])]
        widths = zip(cells, (8, 9, 8, 13, 8), strict=True)
        print(f"{problem.name:10}" + "".join(f"{cell:{width}.1f}" for cell, width in widths), flush=True)


if __name__ == "__main__":
    main()
