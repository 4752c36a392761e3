"""Designs of the tests: which observations are compared, between which levels, against which error.

Day (thesis Section 4.2), direction (4.4) and normal force (5.2). Direction and normal force are tested
over all sessions, with sessions as blocks, and within each. For normal force, orientations differ by a
rotation about the joint's axis, which turns the force on guide or bearing and leaves the load along the
axis as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.anova.contrasts import build_comparison
from stickslip_fit.errors import InputError
from stickslip_fit.laws import expected_steps, float_column, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.machine import published_load
from stickslip_fit.units import from_si

WITHIN_SESSION_ERROR = "readings within session"
ConfigurationChooser = Callable[[pd.DataFrame, list[str]], Iterable[pd.DataFrame]]


@dataclass(frozen=True)
class FactorTestDesign:
    """What is asked, and of which readings.

    Attributes
    ----------
    analysis : str
        ``day``, ``direction`` or ``normal-force``.
    joint : int
    direction, session : str or None
        None where the question is about both, or all.
    configuration : str
        Where everything else stood, in words.
    factor : str
        Column of `readings` whose levels are compared.
    error_term : str
        What the difference between levels is measured against.
    readings : DataFrame
        See `readings.readings`; with a column level, the names of the levels.
    """

    analysis: str
    joint: int
    direction: str | None
    session: str | None
    configuration: str
    factor: str
    error_term: str
    readings: pd.DataFrame

    @property
    def units(self) -> pd.DataFrame:
        """What is compared: readings, or their mean in each session and level.

        Returns
        -------
        DataFrame
            step_size, level, block.
        """
        if self.error_term == WITHIN_SESSION_ERROR:
            return self.readings[["step_size", "level"]].assign(block="")
        cells = self.readings.groupby(["session", "level"], sort=False, as_index=False)["step_size"].mean()
        return cells.rename(columns={"session": "block"})


@dataclass(frozen=True)
class NotTestable:
    """A question that the log cannot answer, and why; attributes as of `Question`."""

    analysis: str
    joint: int
    direction: str | None
    session: str | None
    configuration: str | None
    reason: str


def choose_most_informative(rows: pd.DataFrame, by: list[str]) -> list[pd.DataFrame]:
    """The configuration that says most: seen in several sessions, repeated most, read most, read first.

    Nothing but the design decides, never what was read.

    Parameters
    ----------
    rows : DataFrame
        Readings of one joint.
    by : list of str
        Columns that make a configuration.
    """
    place, order = _ranked(rows, by)
    return [rows[place == order[0]]]


def choose_all(rows: pd.DataFrame, by: list[str]) -> list[pd.DataFrame]:
    """Each configuration, the one that says most first."""
    place, order = _ranked(rows, by)
    parts = dict(list(rows.groupby(place, sort=False)))
    return [parts[one] for one in order]


def _ranked(rows: pd.DataFrame, by: list[str]) -> tuple[pd.Series[int], list[int]]:
    """The number of each row's configuration, and these numbers, the one that says most first."""
    place = rows.groupby(by, dropna=False, sort=False).ngroup()
    cells = rows.groupby([place, "session", "direction", "orientation"], sort=False).size()
    places = cells.groupby(level=0, sort=False)
    repeats = places.sum() - places.size()
    again = rows.groupby(place)["session"].nunique() > 1
    ranking = pd.DataFrame(
        {"both": again & (repeats > 0), "again": again, "repeats": repeats, "readings": places.sum()}
    )
    return place, list(ranking.sort_values(list(ranking), ascending=False, kind="stable").index)


MAX_SESSIONS = 12  # beyond these, only the question over all sessions; one can still be named


def design_session_tests(
    analysis: str, factor: str, rows: pd.DataFrame, direction: str | None, configuration: str
) -> list[FactorTestDesign | NotTestable]:
    """Ask over all sessions, sessions being blocks, and in each of them.

    Over sessions, levels are compared by the means of their cells, against how differently they differ from
    session to session: what holds for these sessions and not only in one of them. In a session, against
    its readings' scatter.

    The F test over sessions is exact where cells have equal numbers of readings. Where these differ sixfold
    and levels differ alike in all sessions, it rejects 3.6 to 5.7 times in 100 in place of 5.

    Parameters
    ----------
    analysis, factor : str
        Name of the question, and of what differs.
    rows : DataFrame
        Readings of one joint at one configuration, with a column level.
    direction : str or None
    configuration : str
    """
    joint = int(rows["joint"].iloc[0])
    levels = rows.groupby("session", sort=False)["level"].nunique()
    paired = [session for session, count in levels.items() if count > 1]
    if not paired:
        reason = f"no session has readings of more than one {factor} here"
        return [NotTestable(analysis, joint, direction, None, configuration, reason)]
    designs: list[FactorTestDesign | NotTestable] = []
    if len(levels) > 1:
        subset = rows[rows["session"].isin(paired)]
        over = FactorTestDesign(
            analysis, joint, direction, None, configuration, factor, f"session x {factor}", subset
        )
        designs.append(_check_between_sessions(over, len(paired)))
    if len(paired) <= MAX_SESSIONS:
        designs += [
            _check_within_session(
                FactorTestDesign(
                    analysis, joint, direction, session, configuration, factor, WITHIN_SESSION_ERROR,
                    rows[rows["session"] == session],
                )
            )
            for session in paired
        ]  # fmt: skip
    return designs


