"""The law of a table fitted, as it is or extended by the causes of a diagnosis, with its covariance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from stickslip_fit._format import pluralize
from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes.roles import ORDER, TableRoles
from stickslip_fit.causes.times import read_times
from stickslip_fit.diagnosis.finding import TableInfo
from stickslip_fit.diagnosis.linearized import ExtendedFit, LawBlock, whiten
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.estimation.result import library_versions
from stickslip_fit.estimation.table_fit import TableFit, TableSource

BOUND_TOL = 1e-9  # of a parameter's size
RANK_TOL = 1e-10  # of singular values, columns of unit length


def make_table_fit(
    problem: DiagnosisProblem, fit: ExtendedFit, table: TableInfo, *, command: str = ""
) -> TableFit:
    """A fit of a table's law as a result; values that the problem has no more were set aside as outlying."""
    (part,) = fit.parts
    named = {role: column for role, column in table.roles.items() if column}
    roles = TableRoles(**named, time_unit=table.time_unit)
    n_shared = problem.n_shared + len(fit.values)
    n_own = part.values.shape[1] - n_shared
    session = problem.rows["session"].astype(str).to_numpy(object)[part.rows]
    names, first, index = np.unique(session, return_index=True, return_inverse=True)
    values = part.values[first]
    on_bound = _find_on_bound(part, values, n_own)
    jacobian = _whitened_jacobian(problem, part, index.ravel(), len(names), n_own)
    covariance, unknown = _covariance(jacobian, on_bound)
    flags = _list_flags(fit.converged, part, on_bound, unknown, n_own)
    if n_aside := table.rows - len(problem):
        flags = [*flags, f"{pluralize(n_aside, 'value')} of {table.response} set aside as outlying"]
    rows, predicted = problem.rows.iloc[part.rows], problem.responses[part.rows] - fit.residual[part.rows]
    residuals = pd.DataFrame(
        {
            "session": session,
            **({roles.time: rows[roles.time].to_numpy()} if roles.time in rows else {}),
            "measured": problem.responses[part.rows],
            "predicted": predicted,
            "residual": fit.residual[part.rows],
        }
    )
    return TableFit(
        law=part.law,
        roles=roles,
        sessions=tuple(map(str, names)),
        begins=_find_begins(rows, roles),
        values=values,
        n_shared=n_shared,
        covariance=covariance,
        noise_sd=float(np.sqrt(np.mean(problem.scale**2))),
        autocorrelation=problem.correlation,
        residuals=residuals,
        flags=tuple(flags),
        source=TableSource(
            table.file, table.sha256, table.files, table.rows, table.independent, library_versions(), command
        ),
    )


def _find_begins(rows: pd.DataFrame, roles: TableRoles) -> dict[str, float]:
    if roles.time is None or roles.time == ORDER or roles.time not in rows:
        return {}
    first = (
        pd.Series(read_times(rows[roles.time]).seconds).groupby(rows["session"].astype(str).to_numpy()).min()
    )
    return {str(name): float(value) for name, value in first.items()}


def _whitened_jacobian(
    problem: DiagnosisProblem, part: LawBlock, session: IntArray, n_sessions: int, n_own: int
) -> Array:
    """Derivatives of every response by each session's own parameters, then by the shared ones, (n + m, q).

    The last m rows are the prior distributions of coefficients that have one.
    """
    n, slopes = len(problem), np.zeros((len(problem), part.values.shape[1]))
    slopes[part.rows] = part.law.jacobian(problem.rows.iloc[part.rows], part.values)
    own = np.zeros((n, n_sessions, n_own))
    own[part.rows, session] = slopes[part.rows, :n_own]
    columns = np.concatenate([own.reshape(n, -1), slopes[:, n_own:]], axis=1)
    measured = whiten(columns, problem.scale, problem.noise_filter)
    # What is known of a coefficient beforehand counts as one more row.
    prior = np.array([getattr(one, "prior_sd", np.inf) for one in part.law.parameters[n_own:]])
    known = np.flatnonzero(np.isfinite(prior))
    rows = np.zeros((len(known), columns.shape[1]))
    rows[np.arange(len(known)), columns.shape[1] - len(prior) + known] = 1.0 / prior[known]
    return np.concatenate([measured, rows])


def _find_on_bound(part: LawBlock, values: Array, n_own: int) -> BoolArray:
    """Which parameters are on a bound, shape (q,)."""
    low, high = np.array([(one.lower, one.upper) for one in part.law.parameters]).T
    tolerance = BOUND_TOL * np.maximum(np.abs(values), 1e-300)
    on_bound = (values <= low + tolerance) | (values >= high - tolerance)
    return np.concatenate([on_bound[:, :n_own].ravel(), on_bound[0, n_own:]])


def _covariance(jacobian: Array, on_bound: BoolArray) -> tuple[Array, BoolArray]:
    """Covariance of the parameters, (q, q), those on a bound held there, and which of them are not known."""
    covariance, unknown = np.full((len(on_bound),) * 2, np.nan), np.zeros(len(on_bound), dtype=bool)
    free = np.flatnonzero(~on_bound)
    columns = jacobian[:, free]
    length = np.linalg.norm(columns, axis=0)
    length = np.where(length > 0, length, 1.0)
    _, singular, right = svd(columns / length)
    lost = singular <= RANK_TOL * singular.max(initial=0.0)
    unknown[free] = np.any(np.abs(right[lost]) > 1e-6, axis=0)
    inverse = (right[~lost].T / singular[~lost] ** 2) @ right[~lost]
    scaled = inverse / length[:, None] / length
    scaled[unknown[free]] = np.nan
    scaled[:, unknown[free]] = np.nan
    covariance[np.ix_(free, free)] = scaled
    return covariance, unknown


def _list_flags(
    converged: bool, part: LawBlock, on_bound: BoolArray, unknown: BoolArray, n_own: int
) -> list[str]:
    names = [one.name for one in part.law.parameters]
    own, shared = names[:n_own], names[n_own:]
    n_sessions = (len(on_bound) - len(shared)) // max(n_own, 1) if n_own else 0
    every = [*own * n_sessions, *shared]

    def list_names(which: BoolArray) -> Iterator[str]:
        return iter(dict.fromkeys(name for name, flag in zip(every, which, strict=True) if flag))

    flags = [] if converged else ["the fit did not converge"]
    flags += [f"{name} is on a bound, where it has no standard error" for name in list_names(on_bound)]
    flags += [f"{name} cannot be known from this table" for name in list_names(unknown)]
    return flags
