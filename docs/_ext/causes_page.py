"""Every cause of the library: what it does, by which parameters, why, and what would show it best."""

import inspect
from math import inf
from pathlib import Path

from markdown import code, table, text

from stickslip_fit.causes import Cause, CountCause, FactorCause, StateCause, TermCause, library
from stickslip_fit.units import from_si

STAGES = {
    StateCause: "the state: an angle, the load or the recoil",
    TermCause: "the step size, as a term outside the recoil's factor",
    FactorCause: "the step size, as a factor",
    CountCause: "the count, as steps added",
}
JOINTS = {(1, 2, 3): "all joints", (1, 2): "joints 1 and 2", (2, 3): "joints 2 and 3"}


def page() -> str:
    """One section for each cause, in the library's order."""
    return "\n\n".join(map(_section, library()))


def _section(cause: Cause) -> str:
    facts = [
        f"acts on {_stage(cause)}; {JOINTS.get(cause.joints) or f'joint {cause.joints[0]}'}",
        f"needs {_needs(cause)}",
        f"would be shown best by {text(cause.shows_best)}",
        f"what helps: {text(cause.remedy or 'an extended law')}",
        f"in code: {{py:obj}}`stickslip_fit.causes.{type(cause).__name__}`, in "
        f"`{Path(inspect.getfile(type(cause))).name}`",
    ]
    parts = [
        f"(cause-{cause.name})=\n## {cause.name}",
        f"{text(cause.phrase[0].upper() + cause.phrase[1:])}.",
        f"> {text(_equation(cause))}",
        text(cause.physics),
        "\n".join(f"- {fact}" for fact in facts),
    ]
    if cause.parameters:
        rows = [
            (code(k.name), text(k.unit), text(k.meaning), _span(k.lower, k.upper, k.unit))
            for k in cause.parameters
        ]
        parts.append(table(["parameter", "unit", "meaning", "physically possible"], rows))
    return "\n\n".join(parts)


def _equation(cause: Cause) -> str:
    return (inspect.getdoc(type(cause)) or "").split("\n\n")[0].replace("\n", " ")


def _stage(cause: Cause) -> str:
    return next(
        (stage for kind, stage in STAGES.items() if isinstance(cause, kind)), "the detection of the stop"
    )


def _needs(cause: Cause) -> str:
    return ", ".join(map(code, cause.columns)) if cause.columns else "nothing besides positions and angles"


def _span(lower: float, upper: float, unit: str) -> str:
    if lower == -inf and upper == inf:
        return "any"
    low, high = (f"{from_si(end, unit):g}" for end in (lower, upper))
    if lower == -inf:
        return f"up to {high}"
    return f"from {low}" if upper == inf else f"{low} to {high}"
