"""Result: the fit of a log by any estimator: covariance, flags, residuals, provenance; saved as JSON.

`JointFit` holds one joint's law with the parameters of each group, a group being a session and a
direction.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import scipy

from stickslip_fit import __version__
from stickslip_fit._format import join_words, step_unit
from stickslip_fit._json import to_plain, write_json
from stickslip_fit._summary import Summarized
from stickslip_fit._typing import Array
from stickslip_fit.causes import ExtendedLaw, describe
from stickslip_fit.errors import InputError
from stickslip_fit.estimation.noise import Flag, NoiseLevel, t_quantile
from stickslip_fit.estimation.shared_estimate import Covariances, SharedCovariance, find_variances
from stickslip_fit.estimation.travel import Stretches, undriven_share
from stickslip_fit.laws import StepLaw, expected_steps, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.logs.history import DEPARTURES, follow_departures
from stickslip_fit.logs.log import CHANGED
from stickslip_fit.machine import Machine
from stickslip_fit.units import UNITS, from_si


@dataclass(frozen=True)
class Provenance:
    """Hashes, versions and command behind a result; an empty command stands for a notebook.

    `seed` is None where nothing random took part.
    """

    log_files: tuple[str, ...]
    log_sha256: str
    machine_name: str
    machine_sha256: str
    versions: dict[str, str]
    command: str = ""
    seed: int | None = None

    def lines(self) -> tuple[tuple[str, str], ...]:
        """Name and value of each, for people."""
        seed = (("seed", str(self.seed)),) if self.seed is not None else ()
        return (
            ("log", f"{join_words(self.log_files or ['no file'])}; sha256 {self.log_sha256}"),
            (f"machine {self.machine_name}", f"sha256 {self.machine_sha256}"),
            ("versions", ", ".join(f"{name} {version}" for name, version in self.versions.items())),
            ("command", self.command or "none: made from Python"),
            *seed,
        )


def library_versions() -> dict[str, str]:
    """Versions of the package, Python and the numerical libraries."""
    return {
        "stickslip_fit": __version__,
        "python": ".".join(str(part) for part in sys.version_info[:3]),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "pandas": pd.__version__,
    }


def build_provenance(log: Log, command: str) -> Provenance:
    """Where a fit of `log` comes from."""
    changed = f" ({CHANGED})" if log.is_changed else ""
    return Provenance(
        log_files=tuple(name + changed for name in log.files),
        log_sha256=log.sha256,
        machine_name=log.machine.name,
        machine_sha256=log.machine.sha256,
        versions=library_versions(),
        command=command,
    )


AxesArray = npt.NDArray[np.object_]  # of a figure, panel by panel
PREDICTION_COLUMNS = ("steps", "step_size", "relative_error", "low", "high")
SHOWN_PREDICTION_COLUMNS = (
    *("calibration", "steps", "low", "high", "step_size", "unit", "error_pct", "extrapolated_pct"),
)
PARAMETER_NUMBERS = ("estimate", "standard_error", "low", "high")
OUTLYING_SD = 6.0  # standard deviations by which an outlying count is off
ALL_JOINTS = 0  # in place of a joint, for what concerns all of them


@dataclass(frozen=True)
class JointFit:
    """One joint's law with its parameters for each session and direction.

    Attributes
    ----------
    law : StepLaw
    groups : DataFrame
        Columns session and direction; g rows in order of time.
    values : array, shape (g, p)
        Parameters, SI. Where the log knows only a combination of them, one that fits it.
    known : array of bool, shape (g, p)
        Which of `values` the log determines one by one.
    covariance : array, shape (g, p, p), or SharedCovariance
        Of `values`; NaN where no error bar can be given. Kept by its parts where there are thousands of
        parameters.
    interval : array, shape (g, p, 2)
        95 % of each parameter, low and high.
    repeatability : dict of str to NoiseLevel
        By direction.
    shared : tuple of str
        Parameters with one value in each direction for all sessions; it stands in each of their groups.
    travel : dict of str to tuple of (float, float)
        By direction, the stretches that the fitted traverses cover, rad or m; empty where that is not known,
        as of files of earlier versions.
    """

    law: StepLaw
    groups: pd.DataFrame
    values: Array
    known: npt.NDArray[np.bool_]
    covariance: Covariances
    interval: Array
    repeatability: dict[str, NoiseLevel]
    shared: tuple[str, ...] = ()
    travel: dict[str, Stretches] = field(default_factory=dict)

    @property
    def cause_parameters(self) -> tuple[str, ...]:
        """Parameters of causes, with one value for the whole campaign; it stands in each group."""
        law = self.law
        return (
            tuple(parameter.name for parameter in law.cause_parameters)
            if isinstance(law, ExtendedLaw)
            else ()
        )

    def group_index(self, rows: pd.DataFrame) -> npt.NDArray[np.intp]:
        """Index of each row's group; -1 where the fit has none for its session and direction."""
        index = pd.MultiIndex.from_frame(self.groups[["session", "direction"]].astype(object))
        wanted = pd.MultiIndex.from_frame(rows[["session", "direction"]].astype(object))
        return index.get_indexer(wanted)

    def for_session_to_come(self) -> JointFit:
        """The fit as it predicts a session that is not in the log, calibrated as one that is.

        Smooth functions of single sessions are as unknown there as before the log was made: zero on average,
        with the covariance of their prior. A sudden change in a session has happened.
        """
        if not isinstance(self.law, ExtendedLaw):
            return self
        first = len(self.law.law.parameters)
        own = [one.session is not None for one in self.law.cause_parameters]
        sds = np.array([one.prior_sd for one in self.law.cause_parameters])
        smooth = first + np.flatnonzero(own & np.isfinite(sds))
        moments = first + np.flatnonzero(
            [one.sudden for one in self.law.cause_parameters] & np.array(own, bool)
        )
        values = self.values.copy()
        values[:, [*smooth, *moments]] = 0.0
        if isinstance(self.covariance, SharedCovariance):
            places = np.array([*smooth, *moments], dtype=np.intp) - first
            variance = np.append(sds[smooth - first] ** 2, np.zeros(len(moments)))
            return replace(self, values=values, covariance=self.covariance.with_shared(places, variance))
        covariance = self.covariance.copy()
        for place in (smooth, moments):
            covariance[:, place, :] = 0.0
            covariance[:, :, place] = 0.0
        covariance[:, smooth, smooth] = sds[smooth - first] ** 2
        return replace(self, values=values, covariance=covariance)


