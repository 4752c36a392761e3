"""Laws of tables, with causes or without, as plain JSON types and back; nothing is imported or run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any

from stickslip_fit._expression import parse_expression
from stickslip_fit._json import to_plain, to_tuples
from stickslip_fit.causes import generic, levels, periodic, table_terms, zeros
from stickslip_fit.causes.formula import restore_formula_cause
from stickslip_fit.causes.formula_table import FormulaTableCause
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.table_cause import ExtendedTableLaw
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Parameter, TableLaw, restore_formula_law
from stickslip_fit.units import TableUnit

_MODULES = {module.__name__: module for module in (generic, levels, periodic, table_terms, zeros)}
Functions = Mapping[str, Callable[..., Any]]
"""Python functions by the name that imports them."""


def describe_table_law(law: Any) -> dict[str, Any]:
    """What `restore_table_law` needs to build a law again, with its causes.

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


def restore_table_law(content: Mapping[str, Any], functions: Functions) -> Any:
    """The law that `describe_table_law` described."""
    source = restore_formula_law(content["source"], functions)
    law = TableLaw(
        source=source,
        left=parse_expression(content["response"]),
        right=source.right,
        columns=tuple(content["columns"]),
        parameters=tuple(_restore_parameter(Parameter, one) for one in content["parameters"]),
        n_shared=int(content["n_shared"]),
        response_unit=TableUnit(content["response_unit"]),
    )
    causes = tuple(_restore_cause(one, functions, law) for one in content["causes"])
    return ExtendedTableLaw(law, causes) if causes else law


def _describe_parameter(parameter: Parameter) -> dict[str, Any]:
    """Its fields; null for a bound or a prior that it has not."""
    is_plain = not isinstance(parameter.unit, TableUnit)
    return to_plain(asdict(parameter) | {"unit": str(parameter.unit), "converted": is_plain})


def _restore_parameter[Kind: Parameter](kind: type[Kind], content: Mapping[str, Any]) -> Kind:
    own = {name: value for name, value in content.items() if value is not None}
    unit, is_plain = own.pop("unit"), own.pop("converted")
    return kind(unit=unit if is_plain else TableUnit(unit), **own)


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
            "columns": list(cause.columns),
        }
    if kind.__module__ in _MODULES and is_dataclass(cause):
        own = [one.name for one in fields(cause) if one.name != "law"]  # which has a description of its own
        return {"kind": kind.__name__} | {name: getattr(cause, name) for name in own}
    raise InputError(f"the cause {cause.name} cannot be saved: write it as a formula, with ssf.Cause")


def _restore_cause(content: Mapping[str, Any], functions: Functions, law: TableLaw) -> Any:
    own = dict(content)
    kind = own.pop("kind")
    if kind == "formula":
        parameters = tuple(_restore_parameter(CauseParameter, one) for one in own.pop("parameters"))
        source = restore_formula_cause(own.pop("source"), functions)
        listed = {name: tuple(values) for name, values in own.items()}
        return FormulaTableCause(source=source, parameters=parameters, **listed)
    restored = next((vars(module)[kind] for module in _MODULES.values() if kind in vars(module)), None)
    if not (isinstance(restored, type) and issubclass(restored, generic.GenericCause)):
        raise ValueError(f"there is no cause {kind}")
    settings: Any = {name: to_tuples(value) for name, value in own.items()}
    if issubclass(restored, levels.LevelCause):
        settings["law"] = law
    return restored(**settings)


def list_functions(law: Mapping[str, Any]) -> list[str]:
    """Names of the functions that a described law needs."""
    sources = [law["source"], *(cause["source"] for cause in law["causes"] if "source" in cause)]
    return [source["function"] for source in sources if "function" in source]
