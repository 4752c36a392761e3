"""diagnose_table: the diagnosis of any table under any law. `pipeline` has the mathematics.

The table becomes a `DiagnosisProblem` as a log does: rows in order of time within each session, the law
fitted to each session, the user's causes beside the generic ones (`causes.table_library`), and unstructured
alternatives (`table_alternatives`). Where rows are samples of a signal, the autocorrelation of their noise is
estimated and removed (`autocorrelation`), and smooth functions of time and waves have to be likelier than
what is found without these (`time_or_columns`).
"""

from __future__ import annotations

import time as clock
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._threads import one_blas_thread
from stickslip_fit._typing import Array
from stickslip_fit.causes import table_library
from stickslip_fit.causes.empty_cells import leave_out_gaps
from stickslip_fit.causes.generic import SessionOffset
from stickslip_fit.causes.late_columns import with_late_columns
from stickslip_fit.causes.levels import ParametersBySession, most_labels
from stickslip_fit.causes.roles import ROW_NUMBER, TableRoles, prepare_rows
from stickslip_fit.causes.times import find_times
from stickslip_fit.diagnosis.autocorrelation import number_samples
from stickslip_fit.diagnosis.extended_table import make_table_fit
from stickslip_fit.diagnosis.finding import TableInfo
from stickslip_fit.diagnosis.lagged import find_late_columns
from stickslip_fit.diagnosis.linearized import LawBlock, linearize_fit
from stickslip_fit.diagnosis.noise_growth import with_growing_noise
from stickslip_fit.diagnosis.pipeline import diagnose_problem
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.diagnosis.table_alternatives import TableAlternatives, response_columns
from stickslip_fit.diagnosis.table_noise import weigh_rows, with_samples
from stickslip_fit.diagnosis.table_rows import (
    as_law,
    declared_time_unit,
    describe_choices,
    describe_late_columns,
    describe_weights,
    find_columns,
    name_file,
    read_rows,
)
from stickslip_fit.diagnosis.time_or_columns import prefer_columns
from stickslip_fit.errors import InputError, InputIssue, check_alpha, check_count
from stickslip_fit.estimation.table_fit import TableFit
from stickslip_fit.estimation.table_law import fit_table_law
from stickslip_fit.logs._numbers import with_numbers
from stickslip_fit.logs.schema import COVARIATE_PREFIX

MAX_RATIO = 1e15  # of a response to their median, beside which the others are lost in rounding
# Of the noise, relative to the responses' standard deviation and to the largest of them; less is rounding.
MIN_RELATIVE_SD, ROUNDING = 1e-9, 1e-13
NO_TIME = "no column was named as the time; "
N_REFITS = 4
MAX_CAUSES = 6  # a table may have many columns
NO_POSITION = "no column was named as the position"
NO_DIRECTION = "no column was named as the direction"