@dataclass(frozen=True, repr=False)
class Result(Summarized):
    """A fitted log.

    Attributes
    ----------
    method : str
        ``closed-form``, ``least-squares``, ``heavy-tailed-least-squares`` or ``bayes``; ``weighted-`` before
        least squares of rows whose noise differs.
    machine : Machine
    joints : dict of int to JointFit
    residuals : DataFrame
        Indexed as the log's usable rows: joint, residual (log steps seen less predicted), used (whether
        the traverse took part in the fit).
    flags : tuple of Flag
    provenance : Provenance
    """

    method: str
    machine: Machine
    joints: dict[int, JointFit]
    residuals: pd.DataFrame
    flags: tuple[Flag, ...]
    provenance: Provenance

    def save(self, path: str | Path) -> None:
        """Write the result as JSON; nothing is left half-written.

        Beside what `load_result` needs, the file holds ``parameters``: a list of name, joint, direction,
        session, unit, estimate, standard_error, low, high (95 %) and flags, in people's units. Joint,
        direction and session are null where a parameter is the same for all of them. ``schema`` ends in the
        number of the format, and ``checksum`` shows whether the file is as it was written.

        Raises
        ------
        InputError
            If the file cannot be written, or is the log that was fitted.
        """
        write_result_json(result_to_json(self), path, self.provenance.log_files)

    def plot_corner(self, joint: int, direction: str, session: str | None = None) -> AxesArray:
        """Normal approximation of a session's parameters, the latest session's unless named, two by two.

        Raises
        ------
        InputError
            If there is no such session, joint or direction, or its parameters have no error bars.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.parameters import plot_covariance_corner

        return collect_axes(plot_covariance_corner(self, joint, direction, session))

    def plot_forest(self, joint: int) -> AxesArray:
        """Every session's parameters of a joint with their 95 % intervals.

        Raises
        ------
        InputError
            If the joint was not fitted.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.parameters import plot_forest

        return collect_axes(plot_forest(self, joint))

    def plot_control(self) -> AxesArray:
        """Every parameter by session, within the limits that the sessions before it set."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.parameters import plot_control

        return collect_axes(plot_control(self))

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter: name, joint, direction, session, unit, estimate, standard_error, low, high, flags.

        session is None for a parameter that all sessions share. A cause's parameter, one for the whole
        campaign, comes last, with joint 0 and an empty direction. Numbers are in `unit`, as in the saved
        JSON; `Result.si` has them in SI. low and high bound 95 %. All are NaN where the log does not
        determine them; standard_error also is where the parameter is on a bound.
        """
        return convert_table(self.si.parameters, PARAMETER_NUMBERS)

    @property
    def si(self) -> ResultInSI:
        """The tables of parameters and predictions in SI."""
        return ResultInSI(self)

    def _collect_parameters(self) -> pd.DataFrame:
        table = pd.concat([self._joint_table(fit) for fit in self.joints.values()], ignore_index=True)
        common = table["joint"] == ALL_JOINTS
        once = table[common].drop_duplicates("name")
        return pd.concat([table[~common], once], ignore_index=True) if len(once) else table

    def _joint_table(self, fit: JointFit) -> pd.DataFrame:
        parameters = fit.law.parameters
        count = len(parameters)
        names = [parameter.name for parameter in parameters]
        table = fit.groups.loc[fit.groups.index.repeat(count), ["direction", "session"]].reset_index(
            drop=True
        )
        table.insert(0, "name", names * len(fit.groups))
        table.insert(1, "joint", fit.law.joint)
        table["unit"] = [parameter.unit for parameter in parameters] * len(fit.groups)
        variance = find_variances(fit.covariance)
        error = np.sqrt(np.where(variance > 0, variance, np.nan))
        columns = (fit.values, error, fit.interval[..., 0], fit.interval[..., 1])
        for name, column in zip(PARAMETER_NUMBERS, columns, strict=True):
            table[name] = np.where(fit.known, column, np.nan).ravel()
        table["flags"] = self._flags(fit, names)
        common = table["name"].isin(fit.shared)
        table["session"] = table["session"].astype(object).mask(common, None)
        everywhere = table["name"].isin(fit.cause_parameters)
        table.loc[everywhere, ["joint", "direction", "session"]] = [ALL_JOINTS, "", None]
        return table[~((common | everywhere) & table.duplicated(["name", "direction"]))]

    def _flags(self, fit: JointFit, names: list[str]) -> list[tuple[str, ...]]:
        """Flags of each parameter; a shared one has those of all its sessions."""
        raised: dict[tuple[str, str, str], list[str]] = {}
        for flag in self.flags:
            if flag.joint in (fit.law.joint, ALL_JOINTS):
                for name in flag.parameters:
                    everywhere = not flag.session or name in fit.shared
                    for session in fit.groups["session"].unique() if everywhere else [flag.session]:
                        for direction in flag.direction or "+-":
                            raised.setdefault((session, direction, name), []).append(flag.flag)
        return [
            tuple(dict.fromkeys(raised.get((session, direction, name), ())))
            for session, direction in zip(fit.groups["session"], fit.groups["direction"], strict=True)
            for name in names
        ]

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Steps and step size for traverses, each by the parameters of its session and direction.

        Parameters
        ----------
        rows : DataFrame
            A log's columns. Steps are not needed; a law in which something carries over from the traverse
            before predicts each traverse from those of the traverses before it, and expects nothing to carry
            over where there are none.

        Returns
        -------
        DataFrame, indexed as `rows`
            steps; low, high: 95 % interval of the steps that a new traverse takes, its own scatter included;
            step_size in unit (nm or µrad); error_pct, the law's from its parameters, in %; and
            extrapolated_pct, the share of the traverse, in %, where no traverse of the fitted log went in its
            direction, so that the law is a guess there (NaN where the result does not know where they went).
            `Result.si` has the same in SI.

        Raises
        ------
        InputError
            For a session, direction or joint that was not fitted.
        """
        return convert_predictions(self.si.predict(rows), rows, self.machine)

    def for_session_to_come(self) -> Result:
        """The result as it predicts a session that is not in the log, see `JointFit.for_session_to_come`."""
        return replace(self, joints={joint: fit.for_session_to_come() for joint, fit in self.joints.items()})

    def _predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        needed = {name for fit in self.joints.values() for name in fit.law.columns} & {*DEPARTURES}
        if "steps" not in rows or needed <= {*rows.columns}:
            return self._predict_each(rows)

        def depart(rows: pd.DataFrame) -> Array:
            """As far as it is not the parameters' error; 0 of a traverse without a usable count.

            A count that is far off says nothing of the step size.
            """
            steps = expected_steps(rows["steps"], rows.get("check_every", 1))
            is_usable = rows["status"] == "ok" if "status" in rows else np.isfinite(steps)
            predicted = self._predict_each(rows)
            noise, error = self._noise_of(rows) ** 2, predicted["relative_error"].fillna(np.inf) ** 2
            departure = predicted["steps"] / steps - 1.0
            is_usable &= (noise > 0) & (departure**2 < OUTLYING_SD**2 * (noise + error))
            return np.where(is_usable, departure / (1.0 + error / noise), 0.0)

        return self._predict_each(follow_departures(rows, depart))

    def extrapolated_share(self, rows: pd.DataFrame) -> Array:
        """Share of each traverse where none of the fitted log's went in its direction, shape (n,).

        NaN of a joint of which that is not known.
        """
        start, stop = rows["start"].to_numpy(float), rows["stop"].to_numpy(float)
        joints, ways = rows["joint"].to_numpy(int), rows["direction"].to_numpy(object)
        share = np.full(len(rows), np.nan)
        for joint, fit in self.joints.items():
            for way in "+-" if fit.travel else "":
                own = (joints == joint) & (ways == way)
                stretches = fit.travel.get(way, ())
                share[own] = undriven_share(start[own], stop[own], stretches, self.machine.span(joint))
        return share

    def _noise_of(self, rows: pd.DataFrame) -> Array:
        """Repeatability of each row's joint and direction, relative, shape (n,)."""
        known = {
            (k, way): one.value for k, fit in self.joints.items() for way, one in fit.repeatability.items()
        }
        return np.array([known[key] for key in zip(rows["joint"], rows["direction"], strict=True)])

    def _predict_each(self, rows: pd.DataFrame) -> pd.DataFrame:
        tables = [self._predict_joint(k, rows[rows["joint"] == k]) for k in rows["joint"].unique()]
        if not tables:
            return pd.DataFrame(columns=list(PREDICTION_COLUMNS), dtype=float)
        return pd.concat(tables).loc[rows.index]

    def _predict_joint(self, joint: int, rows: pd.DataFrame) -> pd.DataFrame:
        if joint not in self.joints:
            raise InputError(f"joint {joint} was not fitted; this result knows joints {list(self.joints)}")
        fit = self.joints[joint]
        group = fit.group_index(rows)
        if np.any(group < 0):
            missing = rows.iloc[int(np.argmax(group < 0))]
            fitted = ", ".join(map(str, fit.groups["session"].unique()))
            raise InputError(
                f"joint {joint} was not fitted for session {missing['session']!r}, direction "
                f"{missing['direction']}; sessions fitted: {fitted}"
            )
        response, jacobian = fit.law.model(rows)(fit.values[group])
        spread = np.empty(len(rows))
        for own in np.unique(group):  # a matrix for each row would not fit into memory
            slopes = jacobian[group == own]
            spread[group == own] = np.sqrt(np.sum(slopes @ fit.covariance[own] * slopes, axis=1))
        reaches = {sign: t_quantile(level.df) for sign, level in fit.repeatability.items()}
        total = rows["direction"].map(reaches).to_numpy(float) * np.hypot(spread, self._noise_of(rows))
        steps = np.exp(response)
        with np.errstate(over="ignore"):  # next to nothing known: the interval has no end
            low, high = np.exp(response - total), np.exp(response + total)
        return pd.DataFrame(
            {
                "steps": steps,
                "step_size": traverse_length(rows) / steps,
                "relative_error": spread,
                "low": low,
                "high": high,
            },
            index=rows.index,
        )


