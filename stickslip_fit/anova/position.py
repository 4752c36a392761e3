"""analyze_positions: whether the step size differs along a joint's travel, and by day and direction.

All stretches of a joint are analysed together; factors are position, session, direction and configuration.
The response is log(step size), so that a profile is the same where it is the same in per cent. Sums of
squares are of type II. Sessions are a random factor: position, direction and their interaction are tested
against their own interaction with session, on means of cells; session, and position by session, against
replicates or, without these, the highest interaction (R. E. Kirk, Experimental Design, 2013, ch. 9 to 10).
A profile that changes from session to session changes alike in neighbouring stretches, for which
`box_epsilon` reduces degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
import pandas as pd

from stickslip_fit._format import coordinate_unit
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.anova.contrasts import indicator_columns, orthonormal_basis
from stickslip_fit.anova.designs import NotTestable, format_plain
from stickslip_fit.anova.term_test import (
    MAX_COLUMNS,
    NO_SCATTER,
    ErrorTerm,
    Term,
    TermTest,
    name_term,
    run_term_test,
)
from stickslip_fit.logs.schema import position_columns
from stickslip_fit.machine import Machine, load_machine

POSITION, DAY, DIRECTION, CONFIGURATION = "position", "day", "direction", "configuration"
FACTORS = (CONFIGURATION, DAY, DIRECTION, POSITION)
ASKED = ((POSITION,), (DAY, POSITION), (DIRECTION, POSITION))
REPLICATES, NEIGHBOURS, HIGHEST = "replicates", "traverses of one stretch", "highest interaction"
MAX_SHARE_OF_TRAVEL = 0.5  # a longer traverse averages over what is to be compared
MIN_REPEATED = 0.5  # share of the traverses whose ends are those of another session's
MAX_CLASSES, ROWS_PER_CELL = 8, 4  # of traverses with ends of their own
MIN_REPLICATE_DF = 6
P_INDEPENDENT = 0.3  # prior probability of errors that are independent from stretch to stretch
SMOOTH_SHARES = (0.3, 0.6, 0.8, 0.9, 0.97, 0.99)  # of the variance of the others
SHORTEST, N_LENGTHS = 0.5, 8  # correlation length, in stretches; the longest is twice the travel
QUANTILE = 0.1  # of Box's epsilon


@dataclass(frozen=True, eq=False)
class PositionAnalysis:
    """The analysis of one joint's stretches.

    Attributes
    ----------
    joint : int
    tests : tuple of TermTest
    stretches : tuple of str
        Names, from low to high.
    repeated : bool
        Whether these are the ends of the traverses; else they are classes of the traverses' middles.
    rows : DataFrame
        Observations that are used, as of `name_stretches`.
    n_left_out : int
        Traverses of the joint that say nothing of position.
    machine : Machine
    """

    joint: int
    tests: tuple[TermTest, ...]
    stretches: tuple[str, ...]
    repeated: bool
    rows: pd.DataFrame = field(repr=False)
    n_left_out: int
    machine: Machine = field(default_factory=load_machine)


def analyze_positions(
    rows: pd.DataFrame, machine: Machine
) -> tuple[PositionAnalysis | None, list[NotTestable]]:
    """The analysis of one joint's observations, and the tests that cannot be made.

    Parameters
    ----------
    rows : DataFrame
        See `step_size_observations`.
    """
    joint, named = int(rows["joint"].iloc[0]), name_stretches(rows, machine)
    classed = bool(named["classed"].any())
    used = named[named[POSITION].notna()]
    # A configuration that was driven over one stretch compares no positions.
    used = used[used.groupby("setting")[POSITION].transform("nunique") > 1]
    if used[POSITION].nunique() < 2:
        return None, [refuse(joint, POSITION, _explain_few(named))]
    model = PositionModel(used, classed)
    if model.n_columns > MAX_COLUMNS:
        used = used[used["setting"] == used["setting"].value_counts().index[0]]
        model = PositionModel(used, classed)
    if model.n_columns > MAX_COLUMNS:
        return None, [
            refuse(joint, POSITION, "too many stretches and sessions at once; select fewer by date")
        ]
    results = {term: model.test(term) for term in ASKED if set(term) <= set(model.factors)}
    tests = tuple(result for result in results.values() if isinstance(result, TermTest))
    if isinstance(results[(POSITION,)], str) and not tests:
        return None, [refuse(joint, POSITION, _explain_confounded(named))]
    refused = [refuse(joint, name_term(term), r) for term, r in results.items() if isinstance(r, str)]
    ordered = tuple(used.sort_values("middle")[POSITION].unique())
    n_left_out = len(rows) - len(used)
    return PositionAnalysis(joint, tests, ordered, not classed, used, n_left_out, machine), refused


def refuse(joint: int, analysis: str, reason: str) -> NotTestable:
    """What cannot be tested of a joint, and why."""
    return NotTestable(analysis, joint, None, None, None, reason)


def _explain_few(named: pd.DataFrame) -> str:
    if named[POSITION].nunique() < 2:
        return "no two stretches of its travel were driven often enough: drive some, one beside the other"
    return "no configuration of the other joints was driven over two stretches: repeat one over several"


def _explain_confounded(named: pd.DataFrame) -> str:
    if named["setting"].nunique() > 1:
        return (
            "the configuration of the other joints changes with the stretch: drive the same stretches at one "
            "configuration, or ask diagnose, whose law takes the load out"
        )
    return "stretches change with the session: drive the same ones in each session"


def name_stretches(rows: pd.DataFrame, machine: Machine) -> pd.DataFrame:
    """A joint's observations with position, middle, setting and classed.

    The position is the name of a traverse's stretch: its ends, where most traverses share them with another
    session's (with another traverse, in a log of one session), else a class of its middle, and `classed` is
    true. It is None for a traverse of half of the travel or more and, among repeated ends, for one that is
    not repeated. The setting is a label of all other positions.
    """
    joint = int(rows["joint"].iloc[0])
    others = [name for name in position_columns(rows) if name != f"q{joint}"]
    setting = rows.groupby(others, dropna=False, sort=False).ngroup().astype(str)
    rows = rows.assign(middle=(rows["low"] + rows["high"]) / 2, setting="c" + setting)
    travel = float(rows["high"].max() - rows["low"].min())
    short = rows[rows["high"] - rows["low"] < MAX_SHARE_OF_TRAVEL * travel]
    ends = short.groupby(["low", "high"])["session"]
    several = short["session"].nunique() > 1
    again = (ends.transform("nunique") if several else ends.transform("size")) > 1
    repeated = len(short) > 0 and bool(again.mean() >= MIN_REPEATED)
    short = short[again] if repeated else short
    bounds = short[["low", "high"]].to_numpy(float) if repeated else _class_bounds(short, travel)
    unit = coordinate_unit(f"q{joint}", machine)
    names = [f"{format_plain(low, unit, 1)} to {format_plain(high, unit, 1)} {unit}" for low, high in bounds]
    position = pd.Series(names, index=short.index, dtype=object).reindex(rows.index)
    return rows.assign(position=position.where(position.notna(), None), classed=not repeated)


def _class_bounds(short: pd.DataFrame, travel: float) -> Array:
    """Lowest and highest middle of each row's class, shape (n, 2); classes have about as many rows each."""
    if short.empty:
        return np.zeros((0, 2))
    n_cells = short.groupby(["session", "direction"]).ngroups
    length = float((short["high"] - short["low"]).median())
    number = max(1, int(min(MAX_CLASSES, travel / length, len(short) / (ROWS_PER_CELL * n_cells))))
    classes = np.ceil(short["middle"].rank(method="max", pct=True) * number)
    by_class = short["middle"].groupby(classes)
    return np.column_stack([by_class.transform("min"), by_class.transform("max")])