@one_blas_thread
def diagnose_table(
    frame: pd.DataFrame | str | Path,
    law: Any,
    *,
    response: str | None = None,
    session: str | None = None,
    time: str | None = None,
    position: str | None = None,
    direction: str | None = None,
    group: str | None = None,
    sigma: str | None = None,
    causes: Iterable[Any] = (),
    generic_causes: Iterable[Any] | None = None,
    shared: Iterable[str] | str | None = None,
    sheet: str | None = None,
    alpha: float = 0.01,
    seed: int = 0,
    gain: bool = True,
    progress: ProgressCallback = ignore_progress,
) -> Diagnosis:
    """Test a law on a table, name the causes of a misfit, and measure what the causes gain.

    Parameters
    ----------
    frame : DataFrame or path of a CSV, Excel or Parquet file
        One row for each measurement.
    law : Law or str
        A formula such as ``"F ~ M*acc + Fv*vel + offset"``, or a `Law`.
    response : str, optional
        Where the law does not say what it predicts.
    session : str, optional
        Column whose values share the law's own parameters; one session without it.
    time : str, optional
        Column of times of day, or of numbers: in the unit that the law's `units` give, else in that in which
        the column's name ends (``t_min``, ``t (h)``), else in seconds. ``"order"``: rows stand in the order
        in which they were measured. Without it their order means nothing, and nothing that needs time is
        tested.
    position, direction, group : str, optional
        Columns of where something stands, of which way it moves (two values, or numbers whose signs count),
        and of what belongs together.
    sigma : str, optional
        Column of uncertainties of the response: rows are weighted by 1 / sigma^2. Only their ratios count;
        the scale is estimated. Without it the noise may grow with the response where it clearly does.
    causes : iterable of Cause, optional
        Candidates beside the generic ones.
    generic_causes : iterable of Cause, optional
        In place of all of `causes.generic_causes`; ``()`` for none.
    shared : iterable of str or "all", optional
        Parameters of the law with one value for the whole table; by default what the law says.
    sheet : str, optional
        Of an Excel workbook; the first one without it.
    alpha : float, optional
        False-alarm rate over all tests.
    seed : int, optional
    gain : bool, optional
        False only names the causes.
    progress : callable, optional
        Called with the step that begins and the share of the work that is done.

    Raises
    ------
    InputError
        With every fault of the table and its roles; as `Law.bind_table`; if `alpha` is not between 0.001
        and 0.2, or `seed` is negative.
    """
    began = clock.perf_counter()
    check_alpha(alpha)
    check_count("seed", seed, least=0)
    law, causes = as_law(law), tuple(causes)
    roles = TableRoles(session, time, position, direction, group, sigma)
    used, levels = find_columns(law, response, causes), [str(getattr(cause, "by", "")) for cause in causes]
    with name_file(frame, sheet):
        table, source = read_rows(frame, sheet, roles, used, levels)
        table, notes = leave_out_gaps(table, {*used, *levels, *roles.columns.values()})
        # The text of a column may have stood in a row that was left out.
        table = with_numbers(table, [*used, *roles.number_columns])
        source["notes"] = (*source["notes"], *notes, *describe_choices(table, roles, law))
        roles = replace(roles, time_unit=declared_time_unit(law, table, time))
        if shared is not None:
            law = replace(law, shared=shared if isinstance(shared, str) else tuple(shared))
        progress("fitting the law", 0.0)
        problem, missing = problem_from_table(
            table, law, response=response, roles=roles, causes=causes, generic_causes=generic_causes
        )
    if not roles.sigma:
        problem = with_growing_noise(problem)
    search = partial(diagnose_problem, missing=missing, alpha=alpha, seed=seed, progress=progress)
    diagnosis = prefer_columns(problem, search(problem), search)
    info = describe_table(problem, diagnosis.selection.problem, roles, source)
    diagnosis = replace(diagnosis, table=info, seconds=clock.perf_counter() - began)
    return diagnosis.measure_gain(progress=progress) if gain else diagnosis


def fit_table(
    frame: pd.DataFrame | str | Path,
    law: Any,
    *,
    response: str | None = None,
    session: str | None = None,
    time: str | None = None,
    sigma: str | None = None,
    shared: Iterable[str] | str | None = None,
    sheet: str | None = None,
    command: str = "",
) -> TableFit:
    """Fit a law to a table, as it is: no cause is searched, and no value set aside.

    With a time the autocorrelation of the noise is in the intervals.

    Parameters
    ----------
    frame, law, response, session, time, sigma, shared, sheet
        As of `diagnose_table`.
    command : str, optional
        For the result's provenance.

    Raises
    ------
    InputError
        As `diagnose_table`.
    """
    roles, law = TableRoles(session, time, sigma=sigma), as_law(law)
    with name_file(frame, sheet):
        table, source = read_rows(frame, sheet, roles, find_columns(law, response, ()))
        if shared is not None:
            law = replace(law, shared=shared if isinstance(shared, str) else tuple(shared))
        problem, _ = problem_from_table(table, law, response=response, roles=roles, generic_causes=())
    correlated = problem.with_autocorrelation()
    linearized = correlated.linearize()
    factor = float(np.sqrt(np.sum(linearized.residual**2) / max(linearized.df, 1)))
    scaled = replace(correlated, repeatability=factor * correlated.repeatability)
    info = describe_table(problem, scaled, roles, source)
    return make_table_fit(scaled, scaled.fit_extended(), info, command=command)


