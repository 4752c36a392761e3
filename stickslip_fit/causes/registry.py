"""The library of causes, and laws with causes as plain JSON types and back."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import asdict, fields, replace
from importlib.metadata import EntryPoint, entry_points
from math import inf
from typing import Any

import pandas as pd

from stickslip_fit._json import to_tuples
from stickslip_fit.causes import environment, geometry, load, position, profile, temporal
from stickslip_fit.causes.added_steps import AddedSteps
from stickslip_fit.causes.base import Cause, ExtendedLaw
from stickslip_fit.causes.environment import Covariate
from stickslip_fit.causes.formula import FormulaCause, restore_formula_cause
from stickslip_fit.causes.formula_step import STEP_CAUSES, FormulaStepCause
from stickslip_fit.causes.function_of_cause import FunctionOfCause
from stickslip_fit.causes.kinds import OfJoints
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.proposed import (
    CarryOverTerm,
    JointTerm,
    NestedTerm,
    PeriodicTerm,
    ProposedTerm,
    SmoothTerm,
    TravelTerm,
)
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Laws, StepLaw, UnknownLawError, describe_law, restore_law
from stickslip_fit.logs.history import DEPARTURES, FURTHER_HISTORY
from stickslip_fit.logs.schema import COVARIATE_PREFIX, NO_TIMES, has_times
from stickslip_fit.machine import Machine

FAMILIES = (temporal, environment, geometry, load, position, profile)
HISTORY_COLUMNS = {
    *("session_seconds", "steps_before", "before_direction", "before_load"),
    *FURTHER_HISTORY,
    *DEPARTURES,
}
ENTRY_POINT = "stickslip_fit.causes"
PROPOSED: dict[str, Callable[..., Cause]] = {
    kind.name: kind
    for kind in (
        *(SmoothTerm, JointTerm, TravelTerm, NestedTerm, PeriodicTerm, ProposedTerm, CarryOverTerm),
        AddedSteps,
    )
}
# Names of proposed functions in files of earlier versions, where they were a sum, not an exponential.
FORMER = ("smooth-term", "smooth-joint-term", "smooth-travel-term", "periodic-term")
FORMER_FIELDS = {"along-travel": "shape", "cable-torque": "middle"}  # of causes that have others now


def library() -> tuple[Cause, ...]:
    """Every cause in the order of the documentation, then those of installed packages.

    The toolkit's own are those in ``__all__`` of each family's module. A package adds its own by the entry
    point ``stickslip_fit.causes``, which names a cause, its class or a function that returns one. One that
    cannot be loaded, is no cause or has the name of another is left out with a warning.

    Examples
    --------
    >>> [cause.name for cause in library()][:3]
    ['thermal-warm-up', 'drift', 'session-jump']
    """
    kinds = [getattr(family, name) for family in FAMILIES for name in family.__all__]
    # A covariate has no name before it has a column.
    causes = [kind() for kind in kinds if kind is not Covariate]
    for point in entry_points(group=ENTRY_POINT):
        try:
            causes.append(_load_cause(point, {cause.name for cause in causes}))
        # Whatever another package's code raises, even where it ends the program, is that package's fault.
        except (Exception, SystemExit) as error:
            reason = str(error) or type(error).__name__
            message = f"the cause {point.value} of an installed package is left out: {reason}"
            warnings.warn(message, stacklevel=2)
    return tuple(causes)


def _load_cause(point: EntryPoint, names: Set[str]) -> Cause:
    loaded = point.load()
    cause = loaded if isinstance(loaded, Cause) else loaded()
    if not isinstance(cause, Cause):
        raise TypeError(f"it is no Cause but {type(cause).__name__}")
    if cause.name in names:
        raise ValueError(f"there is a cause {cause.name!r} already")
    return cause


def covariates(rows: pd.DataFrame) -> tuple[Covariate, ...]:
    """A cause for every numeric column that the lab added."""
    names = [name for name in rows.columns if name.startswith(COVARIATE_PREFIX)]
    return tuple(Covariate(name.removeprefix(COVARIATE_PREFIX)) for name in names)


def describe(law: StepLaw) -> dict[str, Any]:
    """What `restore` needs to build a law again, published or extended; plain JSON types.

    Examples
    --------
    >>> from stickslip_fit.causes import Temperature, extend
    >>> from stickslip_fit.laws import Prismatic
    >>> described = describe(extend(Prismatic(), Temperature(mean=294.0)))
    >>> described["law"]["name"], described["causes"][0]["name"], described["causes"][0]["mean"]
    ('prismatic', 'temperature', 294.0)
    """
    if not isinstance(law, ExtendedLaw):
        return describe_law(law)
    causes = [_describe_cause(cause) for cause in law.causes]
    return {"name": law.name, "joint": law.joint, "law": describe_law(law.law), "causes": causes}


def restore(
    description: Mapping[str, Any], machine: Machine, causes: Iterable[Cause] = (), laws: Laws | None = None
) -> StepLaw:
    """The law that `describe` described.

    Parameters
    ----------
    description : mapping
    machine : Machine
    causes : iterable of Cause, optional
        Your own, besides those of `library`.
    laws : mapping of int to law, optional
        Your own by joint, besides those of `laws.installed_laws`.

    Raises
    ------
    InputError
        For a law or a cause that is not known.
    """
    if description["name"] != ExtendedLaw.name:
        return restore_law(description, machine, laws)
    known = {cause.name: cause for cause in (*library(), *causes)}
    restored = [_restore_cause(cause, known) for cause in description["causes"]]
    return ExtendedLaw(restore_law(description["law"], machine, laws), restored)


def _describe_cause(cause: Cause) -> dict[str, Any]:
    if isinstance(cause, OfJoints):
        return _describe_cause(cause.cause) | {"of_joints": cause.on, "trial": cause.others}
    if not isinstance(cause, FormulaStepCause):
        return {"name": cause.name} | {field.name: getattr(cause, field.name) for field in fields(cause)}  # type: ignore[arg-type]
    bound = {field.name: getattr(cause, field.name) for field in fields(cause)}
    parameters = [
        {key: value for key, value in asdict(parameter).items() if value not in (-inf, inf)}
        for parameter in cause.parameters
    ]
    return {"name": cause.name} | bound | {"source": cause.source.describe(), "parameters": parameters}


def _restore_formula_cause(description: Mapping[str, Any], known: Mapping[str, Any]) -> Cause:
    """A formula from its text; a function from a cause that is given: no code is run for a file's sake."""
    name, source = description["name"], description["source"]
    own = known.get(name)
    if "function" in source:
        if not (isinstance(own, FormulaCause) and own.describe().get("function") == source["function"]):
            raise UnknownLawError(
                f"the saved law has a cause {name!r} that is the function {source['function']}, and no code "
                "is run because a file names it; if you trust it, pass the cause in `causes`"
            )
    else:
        own = restore_formula_cause(source)
    bound = {key: to_tuples(value) for key, value in description.items() if key != "name"}
    parameters = tuple(CauseParameter(**parameter) for parameter in description["parameters"])
    return STEP_CAUSES[own.operation](**bound | {"source": own, "parameters": parameters})


