"""What each cause does in a log, said in a sentence, and what a lab can do about it."""

from __future__ import annotations

from collections.abc import Callable
from math import log, log10

from stickslip_fit._format import capitalize_first as begun_large
from stickslip_fit._format import format_direction as way
from stickslip_fit._format import format_estimate as amount
from stickslip_fit._format import format_number as number
from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import grow_or_shrink as more_or_less
from stickslip_fit._format import join_words as listed
from stickslip_fit.diagnose.diagnosis import Finding, SizedParameter
from stickslip_fit.logs.columns import COVARIATE
from stickslip_fit.units import Interval

HALF_WAY = -36e-6  # m^2; of q3 (q3 - 12 mm) at 6 mm
Parameters = tuple[SizedParameter, ...]
Sentence = Callable[[Parameters], str]

# What cures a cause, as the beginning of a sentence; where nothing does, the law has to know of it.
TO_DO = {
    "thermal-warm-up": "waiting until it is warm",
    "drift": "recalibrating within the session",
    "session-jump": "calibrating anew after it",
    "wear": "calibrating more often",
    "temperature": "keeping the room's temperature",
    "humidity": "keeping the room's humidity",
    "supply-voltage": "steadying the supply",
    "step-rate": "keeping to one step period",
    "theta-offset": "mounting the base straight",
    "psi-offset": "mounting the base straight",
    "q2-offset": "setting joint 2's zero",
    "q1-gravity": "calibrating at the q1 that is used",
    "side-load": "calibrating in the orientation that is used",
    "load-nonlinearity": "calibrating at the loads that are used",
    "load-hysteresis": "letting a traverse of little load come before each",
    "payload-change": "calibrating anew with each payload",
    "inertia-quadratic": "calibrating joint 2 at the q3 that is used",
    "cable-torque": "relieving the cable",
    "bearing-runout": "calibrating over the stretch that is used",
    "guide-gradient": "calibrating over the stretch that is used",
    "worn-spot": "staying off that stretch",
    "end-stop-latency": "taking those steps off every count",
    "reversal-loss": "adding those steps after each reversal",
    "end-stop-misfire": "excluding those counts and repeating them",
}


def what_happens(finding: Finding) -> str:
    """What a named cause does, without a full stop.

    Parameters
    ----------
    finding : Finding
        Of any cause; one that has no sentence here, or not all it takes, is told by its phrase.
    """
    if finding.cause.startswith(COVARIATE):
        column = finding.cause.removeprefix(COVARIATE)
        return f"Steps follow the column {column}, by {percent(finding.effect.estimate)} rms"
    try:
        return SENTENCES[finding.cause](finding.parameters)
    except LookupError:
        return _plainly(finding)


def what_to_do(cause: str) -> str:
    """What cures it, as the beginning of a sentence; empty where nothing but the extended law does.

    Examples
    --------
    >>> what_to_do("covariate:pressure_hPa"), what_to_do("recoil-axis")
    ('keeping pressure_hPa steady', '')
    """
    if cause.startswith(COVARIATE):
        return f"keeping {cause.removeprefix(COVARIATE)} steady"
    return TO_DO.get(cause, "")


def _size(parameters: Parameters, name: str) -> Interval:
    """Of a parameter by its name; LookupError where it is not known."""
    return {each.name: each.size for each in parameters}[name]


def _changes(what: str, size: Interval, unit: str) -> str:
    return f"{what} {more_or_less(size.estimate)} by {amount(size, unit)}"


def _rate(how: str, unit: str = "%", name: str = "k", factor: float = 1.0, what: str = "Steps") -> Sentence:
    return lambda known: f"{_changes(what, _size(known, name).times(factor), unit)} {how}"


def _signed(name: str, unit: str, before: str, after: str = "", factor: float = 1.0) -> Sentence:
    return lambda known: f"{before}{amount(_size(known, name).times(factor), unit, signed=True)}{after}"


def _warm(known: Parameters) -> str:
    time = amount(_size(known, "tau"), "min")
    grown = _changes("Steps", _size(known, "A"), "%")
    return f"{grown} as a session runs, with a time constant of {time}: the drive warms up"


def _jump(known: Parameters) -> str:
    when = f"{amount(_size(known, 'moment'), 'min')} into session {known[0].session}"
    return f"{_changes('Steps', _size(known, 'A'), '%')} {when}, and stay so"