def _slope_columns(rows: pd.DataFrame) -> Array:
    """The slope of each class by direction, shape (n, q); none where too few traverses share a cell."""
    aside = rows["middle"] - rows.groupby(POSITION)["middle"].transform("mean")
    columns = _indicators(rows, (POSITION, DIRECTION)) * aside.to_numpy()[:, None]
    within = _within_cells(rows, columns)
    columns = columns[:, np.sum(within**2, axis=0) > NO_SCATTER * np.sum(aside**2)]
    df = len(rows) - rows.groupby([*FACTORS]).ngroups - columns.shape[1]
    return columns if df >= MIN_REPLICATE_DF else np.zeros((len(rows), 0))


def _within_cells(rows: pd.DataFrame, columns: Array) -> Array:
    """Columns, shape (n, q), less their mean in each combination of all factors."""
    cells = _indicators(rows, FACTORS)
    return np.asarray(columns - cells @ ((cells.T @ columns) / cells.sum(axis=0)[:, None]))


def _indicators(table: pd.DataFrame, term: Term) -> Array:
    return indicator_columns(_number_cells(table, term))


def _number_cells(table: pd.DataFrame, term: Sequence[str]) -> IntArray:
    """The combination of the factors in each row, counted from 0, shape (n,)."""
    code = np.zeros(len(table), dtype=np.intp)
    for name in term:
        factor = table[name].to_numpy()
        code = code * (factor.max() + 1) + factor
    return np.unique(code, return_inverse=True)[1]


