"""The Python API: one page for the front door, and one for each package, with every name it exports."""

import inspect
from importlib import import_module
from types import ModuleType

from markdown import table, text

MODULES = {
    "step": ("stickslip_fit.step", "stickslip_fit.step.stage_file"),
    "machine": ("stickslip_fit.machine",),
    "logs": ("stickslip_fit.logs", "stickslip_fit.logs.plan"),
    "laws": ("stickslip_fit.laws",),
    "causes": ("stickslip_fit.causes",),
    "simulation": ("stickslip_fit.simulation",),
    "estimation": ("stickslip_fit.estimation", "stickslip_fit.estimation.noise"),
    "bayes": ("stickslip_fit.bayes",),
    "anova": ("stickslip_fit.anova",),
    "diagnosis": (
        "stickslip_fit.diagnosis",
        "stickslip_fit.diagnosis.pipeline",
        "stickslip_fit.diagnosis.problem",
        "stickslip_fit.diagnosis.separability",
        "stickslip_fit.diagnosis.stage_change",
    ),
    "moves": ("stickslip_fit.moves",),
    "strategies": ("stickslip_fit.strategies",),
    "changes": ("stickslip_fit.changes",),
    "law_comparison": ("stickslip_fit.law_comparison",),
    "studies": ("stickslip_fit.studies",),
    "capture": (
        "stickslip_fit.capture.protocols",
        "stickslip_fit.capture.nanocontrol",
        "stickslip_fit.capture.operator",
        "stickslip_fit.capture.tuning",
    ),
    "drive": (
        "stickslip_fit.drive.state",
        "stickslip_fit.drive.loop",
        "stickslip_fit.drive.record",
        "stickslip_fit.drive.rehearsal",
    ),
    "reporting": ("stickslip_fit.reporting",),
    "units": ("stickslip_fit.units", "stickslip_fit.errors"),
}


def pages() -> dict[str, str]:
    """The page of the front door and of each package."""
    packages = {
        package: "\n\n".join([f"# {package}", *map(_section, names)]) for package, names in MODULES.items()
    }
    return {"front-door": _front_door()} | packages


def _front_door() -> str:
    """Names of `stickslip_fit` itself, each a link to its package's page."""
    package = import_module("stickslip_fit")
    rows = []
    for name in package.__all__:
        thing = getattr(package, name)
        if not isinstance(thing, ModuleType):
            summary = (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")
            rows.append((f"`ssf.{name}`", f"{{py:obj}}`{_home(thing, name)}.{name}`", text(summary)))
    return "# import stickslip_fit as ssf\n\n" + table(["name", "documentation", "what it is"], rows)


def _home(thing: object, name: str) -> str:
    """The module of `MODULES` under which a name is documented; else the one that defines it."""
    listed = [module for modules in MODULES.values() for module in modules]
    return next((module for module in listed if name in _names(import_module(module))), thing.__module__)


def _section(name: str) -> str:
    module = import_module(name)
    names = _names(module)
    listing = "\n".join(f"   {member}" for member in names)
    directives = "\n\n".join(f".. auto{_kind(getattr(module, member))}:: {member}" for member in names)
    summary = f".. autosummary::\n   :nosignatures:\n\n{listing}\n\n{directives}" if names else ""
    rst = f".. automodule:: {name}\n   :no-members:\n\n.. currentmodule:: {name}\n\n{summary}"
    return f"## {name}\n\n```{{eval-rst}}\n{rst}\n```"


def _names(module: ModuleType) -> list[str]:
    """What the module exports: its own list, or else what it defines."""
    exported = getattr(module, "__all__", None)
    if exported is not None:
        return list(exported)
    return [
        name
        for name, thing in vars(module).items()
        if not name.startswith("_") and getattr(thing, "__module__", "") == module.__name__
    ]


def _kind(thing: object) -> str:
    if inspect.isclass(thing):
        return "exception" if issubclass(thing, BaseException) else "class"
    return "function" if callable(thing) and hasattr(thing, "__code__") else "data"
