"""Every public method has a docstring: its own, or that of what it overrides."""

import inspect
import pkgutil
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from types import FunctionType

import stickslip_fit

KINDS = (FunctionType, classmethod, staticmethod, property, cached_property)


def list_classes() -> Iterator[type]:
    """Public classes of the package's public modules."""
    for module in pkgutil.walk_packages(stickslip_fit.__path__, f"{stickslip_fit.__name__}."):
        if "._" in module.name:
            continue
        for name, thing in vars(import_module(module.name)).items():
            if inspect.isclass(thing) and thing.__module__ == module.name and not name.startswith("_"):
                yield thing


def find_undocumented(kind: type) -> list[str]:
    """Methods and properties that neither have a docstring nor override what a base class has or declares."""
    return [
        f"{kind.__module__}.{kind.__qualname__}.{name}"
        for name, member in vars(kind).items()
        if not name.startswith("_")
        and isinstance(member, KINDS)
        and not (getattr(member, "__doc__", None) or "").strip()
        and not any(name in {*vars(base), *getattr(base, "__annotations__", ())} for base in kind.__mro__[1:])
    ]


class _Documented:
    said: str

    def method(self) -> None:
        """Says what it does."""


class _Lacking(_Documented):
    @property
    def said(self) -> str:  # type: ignore[override]
        return ""

    def method(self) -> None:
        return

    def other(self) -> None:
        return


def test_a_method_of_its_own_needs_a_docstring() -> None:
    assert [name.rpartition(".")[2] for name in find_undocumented(_Lacking)] == ["other"]


def test_methods_are_documented() -> None:
    classes = list(list_classes())
    assert len(classes) > 300
    assert not [name for kind in classes for name in find_undocumented(kind)]
