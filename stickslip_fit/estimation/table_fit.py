"""TableFit: a law of a table, fitted: parameters with intervals, residuals, predictions; saved as JSON.

Intervals allow for the autocorrelation of the noise: the covariance is that of generalized least squares (A.
Aitken, Proc. R. Soc. Edinburgh 55:42, 1936), and the quantile is Student's t with as many degrees of freedom
as there are independent values beyond the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._json import to_plain, write_json
from stickslip_fit._summary import Summarized
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.late_columns import find_late
from stickslip_fit.causes.levels import LevelCause
from stickslip_fit.causes.roles import ORDER, ROW_NUMBER, TableRoles, prepare_rows
from stickslip_fit.causes.times import read_times
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.estimation._table_law_json import describe_table_law
from stickslip_fit.estimation.noise import t_quantile
from stickslip_fit.estimation.result import AxesArray, compute_checksum

OWN_COLUMNS = ("session", "session_seconds", "joint")  # which `prepare_rows` makes
MAX_NAMED = 10


@dataclass(frozen=True)
class TableSource:
    """Where a fit comes from.

    Attributes
    ----------
    file, sha256 : str
        Of the table; the file is empty for one that was never in a file.
    files : tuple of str
        What was read, which `TableFit.save` does not replace.
    rows : int
        With a response.
    independent : float
        How many independent values tell as much.
    """

    file: str
    sha256: str
    files: tuple[str, ...]
    rows: int
    independent: float
    versions: dict[str, str]
    command: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class TableFit(Summarized):
    """A fitted law of a table, with causes in it or without; g sessions.

    Attributes
    ----------
    law : object
        A `TableLaw`, or one with causes: own parameters of each session first, shared ones last.
    roles : TableRoles
    sessions : tuple of str
    begins : mapping of str to float
        Time of each session's first row, as the table has it (s since 1970 for times of day).
    values : array, shape (g, p)
    n_shared : int
        How many of the p parameters, the last ones, all sessions share.
    covariance : array, shape (q, q)
        Of the own parameters, session by session, then the shared ones; NaN of those on a bound.
    noise_sd : float
        Standard deviation of the noise, in the unit of the response.
    autocorrelation : array
        Coefficients of the noise's autoregression, the nearest value first; empty for independent noise.
    residuals : DataFrame
        A row for each value that was used, in order of time within each session: session, the time if there
        is one, measured, predicted, residual.
    flags : tuple of str
        What is wrong with the fit, in sentences.
    source : TableSource
    """

    law: Any
    roles: TableRoles
    sessions: tuple[str, ...]
    begins: Mapping[str, float]
    values: Array
    n_shared: int
    covariance: Array
    noise_sd: float
    autocorrelation: Array
    residuals: pd.DataFrame
    flags: tuple[str, ...]
    source: TableSource

    @property
    def n_own(self) -> int:
        """Parameters of which each session has its own value."""
        return self.values.shape[1] - self.n_shared

    @property
    def df(self) -> int:
        """Degrees of freedom of intervals, at least 1: of the independent values the share beyond parameters.

        Parameters take rows, each of which counts as less than one independent value.
        """
        rows = max(self.source.rows, 1)
        return max(int(self.source.independent * (rows - len(self.covariance)) / rows), 1)

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter: name, session (None for one of all), unit, estimate, standard_error, low, high.

        Numbers are in the table's own units; low and high bound 95 %. They and the standard error are NaN
        where the parameter is on a bound.
        """
        own, shared = self.law.parameters[: self.n_own], self.law.parameters[self.n_own :]
        named = [
            *((one, session) for session in self.sessions for one in own),
            *((one, getattr(one, "session", None)) for one in shared),
        ]
        estimate = np.concatenate([self.values[:, : self.n_own].ravel(), self.values[0, self.n_own :]])
        error = np.sqrt(np.diag(self.covariance))
        reach = t_quantile(self.df) * error
        return pd.DataFrame(
            {
                "name": [one.name for one, _ in named],
                "session": pd.Series([session for _, session in named], dtype=object),
                "unit": pd.Series([one.unit for one, _ in named], dtype=object),
                "estimate": estimate,
                "standard_error": error,
                "low": estimate - reach,
                "high": estimate + reach,
            }
        )

    @property
    def rms(self) -> float:
        """Root mean square residual."""
        return float(np.sqrt(np.mean(self.residuals["residual"] ** 2)))

    def predict(self, frame: pd.DataFrame) -> pd.DataFrame:
        """The response of other rows, each by the parameters of its session.

        Parameters
        ----------
        frame : DataFrame
            With the columns that the law uses; the response is not needed.

        Returns
        -------
        DataFrame, indexed as `frame`
            predicted; standard_error (of the prediction, from the parameters); low, high: 95 % interval of a
            new value, noise included.

        Raises
        ------
        InputError
            For a column that is missing or no number, and for a session that was not fitted.
        """
        rows = self._prepare(frame)
        session = self._session_index(rows)
        predicted, slopes = self.law.model(rows)(self.values[session])
        places = self._places(session)
        known = np.where(np.isnan(self.covariance), 0.0, self.covariance)
        each = known[places[:, :, None], places[:, None, :]]
        error = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", slopes, each, slopes), 0.0))
        reach = t_quantile(self.df) * np.hypot(error, self.noise_sd)
        table = pd.DataFrame(
            {
                "predicted": predicted,
                "standard_error": error,
                "low": predicted - reach,
                "high": predicted + reach,
            },
            index=rows[ROW_NUMBER],
        )
        return table.sort_index().set_axis(frame.index)

    def _prepare(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Rows as the law's causes see them, times counted from where each fitted session began."""
        if not isinstance(frame, pd.DataFrame):
            raise InputError(f"predict needs a DataFrame, not {type(frame).__name__}")
        base = getattr(self.law, "law", self.law)
        response = set(base.left.names) - set(base.right.names)
        needed = [name for name in self.law.columns if name not in response]
        needs_time = "session_seconds" in needed or bool(find_late(needed, frame, self.roles.time_unit))
        texts = {self.roles.direction, self.roles.group, self.roles.session}
        texts |= {getattr(getattr(cause, "source", None), "by", None) for cause in self._causes}
        levels = [cause for cause in self._causes if isinstance(cause, LevelCause)]
        texts |= {name for cause in self._causes for name in cause.texts}
        numbers = [name for name in needed if name not in (*OWN_COLUMNS, *texts)]
        has_own = self.n_own > 0 or "session" in self.law.columns or any(one.session for one in self._causes)
        roles = replace(
            self.roles,
            session=self.roles.session if has_own or self.roles.session in frame else None,
            time=self.roles.time if needs_time else None,
            position=None,
            group=None,
            sigma=None,
            direction=self.roles.direction if self.roles.direction in needed else None,
        )
        rows = prepare_rows(frame, roles, numbers)
        if issues := [issue for cause in levels for issue in cause.find_unknown(frame)]:
            raise InputError(issues)
        if needs_time and roles.time != ORDER:
            seconds = read_times(frame[roles.time]).seconds[rows[ROW_NUMBER].to_numpy()]
            begin = pd.Series(seconds).groupby(rows["session"].to_numpy(object)).transform("min")
            fitted = rows["session"].map(dict(self.begins)).astype(float)
            rows["session_seconds"] = seconds - fitted.fillna(begin).to_numpy(float)
        return rows

    @property
    def _causes(self) -> tuple[Any, ...]:
        return tuple(getattr(self.law, "causes", ()))

    def _session_index(self, rows: pd.DataFrame) -> IntArray:
        if self.n_own == 0:
            return np.zeros(len(rows), dtype=np.intp)
        index = pd.Index(self.sessions).get_indexer(rows["session"].astype(str))
        if unknown := sorted({str(name) for name in rows["session"][index < 0]}):
            fitted = ", ".join(self.sessions[:MAX_NAMED]) + " ..." * (len(self.sessions) > MAX_NAMED)
            names = ", ".join(shorten(name) for name in unknown[:MAX_NAMED])
            raise InputError(
                f"no parameters are known for session {names}; sessions fitted: {fitted}. Fit a table with "
                "these sessions, or a law whose parameters are shared"
            )
        return index

    def _places(self, session: IntArray) -> IntArray:
        """Where the covariance has each row's parameters, shape (n, p)."""
        own = session[:, None] * self.n_own + np.arange(self.n_own)
        first = len(self.sessions) * self.n_own
        shared = np.broadcast_to(first + np.arange(self.n_shared), (len(session), self.n_shared))
        return np.concatenate([own, shared], axis=1)

    def save(self, path: str | Path) -> None:
        """Write the fit as JSON, for `load_table_fit`; nothing is left half-written.

        Raises
        ------
        InputError
            If the file cannot be written or was read for this fit; if the law or a cause in it is neither a
            formula nor a function that can be imported by a name.
        """
        content = table_fit_to_json(self)
        content |= {"checksum": compute_checksum(content)}
        write_json(path, content, self.source.files)

    def plot_measured(self) -> AxesArray:
        """Measured against predicted values, and the residuals over the prediction."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.table import plot_measured

        return collect_axes(plot_measured(self))


FORMAT, VERSION = "stickslip-fit/table-fit", 1


def table_fit_to_json(fit: TableFit) -> dict[str, Any]:
    """The content of the file, but for its checksum; plain JSON types."""
    numbers = ("estimate", "standard_error", "low", "high")
    return {
        "schema": f"{FORMAT}/{VERSION}",
        "parameters": [
            {"name": row.name, "session": row.session, "unit": row.unit}
            | {number: to_plain(getattr(row, number)) for number in numbers}
            for row in fit.parameters.itertuples(index=False)
        ],
        "flags": list(fit.flags),
        "law": describe_table_law(fit.law),
        "roles": fit.roles.columns,
        "time_unit": fit.roles.time_unit,
        "sessions": list(fit.sessions),
        "begins": dict(fit.begins),
        "n_shared": fit.n_shared,
        "values": fit.values.tolist(),
        "covariance": to_plain(fit.covariance),
        "noise_sd": fit.noise_sd,
        "autocorrelation": fit.autocorrelation.tolist(),
        "residuals": {str(name): _cells(column) for name, column in fit.residuals.items()},
        "source": asdict(fit.source) | {"files": list(fit.source.files)},
    }


def _cells(column: pd.Series[Any]) -> list[Any]:
    if pd.api.types.is_numeric_dtype(column):
        return to_plain(column.to_numpy(float))
    return [str(value) for value in column]