def _wear(known: Parameters) -> str:
    begun = f"{10 ** round(log10(_size(known, 'n0').estimate)):,}"
    tenfold = _changes("Steps", _size(known, "k").times(log(10)), "%")
    return f"{tenfold} for every tenfold of the steps that a joint has made, from {begun} on: the joints wear"


def _payload(known: Parameters) -> str:
    changed = _changes("The effects of load", _size(known, "k"), known[0].unit)
    if known[0].session is None:
        return f"{changed} with the payload"
    when = f"{amount(_size(known, 'moment'), 'min')} into session {known[0].session}"
    return f"{changed} {when}: the arm carries another mass"


def _bends(known: Parameters) -> str:
    each = [
        f"{amount(one.size, one.unit, signed=True)} for {one.joint} {way(one.direction)}" for one in known
    ]
    return f"The response to load bends, by {listed(each)} (joint and direction)"


def _late(known: Parameters) -> str:
    size = _size(known, "L")
    return f"The end stop is heard {amount(size, 'steps')} {'late' if size.estimate > 0 else 'early'}"


def _lost(known: Parameters) -> str:
    size = _size(known, "L")
    return f"At each reversal {amount(size, 'steps')} are {'lost' if size.estimate > 0 else 'gained'}"


def _worn(known: Parameters) -> str:
    where = f"around q3 = {amount(_size(known, 'x0'), 'mm')} ({amount(_size(known, 'w'), 'mm')} wide)"
    return f"{_changes("Joint 3's steps", _size(known, 'A'), '%')} {where}: the guide has a worn spot"


def _misfires(known: Parameters) -> str:
    one_in, off = round(1 / _size(known, "share").estimate), percent(_size(known, "size").estimate)
    return f"About one count in {one_in:,} is off by {off} or so: the end stop is missed or imagined"


SENTENCES: dict[str, Sentence] = {
    "thermal-warm-up": _warm,
    "drift": _rate("through each session", "%/h"),
    "session-jump": _jump,
    "wear": _wear,
    "temperature": _rate("with the room's temperature", "%/K"),
    "humidity": _rate("with the humidity", "%/%"),
    "supply-voltage": _rate("with the supply voltage", "%/V"),
    "step-rate": _rate("when the step period doubles", factor=log(2)),
    "theta-offset": _signed("delta", "deg", "The base is tilted by ", " about x"),
    "psi-offset": _signed("delta", "deg", "The base is tilted by ", " about y"),
    "q2-offset": _signed("delta", "deg", "Joint 2's zero is off by "),
    "q1-gravity": _signed(
        "k", "%", "Gravity acts on a joint as q1 turns it, which the law ignores: ", " of what physics says"
    ),
    "recoil-axis": _signed("phi", "deg", "The arm recoils most at q2 = ", ", where the law has it at 0 deg"),
    "recoil-shape": lambda known: (
        f"Recoil follows the cosine of q2 to the power {number(_size(known, 'p').estimate, '1', 2)}"
    ),
    "side-load": _rate("where all the load lies across the guide", factor=-1.0, what="Joint 3's steps"),
    "load-nonlinearity": _bends,
    "load-hysteresis": _rate("after a traverse against full load"),
    "payload-change": _payload,
    "inertia-quadratic": _signed(
        "k", "µrad", "Joint 2's steps at q3 = 6 mm are ", " off the line between those at 0 and 12 mm",
        factor=HALF_WAY,
    ),
    "cable-torque": _rate(
        "along the range in direction +, and the reverse in −: a cable pulls", "µrad/deg",
        what="Rotary steps",
    ),
    "bearing-runout": _signed("A", "%", "Rotary steps vary by ± ", " over a turn: a bearing is eccentric"),
    "guide-gradient": _rate("along the guide", "%/mm", what="Joint 3's steps"),
    "worn-spot": _worn,
    "end-stop-latency": _late,
    "reversal-loss": _lost,
    "end-stop-misfire": _misfires,
}  # fmt: skip


def _plainly(finding: Finding) -> str:
    phrase = begun_large(str(getattr(finding.version, "phrase", finding.cause)))
    sizes = [f"{each.name} = {amount(each.size, each.unit, signed=True)}" for each in finding.parameters]
    return f"{phrase} ({', '.join(sizes)})" if sizes else phrase
