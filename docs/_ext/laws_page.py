"""The published laws: parameters, what they depend on, and the traverses that calibrate them."""

import inspect
from math import isnan

from markdown import code, table, text

from stickslip_fit.laws import Base, Configuration, Elbow, Prismatic, StepLaw
from stickslip_fit.machine import load_machine
from stickslip_fit.units import from_si


def page() -> str:
    """One section for each joint's law."""
    machine = load_machine()
    return "\n\n".join(map(_section, (Prismatic(), Elbow(machine), Base(machine))))


def _section(law: StepLaw) -> str:
    about = (inspect.getdoc(type(law)) or "").split("\nParameters\n")[0].strip()
    parameters = [(code(k.name), text(k.unit), text(k.meaning)) for k in law.parameters]
    calibration = [(text(place.label), *_pose(place)) for place in law.calibration()]
    return "\n\n".join(
        [
            f"## Joint {law.joint}: {code(law.name)}",
            text(about),
            f"Depends on {', '.join(map(code, law.columns))}.",
            table(["parameter", "unit", "meaning"], parameters),
            "The closed form solves one full traverse in each of these configurations for the parameters:",
            table(["configuration", "q2 (deg)", "q3 (mm)", "theta (deg)", "psi (deg)"], calibration),
        ]
    )


def _pose(place: Configuration) -> list[str]:
    angles = (place.q2, place.theta, place.psi)
    q2, theta, psi = ("any" if isnan(angle) else f"{from_si(angle, 'deg'):g}" for angle in angles)
    return [q2, "any" if isnan(place.q3) else f"{from_si(place.q3, 'mm'):g}", theta, psi]
