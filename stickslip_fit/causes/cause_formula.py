"""CauseFormula: the text of a cause, or its Python function, with its parameters, and what kind it is.

Its first sign says what it does: ``+ expression`` adds to the response of a table or to the step size of a
log, ``* expression`` multiplies it, ``name = expression`` stands in place of a column or a coordinate, and
``steps + expression`` adds to the count of a log.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from math import isfinite
from numbers import Real
from typing import Any

from stickslip_fit._expression import Expression, parse_expression, refuse
from stickslip_fit._function import NumericFunction
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.errors import InputError, InputIssue, shorten

_NAME = r"""(?:[^\W\d]\w*|Q\(\s*"[^"\n]+"\s*\))"""
_REPLACES = re.compile(rf"\s*({_NAME})\s*=(?!=)")
_STEPS = re.compile(r"\s*steps\s*(?=[+-])")
_PARAMETER = re.compile(r"\s*([^\W\d]\w*)\s*(?:\bin\s+(\S(?:[^,]*\S)?))?\s*$")
HOW_TO_BEGIN = (
    "it begins with + (adds), * (multiplies), 'name =' (in place of a column) or 'steps +' (of a log)"
)


@dataclass(frozen=True)
class CauseFormula:
    """What a law leaves out, as a formula or a Python function.

    Parameters
    ----------
    formula : str or callable
        ``+ expression``, ``* expression``, ``name = expression`` or ``steps + expression``. In a table the
        names in it are columns, the law's parameters, the response's own name for the law's prediction, and
        the cause's parameters. In a log: q, q1 to q3, theta, psi, load, recoil, direction (1 or -1), gamma
        (the step size without load), and all columns of its rows. A function takes them as arguments.
    parameters : str or sequence of CauseParameter
        As in ``"A in %, tau in min"``. The effect is none where they are 0, or where those are 0 in which it
        is linear. A table's parameters are in the table's own units, save ``%``: 0.03 is shown as 3 %.
    by : str, optional
        A column: one set of parameters for each of its values.
    bounds : mapping of str to (float, float), optional
        In the parameter's unit. Parameters that enter nonlinearly need them: they are searched in between.
    size : float or mapping of str to float, optional
        A size that matters, in the parameter's unit; by default one that shows beside the scatter.
    phrase, physics, sentence, remedy, shows_best : str, optional
        What a diagnosis says of it; see `causes.Cause`.
    joints : tuple of int, optional
        Of a log, on which it acts; all by default.
    acts : str, optional
        What a function's value does: "+", "*", "steps +" or "name =". A formula says so itself.

    Raises
    ------
    InputError
        For a formula that cannot be read, and for parameters that it does not have.
    """

    name: str
    formula: str | Callable[..., Any]
    parameters: str | Sequence[CauseParameter]
    _: KW_ONLY
    by: str = ""
    bounds: Mapping[str, Sequence[float]] = field(default_factory=dict)
    size: float | Mapping[str, float] | None = None
    phrase: str = ""
    physics: str = ""
    sentence: str = ""
    remedy: str = ""
    shows_best: str = ""
    joints: tuple[int, ...] = ()
    acts: str = "+"

    def __post_init__(self) -> None:
        issues = [InputIssue(f"the cause {self.name}: {reason}") for reason in self._faults()]
        if issues:
            raise InputError(issues)

    def __hash__(self) -> int:
        return hash((self.name, self.formula))

    @property
    def operation(self) -> str:
        """``+``, ``*``, ``steps +`` or ``=``."""
        return self._parts[0]

    @property
    def target(self) -> str:
        """The column or coordinate that it replaces; empty for others."""
        return self._parts[1]

    @property
    def effect(self) -> Expression | NumericFunction:
        """What is added, multiplied by, or put in place."""
        return self._parts[2]

    @property
    def text(self) -> str:
        """The formula, or the function's name."""
        return self.formula if isinstance(self.formula, str) else f"{self.acts} {self.effect.text}(...)"

    @property
    def names(self) -> tuple[str, ...]:
        """The names in the formula."""
        return self.effect.names

    @cached_property
    def declared(self) -> tuple[CauseParameter, ...]:
        """The parameters, with bounds in the units that they are displayed in."""
        if isinstance(self.parameters, str):
            declared = [self._read_parameter(part) for part in self.parameters.split(",")]
        else:
            declared = list(self.parameters)
        bounds = {name: tuple(pair) for name, pair in self.bounds.items() if _are_bounds(pair)}
        return tuple(
            replace(one, lower=bounds[one.name][0], upper=bounds[one.name][1]) if one.name in bounds else one
            for one in declared
        )

    @cached_property
    def _parts(self) -> tuple[str, str, Expression | NumericFunction]:
        """Kind, target and effect."""
        if isinstance(self.formula, str):
            return _read_cause(self.formula)
        if not callable(self.formula):
            raise InputError(f"a cause is a formula or a function, not {shorten(repr(self.formula))}")
        kind, target, _ = _read_cause(f"{self.acts} 1")
        return kind, target, NumericFunction(self.formula)

    def _read_parameter(self, text: str) -> CauseParameter:
        match = _PARAMETER.match(text)
        if match is None:
            raise InputError(
                f"the cause {self.name}: the parameter {shorten(text.strip())!r} cannot be read; write them "
                "as 'A in %, tau in min', a name each, and its unit"
            )
        return CauseParameter(match[1], match[2] or "1", "")

    def _faults(self) -> list[str]:
        names = [parameter.name for parameter in self.declared]
        faults = [f"{name} is declared twice" for name in dict.fromkeys(names) if names.count(name) > 1]
        for name in names:
            if name not in self.names:
                faults.append(f"its parameter {name} is never used in {shorten(self.text)!r}")
            elif name not in self.effect.active_names:
                faults.append(f"its parameter {name} cancels out of {shorten(self.text)!r}")
        sizes = self.size if isinstance(self.size, Mapping) else {}
        for name in dict.fromkeys([*self.bounds, *sizes]):
            if name not in names:
                faults.append(f"{name} is none of its parameters ({', '.join(names)})")
        for name, pair in self.bounds.items():
            if not _are_bounds(pair):
                faults.append(f"bounds of {name} must be a lower and a higher number, not {pair!r}")
        for value in sizes.values() if sizes else [self.size]:
            if value is not None and not (isinstance(value, Real) and isfinite(value) and value != 0):
                faults.append(f"size must be a number other than 0, not {value!r}")
        return faults

    def describe(self) -> dict[str, Any]:
        """What `restore_formula_cause` needs to build it again; plain JSON types.

        Raises
        ------
        InputError
            For a function that cannot be imported by a name.
        """
        if isinstance(self.effect, NumericFunction):
            own = {"function": self.effect.importable_name(), "acts": self.acts}
        else:
            own = {"formula": self.text}
        bounds = [{"lower": one.lower, "upper": one.upper} for one in self.declared]
        return {
            "name": self.name,
            **own,
            "parameters": [
                {"name": one.name, "unit": str(one.unit), "meaning": one.meaning}
                | {key: end for key, end in ends.items() if isfinite(end)}
                for one, ends in zip(self.declared, bounds, strict=True)
            ],
            "by": self.by,
            "joints": list(self.joints),
            "size": dict(self.size) if isinstance(self.size, Mapping) else self.size,
            **{key: getattr(self, key) for key in ("phrase", "physics", "sentence", "remedy", "shows_best")},
        }


def _are_bounds(pair: Any) -> bool:
    """Whether they are two numbers, the lower one first."""
    if not (isinstance(pair, tuple | list) and len(pair) == 2):
        return False
    return all(isinstance(end, Real) and not isinstance(end, bool) for end in pair) and pair[0] < pair[1]


def _read_cause(text: str) -> tuple[str, str, Expression]:
    """The kind of a cause's formula, what it replaces, and its expression."""
    body = text.lstrip()
    first = len(text) - len(body)
    if body.startswith(("+", "-")):
        skip = first + body.startswith("+")
        return "+", "", parse_expression(text[skip:], text, skip)
    if body.startswith("*") and not body.startswith("**"):
        return "*", "", parse_expression(text[first + 1 :], text, first + 1)
    if match := _STEPS.match(text):
        skip = match.end() + (text[match.end()] == "+")
        return "steps +", "", parse_expression(text[skip:], text, skip)
    if match := _REPLACES.match(text):
        target = parse_expression(match[1], text).names[0]
        return "=", target, parse_expression(text[match.end() :], text, match.end())
    refuse(text, first, f"what it does is not said; {HOW_TO_BEGIN}")
