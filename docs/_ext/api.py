"""The Python API: one page for each package, with the names that its modules list."""

from __future__ import annotations

import inspect
from importlib import import_module
from types import ModuleType

PACKAGES = {
    "units": ("stickslip_fit.units", "stickslip_fit.errors"),
    "machine": ("stickslip_fit.machine",),
    "logs": ("stickslip_fit.logs", "stickslip_fit.logs.plan"),
    "laws": ("stickslip_fit.laws",),
    "causes": ("stickslip_fit.causes",),
    "simulate": ("stickslip_fit.simulation",),
    "fit": ("stickslip_fit.estimation", "stickslip_fit.moves.prediction", "stickslip_fit.bayes"),
    "anova": ("stickslip_fit.anova",),
    "diagnose": ("stickslip_fit.diagnosis", "stickslip_fit.diagnosis.result"),
    "moves": ("stickslip_fit.moves",),
    "strategies": ("stickslip_fit.strategies", "stickslip_fit.studies"),
    "capture": (
        "stickslip_fit.capture",
        "stickslip_fit.capture.protocols",
        "stickslip_fit.capture.operator",
        "stickslip_fit.capture.tuning",
    ),
    "report": ("stickslip_fit.reporting",),
}


def pages() -> dict[str, str]:
    """The page of each package."""
    return {title: "\n\n".join([f"# {title}", *map(_section, names)]) for title, names in PACKAGES.items()}


def _section(name: str) -> str:
    module = import_module(name)
    names = _names(module)
    listed = "\n".join(f"   {entry}" for entry in names)
    directives = "\n\n".join(f".. auto{_kind(getattr(module, entry))}:: {entry}" for entry in names)
    summary = f".. autosummary::\n   :nosignatures:\n\n{listed}\n\n{directives}" if names else ""
    rst = f".. automodule:: {name}\n   :no-members:\n\n.. currentmodule:: {name}\n\n{summary}"
    return f"## {name}\n\n```{{eval-rst}}\n{rst}\n```"


def _names(module: ModuleType) -> list[str]:
    """The module's own list of names, or else what it defines."""
    listed = getattr(module, "__all__", None)
    if listed is not None:
        return list(listed)
    return [
        name
        for name, thing in vars(module).items()
        if not name.startswith("_") and getattr(thing, "__module__", "") == module.__name__
    ]


def _kind(thing: object) -> str:
    if inspect.isclass(thing):
        return "exception" if issubclass(thing, BaseException) else "class"
    return "function" if callable(thing) and hasattr(thing, "__code__") else "data"
