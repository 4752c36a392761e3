"""A fitted law of a table as JSON and back: formulas as text, functions by the name that imports them.

A file never makes the program import or run anything: whoever loads a fit with functions in its law hands
these functions over. A checksum finds what was damaged or edited; a newer format is refused.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._expression import parse_expression
from stickslip_fit._function import NumericFunction
from stickslip_fit._io import write_atomically
from stickslip_fit.causes import generic
from stickslip_fit.causes.formula import restore_formula_cause
from stickslip_fit.causes.formula_table import FormulaTableCause
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.roles import TableRoles
from stickslip_fit.causes.table_cause import ExtendedTableLaw
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.estimation.result import compute_checksum
from stickslip_fit.estimation.saved_result import is_covariance
from stickslip_fit.estimation.table_fit import TableFit, TableSource
from stickslip_fit.laws import Parameter, TableLaw, restore_formula_law
from stickslip_fit.units import TableUnit

FORMAT, VERSION = "stickslip-fit/table-fit", 1
ADVICE = "fit the table again"
Functions = Mapping[str, Callable[..., Any]]


def save_table_fit(fit: TableFit, path: str | Path) -> None:
    """Write a fit; see `TableFit.save`."""
    content = table_fit_to_json(fit)
    content |= {"checksum": compute_checksum(content)}
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(path, text + "\n", fit.source.files)


def table_fit_to_json(fit: TableFit) -> dict[str, Any]:
    """The content of the file, but for its checksum; plain JSON types."""
    numbers = ("estimate", "standard_error", "low", "high")
    return {
        "schema": f"{FORMAT}/{VERSION}",
        "parameters": [
            {"name": row.name, "session": row.session, "unit": row.unit}
            | {number: _or_null(getattr(row, number)) for number in numbers}
            for row in fit.parameters.itertuples(index=False)
        ],
        "flags": list(fit.flags),
        "law": _describe_law(fit.law),
        "roles": fit.roles.columns,
        "sessions": list(fit.sessions),
        "begins": dict(fit.begins),
        "n_shared": fit.n_shared,
        "values": fit.values.tolist(),
        "covariance": [[_or_null(value) for value in row] for row in fit.covariance.tolist()],
        "noise_sd": fit.noise_sd,
        "autocorrelation": fit.autocorrelation.tolist(),
        "residuals": {str(name): _cells(column) for name, column in fit.residuals.items()},
        "source": asdict(fit.source) | {"files": list(fit.source.files)},
    }


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
    content = _read(path)
    given = {NumericFunction(function).importable_name(): function for function in functions}
    if missing := sorted(set(_list_functions(content["law"])) - set(given)):
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


def _read(path: str | Path) -> dict[str, Any]:
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(InputIssue(f"cannot be read ({error.strerror})", str(path))) from None
    except (ValueError, RecursionError) as error:
        raise InputError(InputIssue(f"is no JSON ({shorten(str(error), 80)})", str(path))) from None
    form, _, version = str(content.get("schema") if isinstance(content, dict) else "").rpartition("/")
    if form != FORMAT or not version.isdecimal():
        message = "is no saved fit of a table; give a file that `diagnose-table --save-law` wrote"
        raise InputError(InputIssue(message, str(path)))
    if int(version[:9]) > VERSION:
        message = f"was made by a newer version of stickslip-fit (its format is {shorten(version, 9)}, "
        raise InputError(InputIssue(f"{message}here {VERSION} is known); update stickslip-fit", str(path)))
    if content.get("checksum") != compute_checksum(content):
        message = f"is a damaged fit: it is not what was saved (its checksum is another); {ADVICE}"
        raise InputError(InputIssue(message, str(path)))
    return dict(content)


def _build(content: Mapping[str, Any], functions: Functions) -> TableFit:
    values, covariance = np.array(content["values"], float), np.array(content["covariance"], float)
    source = TableSource(**content["source"] | {"files": tuple(content["source"]["files"])})
    fit = TableFit(
        law=_restore_law(content["law"], functions),
        roles=TableRoles(**content["roles"]),
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
    _check(values.shape == (len(fit.sessions), len(fit.law.parameters)), "values")
    _check(covariance.shape == (q, q) and is_covariance(covariance), "covariance")
    _check(bool(np.isfinite(values).all()) and fit.noise_sd >= 0, "values")
    _check([row["name"] for row in content["parameters"]] == list(fit.parameters["name"]), "parameters")
    return fit


def _check(holds: bool, what: str) -> None:
    if not holds:
        raise ValueError(what)


def _or_null(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _cells(column: pd.Series[Any]) -> list[Any]:
    if pd.api.types.is_numeric_dtype(column):
        return [_or_null(value) for value in column.astype(float)]
    return [str(value) for value in column]


def _describe_law(law: Any) -> dict[str, Any]:
    """What `_restore_law` needs to build a law again, with its causes.

    Raises
    ------
    InputError
        For a law or a cause that is no formula, and no function with a name.
    """
    causes = law.causes if isinstance(law, ExtendedTableLaw) else ()
    base = law.law if isinstance(law, ExtendedTableLaw) else law
    if not isinstance(base, TableLaw):
        raise InputError(f"a law of the kind {type(base).__name__} cannot be saved: write it as a formula")
    return {
        "source": base.source.describe(),
        "response": base.left.text,
        "columns": list(base.columns),
        "parameters": [_describe_parameter(one) for one in base.parameters],
        "n_shared": base.n_shared,
        "response_unit": str(base.response_unit),
        "causes": [_describe_cause(cause) for cause in causes],
    }


def _restore_law(content: Mapping[str, Any], functions: Functions) -> Any:
    source = _restore_source(restore_formula_law, content["source"], functions)
    law = TableLaw(
        source=source,
        left=parse_expression(content["response"]),
        right=source.right,
        columns=tuple(content["columns"]),
        parameters=tuple(_restore_parameter(Parameter, one) for one in content["parameters"]),
        n_shared=int(content["n_shared"]),
        response_unit=TableUnit(content["response_unit"]),
    )
    causes = tuple(_restore_cause(one, functions) for one in content["causes"])
    return ExtendedTableLaw(law, causes) if causes else law


def _describe_parameter(parameter: Parameter) -> dict[str, Any]:
    limits = {"lower": _or_null(parameter.lower), "upper": _or_null(parameter.upper)}
    is_plain = not isinstance(parameter.unit, TableUnit)
    return asdict(parameter) | {"unit": str(parameter.unit), "converted": is_plain} | limits


def _restore_parameter[Kind: Parameter](kind: type[Kind], content: Mapping[str, Any]) -> Kind:
    own = dict(content)
    unit = own.pop("unit")
    lower, upper = own.pop("lower"), own.pop("upper")
    return kind(
        unit=unit if own.pop("converted") else TableUnit(unit),
        lower=-np.inf if lower is None else lower,
        upper=np.inf if upper is None else upper,
        **own,
    )


def _describe_cause(cause: Any) -> dict[str, Any]:
    """A cause as its class, and its fields as plain JSON types."""
    kind = type(cause)
    if isinstance(cause, FormulaTableCause):
        return {
            "kind": "formula",
            "source": cause.source.describe(),
            "order": list(cause.order),
            "levels": list(cause.levels),
            "parameters": [_describe_parameter(one) for one in cause.parameters],
            "null_values": list(cause.null_values),
            "scale": list(cause.scale),
        }
    if kind.__module__ == generic.__name__ and is_dataclass(cause):
        return {"kind": kind.__name__} | {one.name: getattr(cause, one.name) for one in fields(cause)}
    raise InputError(f"the cause {cause.name} cannot be saved: write it as a formula, with ssf.Cause")


def _restore_cause(content: Mapping[str, Any], functions: Functions) -> Any:
    own = dict(content)
    kind = own.pop("kind")
    if kind == "formula":
        parameters = tuple(_restore_parameter(CauseParameter, one) for one in own.pop("parameters"))
        source = _restore_source(restore_formula_cause, own.pop("source"), functions)
        listed = {name: tuple(values) for name, values in own.items()}
        return FormulaTableCause(source=source, parameters=parameters, **listed)
    restored = getattr(generic, kind)
    _check(isinstance(restored, type) and issubclass(restored, generic.GenericCause), "causes")
    return restored(
        **{name: tuple(value) if isinstance(value, list) else value for name, value in own.items()}
    )


def _restore_source(restore: Any, description: Mapping[str, Any], functions: Functions) -> Any:
    """A Law or a FormulaCause from its own description, functions taken from those handed over."""
    own = dict(description)
    if "function" in own:
        own["formula"] = functions[own.pop("function")]
    return restore(own)


def _list_functions(law: Mapping[str, Any]) -> list[str]:
    sources = [law["source"], *(cause["source"] for cause in law["causes"] if "source" in cause)]
    return [source["function"] for source in sources if "function" in source]