@dataclass(frozen=True)
class ResultInSI:
    """The tables of a result in SI: m and rad, ratios as fractions."""

    result: Result

    @property
    def parameters(self) -> pd.DataFrame:
        """As `Result.parameters`; unit remains the one people read the numbers in."""
        return self.result._collect_parameters()

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """As `Result.predict`, in rad or m; relative_error and extrapolated as fractions."""
        return self.result._predict(rows).assign(extrapolated=self.result.extrapolated_share(rows))


def convert_table(table: pd.DataFrame, numbers: Sequence[str]) -> pd.DataFrame:
    """A table whose columns `numbers` are SI, with these in the unit of each row's column unit."""
    table = table.copy()
    for name in numbers:
        values = zip(table[name].to_numpy(float), table["unit"], strict=True)
        shown = [from_si(float(value), unit) if unit in UNITS else value for value, unit in values]
        table[name] = np.array(shown, dtype=float)
    return table


def convert_predictions(predicted: pd.DataFrame, rows: pd.DataFrame, machine: Machine) -> pd.DataFrame:
    """Predictions in SI, with step sizes in nm or µrad and relative errors in %."""
    units = {int(joint): step_unit(int(joint), machine) for joint in rows["joint"].unique()}
    table = predicted.assign(unit=rows["joint"].map(units).astype(object))
    table = convert_table(table, ["step_size"])
    for name, shown in (("relative_error", "error_pct"), ("extrapolated", "extrapolated_pct")):
        if name in table:
            table[shown] = from_si(table[name].to_numpy(float), "%")
    return table[[name for name in SHOWN_PREDICTION_COLUMNS if name in table]]