def _check_between_sessions(over: FactorTestDesign, sessions: int) -> FactorTestDesign | NotTestable:
    if sessions < 2:
        return _not_testable(
            over, f"one session only has more than one {over.factor}: repeat it in another session"
        )
    units = over.units
    comparison = build_comparison(units["level"], units["block"])
    if not comparison.connected:
        return _not_testable(
            over, f"some levels of {over.factor} were never read in one session with the others"
        )
    if comparison.df[1] < 1:
        return _not_testable(over, f"too few sessions have the same levels of {over.factor}")
    return over


def _check_within_session(design: FactorTestDesign) -> FactorTestDesign | NotTestable:
    if len(design.readings) == design.readings["level"].nunique():
        reason = f"one reading of each {design.factor} says nothing of scatter: repeat one in this session"
        return _not_testable(design, reason)
    return design


def _not_testable(design: FactorTestDesign, reason: str) -> NotTestable:
    return NotTestable(
        design.analysis,
        design.joint,
        design.direction,
        design.session,
        design.configuration,
        reason,
    )


COORDINATE_UNITS = {"q1": "deg", "q2": "deg", "q3": "mm", "theta": "deg", "psi": "deg"}
CONFIGURATION_COLUMNS = ["q1", "q2", "q3", "theta", "psi", "low", "high"]
ROTATION_COLUMNS = ["q1", "q2", "q3", "load_low", "load_middle", "load_high", "low", "high"]
_POSITION_DECIMALS, _LOAD_DECIMALS = 10, 6  # finer than anything that can be set


def step_size_observations(log: Log) -> pd.DataFrame:
    """The usable traverses of a log.

    Returns
    -------
    DataFrame
        The log's columns with plain text for session and direction, and step_size (rad or m per step),
        rounding (spread that the end stop's check adds to it), low and high (the stretch traversed),
        load_low, load_middle, load_high (published load along it), configuration and orientation
        (labels of where everything stood, and of how the base was turned).
    """
    rows = log.usable
    found = rows.astype({"session": object, "direction": object})
    seen = expected_steps(rows["steps"], rows["check_every"])
    found["step_size"] = traverse_length(rows) / seen
    checked = np.where(rows["check_every"] > 1, rows["check_every"], 1)
    found["rounding"] = found["step_size"] * checked / np.sqrt(12.0) / seen
    found["low"], found["high"] = (
        np.minimum(rows["start"], rows["stop"]),
        np.maximum(rows["start"], rows["stop"]),
    )
    found[CONFIGURATION_COLUMNS] = found[CONFIGURATION_COLUMNS].round(_POSITION_DECIMALS) + 0.0
    for joint in log.joints:
        subset = found["joint"] == joint
        for name, share in (("low", 0.0), ("middle", 0.5), ("high", 1.0)):
            found.loc[subset, f"load_{name}"] = _observation_loads(found[subset], joint, share)
    found["configuration"] = _group_labels(found, CONFIGURATION_COLUMNS)
    found["orientation"] = _group_labels(found, ["joint", "theta", "psi"])
    return found


def select_observations(rows: pd.DataFrame, joint: int | None, session: str | None) -> pd.DataFrame:
    """The readings of one joint, of one session, or of both.

    Raises
    ------
    InputError
        If there are none.
    """
    for name, wanted in (("joint", joint), ("session", session)):
        if wanted is not None:
            known = ", ".join(map(str, rows[name].unique()))
            rows = rows[rows[name] == wanted]
            if rows.empty:
                raise InputError(f"no usable traverse of {name} {wanted!r}; the log has {known or 'none'}")
    if rows.empty:
        raise InputError("the log has no usable traverse")
    return rows


def describe_design_point(row: pd.Series, span: float, names: list[str]) -> str:
    """Where things stood, of a partial traverse its ends too.

    Parameters
    ----------
    row : Series
        A reading.
    span : float
        The joint's full travel.
    names : list of str
        Of q1, q2, q3, theta, psi; the moving joint's own is left out.
    """
    parts = [format_position(name, row[name]) for name in names if name != f"q{row['joint']}"]
    if not np.isclose(row["high"] - row["low"], span, rtol=1e-6):
        unit = COORDINATE_UNITS[f"q{row['joint']}"]
        parts.append(f"{_format_plain(row['low'], unit)} to {_format_plain(row['high'], unit)} {unit}")
    return ", ".join(parts)


def format_position(name: str, value: float) -> str:
    """One coordinate.

    Examples
    --------
    >>> format_position("q3", 0.012), format_position("psi", -1.5707963267948966)
    ('q3 12 mm', 'psi -90 deg')
    """
    return f"{name} {_format_plain(value, COORDINATE_UNITS[name])} {COORDINATE_UNITS[name]}"


