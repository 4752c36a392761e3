"""compare_strategies: calibration strategies on a measured log, and Comparison, its result.

Order: `evaluation`, then `statistics` over the sessions that all strategies can calibrate, and there
over the traverses from which none calibrates. `save_comparison` writes all tables as CSV and Parquet.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._io import find_source, make_folder, write_atomically
from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._summary import Summarized
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, check_type
from stickslip_fit.estimation.result import AxesArray, Provenance, build_provenance
from stickslip_fit.laws import Laws, is_published
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine
from stickslip_fit.strategies.base import SessionSelector, Strategy, handling_seconds, other_sessions
from stickslip_fit.strategies.evaluation import (
    POSITION_COLUMNS,
    EvaluationTables,
    evaluate_strategies,
    make_cases,
)
from stickslip_fit.strategies.library import default_strategies
from stickslip_fit.strategies.statistics import (
    CONFIGURATION_UNIT,
    SESSION_UNIT,
    add_errors,
    compare_pairs,
    compute_bounds,
    summarize_errors,
)
from stickslip_fit.units import PRISMATIC, to_si


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Summarized):
    """What `compare_strategies` returns; SI.

    Attributes
    ----------
    strategies : tuple of str
        Their names, in the order given.
    errors : DataFrame
        See `EvaluationTables`, with absolute and relative errors, and shared: True for a held-out traverse
        of every strategy, in a session that all of them can calibrate. The statistics are of those only.
    costs : DataFrame
        strategy, session, joint, direction, traverses, steps, seconds (handling included).
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    pairs, bounds : DataFrame
        See `compare_pairs` and `compute_bounds`, for each joint.
    repeatability : dict of (int, str) to float
        By joint and direction.
    handling_seconds : float
        Seconds that a traverse costs beside its steps.
    session_scope : str
        Which sessions a strategy may use besides the one that it calibrates, in words.
    published_joints : tuple of int
        Joints with their published law, of which the thesis makes its claims.
    """

    strategies: tuple[str, ...]
    errors: pd.DataFrame
    costs: pd.DataFrame
    left_out: pd.DataFrame
    pairs: pd.DataFrame
    bounds: pd.DataFrame
    repeatability: dict[tuple[int, str], float]
    handling_seconds: float
    session_scope: str
    published_joints: tuple[int, ...]
    machine: Machine
    provenance: Provenance

    def plot_pareto(self) -> AxesArray:
        """Calibration time against held-out error, with the Cramer-Rao bound and the replicate scatter.

        Raises
        ------
        InputError
            If no session is shared.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.strategies import plot_pareto

        return collect_axes(plot_pareto(self))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints with shared errors."""
        return tuple(int(joint) for joint in sorted(self.shared["joint"].unique()))

    @cached_property
    def shared(self) -> pd.DataFrame:
        """The errors that the statistics are of."""
        return self.errors[self.errors["shared"]]

    def compared(self, joint: int) -> tuple[str, ...]:
        """Strategies that can calibrate at least one session of a joint."""
        present = set(self.errors.loc[self.errors["joint"] == joint, "strategy"])
        return tuple(name for name in self.strategies if name in present)

    def sessions(self, joint: int) -> tuple[str, ...]:
        """Sessions that all compared strategies share."""
        return self._sessions.get(joint, ())

    @cached_property
    def _sessions(self) -> dict[int, tuple[str, ...]]:
        by_joint = self.shared.groupby("joint")["session"]
        return {int(joint): tuple(names.unique()) for joint, names in by_joint}

    def unit(self, joint: int) -> tuple[str, ...]:
        """The sampling unit of intervals: sessions, or configurations where there is only one session."""
        return SESSION_UNIT if len(self.sessions(joint)) > 1 else CONFIGURATION_UNIT

    def accuracy(self, *by: str) -> pd.DataFrame:
        """Statistics of the errors by joint and strategy, and by further columns.

        Parameters
        ----------
        *by : str
            None, ``"direction"``, or also the columns of a configuration, ``*POSITION_COLUMNS``.

        Returns
        -------
        DataFrame
            See `summarize_errors`.
        """
        if by not in self._accuracy_tables:
            self._accuracy_tables[by] = _concatenate(
                summarize_errors(subset, ["joint", "strategy", *by], self.unit(int(joint)))
                for joint, subset in self.shared.groupby("joint")
            )
        return self._accuracy_tables[by].copy()

    @cached_property
    def _accuracy_tables(self) -> dict[tuple[str, ...], pd.DataFrame]:
        """Tables that `accuracy` has computed; a report asks for the same one a dozen times."""
        return {}

    def accuracy_and_cost(self) -> pd.DataFrame:
        """`accuracy` and `cost` of each joint and strategy in one table; traverses_made is that of `cost`."""
        cost, keys = self.cost(), ["joint", "strategy"]
        return self.accuracy().merge(cost, on=keys, suffixes=("", "_made")) if len(cost) else cost

    def cost(self) -> pd.DataFrame:
        """joint, strategy, traverses (each way) and seconds (both ways) of a shared session, on average."""
        return self._cost.copy()

    @cached_property
    def _cost(self) -> pd.DataFrame:
        parts = []
        for joint in self.joints:
            subset = self.costs[
                (self.costs["joint"] == joint) & self.costs["session"].isin(self.sessions(joint))
            ]
            by_strategy = subset.groupby("strategy", sort=False)
            seconds = by_strategy["seconds"].sum() / len(self.sessions(joint))
            table = pd.DataFrame({"traverses": by_strategy["traverses"].mean(), "seconds": seconds})
            parts.append(table.reset_index().assign(joint=joint))
        return _concatenate(parts)


EVALUATION_SHARE = 0.7  # of the time
ALL_STRATEGIES = ""  # in place of a strategy's name, for a reason that holds for all
NO_SHARED_TRAVERSE = "no traverse is left that none of the strategies calibrates from"
EXTRA_BOUND_TRAVERSES = 4  # traverses by which the bound goes on after the most that a strategy makes


def compare_strategies(
    log: Log,
    strategies: Sequence[Strategy] | None = None,
    *,
    laws: Laws | None = None,
    session_selector: SessionSelector = other_sessions,
    command: str = "",
    progress: ProgressCallback = ignore_progress,
) -> Comparison:
    """Calibrate every session of a log by each strategy, and predict the session's other traverses.

    A strategy chooses among the first traverses of each configuration, before it knows their counts.
    Errors are compared over the sessions that all strategies can calibrate, and there over the traverses
    that none calibrates from. A strategy that can calibrate no session of a joint takes no part in that
    joint's comparison.

    Parameters
    ----------
    strategies : sequence of Strategy, optional
        By default those of `default_strategies`.
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    session_selector : callable, optional
        Which other sessions a session's calibration may use; `earlier_sessions` as on the day.
    command : str, optional
        Kept in the comparison's provenance.
    progress : callable, optional
        Called with each step that begins and the share of the work that is done.

    Raises
    ------
    InputError
        If two strategies have one name, no traverse of the log is usable, a strategy chooses what is not
        offered, or nothing shows how well a traverse repeats.
    """
    check_type("log", log, Log)
    log.machine.require_geometry("a comparison of calibration strategies")
    strategies = default_strategies() if strategies is None else strategies
    names = [strategy.name for strategy in strategies]
    if len(set(names)) < len(names) or not names:
        raise InputError(f"strategies need names that differ, and there must be one; these are {names}")
    cases = list(make_cases(log, session_selector, laws))
    handling_time = handling_seconds(log.rows)
    tables = evaluate_strategies(
        cases, strategies, progress=lambda step, done: progress(step, EVALUATION_SHARE * done)
    )
    progress("comparing the strategies", EVALUATION_SHARE)
    sessions = find_shared_sessions(tables)
    errors = add_errors(_mark_shared(tables.errors, sessions))
    costs = tables.costs.assign(seconds=tables.costs["seconds"] + handling_time * tables.costs["traverses"])
    shared = errors[errors["shared"]]
    empty = sessions & _joint_sessions(costs) - _joint_sessions(shared)
    rows = [(ALL_STRATEGIES, session, joint, "", NO_SHARED_TRAVERSE) for joint, session in sorted(empty)]
    reasons = pd.DataFrame(rows, columns=tables.left_out.columns)
    left_out = pd.concat([tables.left_out, reasons], ignore_index=True)
    pairs, bounds = [], []
    for joint, subset in shared.groupby("joint"):
        own_sessions = set(subset["session"])
        unit = SESSION_UNIT if len(own_sessions) > 1 else CONFIGURATION_UNIT
        pairs.append(compare_pairs(subset, unit).assign(joint=joint))
        own = [case for case in cases if case.task.law.joint == joint and case.task.session in own_sessions]
        max_traverses = int(costs.loc[costs["joint"] == joint, "traverses"].max()) + EXTRA_BOUND_TRAVERSES
        limit = compute_bounds(own, subset["traverse"].unique(), max_traverses, handling_time)
        bounds.append(limit.assign(joint=joint))
    return Comparison(
        strategies=tuple(names),
        errors=errors,
        costs=costs,
        left_out=left_out,
        pairs=_concatenate(pairs),
        bounds=_concatenate(bounds),
        repeatability={(case.task.law.joint, case.task.direction): case.task.repeatability for case in cases},
        handling_seconds=handling_time,
        session_scope=session_selector.__name__.replace("_", " "),
        published_joints=tuple(sorted({c.task.law.joint for c in cases if is_published(c.task.law)})),
        machine=log.machine,
        provenance=build_provenance(log, command),
    )


def find_shared_sessions(tables: EvaluationTables) -> set[tuple[int, str]]:
    """Joints and sessions that every strategy compared there can calibrate, in each direction driven."""
    costs, left_out = tables.costs, tables.left_out
    applicable = set(zip(costs["strategy"], costs["joint"], strict=True))
    pairs = zip(left_out["strategy"], left_out["joint"], strict=True)
    excluded = left_out[np.array([pair in applicable for pair in pairs], dtype=bool)]
    return (_joint_sessions(costs) | _joint_sessions(left_out)) - _joint_sessions(excluded)


def _joint_sessions(table: pd.DataFrame) -> set[tuple[int, str]]:
    return set(zip(table["joint"], table["session"], strict=True))


def _mark_shared(errors: pd.DataFrame, sessions: set[tuple[int, str]]) -> pd.DataFrame:
    compared = errors.groupby("joint")["strategy"].nunique()
    in_all = errors.groupby("traverse")["strategy"].transform("nunique") == errors["joint"].map(compared)
    shared = [pair in sessions for pair in zip(errors["joint"], errors["session"], strict=True)]
    return errors.assign(shared=in_all.to_numpy(bool) & np.array(shared, dtype=bool))


def _concatenate(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    parts = list(tables)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


DECIMALS = 6  # of degrees and mm: finer than anything that can be set
ANGLE_COLUMNS = ("q1", "q2", "theta", "psi")
STEP_SIZE_COLUMNS = {
    *("measured", "predicted", "absolute", "rms", "bias", "worst", "typical_worst", "difference", "floor")
}
RELATIVE_SUFFIX = "_relative"


def make_tables(comparison: Comparison) -> dict[str, pd.DataFrame]:
    """All tables of a comparison by name, SI."""
    return {
        "errors": comparison.errors,
        "spent": comparison.costs,
        "left_out": comparison.left_out,
        "accuracy": comparison.accuracy_and_cost(),
        "accuracy_by_direction": comparison.accuracy("direction"),
        "accuracy_by_configuration": comparison.accuracy("direction", *POSITION_COLUMNS),
        "pairs": comparison.pairs,
        "bounds": comparison.bounds,
    }


def save_comparison(comparison: Comparison, folder: str | Path) -> list[Path]:
    """Write each table as CSV and as Parquet; the folder is made if it does not exist.

    Angles are in deg, positions in mm, step sizes and their errors in the unit of the column ``unit``,
    relative numbers in %, in columns that end in ``_pct``.

    Raises
    ------
    InputError
        If the folder cannot be made or written to.
    """
    tables = {name: convert_units(table) for name, table in make_tables(comparison).items()}
    return save_tables(tables, folder, comparison.provenance.log_files)


def save_tables(
    tables: Mapping[str, pd.DataFrame], folder: str | Path, sources: Sequence[str] = ()
) -> list[Path]:
    """Write each table as CSV and as Parquet under its name; the folder is made if it does not exist.

    Raises
    ------
    InputError
        If the folder cannot be made or written to, or holds one of the sources under such a name; then
        nothing is written.
    """
    folder = Path(folder)
    make_folder(folder)
    paths = [folder / f"{name}{suffix}" for name in tables for suffix in (".csv", ".parquet")]
    if clashes := [clash for path in paths if (clash := find_source(path, sources))]:
        raise InputError(clashes)
    for name, table in tables.items():
        stream = io.BytesIO()
        table.to_parquet(stream, index=False)
        for suffix, content in ((".csv", table.to_csv(index=False)), (".parquet", stream.getvalue())):
            write_atomically(folder / f"{name}{suffix}", content, sources)
    return paths


def convert_units(table: pd.DataFrame) -> pd.DataFrame:
    """A table with its units in names and, for step sizes, in a column of its own."""
    if "joint" not in table:
        return table
    prismatic = (table["joint"] == PRISMATIC).to_numpy()
    scale = np.where(prismatic, to_si(1.0, "nm"), to_si(1.0, "µrad"))
    columns: dict[str, object] = {}

    def degrees(values: Array) -> Array:
        return np.degrees(values).round(DECIMALS) + 0.0

    def millimetres(values: Array) -> Array:
        return (values / to_si(1.0, "mm")).round(DECIMALS) + 0.0

    for name in table:
        if name in ("start", "stop"):
            end, values = {"start": "from", "stop": "to"}[name], table[name].to_numpy()
            columns[f"{end}_deg"] = np.where(prismatic, np.nan, degrees(values))
            columns[f"{end}_mm"] = np.where(prismatic, millimetres(values), np.nan)
        elif name in ANGLE_COLUMNS:
            columns[f"{name}_deg"] = degrees(table[name].to_numpy())
        elif name == "q3":
            columns["q3_mm"] = millimetres(table[name].to_numpy())
        elif name in ("relative", "sd"):
            columns[f"{name}_pct"] = 100 * table[name]
        elif RELATIVE_SUFFIX in name:
            columns[f"{name.replace(RELATIVE_SUFFIX, '')}_pct"] = 100 * table[name]
        elif name.removesuffix("_low").removesuffix("_high") in STEP_SIZE_COLUMNS:
            columns.setdefault("unit", np.where(prismatic, "nm", "µrad").astype(object))
            columns[name] = table[name] / scale
        else:
            columns[name] = table[name]
    return pd.DataFrame(columns).rename(columns={"absolute": "error", "relative_pct": "error_pct"})