MIN_REPLICATE_DF = 3  # degrees of freedom


def choose_repeatability(joint: int, direction: str, calibration: Result, fit: Result) -> NoiseLevel:
    """The replicates' repeatability; the fit's residuals' where there are few replicates."""
    replicates = calibration.joints[joint].repeatability[direction]
    return replicates if has_enough_replicates(replicates) else fit.joints[joint].repeatability[direction]


def has_enough_replicates(noise: NoiseLevel) -> bool:
    """Whether the repeatability comes from replicates, not residuals, with enough degrees of freedom."""
    return noise.source == "replicates" and noise.df >= MIN_REPLICATE_DF


FORMAT, VERSION = "stickslip-fit/result", 1
COMMON_TOL = 1e-6  # relative, and of a standard error: each group has its own rounding
ROUNDING_TOL = 1e-12  # of a correlation
MAX_WHOLE = 1000  # parameters of causes, beyond which covariances are kept by their parts
SCHEMA = f"{FORMAT}/{VERSION}"


def result_to_json(result: Result) -> dict[str, Any]:
    """The content of the file that `Result.save` writes, but for its checksum; plain JSON types.

    Of causes with hundreds of parameters nearly all of a group's covariance is that of all other groups, too.
    """
    common = _common_covariance(result.joints.values())
    return {
        "schema": SCHEMA,
        "method": result.method,
        "parameters": parameters_to_json(result.parameters),
        "remarks": [asdict(flag) for flag in result.flags],
        "provenance": asdict(result.provenance),
        "machine": _machine_to_json(result.machine),
        **({} if common is None else {"cause_covariance": _triangle_to_json(common)}),
        "joints": [_joint_to_json(fit, common) for fit in result.joints.values()],
        "residuals": {
            "row": [int(row) for row in result.residuals.index],
            "joint": [int(joint) for joint in result.residuals["joint"]],
            "residual": to_plain(result.residuals["residual"].to_numpy(float)),
            "used": [bool(used) for used in result.residuals["used"]],
        },
    }