def _format_plain(value: float, unit: str) -> str:
    return f"{round(from_si(float(value), unit), 4) + 0.0:g}"


def _observation_loads(rows: pd.DataFrame, joint: int, share: float) -> np.ndarray:
    at = (rows["low"] + share * (rows["high"] - rows["low"])).to_numpy()
    q1 = at if joint == 1 else float_column(rows, "q1")
    q2 = at if joint == 2 else float_column(rows, "q2")
    load = published_load(joint, q1, q2, float_column(rows, "theta"), float_column(rows, "psi"))
    return np.round(load, _LOAD_DECIMALS) + 0.0


def _group_labels(rows: pd.DataFrame, by: list[str]) -> pd.Series:
    """The same small text for rows that agree in all of `by`."""
    groups = rows.groupby(["joint", *[name for name in by if name != "joint"]], dropna=False, sort=False)
    return "c" + groups.ngroup().astype(str)


POSITION_COLUMNS = ["q1", "q2", "q3", "theta", "psi"]


def design_day_tests(
    rows: pd.DataFrame, span: float, choose: ConfigurationChooser
) -> list[FactorTestDesign | NotTestable]:
    """One question for each direction: sessions against readings within them, at one configuration.

    Parameters
    ----------
    rows : DataFrame
        Readings of one joint.
    span : float
        The joint's full travel, rad or m.
    choose : callable
        Picks the configurations.
    """
    return [
        _design_day_test(
            here[here["direction"] == direction],
            direction,
            describe_design_point(here.iloc[0], span, POSITION_COLUMNS),
        )
        for here in choose(rows, CONFIGURATION_COLUMNS)
        for direction in ("+", "-")
        if (here["direction"] == direction).any()
    ]


def _design_day_test(
    rows: pd.DataFrame, direction: str, configuration: str
) -> FactorTestDesign | NotTestable:
    joint = int(rows["joint"].iloc[0])
    sessions = rows["session"].nunique()
    asked = ("day", joint, direction, None, configuration)
    if sessions < 2:
        return NotTestable(*asked, "all readings are of one session: repeat this configuration in another")
    if len(rows) == sessions:
        return NotTestable(
            *asked,
            "one reading in each session says nothing of scatter: read it twice in one session at least",
        )
    return FactorTestDesign(*asked, "session", WITHIN_SESSION_ERROR, rows.assign(level=rows["session"]))


def design_direction_tests(
    rows: pd.DataFrame, span: float, choose: ConfigurationChooser
) -> list[FactorTestDesign | NotTestable]:
    """Direction + against -, at one configuration; parameters as of `day.day`."""
    joint = int(rows["joint"].iloc[0])
    driven = rows["direction"].unique()
    if len(driven) < 2:
        reason = f"joint {joint} was driven in direction {driven[0]} only"
        return [NotTestable("direction", joint, None, None, None, reason)]
    return [
        asked
        for here in choose(rows, CONFIGURATION_COLUMNS)
        for asked in design_session_tests(
            "direction",
            "direction",
            here.assign(level=here["direction"]),
            None,
            describe_design_point(here.iloc[0], span, POSITION_COLUMNS),
        )
    ]


NO_ROTATION_REASON = (
    "no session has two orientations of the base that differ by a rotation about the joint's axis alone, "
    "with the load along it the same (joint 3: drive at q2 -90 deg, psi 0 deg and several theta)"
)


def design_normal_force_tests(
    rows: pd.DataFrame, span: float, choose: ConfigurationChooser
) -> list[FactorTestDesign | NotTestable]:
    """One question for each direction; parameters as of `day.day`."""
    joint = int(rows["joint"].iloc[0])
    together = rows.groupby([*ROTATION_COLUMNS, "session", "direction"], dropna=False)["orientation"]
    compared = rows.assign(compared=together.transform("nunique") > 1).groupby(ROTATION_COLUMNS, dropna=False)
    turned = compared["compared"].transform("any")
    if not turned.any():
        return [NotTestable("normal-force", joint, None, None, None, NO_ROTATION_REASON)]
    asked: list[FactorTestDesign | NotTestable] = []
    for here in choose(rows[turned], ROTATION_COLUMNS):
        varied = [name for name in ("theta", "psi") if here[name].nunique() > 1]
        fixed = [name for name in ("q1", "q2", "q3", "theta", "psi") if name not in varied]
        names = {key: _orientation_name(part.iloc[0], varied) for key, part in here.groupby("orientation")}
        configuration = f"{describe_design_point(here.iloc[0], span, fixed)}; {' and '.join(varied)} turned"
        labelled = here.assign(level=here["orientation"].map(names))
        for sign in ("+", "-"):
            driven = labelled[labelled["direction"] == sign]
            if driven["level"].nunique() > 1:
                asked += design_session_tests("normal-force", "orientation", driven, sign, configuration)
            elif len(driven):
                reason = f"direction {sign} was driven in one of these orientations only"
                asked.append(NotTestable("normal-force", joint, sign, None, configuration, reason))
    return asked


def _orientation_name(row: pd.Series, varied: list[str]) -> str:
    return ", ".join(format_position(name, row[name]) for name in varied)