class PositionModel:
    """The terms of one joint's model, on single observations and on means of cells.

    Parameters
    ----------
    rows : DataFrame
        Observations with position, middle and setting.
    classed : bool
        Whether a position is a class of middles. The mean slope within each class and direction is then taken
        out, so that it does not matter where in their class a session's traverses happen to lie.
    """

    def __init__(self, rows: pd.DataFrame, classed: bool) -> None:
        y = np.log(rows["step_size"])
        columns = {CONFIGURATION: "setting", DAY: "session", DIRECTION: "direction", POSITION: POSITION}
        coded = {
            name: np.unique(rows[column].to_numpy(object), return_inverse=True)
            for name, column in columns.items()
        }
        self.levels = {name: tuple(map(str, names)) for name, (names, _) in coded.items()}
        codes = {name: code for name, (_, code) in coded.items()}
        rows = pd.DataFrame({**codes, "middle": rows["middle"].to_numpy(), "y": (y - y.median()).to_numpy()})
        self.classed = classed
        self.factors = [name for name in FACTORS if len(self.levels[name]) > 1]
        self.rows = rows
        self.slopes = _slope_columns(rows) if classed else np.zeros((len(rows), 0))

    @cached_property
    def terms(self) -> list[Term]:
        """Main effects, all interactions of two, and of three with direction, as laws have them."""
        terms = [term for size in (1, 2) for term in combinations(self.factors, size)]
        triples = [term for term in combinations(self.factors, 3) if DIRECTION in term]
        return [*terms, *triples]

    @cached_property
    def cells(self) -> pd.DataFrame:
        """Mean of each combination of all factors, slopes taken out as they are within them."""
        slopes = np.linalg.lstsq(_within_cells(self.rows, self.slopes), self.rows["y"], rcond=1e-9)[0]
        level = self.rows.assign(y=self.rows["y"] - self.slopes @ slopes)
        return level.groupby([*FACTORS], sort=False, as_index=False)[["y", "middle"]].mean()

    @property
    def n_columns(self) -> int:
        """Columns of the largest design matrix."""
        return sum(int(_number_cells(self.rows, term).max()) + 1 for term in self.terms)

    @property
    def replicate_df(self) -> int:
        """Of the scatter within cells."""
        return len(self.rows) - len(self.cells) - self.slopes.shape[1]

    def _span(self, table: pd.DataFrame, terms: Sequence[Term]) -> Array:
        """Orthonormal basis of the general mean, the slopes and some terms, shape (n, q)."""
        columns = [np.ones((len(table), 1)), *(_indicators(table, term) for term in terms)]
        if table is self.rows:
            columns.append(self.slopes)
        return orthonormal_basis(np.hstack(columns), np.zeros((len(table), 0)))

    def _bases(self, table: pd.DataFrame, term: Term) -> tuple[Array, Array]:
        """Bases of all terms that do not contain `term`, and of `term` beside them (type II)."""
        others = self._span(table, [other for other in self.terms if not set(term) <= set(other)])
        return others, orthonormal_basis(_indicators(table, term), others)

    def _residual(self) -> ErrorTerm:
        """What replicates scatter, or the highest interaction."""
        y = self.rows["y"].to_numpy()
        if self.replicate_df >= MIN_REPLICATE_DF:
            columns = _within_cells(self.rows, np.column_stack([y, self.slopes]))
            slopes = np.linalg.lstsq(columns[:, 1:], columns[:, 0], rcond=1e-9)[0]
            name = NEIGHBOURS if self.classed else REPLICATES
            return ErrorTerm(columns[:, 0] - columns[:, 1:] @ slopes, self.replicate_df, name)
        model = self._span(self.rows, [term for term in self.terms if not self._is_highest(term)])
        return ErrorTerm(y - model @ (model.T @ y), len(y) - model.shape[1], HIGHEST)

    def _is_highest(self, term: Term) -> bool:
        return len(term) == len(self.factors)

    def _interaction(self, term: Term) -> ErrorTerm:
        """The part of the cells' means that an interaction with session explains."""
        basis, y = self._bases(self.cells, term)[1], self.cells["y"].to_numpy()
        return ErrorTerm(basis @ (basis.T @ y), basis.shape[1], name_term(term))

    def test(self, term: Term) -> TermTest | str:
        """The test of one term, or why the design does not allow it."""
        over_sessions = DAY in self.factors and DAY not in term
        table = self.cells if over_sessions else self.rows
        with_session = tuple(name for name in FACTORS if name in (*term, DAY))
        error = self._interaction(with_session) if over_sessions else self._residual()
        others, effect = self._bases(table, term)
        if not effect.shape[1]:
            return "it changes together with other factors: repeat stretches in another session"
        if error.df < 1 or (error.name == HIGHEST and self._is_highest(term)):
            return "nothing to compare it with: repeat stretches, in this session and in others"
        if np.sqrt(error.mean_square) <= NO_SCATTER:
            return f"{error.name}: no scatter at all, so that nothing can be compared with it"
        epsilon = 1.0
        if POSITION in term and error.name not in (REPLICATES, NEIGHBOURS):
            runs = _runs(error.values, table)
            epsilon = box_epsilon(runs, error.df / (runs.shape[1] - 1))
        return run_term_test(
            term,
            table["y"].to_numpy(),
            (others, effect),
            error,
            codes=table[term[0]].to_numpy() if len(term) == 1 else None,
            levels=self.levels[term[0]] if len(term) == 1 else (),
            epsilon=epsilon,
        )


