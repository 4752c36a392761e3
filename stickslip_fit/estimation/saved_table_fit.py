"""load_table_fit: a fitted law of a table from its file.

A file never makes the program import or run anything: whoever loads a fit with functions in its law hands
these functions over. A checksum finds what was damaged or edited; a newer format is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._function import NumericFunction
from stickslip_fit.causes.roles import TableRoles
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.estimation._table_law_json import Functions, list_functions, restore_table_law
from stickslip_fit.estimation.saved_result import is_covariance, read_saved, require
from stickslip_fit.estimation.table_fit import FORMAT, VERSION, TableFit, TableSource

ADVICE = "fit the table again"


def load_table_fit(path: str | Path, functions: Iterable[Callable[..., Any]] = ()) -> TableFit:
    """Read a fit that `TableFit.save` wrote.

    Parameters
    ----------
    path : path
    functions : iterable of callable, optional
        The Python functions in its law and causes, if it has any; nothing is imported because a file says so.

    Raises
    ------
    InputError
        If the file cannot be read, is no saved fit of a table, is damaged or of a newer version, or needs
        functions that were not handed over.
    """
    content = read_saved(path, (FORMAT, VERSION), "fit of a table", "diagnose-table --save-law", ADVICE)
    given = {NumericFunction(function).importable_name(): function for function in functions}
    if missing := sorted(set(list_functions(content["law"])) - set(given)):
        names = ", ".join(missing)
        message = f"its law has the functions {names}: hand them over, load_table_fit(path, functions=[...])"
        raise InputError(InputIssue(message, str(path)))
    try:
        with np.errstate(all="ignore"):
            return _build(content, given)
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError, InputError) as error:
        what = error.args[0] if error.args else type(error).__name__
        message = f"is a damaged fit: {shorten(str(what), 200)}; {ADVICE}"
        raise InputError(InputIssue(message, str(path))) from None


def _build(content: Mapping[str, Any], functions: Functions) -> TableFit:
    values, covariance = np.array(content["values"], float), np.array(content["covariance"], float)
    source = TableSource(**content["source"] | {"files": tuple(content["source"]["files"])})
    fit = TableFit(
        law=restore_table_law(content["law"], functions),
        roles=TableRoles(**content["roles"], time_unit=str(content.get("time_unit", "s"))),
        sessions=tuple(content["sessions"]),
        begins=dict(content["begins"]),
        values=values,
        n_shared=int(content["n_shared"]),
        covariance=covariance,
        noise_sd=float(content["noise_sd"]),
        autocorrelation=np.array(content["autocorrelation"], float),
        residuals=pd.DataFrame(content["residuals"]),
        flags=tuple(content["flags"]),
        source=source,
    )
    q = len(fit.sessions) * fit.n_own + fit.n_shared
    require(values.shape == (len(fit.sessions), len(fit.law.parameters)), "values")
    require(covariance.shape == (q, q) and is_covariance(covariance), "covariance")
    require(bool(np.isfinite(values).all()) and fit.noise_sd >= 0, "values")
    require([row["name"] for row in content["parameters"]] == list(fit.parameters["name"]), "parameters")
    return fit
