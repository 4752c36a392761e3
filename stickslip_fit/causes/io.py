"""Laws with causes in them as plain JSON types, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

from stickslip_fit.causes.base import Cause, ExtendedLaw
from stickslip_fit.causes.environment import Covariate
from stickslip_fit.errors import InputError
from stickslip_fit.laws import StepLaw, describe_law, restore_law
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.machine import Machine


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
        return dict(describe_law(law))
    causes = [
        {"name": cause.name} | {field.name: getattr(cause, field.name) for field in fields(cause)}  # type: ignore[arg-type]
        for cause in law.causes
    ]
    return {"name": law.name, "joint": law.joint, "law": describe_law(law.law), "causes": causes}


def restore(description: Mapping[str, Any], machine: Machine, causes: Iterable[Cause] = ()) -> StepLaw:
    """The law that `describe` described.

    Parameters
    ----------
    description : mapping
    machine : Machine
    causes : iterable of Cause, optional
        Of your own, beside those of `library`.

    Raises
    ------
    InputError
        For a law or a cause that is not known.
    """
    from stickslip_fit.causes import library

    if description["name"] != ExtendedLaw.name:
        return restore_law(dict(description), machine)
    known = {cause.name: cause for cause in (*library(), *causes)}
    found = [_restored(each, known) for each in description["causes"]]
    return ExtendedLaw(restore_law(description["law"], machine), found)


def _restored(description: Mapping[str, Any], known: Mapping[str, Cause]) -> Cause:
    name, bound = description["name"], {key: _tuples(value) for key, value in description.items()}
    if name.startswith(COVARIATE_PREFIX):
        return Covariate(**{key: value for key, value in bound.items() if key != "name"})
    if name not in known:
        raise InputError(
            f"the saved law has a cause {name!r} in it, which is not in the library; pass it in `causes`"
        )
    cause: Any = known[name]
    return replace(cause, **{field.name: bound[field.name] for field in fields(cause)})


def _tuples(value: Any) -> Any:
    """What JSON made lists of."""
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