def write_result_json(content: dict[str, Any], path: str | Path, sources: Sequence[str] = ()) -> None:
    """Write the content of a result's file with its checksum.

    Raises InputError if it cannot be written, or is one of the files `sources` that the result is of.
    """
    content = content | {"checksum": compute_checksum(content)}
    many = len(content.get("cause_covariance", ())) > MAX_WHOLE
    write_json(path, content, sources, indent=None if many else 1)


def compute_checksum(content: dict[str, Any]) -> str:
    """The sha256 of a file's content, however it is laid out, but for the checksum itself."""
    rest = {key: value for key, value in content.items() if key != "checksum"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def parameters_to_json(table: pd.DataFrame) -> list[dict[str, Any]]:
    """`Result.parameters`, as saved."""
    return [
        {
            "name": row.name,
            "joint": int(row.joint) or None,
            "direction": str(row.direction) or None,
            "session": None if row.session is None else str(row.session),
            "unit": row.unit,
            **{number: to_plain(getattr(row, number)) for number in PARAMETER_NUMBERS},
            "flags": list(row.flags),
        }
        for row in table.itertuples(index=False)
    ]


def _machine_to_json(machine: Machine) -> dict[str, Any]:
    """The machine's fields but those that it does not have, or that every published arm has."""
    content, arm = asdict(machine), machine.has_published_geometry
    absent = ("kinds", "joint_names") if arm else ("a1", "l2", "links")
    return {name: value for name, value in content.items() if name not in absent}


def _common_covariance(fits: Iterable[JointFit]) -> Array | None:
    """Covariance of the causes' parameters, (q, q), which all groups with error bars share; None without."""
    common = None
    for fit in fits:
        own = fit.values.shape[1] - len(fit.cause_parameters)
        if isinstance(fit.covariance, SharedCovariance):
            return fit.covariance.shared
        for matrix in fit.covariance:
            block, unknown = matrix[own:, own:], np.isnan(matrix[own:]).all()
            if unknown or not len(block):
                continue
            common = block if common is None else common
            slack = COMMON_TOL * np.sqrt(np.abs(np.outer(np.diag(common), np.diag(common))))
            if np.isnan(matrix[own:]).any() or np.any(np.abs(block - common) > slack):
                return None
    return common


def _triangle_to_json(covariance: Array) -> list[list[float]]:
    """The lower triangle, to ten digits, without what is rounding beside the variances."""
    sd = np.sqrt(np.abs(np.diag(covariance)))
    kept = np.where(np.abs(covariance) > ROUNDING_TOL * np.outer(sd, sd), covariance, 0.0)
    return [
        [float(f"{value:.10g}") if value else 0.0 for value in row[: k + 1].tolist()]
        for k, row in enumerate(kept)
    ]


def _joint_to_json(fit: JointFit, common: Array | None) -> dict[str, Any]:
    own = fit.values.shape[1] - (0 if common is None else len(common))
    return {
        "law": describe(fit.law),
        "sessions": [str(session) for session in fit.groups["session"]],
        "directions": [str(direction) for direction in fit.groups["direction"]],
        "shared": list(fit.shared),
        "values": to_plain(fit.values),
        "known": fit.known.tolist(),
        "covariance": to_plain(
            fit.covariance.columns
            if isinstance(fit.covariance, SharedCovariance)
            else fit.covariance[:, :, :own]
        ),
        "interval": to_plain(fit.interval),
        "repeatability": {
            direction: {**asdict(noise), "value": to_plain(noise.value)}
            for direction, noise in fit.repeatability.items()
        },
        **({"travel": {way: [*map(list, own)] for way, own in fit.travel.items()}} if fit.travel else {}),
    }
