"""detect_changes: step sizes and parameters of the sessions of one log against those of another.

Both logs are fitted by least squares, each session and direction with its own parameters. Compared are, for
each joint and direction that both logs have, the step size, as the mean of its logarithm over the law's
calibration configurations, and every parameter of the law. The step size is what moves are made of, and a
change of it is seen best; parameters may trade against each other without a change of any step. All of them
are one family of tests, see `difference`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import format_direction, step_unit
from stickslip_fit._json import write_json
from stickslip_fit._summary import Summarized
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.changes.difference import Difference, SessionEstimates, compare_means
from stickslip_fit.errors import InputError, check_alpha, check_type
from stickslip_fit.estimation import Flag, Result, fit_least_squares
from stickslip_fit.estimation._groups import usable_rows
from stickslip_fit.estimation.identifiability import configuration_rows
from stickslip_fit.estimation.result import Provenance
from stickslip_fit.estimation.reweighting import OUTLIER, PATTERN
from stickslip_fit.laws import Laws, StepLaw, choose_laws, is_published
from stickslip_fit.laws.base import traverse_length
from stickslip_fit.laws.physical import Physical
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine
from stickslip_fit.units import from_si

STEP_SIZE = "step size"
UNLOADED, RESPONSE = "unloaded", "response"
ROLES = {"a": UNLOADED, "gamma0": UNLOADED, "c": RESPONSE, "d": RESPONSE}  # of published parameters
MAX_CONFIGURATIONS = 50  # of a law without calibration configurations
SCHEMA = "stickslip-fit/changes/1"
DECIMALS = 9  # of a configuration's features that make it another


@dataclass(frozen=True)
class Change:
    """What became of one quantity of one joint and direction.

    Attributes
    ----------
    joint : int
    direction : str
    name : str
        ``step size`` or a parameter of the law.
    unit : str
        For display; all numbers are SI.
    sessions : tuple of (int, int)
        How many sessions of the old and the new log determine it.
    difference : Difference
        That of step sizes, which are geometric means, is relative to the old one.
    is_significant : bool
        Whether its adjusted p-value is below the rate of false alarms.
    role : {"unloaded", "response", ""}
        Of a parameter of a published law: whether it is a step size without load or a response to load.
    """

    joint: int
    direction: str
    name: str
    unit: str
    sessions: tuple[int, int]
    difference: Difference
    is_significant: bool
    role: str = ""

    @property
    def difference_unit(self) -> str:
        """Unit of the difference."""
        return "%" if self.name == STEP_SIZE else self.unit


@dataclass(frozen=True, repr=False)
class Changes(Summarized):
    """Whether an actuator has changed.

    Attributes
    ----------
    alpha : float
        Rate of false alarms over all changes together.
    sessions : tuple of (tuple of str, tuple of str)
        Of the old and of the new log.
    changes : tuple of Change
        By joint and direction, the step size first.
    not_compared : tuple of str
        What only one of the logs can tell, in sentences.
    flags : tuple of Flag
        Of the two fits, where they concern single counts.
    provenance : tuple of (Provenance, Provenance)
    laws : mapping of int to StepLaw
        By joint, of those that were compared.
    logs : tuple of (Log, Log)
        The old and the new one.
    """

    alpha: float
    sessions: tuple[tuple[str, ...], tuple[str, ...]]
    changes: tuple[Change, ...]
    not_compared: tuple[str, ...]
    flags: tuple[Flag, ...]
    provenance: tuple[Provenance, Provenance]
    laws: Mapping[int, StepLaw]
    logs: tuple[Log, Log]

    @property
    def significant(self) -> tuple[Change, ...]:
        """Those beyond the scatter from day to day."""
        return tuple(change for change in self.changes if change.is_significant)

    @property
    def knows_scatter(self) -> bool:
        """Whether either log has two sessions, without which a change is no other than a day's scatter."""
        return any(change.difference.df > 0 for change in self.changes)

    @property
    def table(self) -> pd.DataFrame:
        """One row for each change, in the units beside each number, with the fields of the saved JSON."""
        return pd.DataFrame([_change_to_json(change) for change in self.changes])

    def save(self, path: str | Path) -> None:
        """Write everything as JSON, in people's units.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        write_json(path, _to_json(self), [file for one in self.provenance for file in one.log_files])


def detect_changes(
    old: Log, new: Log, *, laws: Laws | None = None, alpha: float = 0.01, command: str = ""
) -> Changes:
    """Test whether an actuator has changed between two logs, beyond its scatter from day to day.

    Parameters
    ----------
    old, new : Log
        Of one machine, with different sessions; of one log, ``read_log(path, until=date)`` and
        ``read_log(path, since=date)``.
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    alpha : float, optional
        Rate of false alarms over all joints, directions and parameters together.
    command : str, optional
        For the provenance.

    Returns
    -------
    Changes

    Raises
    ------
    InputError
        If `alpha` is not between 0.001 and 0.2, or the logs are of two machines, are the same, or have no
        joint in common.
    """
    check_alpha(alpha)
    check_type("old", old, Log)
    check_type("new", new, Log)
    if old.machine.sha256 != new.machine.sha256:
        raise InputError("the logs are of two machines; read both with the same machine file")
    if set(map(tuple, _keys(old))) & set(map(tuple, _keys(new))):
        raise InputError("the logs have traverses in common; name two logs of different sessions")
    laws = _choose_together((old, new), laws)
    fits = (
        fit_least_squares(old, laws=laws, command=command),
        fit_least_squares(new, laws=laws, command=command),
    )
    drives, apart = _pair_drives(*fits)
    quantities = [quantity for drive in drives for quantity in _quantities(drive, (old, new))]
    apart += [f"{one.where}: not known in both logs." for one in quantities if not one.is_comparable]
    quantities = [one for one in quantities if one.is_comparable]
    if not quantities:
        raise InputError("no joint and direction is calibrated in both logs, so that nothing can be compared")
    differences = compare_means([one.estimates for one in quantities], alpha)
    changes = tuple(
        _make_change(quantity, difference, alpha)
        for quantity, difference in zip(quantities, differences, strict=True)
    )
    flags = tuple(flag for fit in fits for flag in fit.flags if flag.flag in (OUTLIER, PATTERN))
    sessions = (old.sessions, new.sessions)
    provenance = (fits[0].provenance, fits[1].provenance)
    compared = {drive.law.joint: drive.law for drive in drives}
    return Changes(alpha, sessions, changes, tuple(apart), flags, provenance, compared, (old, new))


def _choose_together(logs: tuple[Log, Log], laws: Laws | None) -> Laws | None:
    """The laws, physical ones with the lambda that both logs together make likely: else r means another."""
    if laws is None:
        return None
    rows = pd.concat([usable_rows(log) for log in logs], ignore_index=True)
    together = choose_laws(rows, logs[0].machine, laws)
    return {**laws, **{joint: law for joint, law in together.items() if isinstance(law, Physical)}}


def _keys(log: Log) -> Array:
    columns = ["session", "time", "joint", "direction", "steps", "start", "stop"]
    return log.usable[columns].astype(str).to_numpy()


@dataclass(frozen=True, eq=False)
class _Drive:
    """A joint and direction: its law, and the parameters of its sessions in both logs, old ones first."""

    law: StepLaw
    direction: str
    machine: Machine
    is_new: BoolArray
    values: Array
    known: BoolArray
    covariance: Array


@dataclass(frozen=True, eq=False)
class _Quantity:
    """A quantity of a drive and its estimates."""

    drive: _Drive
    name: str
    unit: str
    estimates: SessionEstimates

    @property
    def where(self) -> str:
        joint, direction = self.drive.law.joint, format_direction(self.drive.direction)
        return f"Joint {joint} {direction}, {self.name}"

    @property
    def is_comparable(self) -> bool:
        return min(self.estimates.counts) > 0


def _pair_drives(old: Result, new: Result) -> tuple[list[_Drive], list[str]]:
    """The drives of joints with the same law in both fits, and sentences on the other joints."""
    drives: list[_Drive] = []
    apart = [
        f"Joint {joint} is in the {age} log only, and was not compared."
        for own, other, age in ((old, new, "old"), (new, old, "new"))
        for joint in sorted(own.joints.keys() - other.joints.keys())
    ]
    for joint in sorted(old.joints.keys() & new.joints.keys()):
        pair = old.joints[joint], new.joints[joint]
        if pair[0].law.parameters != pair[1].law.parameters:
            apart.append(f"Joint {joint} has another law in either log, and was not compared.")
            continue
        for direction in ("+", "-"):
            groups = [np.flatnonzero(fit.groups["direction"] == direction) for fit in pair]
            values, known, covariance = (
                np.concatenate([getattr(fit, name)[group] for fit, group in zip(pair, groups, strict=True)])
                for name in ("values", "known", "covariance")
            )
            if len(values):
                is_new = np.repeat([False, True], list(map(len, groups)))
                drives.append(_Drive(pair[0].law, direction, old.machine, is_new, values, known, covariance))
    return drives, apart


def _quantities(drive: _Drive, logs: tuple[Log, Log]) -> Iterator[_Quantity]:
    """The step size of a drive, then its parameters."""
    law = drive.law
    rows = _typical_rows(drive, logs)
    if len(rows):
        log_size, variance = _log_step_sizes(drive, rows)
        usable = np.isfinite(log_size)
        estimates = SessionEstimates(STEP_SIZE, log_size[usable], variance[usable], drive.is_new[usable], 1.0)
        yield _Quantity(drive, STEP_SIZE, step_unit(law.joint, drive.machine), estimates)
    for k, parameter in enumerate(law.parameters):
        known = drive.known[:, k] & (drive.covariance[:, k, k] != 0)
        variances = drive.covariance[known, k, k]
        scale = float(np.sqrt(np.mean(variances))) if known.any() else 1.0
        estimates = SessionEstimates(
            parameter.name, drive.values[known, k], variances, drive.is_new[known], scale
        )
        yield _Quantity(drive, parameter.name, parameter.unit, estimates)


def _typical_rows(drive: _Drive, logs: tuple[Log, Log]) -> pd.DataFrame:
    """Traverses over which step sizes are compared.

    The law's calibration configurations, where every session determines the law; else, and for a law without
    any, the configurations that both logs have, or without any those of the old log.
    """
    law = drive.law
    if law.calibration() and drive.known.all():
        rows = configuration_rows(law.calibration(), law.joint, drive.direction, drive.machine)
        if set(law.columns) <= set(rows.columns):
            return rows
    old, new = (
        log.usable[(log.usable["joint"] == law.joint) & (log.usable["direction"] == drive.direction)]
        for log in logs
    )
    if old.empty or new.empty:
        return old.iloc[:0]
    features = [
        np.column_stack([law.features(rows), rows[["start", "stop"]]]).round(DECIMALS) for rows in (old, new)
    ]
    both = set(map(tuple, features[1].tolist()))
    first = ~pd.DataFrame(features[0]).duplicated().to_numpy()
    shared = np.array([tuple(one) in both for one in features[0].tolist()], bool)
    # A law that every session determines predicts configurations that only one log has, too.
    usable = first & shared if (first & shared).any() or not drive.known.all() else first
    return old[usable].head(MAX_CONFIGURATIONS)


def _log_step_sizes(drive: _Drive, rows: pd.DataFrame) -> tuple[Array, Array]:
    """The mean of the logarithm of the step size over `rows`, and its variance, for each session."""
    model, lengths = drive.law.model(rows), np.log(traverse_length(rows))
    means, slopes = [], []
    for values in drive.values:
        log_steps, jacobian = model(values)
        means.append(np.mean(lengths - log_steps))
        slopes.append(-np.mean(jacobian, axis=0))
    slope = np.array(slopes)
    return np.array(means), np.einsum("gi,gij,gj->g", slope, drive.covariance, slope)


def _make_change(quantity: _Quantity, difference: Difference, alpha: float) -> Change:
    if quantity.name == STEP_SIZE:
        difference = _of_sizes(difference)
    drive, counts = quantity.drive, quantity.estimates.counts
    significant = bool(difference.p_adjusted < alpha)
    return Change(
        drive.law.joint,
        drive.direction,
        quantity.name,
        quantity.unit,
        counts,
        difference,
        significant,
        ROLES.get(quantity.name.split("_")[0], "") if is_published(drive.law) else "",
    )


def _of_sizes(log_size: Difference) -> Difference:
    """The difference of step sizes, relative to the old one, from that of their logarithms."""
    with np.errstate(over="ignore"):
        relative = {
            name: float(np.expm1(getattr(log_size, name)))
            for name in ("estimate", "low", "high", "detectable")
        }
    return replace(
        log_size,
        **relative,
        old=float(np.exp(log_size.old)),
        new=float(np.exp(log_size.new)),
        standard_error=log_size.standard_error * (1 + relative["estimate"]),
    )


def _to_json(changes: Changes) -> dict[str, Any]:
    """Everything in people's units."""
    return {
        "schema": SCHEMA,
        "alpha": changes.alpha,
        "sessions": {"old": list(changes.sessions[0]), "new": list(changes.sessions[1])},
        "changed": bool(changes.significant),
        "knows_day_to_day_scatter": changes.knows_scatter,
        "changes": [_change_to_json(change) for change in changes.changes],
        "not_compared": list(changes.not_compared),
        "remarks": [asdict(flag) for flag in changes.flags],
        "provenance": {age: asdict(one) for age, one in zip(("old", "new"), changes.provenance, strict=True)},
    }


def _change_to_json(change: Change) -> dict[str, Any]:
    difference = asdict(change.difference)
    for name in ("estimate", "standard_error", "low", "high", "detectable"):
        difference[name] = from_si(difference[name], change.difference_unit)
    for name in ("old", "new"):
        difference[name] = from_si(difference[name], change.unit)
    numbers = {name: float(value) if np.isfinite(value) else None for name, value in difference.items()}
    return {
        "joint": change.joint,
        "direction": change.direction,
        "name": change.name,
        "unit": change.unit,
        "difference_unit": change.difference_unit,
        "old_sessions": change.sessions[0],
        "new_sessions": change.sessions[1],
        **numbers,
        "is_significant": change.is_significant,
    }
