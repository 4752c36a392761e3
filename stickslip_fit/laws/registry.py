"""Laws by name: installed packages' laws, and what a saved result keeps of a law of one's own.

A published law is kept by its name, a formula as text, a law of Python by ``module:name``. A file may
come from a stranger: what it names is never imported. Who loads it gives such a law again, or has it
installed.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib.metadata import entry_points
from math import inf, isfinite
from sys import modules
from types import ModuleType
from typing import Any

import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit.errors import InputError
from stickslip_fit.laws.base import StepLaw
from stickslip_fit.laws.choice import Laws, LawSource, make_law
from stickslip_fit.laws.formula import Law, restore_formula_law
from stickslip_fit.laws.formula_step import FormulaStepLaw, restore_step_law
from stickslip_fit.laws.physical import Physical, restore_physical
from stickslip_fit.laws.published import (
    Base,
    BaseAtOneReach,
    ConstantStep,
    Elbow,
    Prismatic,
    describe_published,
    restore_published,
)
from stickslip_fit.machine import Machine

ENTRY_POINT = "stickslip_fit.laws"
PUBLISHED = (Base, BaseAtOneReach, ConstantStep, Elbow, Prismatic)


class UnknownLawError(InputError):
    """A saved law that has to be given again."""


def installed_laws() -> dict[str, Any]:
    """Laws that installed packages offer by the entry point ``stickslip_fit.laws``, by name.

    Each is a law, its class, a formula, a function of joint, rows and machine, or a mapping of these by
    joint. One that cannot be loaded, is none of these or has the name of another is left out with a warning.
    """
    found: dict[str, Any] = {}
    for point in entry_points(group=ENTRY_POINT):
        try:
            if point.name in found:
                raise ValueError(f"there is a law {point.name!r} already")
            found[point.name] = check_kind(point.load())
        # Whatever another package's code raises, even where it ends the program, is that package's fault.
        except (Exception, SystemExit) as error:
            reason = str(error) or type(error).__name__
            message = f"the law {point.value} of an installed package is left out: {reason}"
            warnings.warn(message, stacklevel=2)
    return found


def check_kind(law: Any) -> Any:
    """A law as `choose_laws` takes it, or a mapping of such by joint; of a law's class, a law.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(law, type) and issubclass(law, StepLaw):
        return law()
    if isinstance(law, StepLaw | LawSource | Mapping) or (callable(law) and not isinstance(law, type)):
        return law
    raise InputError(f"it is no law but {type(law).__name__}")


def laws_by_joint(law: Any, joints: tuple[int, ...]) -> dict[int, Any]:
    """What `check_kind` returns, by joint; a formula or function is for all of `joints`."""
    if isinstance(law, Mapping):
        return dict(law)
    return {law.joint: law} if isinstance(law, StepLaw) else dict.fromkeys(joints, law)


def describe_law(law: StepLaw) -> dict[str, Any]:
    """What `restore_law` needs to build the law again, as plain JSON types.

    Raises
    ------
    InputError
        For a law that no other program could find.
    """
    if type(law) in PUBLISHED:
        return dict(describe_published(law))
    if isinstance(law, Physical):
        return law.describe()
    if isinstance(law, FormulaStepLaw):
        return law.describe() | {"max_panel": law.max_panel if isfinite(law.max_panel) else None}
    parameters = [[parameter.name, str(parameter.unit)] for parameter in law.parameters]
    return {"name": law.name, "joint": law.joint, "source": importable_name(law), "parameters": parameters}


def importable_name(law: StepLaw) -> str:
    """``module:name`` of a law's class, or of the variable that holds the law.

    Raises
    ------
    InputError
        For a law of a notebook or script, or of a class within a function.
    """
    kind = type(law)
    home = modules.get(kind.__module__)
    if home is not None and _is_importable(home) and vars(home).get(kind.__qualname__) is kind:
        return f"{home.__name__}:{kind.__qualname__}"
    for module in filter(_is_importable, list(modules.values())):
        for name, value in vars(module).items():
            if value is law:
                return f"{module.__name__}:{name}"
    raise InputError(
        f"joint {law.joint}: the law {law.name!r} cannot be saved, for nothing could find it again: its "
        f"class {kind.__qualname__} is not in a module that can be imported. Move it into a file of its own "
        "and import it from there, or write it as a formula"
    )


def _is_importable(module: Any) -> bool:
    """Whether it was imported from somewhere, so that it can be imported elsewhere."""
    return isinstance(module, ModuleType) and module.__name__ != "__main__" and module.__spec__ is not None


def restore_law(description: Mapping[str, Any], machine: Machine, laws: Laws | None = None) -> StepLaw:
    """The law that `describe_law` described.

    Parameters
    ----------
    description : mapping
    machine : Machine
    laws : mapping of int to law, optional
        Your own by joint, besides those of `installed_laws`. No other code is run.

    Raises
    ------
    UnknownLawError
        For a law of someone's own that is not among them.
    InputError
        For a law that this version does not know.
    """
    if "formula_law" in description:
        return _restore_formula(description, laws)
    if "source" not in description:
        physical = restore_physical(description, machine)
        return restore_published(dict(description), machine) if physical is None else physical
    joint, source = int(description["joint"]), str(description["source"])
    given = None
    for law in _candidates(joint, machine, laws):
        if importable_name_or_empty(law) == source:
            own = [[parameter.name, str(parameter.unit)] for parameter in law.parameters]
            if own == description["parameters"]:
                return law
            given = law
    if given is not None:
        names = join_words([str(name) for name, _ in description["parameters"]])
        raise UnknownLawError(
            f"joint {joint}: the law {source} has changed since this was saved, when its parameters were "
            f"{names}; fit the log again"
        )
    raise _unknown_law(joint, source)


def _unknown_law(joint: int, source: str) -> UnknownLawError:
    return UnknownLawError(
        f"joint {joint} has a law of someone's own, {source}, and no code is run because a file names it; if "
        f"you trust it, give it again: laws={{{joint}: ...}}, at the command line --law {source}"
    )


def _restore_formula(description: Mapping[str, Any], laws: Laws | None) -> StepLaw:
    own, joint = description["formula_law"], int(description["joint"])
    fields = {**description, "max_panel": description["max_panel"] or inf}
    if "function" not in own:
        return restore_step_law(fields, restore_formula_law(own))
    for law in _given_or_installed(joint, laws):
        if isinstance(law, Law) and callable(law.formula) and law.describe()["function"] == own["function"]:
            return restore_step_law(fields, law)
    raise _unknown_law(joint, own["function"])


def _candidates(joint: int, machine: Machine, laws: Laws | None) -> Iterator[StepLaw]:
    """The joint's law among those given, then among the installed ones."""
    rows = pd.DataFrame({"joint": pd.Series(dtype=int)})
    for law in _given_or_installed(joint, laws):
        # A function that wants rows makes none here.
        with suppress(InputError):
            if not isinstance(law, LawSource):
                yield make_law(law, joint, rows, machine)


def _given_or_installed(joint: int, laws: Laws | None) -> Iterator[Any]:
    if laws is not None and joint in laws:
        yield laws[joint]
    for law in installed_laws().values():
        own = laws_by_joint(law, (joint,))
        if joint in own:
            yield own[joint]


def importable_name_or_empty(law: StepLaw) -> str:
    """`importable_name`; empty for a law that has none."""
    try:
        return importable_name(law)
    except InputError:
        return ""