def problem_from_table(
    frame: pd.DataFrame,
    law: Any,
    *,
    response: str | None = None,
    roles: TableRoles | None = None,
    causes: Iterable[Any] = (),
    generic_causes: Iterable[Any] | None = None,
) -> tuple[DiagnosisProblem, dict[str, str]]:
    """A table under a law, fitted to each session.

    Parameters
    ----------
    frame, law, response, causes, generic_causes
        As of `diagnose_table`.

    Returns
    -------
    problem : DiagnosisProblem
    missing : dict of str to str
        Generic causes for which the table has no column, with the reason.

    Raises
    ------
    InputError
        As `diagnose_table`.
    """
    roles = TableRoles() if roles is None else roles
    law = as_law(law)
    names = [str(name) for name in getattr(frame, "columns", ())]
    prepare_rows(frame, roles, [name for name in find_columns(law, None, ()) if name in names])
    own = frame.drop(columns=ROW_NUMBER, errors="ignore")
    bound = law.bind_table(own, response=response, session=roles.session)
    rows = prepare_rows(frame, roles, bound.columns)
    y, rounding = bound.response(rows)
    _check_response(y, rows, bound.response_name)
    part, repeatability = _fit_law(bound, rows, y)
    least_sd = MIN_RELATIVE_SD * float(np.std(y)) + ROUNDING * (float(np.abs(y).max()) or 1.0)
    session = pd.factorize(rows["session"])[0].astype(np.intp)
    group = pd.factorize(rows[roles.group])[0].astype(np.intp) if roles.group else session
    seconds = rows["session_seconds"].to_numpy(float)
    sample = number_samples(seconds, session) if roles.time else None
    if sample is not None and generic_causes is None and repeatability > least_sd:
        scale = np.full(len(rows), repeatability)
        linearized = linearize_fit(RowTable(rows), (part,), y, scale, shared=bound.n_shared)
        numbers = [
            name
            for name in table_library.covariate_columns(rows, bound, roles)
            if table_library.is_numeric(rows[name])
        ]
        late = find_late_columns(linearized, numbers, sample, roles.time_unit)
        rows = with_late_columns(rows, late)
    built = (
        table_library.generic_causes(rows, bound, roles) if generic_causes is None else tuple(generic_causes)
    )
    candidates = _bind_causes((*causes, *built), bound, rows)
    covariates = table_library.covariate_columns(rows, bound, roles)
    alternatives = TableAlternatives.of(rows, bound, roles, covariates, sample is not None)
    problem = DiagnosisProblem(
        table=RowTable(rows),
        parts=(part,),
        responses=y,
        rounding=rounding,
        noise_group=np.zeros(len(rows), dtype=np.intp),
        repeatability=np.array([max(repeatability, least_sd)]),
        causes=candidates,
        alternatives=alternatives,
        expressions=alternatives.expressions,
        configuration=group,
        noise_ratio=np.ones(len(rows)),
        n_shared=bound.n_shared,
        outlier_cause="outliers",
        max_causes=MAX_CAUSES,
        smooth_columns=rows[list(alternatives.columns)].to_numpy(float),
        n_refits=N_REFITS,
        least_sd=least_sd,
        noise_columns=tuple(dict.fromkeys((*alternatives.columns, *covariates))),
    )
    if roles.sigma:
        problem = weigh_rows(problem, rows[roles.sigma].to_numpy(float))
    missing = _explain_missing(rows, bound, roles) if generic_causes is None else {}
    if sample is None or repeatability <= least_sd:  # without scatter there is no noise to be coloured
        return problem, missing
    time_unit = roles.time_unit if generic_causes is None else None
    return with_samples(problem, alternatives, sample, time_unit), missing