def _runs(error: Array, table: pd.DataFrame) -> Array:
    """Errors by stretch, from low to high, by the other factors; NaN where there is none."""
    order = table.groupby(POSITION)["middle"].mean().rank().astype(int)
    places, place = np.unique(order.loc[table[POSITION]], return_inverse=True)
    number = _number_cells(table, [name for name in FACTORS if name != POSITION])
    shape, cell = (int(number.max()) + 1, len(places)), number * len(places) + place
    sums, counts = (np.bincount(cell, weight, np.prod(shape)).reshape(shape) for weight in (error, None))
    return np.divide(sums, counts, out=np.full(shape, np.nan), where=counts > 0)


def box_epsilon(errors: Array, n_runs: float) -> float:
    """A lower limit of Box's epsilon, between 1 / (p - 1) and 1.

    Of p - 1 degrees of freedom along the travel it is the share that F tests have left under the covariance
    of errors from stretch to stretch (Ann. Math. Stat. 25:484, 1954). A few sessions say little of that: each
    of a grid, part independent and part smooth, counts by its restricted likelihood, and epsilon is a low
    quantile. With the likeliest, tests of sessions that have profiles of their own reject twice as often as
    they say: where errors happen to be small, they look independent, too.

    Parameters
    ----------
    errors : array, shape (m, p)
        Of p stretches in their order along the travel, by session and so on; NaN where unknown.
    n_runs : float
        How many runs along the travel are independent: the errors' degrees of freedom over p - 1.
    """
    p = errors.shape[1]
    if p < 3:
        return 1.0
    known = np.isfinite(errors)
    filled = np.where(known, errors, 0.0)
    covariance = filled.T @ filled / np.maximum(known.T.astype(float) @ known, 1.0)
    variances, squares = _covariances(covariance)
    deviance = np.log(variances).sum(axis=1) + (p - 1) * np.log(np.mean(squares / variances, axis=1))
    log_likelihood = -0.5 * n_runs * deviance
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight[0] *= P_INDEPENDENT
    weight[1:] *= (1.0 - P_INDEPENDENT) / (len(weight) - 1)
    epsilon = variances.sum(axis=1) ** 2 / ((p - 1) * np.sum(variances**2, axis=1))
    order = np.argsort(epsilon)
    share = np.cumsum(weight[order]) / weight.sum()
    return float(epsilon[order][np.searchsorted(share, QUANTILE)])


def _covariances(measured: Array) -> tuple[Array, Array]:
    """Eigenvalues of each covariance of the grid, and mean squares of errors along its axes, (k, p - 1) each.

    The general mean is taken out; the first covariance is that of independent errors.
    """
    p = len(measured)
    contrasts = np.linalg.svd(np.ones((1, p)))[2][1:]
    measured = contrasts @ measured @ contrasts.T
    variances, squares = [np.ones(p - 1)], [np.full(p - 1, np.trace(measured) / (p - 1))]
    apart = np.abs(np.subtract.outer(np.arange(p), np.arange(p)))
    for length in np.geomspace(SHORTEST, 2.0 * p, N_LENGTHS):
        for correlation in (np.exp(-apart / length), np.exp(-0.5 * (apart / length) ** 2)):
            smooth, axes = np.linalg.eigh(contrasts @ correlation @ contrasts.T)
            smooth = np.maximum(smooth, 0.0) / np.mean(smooth)
            along = np.maximum(np.sum(axes * (measured @ axes), axis=0), 0.0)
            for share in SMOOTH_SHARES:
                variances.append(share * smooth + (1.0 - share))
                squares.append(along)
    return np.array(variances), np.array(squares)
