"""compare_strategies: calibration strategies on a measured log, and Comparison, its result.

Order: `evaluation`, then `statistics` over the sessions that all strategies can calibrate, and there
over the traverses from which none calibrates. `save_comparison` writes all tables as CSV and Parquet.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._io import write_atomically
from stickslip_fit._summary import Summarized
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.estimation.result import AxesArray, Provenance, build_provenance
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine
from stickslip_fit.strategies.base import SessionSelector, Strategy, handling_seconds, other_sessions
from stickslip_fit.strategies.evaluation import (
    POSITION_COLUMNS,
    EvaluationCase,
    EvaluationTables,
    evaluate_strategies,
    make_cases,
)
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
    """What `compare` returns; SI.

    Attributes
    ----------
    strategies : tuple of str
        Their names, in the order given.
    errors : DataFrame
        See `trials.Outcomes`, with the errors absolute and relative, and shared: whether the traverse's
        session is one that all compared strategies share, and none of them calibrates from the traverse.
        Only those are summed up.
    costs : DataFrame
        strategy, session, joint, direction, traverses, steps, seconds (with what a traverse costs besides).
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    pairs : DataFrame
        See `paired.pair_up`, for each joint.
    bounds : DataFrame
        See `bound.bounds`, for each joint.
    repeatability : dict of (int, str) to float
        By joint and direction.
    handling_seconds : float
        Seconds that a traverse costs beside its steps.
    looks_back : str
        On which sessions a strategy may look back, in words.
    machine : Machine
    provenance : Provenance
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
    machine: Machine
    provenance: Provenance

    def plot_pareto(self) -> AxesArray:
        """Calibration time against held-out error, with the Cramer-Rao bound and the repeatability floor.

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
        """Joints of which there is anything to compare."""
        return tuple(int(joint) for joint in sorted(self.shared["joint"].unique()))

    @property
    def shared(self) -> pd.DataFrame:
        """The errors that are summed up."""
        return self.errors[self.errors["shared"]]

    def compared(self, joint: int) -> tuple[str, ...]:
        """Strategies compared on a joint: those that suit at least one of its sessions."""
        there = set(self.errors.loc[self.errors["joint"] == joint, "strategy"])
        return tuple(name for name in self.strategies if name in there)

    def sessions(self, joint: int) -> tuple[str, ...]:
        """Sessions that all compared strategies share."""
        return tuple(self.shared.loc[self.shared["joint"] == joint, "session"].unique())

    def unit(self, joint: int) -> tuple[str, ...]:
        """What intervals are over: sessions, or configurations where there is only one."""
        return SESSION_UNIT if len(self.sessions(joint)) > 1 else CONFIGURATION_UNIT

    def accuracy(self, *by: str) -> pd.DataFrame:
        """Errors summed up by joint and strategy, and by further columns.

        Parameters
        ----------
        *by : str
            None, ``"direction"``, or also the columns of a configuration, ``*WHERE``.

        Returns
        -------
        DataFrame
            See `accuracy.summarise`.
        """
        if by not in self._summed_up:
            parts = [
                summarize_errors(subset, ["joint", "strategy", *by], self.unit(int(joint)))
                for joint, subset in self.shared.groupby("joint")
            ]
            self._summed_up[by] = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
        return self._summed_up[by].copy()

    @cached_property
    def _summed_up(self) -> dict[tuple[str, ...], pd.DataFrame]:
        """What `accuracy` has worked out; a page asks for the same table a dozen times."""
        return {}

    def cost(self) -> pd.DataFrame:
        """joint, strategy, traverses (each way) and seconds (both ways) of a shared session, on average."""
        parts = []
        for joint in self.joints:
            subset = self.costs[
                (self.costs["joint"] == joint) & self.costs["session"].isin(self.sessions(joint))
            ]
            each = subset.groupby("strategy", sort=False)
            seconds = each["seconds"].sum() / len(self.sessions(joint))
            table = pd.DataFrame({"traverses": each["traverses"].mean(), "seconds": seconds})
            parts.append(table.reset_index().assign(joint=joint))
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


ALL_STRATEGIES = ""  # in place of a strategy, where something is said of all
NO_SHARED_TRAVERSE = "no traverse is left that none of the strategies calibrates from"
EXTRA_BOUND_TRAVERSES = 4  # traverses by which the bound goes on after the most that a strategy makes


def compare_strategies(
    log: Log,
    strategies: Sequence[Strategy],
    *,
    session_selector: SessionSelector = other_sessions,
    command: str = "",
) -> Comparison:
    """Let each strategy calibrate every session of a log from its own traverses, and predict all others.

    Only the first traverse of a configuration is there to be chosen, and its count is not known when it is.
    Errors are summed up over the sessions that all strategies can calibrate, and there over the traverses
    that none calibrates from, so that all are judged by the same. A strategy that suits no session of a joint
    takes no part in that joint's comparison.

    Parameters
    ----------
    log : Log
    strategies : sequence of Strategy
    at_hand : callable, optional
        On which sessions a session may look back; `earlier_sessions` as on the day.
    command : str, optional
        Kept in the comparison's provenance.

    Raises
    ------
    InputError
        If two strategies have one name, no traverse of the log is usable, a strategy chooses what is not
        offered, or nothing shows how well a traverse repeats.
    """
    names = [strategy.name for strategy in strategies]
    if len(set(names)) < len(names) or not names:
        raise InputError(f"strategies need names that differ, and there must be one; these are {names}")
    trials = list(make_cases(log, session_selector))
    handling = handling_seconds(log.rows)
    found = evaluate_strategies(trials, strategies)
    errors = add_errors(_mark_shared(found))
    spent = found.costs.assign(seconds=found.costs["seconds"] + handling * found.costs["traverses"])
    left_out = pd.concat([found.left_out, _list_empty_sessions(found, errors)], ignore_index=True)
    return Comparison(
        tuple(names), errors, spent, left_out, _compare_joint_pairs(errors), _compute_joint_bounds(trials, errors, spent, handling),
        {(trial.task.law.joint, trial.task.direction): trial.task.repeatability for trial in trials},
        handling, session_selector.__name__.replace("_", " "), log.machine, build_provenance(log, command),
    )  # fmt: skip


def find_shared_sessions(found: EvaluationTables) -> set[tuple[int, str]]:
    """Joints and sessions that every strategy compared there can calibrate, in each direction driven."""
    tried = pd.concat([found.costs, found.left_out])
    suited = {(row.strategy, row.joint) for row in found.costs.itertuples()}
    out = {
        (row.joint, row.session) for row in found.left_out.itertuples() if (row.strategy, row.joint) in suited
    }
    return {(row.joint, row.session) for row in tried.itertuples() if (row.joint, row.session) not in out}


def _mark_shared(found: EvaluationTables) -> pd.DataFrame:
    errors = found.errors
    compared = errors.groupby("joint")["strategy"].nunique()
    everywhere = errors.groupby("traverse")["strategy"].transform("nunique") == errors["joint"].map(compared)
    kept = find_shared_sessions(found)
    shared = [
        (joint, session) in kept for joint, session in zip(errors["joint"], errors["session"], strict=True)
    ]
    return errors.assign(shared=everywhere.to_numpy(bool) & np.array(shared, dtype=bool))


def _list_empty_sessions(found: EvaluationTables, errors: pd.DataFrame) -> pd.DataFrame:
    there = set(zip(errors["joint"][errors["shared"]], errors["session"][errors["shared"]], strict=True))
    suited = set(zip(found.costs["joint"], found.costs["session"], strict=True))
    lost = sorted((find_shared_sessions(found) & suited) - there)
    rows = [(ALL_STRATEGIES, session, joint, "", NO_SHARED_TRAVERSE) for joint, session in lost]
    return pd.DataFrame(rows, columns=found.left_out.columns)


def _compare_joint_pairs(errors: pd.DataFrame) -> pd.DataFrame:
    parts = []
    for joint, subset in errors[errors["shared"]].groupby("joint"):
        unit = SESSION_UNIT if subset["session"].nunique() > 1 else CONFIGURATION_UNIT
        parts.append(compare_pairs(subset, unit).assign(joint=joint))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def _compute_joint_bounds(
    trials: Sequence[EvaluationCase], errors: pd.DataFrame, spent: pd.DataFrame, handling: float
) -> pd.DataFrame:
    parts = []
    for joint, subset in errors[errors["shared"]].groupby("joint"):
        most = int(spent.loc[spent["joint"] == joint, "traverses"].max()) + EXTRA_BOUND_TRAVERSES
        own = [
            trial
            for trial in trials
            if trial.task.law.joint == joint and trial.task.session in set(subset["session"])
        ]
        parts.append(compute_bounds(own, subset["traverse"].unique(), most, handling).assign(joint=joint))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


DECIMALS = 6  # of degrees and mm: finer than anything that can be set
ANGLE_COLUMNS = ("q1", "q2", "theta", "psi")
STEP_SIZE_COLUMNS = (
    "measured",
    "predicted",
    "absolute",
    "rms",
    "bias",
    "worst",
    "typical_worst",
    "difference",
    "floor",
)
RELATIVE_SUFFIX = "_relative"


def make_tables(found: Comparison) -> dict[str, pd.DataFrame]:
    """All tables of a comparison by name, SI."""
    cost = found.cost()
    return {
        "errors": found.errors,
        "spent": found.costs,
        "left_out": found.left_out,
        "accuracy": found.accuracy().merge(cost, on=["joint", "strategy"], suffixes=("", "_made"))
        if len(cost)
        else cost,
        "accuracy_by_direction": found.accuracy("direction"),
        "accuracy_by_configuration": found.accuracy("direction", *POSITION_COLUMNS),
        "pairs": found.pairs,
        "bounds": found.bounds,
    }


def save_comparison(found: Comparison, folder: str | Path) -> list[Path]:
    """Write each table as CSV and as Parquet; the folder is made where it is not there.

    Angles are in deg, positions in mm, step sizes and their errors in what the column unit says, relative
    numbers in %, under names that end so.

    Raises
    ------
    InputError
        If the folder cannot be made or written to.
    """
    folder = Path(folder)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(
            InputIssue(f"cannot be made ({error.strerror}); name a folder in an existing one", str(folder))
        ) from None
    written = []
    for name, table in make_tables(found).items():
        shown, stream = convert_units(table), io.BytesIO()
        shown.to_parquet(stream, index=False)
        for suffix, content in ((".csv", shown.to_csv(index=False)), (".parquet", stream.getvalue())):
            written.append(folder / f"{name}{suffix}")
            write_atomically(written[-1], content)
    return written


def convert_units(table: pd.DataFrame) -> pd.DataFrame:
    """A table with its units in names and, for step sizes, in a column of its own."""
    if "joint" not in table:
        return table
    prismatic = (table["joint"] == PRISMATIC).to_numpy()
    scale = np.where(prismatic, to_si(1.0, "nm"), to_si(1.0, "µrad"))
    columns: dict[str, object] = {}
    for name in table:
        if name in ("start", "stop"):
            end, values = {"start": "from", "stop": "to"}[name], table[name].to_numpy()
            columns[f"{end}_deg"] = np.where(prismatic, np.nan, _to_degrees(values))
            columns[f"{end}_mm"] = np.where(prismatic, _to_millimetres(values), np.nan)
        elif name in ANGLE_COLUMNS:
            columns[f"{name}_deg"] = _to_degrees(table[name].to_numpy())
        elif name == "q3":
            columns["q3_mm"] = _to_millimetres(table[name].to_numpy())
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


def _to_degrees(values: Array) -> Array:
    return np.degrees(values).round(DECIMALS) + 0.0


def _to_millimetres(values: Array) -> Array:
    return (values / to_si(1.0, "mm")).round(DECIMALS) + 0.0
