"""Designs of the tests: which observations are compared, between which levels, against which error.

Day and direction (thesis Sections 4.2 and 5.2) and normal force (4.4). Direction and normal force are tested
over all sessions, with sessions as blocks, and within each. For normal force, orientations differ by a
rotation about the joint's axis, which turns the force on guide or bearing and leaves the load along the
axis as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from math import isfinite

import numpy as np
import pandas as pd

from stickslip_fit._format import coordinate_unit, join_words, step_unit
from stickslip_fit.anova.contrasts import build_comparison
from stickslip_fit.errors import InputError, check_type
from stickslip_fit.laws import expected_steps, float_column, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import position_columns
from stickslip_fit.machine import Machine, load_machine, published_load
from stickslip_fit.units import from_si

WITHIN_SESSION_ERROR = "traverses within session"
ConfigurationChooser = Callable[[pd.DataFrame, list[str]], Iterable[pd.DataFrame]]


@dataclass(frozen=True)
class NotTestable:
    """A test that the log does not allow, and why; other attributes as of `FactorTestDesign`."""

    analysis: str
    joint: int
    direction: str | None
    session: str | None
    configuration: str | None
    reason: str


@dataclass(frozen=True)
class FactorTestDesign:
    """The observations, levels and error term of one test.

    Attributes
    ----------
    analysis : str
        ``day``, ``direction`` or ``normal-force``.
    joint : int
    direction, session : str or None
        None where the test is over both, or all.
    configuration : str
        Position of all other joints and the base, in words.
    factor : str
        What differs between the levels, in words.
    error_term : str
        The variation that differences between levels are compared with.
    observations : DataFrame
        See `step_size_observations`; with a column level, the names of the levels.
    machine : Machine
        The nominal one if not given.
    """

    analysis: str
    joint: int
    direction: str | None
    session: str | None
    configuration: str
    factor: str
    error_term: str
    observations: pd.DataFrame
    machine: Machine = field(default_factory=load_machine)

    @property
    def unit(self) -> str:
        """Display unit of the step size."""
        return step_unit(self.joint, self.machine)

    @property
    def units(self) -> pd.DataFrame:
        """Observations, or their mean in each session and level: step_size, level, block."""
        if self.error_term == WITHIN_SESSION_ERROR:
            return self.observations[["step_size", "level"]].assign(block="")
        cells = self.observations.groupby(["session", "level"], sort=False, as_index=False)[
            "step_size"
        ].mean()
        return cells.rename(columns={"session": "block"})

    def not_testable(self, reason: str) -> NotTestable:
        """The test as one that cannot be made, with the reason."""
        return NotTestable(
            self.analysis, self.joint, self.direction, self.session, self.configuration, reason
        )


def choose_most_informative(rows: pd.DataFrame, by: list[str]) -> list[pd.DataFrame]:
    """The configuration with several sessions, then most replicates, then most observations.

    The choice depends on the design alone, never on the observed values.

    Parameters
    ----------
    rows : DataFrame
        Observations of one joint.
    by : list of str
        Columns that make a configuration.
    """
    return list(islice(choose_all(rows, by), 1))


def choose_all(rows: pd.DataFrame, by: list[str]) -> Iterator[pd.DataFrame]:
    """Each configuration, the most informative first."""
    code = rows.groupby(by, dropna=False, sort=False).ngroup()
    cells = rows.groupby([code, "session", "direction", "orientation"], sort=False).size()
    by_code = cells.groupby(level=0, sort=False)
    replicates = by_code.sum() - by_code.size()
    several = rows.groupby(code)["session"].nunique() > 1
    ranking = pd.DataFrame(
        {"both": several & (replicates > 0), "several": several, "replicates": replicates, "n": by_code.sum()}
    )
    # Configurations may be as many as traverses, and most often only the first is asked for.
    return (
        rows[code == one] for one in ranking.sort_values(list(ranking), ascending=False, kind="stable").index
    )


MAX_SESSIONS = 12  # with more, only the test over all sessions; one session can still be chosen


def design_session_tests(
    analysis: str,
    factor: str,
    rows: pd.DataFrame,
    direction: str | None,
    configuration: str,
    machine: Machine,
) -> list[FactorTestDesign | NotTestable]:
    """Tests over all sessions, with sessions as blocks, and within each of them.

    Over sessions, cell means are compared against the interaction of session and level, so that the result
    holds for other sessions too; within a session, observations against their scatter.

    The F test over sessions is exact where cells have equal numbers of observations. Where these differ
    sixfold and levels differ alike in all sessions, it rejects 3.6 to 5.7 times in 100 in place of 5.

    Parameters
    ----------
    analysis, factor : str
        Name of the test, and of what differs.
    rows : DataFrame
        Observations of one joint at one configuration, with a column level.
    """
    joint = int(rows["joint"].iloc[0])
    n_levels = rows.groupby("session", sort=False)["level"].nunique()
    sessions = [session for session, count in n_levels.items() if count > 1]
    if not sessions:
        reason = f"no session has traverses of more than one {factor} here"
        return [NotTestable(analysis, joint, direction, None, configuration, reason)]

    def design(session: str | None, error_term: str, subset: pd.DataFrame) -> FactorTestDesign:
        return FactorTestDesign(
            analysis, joint, direction, session, configuration, factor, error_term, subset, machine
        )

    designs: list[FactorTestDesign | NotTestable] = []
    if len(n_levels) > 1:
        over = design(None, f"session x {factor}", rows[rows["session"].isin(sessions)])
        reason = _why_not_between_sessions(over, len(sessions))
        designs.append(over.not_testable(reason) if reason else over)
    for session in sessions if len(sessions) <= MAX_SESSIONS else ():
        within = design(session, WITHIN_SESSION_ERROR, rows[rows["session"] == session])
        replicated = len(within.observations) > within.observations["level"].nunique()
        reason = f"one traverse of each {factor} says nothing of scatter: repeat one in this session"
        designs.append(within if replicated else within.not_testable(reason))
    return designs


def _why_not_between_sessions(over: FactorTestDesign, n_sessions: int) -> str:
    if n_sessions < 2:
        return f"one session only has more than one {over.factor}: repeat it in another session"
    units = over.units
    comparison = build_comparison(units["level"], units["block"])
    if not comparison.connected:
        return f"some levels of {over.factor} were never read in one session with the others"
    if comparison.df[1] < 1:
        return f"too few sessions have the same levels of {over.factor}"
    return ""


ROTATION_COLUMNS = ["q1", "q2", "q3", "load_low", "load_middle", "load_high", "low", "high"]
_POSITION_DECIMALS, _LOAD_DECIMALS = 10, 6  # finer than anything that can be set


def step_size_observations(log: Log) -> pd.DataFrame:
    """The usable traverses of a log.

    Returns
    -------
    DataFrame
        The log's columns with plain text for session and direction, and step_size (rad or m per step),
        rounding (standard deviation that the end stop's check adds to it), low and high (ends of the
        traverse in order), load_low, load_middle, load_high (published load along it, for a machine of the
        published geometry), configuration and orientation (labels of all positions, and of the base's).
    """
    check_type("log", log, Log)
    rows = log.usable
    table = rows.astype({"session": object, "direction": object})
    steps = expected_steps(rows["steps"], rows["check_every"])
    table["step_size"] = traverse_length(rows) / steps
    check_every = np.where(rows["check_every"] > 1, rows["check_every"], 1)
    table["rounding"] = table["step_size"] * check_every / np.sqrt(12.0) / steps
    table["low"], table["high"] = rows[["start", "stop"]].min(axis=1), rows[["start", "stop"]].max(axis=1)
    columns = configuration_columns(table)
    table[columns] = table[columns].round(_POSITION_DECIMALS) + 0.0
    for joint in log.joints if log.machine.has_published_geometry else ():
        subset = table["joint"] == joint
        for name, share in (("low", 0.0), ("middle", 0.5), ("high", 1.0)):
            table.loc[subset, f"load_{name}"] = _observation_loads(table[subset], joint, share)
    table["configuration"] = _group_labels(table, columns)
    table["orientation"] = _group_labels(table, ["joint", "theta", "psi"])
    return table.copy()  # few blocks of columns are selected several times as fast


def configuration_columns(rows: pd.DataFrame) -> list[str]:
    """The columns that make a configuration: positions, orientation and ends of the traverse."""
    return [*position_columns(rows), "low", "high"]


def select_observations(rows: pd.DataFrame, joint: int | None, session: str | None) -> pd.DataFrame:
    """The observations of one joint, of one session, or of both.

    Raises
    ------
    InputError
        If there are none.
    """
    for name, wanted in (("joint", joint), ("session", session)):
        if wanted is not None:
            known = join_words(list(map(str, sorted(rows[name].unique()))))
            rows = rows[rows[name] == wanted]
            if rows.empty:
                raise InputError(f"no usable traverse of {name} {wanted!r}; the log has {known or 'none'}")
    if rows.empty:
        raise InputError("the log has no usable traverse")
    return rows


def describe_design_point(row: pd.Series, machine: Machine, names: list[str]) -> str:
    """The configuration of an observation, in words; of a partial traverse its ends too.

    Parameters
    ----------
    row : Series
        An observation.
    names : list of str
        Of q1 to qn, theta, psi; the moving joint's own, and what is not known, is left out.
    """
    shown = [name for name in names if name != f"q{row['joint']}" and isfinite(row[name])]
    parts = [format_position(name, row[name], machine) for name in shown]
    if not np.isclose(row["high"] - row["low"], machine.span(int(row["joint"])), rtol=1e-6):
        unit = coordinate_unit(f"q{row['joint']}", machine)
        parts.append(f"{format_plain(row['low'], unit)} to {format_plain(row['high'], unit)} {unit}")
    return ", ".join(parts)


def format_position(name: str, value: float, machine: Machine) -> str:
    """One coordinate.

    Examples
    --------
    >>> arm = load_machine()
    >>> format_position("q3", 0.012, arm), format_position("psi", -1.5707963267948966, arm)
    ('q3 12 mm', 'psi -90 deg')
    """
    unit = coordinate_unit(name, machine)
    return f"{name} {format_plain(value, unit)} {unit}"


def format_plain(value: float, unit: str, decimals: int = 4) -> str:
    """A coordinate without its unit, trailing zeros left out."""
    return f"{round(from_si(float(value), unit), decimals) + 0.0:g}"


def _observation_loads(rows: pd.DataFrame, joint: int, share: float) -> np.ndarray:
    moving = (rows["low"] + share * (rows["high"] - rows["low"])).to_numpy()
    q1 = moving if joint == 1 else float_column(rows, "q1")
    q2 = moving if joint == 2 else float_column(rows, "q2")
    load = published_load(joint, q1, q2, float_column(rows, "theta"), float_column(rows, "psi"))
    return np.round(load, _LOAD_DECIMALS) + 0.0


def _group_labels(rows: pd.DataFrame, by: list[str]) -> pd.Series:
    """The same small text for rows that agree in all of `by`."""
    groups = rows.groupby(["joint", *[name for name in by if name != "joint"]], dropna=False, sort=False)
    return pd.Series([f"c{number}" for number in groups.ngroup()], rows.index, dtype=object)


def design_day_tests(
    rows: pd.DataFrame, machine: Machine, choose: ConfigurationChooser
) -> list[FactorTestDesign | NotTestable]:
    """One test for each direction: sessions against observations within them, at one configuration.

    Parameters
    ----------
    rows : DataFrame
        Observations of one joint.
    choose : callable
        Picks the configurations.
    """
    designs: list[FactorTestDesign | NotTestable] = []
    for subset in choose(rows, configuration_columns(rows)):
        configuration = describe_design_point(subset.iloc[0], machine, position_columns(rows))
        for direction, observations in subset.groupby("direction"):
            n_sessions = observations["session"].nunique()
            common = ("day", int(rows["joint"].iloc[0]), str(direction), None, configuration)
            if n_sessions < 2:
                reason = "all traverses are of one session: repeat this configuration in another"
                designs.append(NotTestable(*common, reason))
            elif len(observations) == n_sessions:
                reason = "one traverse in each session says nothing of scatter: repeat it in one session "
                designs.append(NotTestable(*common, f"{reason}at least"))
            else:
                levels = observations.assign(level=observations["session"])
                designs.append(FactorTestDesign(*common, "session", WITHIN_SESSION_ERROR, levels, machine))
    return designs


def design_direction_tests(
    rows: pd.DataFrame, machine: Machine, choose: ConfigurationChooser
) -> list[FactorTestDesign | NotTestable]:
    """Direction + against -, at one configuration; parameters as of `design_day_tests`."""
    joint = int(rows["joint"].iloc[0])
    driven = rows["direction"].unique()
    if len(driven) < 2:
        reason = f"joint {joint} was driven in direction {driven[0]} only"
        return [NotTestable("direction", joint, None, None, None, reason)]
    designs: list[FactorTestDesign | NotTestable] = []
    for subset in choose(rows, configuration_columns(rows)):
        levels = subset.assign(level=subset["direction"])
        configuration = describe_design_point(subset.iloc[0], machine, position_columns(rows))
        designs += design_session_tests("direction", "direction", levels, None, configuration, machine)
    return designs


NO_ROTATION_REASON = (
    "no session has two orientations of the base that differ by a rotation about the joint's axis alone, "
    "with the load along it the same (joint 3: drive at q2 -90 deg, psi 0 deg and several theta)"
)

NO_GEOMETRY_REASON = "the force across a joint's axis follows from the arm's lengths, which the machine lacks"


def design_normal_force_tests(
    rows: pd.DataFrame, machine: Machine, choose: ConfigurationChooser
) -> list[FactorTestDesign | NotTestable]:
    """One test for each direction; parameters as of `design_day_tests`."""
    joint = int(rows["joint"].iloc[0])
    if not machine.has_published_geometry:
        return [NotTestable("normal-force", joint, None, None, None, NO_GEOMETRY_REASON)]
    cell, place = (
        rows.groupby(names, dropna=False, sort=False).ngroup().to_numpy()
        for names in ([*ROTATION_COLUMNS, "session", "direction"], ROTATION_COLUMNS)
    )
    orientation, orientations = pd.factorize(rows["orientation"])
    several = np.bincount(np.unique(cell * len(orientations) + orientation) // len(orientations)) > 1
    turned = np.bincount(place, several[cell])[place] > 0
    if not turned.any():
        return [NotTestable("normal-force", joint, None, None, None, NO_ROTATION_REASON)]
    designs: list[FactorTestDesign | NotTestable] = []
    for subset in choose(rows[turned], ROTATION_COLUMNS):
        varied = [name for name in ("theta", "psi") if subset[name].nunique() > 1]
        fixed = [name for name in position_columns(rows) if name not in varied]
        by_orientation = subset.groupby("orientation")
        names = {key: _orientation_name(part.iloc[0], varied, machine) for key, part in by_orientation}
        configuration = (
            f"{describe_design_point(subset.iloc[0], machine, fixed)}; {' and '.join(varied)} turned"
        )
        levels = subset.assign(level=subset["orientation"].map(names))
        for sign, driven in levels.groupby("direction"):
            if driven["level"].nunique() > 1:
                designs += design_session_tests(
                    "normal-force", "orientation", driven, str(sign), configuration, machine
                )
            else:
                reason = f"direction {sign} was driven in one of these orientations only"
                designs.append(NotTestable("normal-force", joint, str(sign), None, configuration, reason))
    return designs


def _orientation_name(row: pd.Series, varied: list[str], machine: Machine) -> str:
    return ", ".join(format_position(name, row[name], machine) for name in varied)