def describe_table(
    problem: DiagnosisProblem, searched: DiagnosisProblem, roles: TableRoles, source: Mapping[str, Any]
) -> TableInfo:
    """What a diagnosis says of its table; `searched` is the problem with the noise as the search left it.

    `source` is as of `read_rows`.
    """
    law, noise = problem.parts[0].law, searched.autocorrelation
    length = 1.0 if noise is None else noise.correlation_rows
    interval = np.nan
    if roles.time and len(problem) > 1:
        spacing = np.diff(problem.rows["session_seconds"].to_numpy(float))
        interval = float(np.median(spacing[spacing > 0])) if np.any(spacing > 0) else np.nan
    info = TableInfo(
        response=str(law.response_name),
        unit=str(law.response_unit),
        response_sd=float(np.std(problem.responses)),
        rows=len(problem),
        independent=len(problem) / length,
        correlation_rows=length,
        correlation_time=length * interval,
        noise_period=np.nan if noise is None else noise.period_rows * interval,
        time_unit=roles.time_unit,
        roles=roles.columns,
        unnamed_time="" if roles.time else find_times(problem.rows),
        **source,
    )
    late = describe_late_columns(problem.rows, roles.time_unit)
    return replace(info, notes=(*info.notes, *late, *describe_weights(searched, info)))


def _check_response(y: Array, rows: pd.DataFrame, name: str) -> None:
    """Refuse responses of which nothing can be learnt."""
    if len(y) > 1 and np.ptp(y) == 0:
        raise InputError(
            f"the response is constant: {name} is {y[0]:g} in every row; there is nothing to explain"
        )
    size = np.abs(y)
    usual = float(np.median(size[size > 0])) if size.any() else 0.0
    if (far := size > MAX_RATIO * usual).any():
        issues = [
            InputIssue(
                f"is more than {MAX_RATIO:.0e} times as large as is usual here; correct it, or leave out its "
                "row",
                line=int(row) + 1,
                place=f"row {row + 1}",
                column=name,
                value=f"{value:g}",
            )
            for row, value in zip(rows.loc[far, ROW_NUMBER], y[far], strict=True)
        ]
        raise InputError(issues[:3])


def _fit_law(law: Any, rows: pd.DataFrame, y: Array) -> tuple[LawBlock, float]:
    """The law fitted to each session, and the standard deviation of what it leaves."""
    size = float(np.std(y)) or 1.0
    scale = np.full(len(rows), size)
    part = LawBlock(
        law,
        np.arange(len(rows)),
        pd.factorize(rows["session"])[0].astype(np.intp),
        fit_table_law(law, rows, y, scale),
        np.array([one.lower for one in law.parameters]),
        np.array([one.upper for one in law.parameters]),
    )
    residual = y - law.predict(rows, part.values)
    df = max(linearize_fit(RowTable(rows), (part,), y, scale, shared=law.n_shared).df, 1)
    return part, float(np.sqrt(np.sum(residual**2) / df))


def _bind_causes(causes: Iterable[Any], law: Any, rows: pd.DataFrame) -> tuple[Any, ...]:
    bound = tuple(cause.bind_table(law, rows) if hasattr(cause, "bind_table") else cause for cause in causes)
    names = [cause.name for cause in bound]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(
            [InputIssue(f"there are two causes {name!r}; give one another name") for name in repeated]
        )
    return bound


def _explain_missing(rows: pd.DataFrame, law: Any, roles: TableRoles) -> dict[str, str]:
    missing: dict[str, str] = {}
    if not roles.time:
        advice = "where rows stand in the order of measurement, name 'order' as it"
        if times := find_times(rows):
            advice = f"name {times!r} as it, which has times"
        missing |= dict.fromkeys(["drift", "warm-up", "sudden-change", "memory"], NO_TIME + advice)
    if not roles.position:
        missing |= dict.fromkeys(["position", "periodic-in-position"], NO_POSITION)
    if not roles.direction:
        missing["offset-by-direction"] = NO_DIRECTION
    sessions = rows["session"].nunique() if law.n_shared else 0
    for name, most, own in (
        (SessionOffset.base_name, table_library.MAX_SESSIONS, "an offset each"),
        (ParametersBySession.base_name, most_labels(law), "parameters of their own"),
    ):
        if sessions > most:
            missing[name] = f"the table has {sessions:,} sessions, and at most {most} can have {own}"
    used = {
        *law.columns,
        *response_columns(law),
        *roles.columns.values(),
        "session",
        "session_seconds",
        "joint",
        ROW_NUMBER,
    }
    for name in map(str, rows.columns):
        why = None if name in used else table_library.explain_unusable(rows, law, name)
        if why is not None:
            missing[COVARIATE_PREFIX + name] = why
    return missing