def _restore_cause(description: Mapping[str, Any], known: Mapping[str, Cause]) -> Cause:
    if "of_joints" in description:
        inner = {key: value for key, value in description.items() if key not in ("of_joints", "trial")}
        on, others = (tuple(description[key]) for key in ("of_joints", "trial"))
        return OfJoints(_restore_cause(inner, known), on, others)
    if "source" in description:
        return _restore_formula_cause(description, known)
    name, bound = description["name"], {key: to_tuples(value) for key, value in description.items()}
    if "of" in bound:
        return FunctionOfCause(**{key: value for key, value in bound.items() if key != "name"})
    if name.startswith(COVARIATE_PREFIX):
        return Covariate(**{key: value for key, value in bound.items() if key != "name"})
    if name in FORMER or FORMER_FIELDS.get(name) in bound:
        raise InputError(
            f"the saved law has a {name!r} of an earlier version, where it meant something else; "
            "diagnose the log again"
        )
    if name in PROPOSED:
        return PROPOSED[name](**{key: value for key, value in bound.items() if key != "name"})
    if name not in known:
        raise InputError(
            f"the saved law has a cause {name!r}, which is not in the library; pass it in `causes`"
        )
    cause: Any = known[name]
    return replace(cause, **{field.name: bound[field.name] for field in fields(cause) if field.name in bound})


def explain_missing(cause: Cause, rows: pd.DataFrame, machine: Machine) -> str | None:
    """Why a log of a machine cannot show a cause, or None where nothing is missing.

    Raises
    ------
    InputError
        For a cause's name or class in place of a cause.
    """
    if not hasattr(cause, "name") or isinstance(cause, type):
        raise InputError(f"{cause!r} is no cause; a cause is a value, such as ssf.causes.ThermalWarmUp()")
    if not has_times(rows) and HISTORY_COLUMNS & {*cause.columns}:
        return NO_TIMES
    if cause.kind:
        joints = [joint for joint in machine.joints if machine.kinds[joint - 1] == cause.kind]
        rows = rows[rows["joint"].isin(joints)]
        if rows.empty:
            of = f"joint {' or '.join(map(str, joints))}" if joints else f"a {cause.kind} joint"
            return f"the log has no traverse of {of}"
        rows = rows.assign(joint=cause.joints[0])  # the numbers of its joints are the published arm's
    if cause.needs_geometry and not machine.has_published_geometry:
        return "the geometry of the published arm is needed, and the machine has another"
    return cause.explain_missing(rows)
