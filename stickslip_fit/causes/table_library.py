"""generic_causes: every generic cause for which a table has the columns; what the other columns lack."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.generic import (
    COVARIATE_ORDER,
    POSITION_ORDER,
    TRIAL_SHARE,
    ColumnDependence,
    DirectionOffset,
    GenericCause,
    OutlyingValues,
    PositionDependence,
    SessionOffset,
    SteadyDrift,
    SuddenChange,
    WarmUp,
)
from stickslip_fit.causes.levels import (
    IntegerDependence,
    LabelDependence,
    explain_unusable_levels,
    level_causes,
    may_be_labels,
    session_parameters,
)
from stickslip_fit.causes.periodic import PeriodicPosition
from stickslip_fit.causes.roles import ROW_NUMBER, TableRoles, direction_labels
from stickslip_fit.causes.zeros import leaves_session_offsets, zero_causes

NO_NAME = re.compile(r"column \d+|Unnamed: \d+")  # as here and by pandas
SAME_TIME = 1e-9  # of a correlation, from which a column is the time
MAX_SESSIONS = 50  # that may each have an offset of their own


def generic_causes(rows: pd.DataFrame, law: Any, roles: TableRoles) -> tuple[GenericCause, ...]:
    """Every generic cause for which a table has the columns.

    Parameters
    ----------
    rows : DataFrame
        Of `prepare_rows`.
    law : TableLaw
    roles : TableRoles
    """
    y = law.response(rows)[0]
    unit, size = str(law.response_unit), TRIAL_SHARE * (float(np.std(y)) or 1.0)
    both: list[GenericCause] = []
    if roles.time:
        longest = float(rows["session_seconds"].max()) or 1.0
        for kind in (SteadyDrift, WarmUp):
            both.append(kind(unit=unit, size=size, longest=longest, time_unit=roles.time_unit))
        both.append(SuddenChange(unit=unit, size=size, time_unit=roles.time_unit))
    columns = covariate_columns(rows, law, roles)
    numbers = [name for name in columns if is_numeric(rows[name])]
    for column in numbers:
        both.append(ColumnDependence(unit=unit, size=size, **_range(rows[column], COVARIATE_ORDER)))
    if roles.position and rows[roles.position].nunique() > 1:
        place = _range(rows[roles.position], POSITION_ORDER)
        both.append(PositionDependence(unit=unit, size=size, **place))
        both.append(PeriodicPosition(unit=unit, size=size, column=roles.position, low=place["low"]))
    named = [name for name in columns if name not in numbers or may_be_labels(rows[name])]
    labelled = {one.column: one for one in level_causes(named, rows, law, y, unit, size)}
    causes = [_with_labels(cause, labelled) for cause in both]
    causes += [cause for column, cause in labelled.items() if column not in numbers]
    sessions = tuple(map(str, rows["session"].unique()))
    if law.n_shared and 1 < len(sessions) <= MAX_SESSIONS:
        causes.append(SessionOffset(unit=unit, size=size, sessions=sessions))
        causes += session_parameters(rows, law, y, unit, size)
    causes += zero_causes(rows, law, y, unit, size)
    if roles.direction:
        labels = direction_labels(rows[roles.direction])
        opposite = partial(replace, direction=roles.direction, labels=labels)
        causes.append(DirectionOffset(unit=unit, size=size, direction=roles.direction, labels=labels))
        causes += [opposite(cause) for cause in both]
    return (*causes, OutlyingValues(unit=unit, size=size))


def _with_labels(cause: GenericCause, labelled: Mapping[str, LabelDependence]) -> GenericCause:
    """The cause, or that of its column of integers that may as well be labels."""
    if type(cause) is not ColumnDependence or cause.column not in labelled:
        return cause
    return IntegerDependence(**vars(cause), as_labels=labelled[cause.column])


def _range(cells: pd.Series[Any], order: int) -> dict[str, Any]:
    """What a polynomial over a column needs; its order is less than the number of the column's values."""
    low, high = float(cells.min()), float(cells.max())
    return {"column": str(cells.name), "low": low, "high": high, "order": min(order, cells.nunique() - 1)}


def covariate_columns(rows: pd.DataFrame, law: Any, roles: TableRoles) -> list[str]:
    """Columns that neither the law nor a role uses, and that vary within sessions, of numbers or of texts."""
    used = {*law.columns, *roles.columns.values(), "session", "session_seconds", "joint", ROW_NUMBER}
    columns = [str(name) for name in rows.columns if name not in used]
    return [name for name in columns if explain_unusable(rows, law, name) is None]


def explain_unusable(rows: pd.DataFrame, law: Any, name: str) -> str | None:
    """Why the response cannot be seen to follow a column, None where it can."""
    cells = rows[name]
    if is_numeric(cells):
        values = cells.to_numpy(dtype=float, na_value=np.nan)
        if not np.isfinite(values).all():
            return f"{int(np.sum(~np.isfinite(values))):,} of its cells are empty or infinite"
        if np.ptp(values) == 0:
            return "it is the same in every row"
        if NO_NAME.fullmatch(name) and len(np.unique(values)) == len(values) and np.all(values % 1 == 0):
            return "it has no name, and numbers the rows; give it a name if it means anything"
        if _is_time(values, rows, law):
            return "it counts up with the time, beside which it is no cause of its own"
    elif reason := explain_unusable_levels(cells):
        return reason
    own = len(law.parameters) > law.n_shared
    same = own and bool((cells.astype(object).groupby(rows["session"].to_numpy()).nunique() < 2).all())
    if same and not leaves_session_offsets(rows, law):
        return "it is the same within every session, and each session has parameters of its own"
    return None


def _is_time(values: Array, rows: pd.DataFrame, law: Any) -> bool:
    """Whether a column is the time in another unit, or numbers the rows in its order; of shape (n,).

    Of several sessions with shared parameters it may tell what changes from one to the next.
    """
    seconds, session = rows["session_seconds"].to_numpy(float), rows["session"].to_numpy(object)
    several = len(np.unique(session)) > 1
    if not np.isfinite(seconds).all() or (several and law.n_shared):
        return False
    within = pd.DataFrame({"values": values, "seconds": seconds}).groupby(session)
    steps = within["values"].diff().dropna()
    if np.all(values % 1 == 0) and (steps > 0).all() and steps.median() == 1:
        return True
    column, time = ((within[name].transform(lambda own: own - own.mean())) for name in ("values", "seconds"))
    size = float(np.linalg.norm(column) * np.linalg.norm(time))
    return size > 0 and abs(float(column @ time)) > (1.0 - SAME_TIME) * size


def is_numeric(cells: pd.Series[Any]) -> bool:
    """Whether a column is of numbers; truth values are texts."""
    return pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells)
