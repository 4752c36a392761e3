"""What is said of structure that no cause describes: what is proposed, what tests that, what comes close.

A finding ``unknown`` may have a version that extends the law: a short term with a formula, `Finding.term`,
or a smooth function of a carrier. Either is a proposal: it describes the log and names nothing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import ceil, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from stickslip_fit._format import (
    MISSING,
    format_coordinate,
    format_direction,
    format_percent,
    format_position,
    format_significant,
    format_uncertain,
    join_words,
)
from stickslip_fit._summary import Column, Table, numbers
from stickslip_fit.causes.profile import AlongTravel
from stickslip_fit.causes.proposed import (
    ANGLES,
    LENGTH,
    LOAD,
    LOADS,
    POSITION,
    TRANSVERSE_LOAD,
    ZETA,
    carrier_values,
)
from stickslip_fit.diagnosis.carriers import NODES, traverse_average
from stickslip_fit.diagnosis.finding import TO_SOME_EXTENT, Finding, closest_cause
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.residuals import term_change
from stickslip_fit.laws import state_at
from stickslip_fit.logs.history import (
    CHANGES,
    DEPARTURES,
    JOINT_NET_USE,
    JOINT_USE,
    LATE_TEMPERATURE,
    MOVES,
    NET_USE,
    OTHER_USE,
    PAUSES,
    RECENT_USE,
    TIME_OF_DAY,
    USE,
    unit_of,
)
from stickslip_fit.logs.log import has_replicates
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, is_coordinate
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.units import Z_95, from_si

if TYPE_CHECKING:
    import pandas as pd

    from stickslip_fit.diagnosis import Diagnosis

BEFORE_JOINT = "before_joint"
# With which some carriers begin.
PERIOD_OF, SETTINGS_OF, ADDED_BY = "period of ", "settings of ", "steps added by "
MIN_EXPLAINED, MAX_EXPLAINING = 0.05, 5  # share of a structure; causes in the table
MIN_CLOSE = 0.1  # share of a structure that a cause explains, from which it is called close
MIN_BENT = 0.1  # share of a structure that a cause explains only bent, from which that is told
OPPOSITE = ", with opposite signs in the two directions"
CARRIER_PHRASES = {
    "time": "changes slowly with time, in each session in its own way",
    "time, the same in each session": "changes slowly with time, in all sessions alike",
    "configuration": "depends on the configuration, in both directions alike",
    "configuration and direction": "depends on configuration and direction",
}
SINCE = {
    "pause": "since the traverse before",
    "joint_pause": "since the joint's traverse before",
    "other_pause": "since another joint moved",
    "tilt_age": "since the arm was tilted",
}
COLUMN_WORDS = {
    "before_direction": "the direction of the traverse before",
    "before_load": "the load of the traverse before",
    "before_length": "the length of the joint's traverse before, as a share of its travel",
    "before_gap": "the distance from where the joint last stopped, as a share of its travel",
    BEFORE_JOINT: "the joint that moved before",
    "other_load": "the load of the last traverse of another joint",
    "departure_before": "the departure of the traverse before",
    "joint_departure_before": "the departure of the joint's traverse before",
    **{name: f"the time {since}" for name, since in SINCE.items()},
    **{name: f"the travel in the last {seconds / 60.0:.0f} min or so" for name, seconds in USE.items()},
    **{
        name: f"the joint's own travel in the last {seconds / 60.0:.0f} min or so"
        for name, seconds in JOINT_USE.items()
    },
    **{
        name: f"the travel of the other joints in the last {seconds / 60.0:.0f} min or so"
        for name, seconds in OTHER_USE.items()
    },
    **{
        name: f"the net travel, by its sign, in the last {seconds / 60.0:.0f} min or so"
        for name, seconds in NET_USE.items()
    },
    **{
        name: f"the joint's own net travel, by its sign, in the last {seconds / 60.0:.0f} min or so"
        for name, seconds in JOINT_NET_USE.items()
    },
    **{
        name: f"the temperature some {seconds / 60.0:.0f} min late"
        for name, seconds in LATE_TEMPERATURE.items()
    },
    **{
        name: f"how the {CONDITIONS[condition].label} has changed in the last {seconds / 60.0:.0f} min or so"
        for name, (condition, seconds) in CHANGES.items()
    },
    **{
        name: f"how {coordinate} has changed in the last {seconds / 60.0:.0f} min or so"
        for name, (coordinate, seconds) in MOVES.items()
    },
    "session_seconds": "the time in the session",
    TIME_OF_DAY: "the time of day",
    "session_order": "the number of traverses in the session",
    "joint_travel": "the joint's own travel in the session, in whole ones",
    "steps_before": "the joint's own steps so far",
    "step_period": "the step period",
    POSITION: "the joint's own position",
    LENGTH: "the length of the traverse",
    LOAD: "the load",
    TRANSVERSE_LOAD: "the transverse load",
    ZETA: "the angle zeta = psi − q2",
}


def describe_carrier(carrier: str) -> str:
    """What unknown structure does, as the end of a sentence.

    Examples
    --------
    >>> describe_carrier("period of 41.2 min"), describe_carrier("time, joint 3")
    ('comes and goes with a period of 41.2 min', 'changes slowly with time, in joint 3')
    >>> describe_carrier("period of 9.0 min, by load")
    'comes and goes with a period of 9.0 min in proportion to the load'
    >>> describe_carrier("memory-by-direction of each joint, + only")
    'carries over from one traverse of each joint to the next in direction +'
    >>> describe_carrier("product of load and session_seconds, joint 3")
    'follows the product of the load and the time in the session, joint 3'
    >>> describe_carrier("steps added by pause, + only")
    'adds steps to counts by the time since the traverse before, + only'
    """
    if carrier.startswith(ADDED_BY):
        return f"adds steps to counts by {name_carrier(carrier.removeprefix(ADDED_BY))}"
    if carrier.startswith("period"):
        wave = carrier.replace(", by load", " in proportion to the load").replace(", opposite", OPPOSITE)
        return f"comes and goes with a {wave}"
    if carrier.startswith("memory"):
        chain, _, direction = carrier.partition(", ")
        joint = chain.removeprefix("memory-by-direction").removeprefix("memory").strip() or "of any joint"
        onto = f" in direction {direction.removesuffix(' only')}" if direction else ""
        return f"carries over from one traverse {joint} to the next{onto}"
    if carrier.endswith(TO_SOME_EXTENT):
        return f"has something of {carrier.removesuffix(TO_SOME_EXTENT)}"
    if carrier.startswith("time, joint"):
        return f"changes slowly with time, in {carrier.removeprefix('time, ')}"
    return CARRIER_PHRASES.get(carrier, f"follows {name_carrier(carrier)}")


def name_carrier(carrier: str) -> str:
    """A carrier with its columns in words.

    Examples
    --------
    >>> name_carrier("steps_before, joint 2 +"), name_carrier("covariate:lamp, opposite")
    ("the joint's own steps so far, joint 2 +", 'lamp, with opposite signs in the two directions')
    """
    names, text = "|".join(COLUMN_WORDS), carrier.replace(COVARIATE_PREFIX, "")
    text = re.sub(rf"\b({names})\b", lambda match: COLUMN_WORDS[match[1]], text)
    text = text.replace(", opposite", OPPOSITE).replace(", in part", ", around what they have in common")
    return re.sub(r"^product of", "the product of", text)


def name_finding(finding: Finding) -> str:
    """A finding as a table calls it; a proposal is called one."""
    if finding.cause != UNKNOWN or finding.version is None:
        return finding.cause
    if finding.term:
        return f"{UNKNOWN}: proposed term"
    forms = {PERIOD_OF: "wave", SETTINGS_OF: "offsets by setting"}
    form = next(
        (name for begin, name in forms.items() if finding.carrier.startswith(begin)), "smooth function"
    )
    return f"{UNKNOWN}: {form}"


def name_findings(findings: Sequence[Finding]) -> list[str]:
    """Findings as a table calls them; what they follow tells apart those of one name."""
    names = [name_finding(one) for one in findings]
    return [
        f"{name} ({name_carrier(one.carrier)})" if names.count(name) > 1 and one.carrier else name
        for name, one in zip(names, findings, strict=True)
    ]


def name_in_sentence(findings: Sequence[Finding]) -> list[str]:
    """The same as they are called within a sentence: "the smooth function", "drift"."""
    return [name.replace(f"{UNKNOWN}: ", "the ") for name in name_findings(findings)]


def describe_proposal(finding: Finding) -> str:
    """What is put into the law for structure without a name, without a full stop."""
    steps, worth = _name_steps(finding), _describe_worth(finding)
    if not finding.term and hasattr(finding.version, "period"):
        period = re.sub(r", joint .*", "", describe_carrier(finding.carrier))  # which `steps` says
        period = period.replace("comes and goes", "come and go")
        changes = ", whose size and phase change," * bool(getattr(finding.version, "n_slow", 0))
        each = _name_each(finding)
        return f"{steps} {period}, which no known cause does; a wave{each}{changes} is proposed; {worth}"
    if not finding.term:
        what = "both" if len(getattr(finding.version, "carriers", ())) > 1 else "it"
        follow = "have steps more or less that follow" if _adds_steps(finding) else "follow"
        return (
            f"{steps} {follow} {name_carriers(finding)} in a way that no known cause describes; "
            f"a smooth function of {what}{_name_each(finding)} is proposed; {worth}"
        )
    sizes = [
        f"{one.name}{f' ({format_direction(one.direction)})' if one.direction else ''} = "
        f"{format_uncertain(one.size.estimate, (one.size.high - one.size.low) / (2 * Z_95), one.unit)}"
        for one in finding.parameters
    ]
    what = ", ".join([f"a term is proposed: {finding.term}", *sizes])
    if finding.carrier.startswith("memory"):
        steps = f"{steps[0].lower()}{steps[1:]}"
        return f"What {steps} depart by {describe_carrier(finding.carrier)}; {what}; {worth}"
    return f"{steps} follow {name_carriers(finding)} in a way that no known cause describes; {what}; {worth}"


def _adds_steps(finding: Finding) -> bool:
    """Whether a proposal adds steps to counts, as many to short ones as to long ones."""
    return getattr(finding.version, "acts_at", "") == "count"


def _differs_by_session(finding: Finding) -> bool:
    return len(getattr(finding.version, "sessions", ())) > 1


def _name_each(finding: Finding) -> str:
    """Of what each has a function of its own."""
    if _differs_by_session(finding):
        return " for each session"
    return " for each joint and direction" if getattr(finding.version, "each", False) else ""


def name_carriers(finding: Finding) -> str:
    """What a proposal follows, in words."""
    carriers = tuple(dict.fromkeys(getattr(finding.version, "carriers", ())))
    together = " together" if len(carriers) > 1 else ""
    words = join_words([name_carrier(name) for name in carriers]) or name_carrier(finding.carrier)
    opposite = getattr(finding.version, "mode", "same") == "opposite"
    ways = f"{OPPOSITE}," if opposite else ""
    partly = "in part " if getattr(finding.version, "common", 0.0) else ""
    in_sessions = f", {partly}differently in each session," * _differs_by_session(finding)
    return f"{words}{together}{ways}{in_sessions}".replace(",,", ",")


def _name_steps(finding: Finding) -> str:
    joints = [str(joint) for joint in finding.joints]
    directions = {direction for _, direction in getattr(finding.version, "on", ())}
    only = f" in direction {format_direction(*directions)}" if len(directions) == 1 else ""
    what = "counts" if _adds_steps(finding) else "steps"
    if len(joints) == 1:
        return f"Joint {joints[0]}'s {what}{only}"
    return f"The {what} of joints {join_words(joints)}{only}" if joints else f"{what.capitalize()}{only}"


def _describe_worth(finding: Finding) -> str:
    gain = finding.gain
    if gain is None:
        return f"its effect is {format_percent(finding.effect.estimate)} rms"
    before, after = format_percent(gain.baseline), format_percent(gain.extended)
    if gain.extended >= gain.baseline or (before == after and gain.doubt):
        return f"held-out errors stay at {after}"
    if before == after:
        return f"it lowers the held-out error of {before} by {format_percent(gain.cut.estimate)}"
    return f"it lowers the held-out error from {before} to {after}{gain.doubt}"


def describe_scatter(diagnosis: Diagnosis) -> str:
    """The error that the true law would leave, as a clause; only what was repeated has a repeatability."""
    size = format_percent(diagnosis.repeatability)
    if has_replicates(diagnosis.selection.problem.rows):
        return f"the repeatability is {size}"
    return f"the scatter that no law tried here explains is {size} (no traverse was repeated)"


def describe_unknown_gain(finding: Finding, diagnosis: Diagnosis) -> str:
    """What to do about a proposal, as sentences; empty for structure without one."""
    if finding.version is None:
        return ""
    test = describe_test(finding, diagnosis)
    what = f"what {describe_stand_in(finding)}"
    carriers = getattr(finding.version, "carriers", ())
    if RECENT_USE.keys() & {*carriers}:
        closest = _name_closest(finding)
        what = f"whether it is warmth from driving, as a thermometer at the joint would tell{closest}"
    if carriers == (POSITION,) and getattr(finding.version, "sessions", ()):
        what = f"what makes it differ from session to session{_name_closest(finding)}"
    noise = (
        "Noise with memory from traverse to traverse would look much the same: what comes back when a "
        "session is repeated is none. "
    ) * diagnosis.selection.behind(finding).resembles_memory
    return (
        f"{test + ' ' if test else ''}{noise}{describe_lag(finding)}What to do: find out {what}, log that as "
        "a column of its own, and diagnose again. Meanwhile the extended law has it; "
        f"{describe_scatter(diagnosis)}."
    )


def describe_lag(finding: Finding) -> str:
    """That a column explains with a lag what was found, as a sentence and a space; else nothing."""
    late = finding.lagged
    if late is None:
        return ""
    before, after = 100 * late.without_lag, 100 * late.share
    what = f"{name_carrier(late.column)} some {from_si(late.lag, 'min'):.0f} min late"
    return (
        f"Steps seem to follow {what}: with this lag it explains {after:.0f} % of all that was found, "
        f"without it {before:.0f} %. "
    )


def describe_stand_in(finding: Finding) -> str:
    """What a proposal is to be replaced by, as a clause: that for which it stands."""
    if finding.carrier.startswith(SETTINGS_OF):
        return f"the offsets stand for{_name_closest(finding)}"
    return f"the {'term' if finding.term else 'function'} stands for{_name_closest(finding)}"


def _name_closest(finding: Finding) -> str:
    """The known cause that explains most of it, in brackets, or that none explains much."""
    if not finding.explains:
        return ""
    closest = closest_cause(finding.explains, finding.explains_by_equation)
    own = share_by_equation(finding, closest)
    if own < MIN_CLOSE:
        bends = max(finding.explains.values()) >= MIN_CLOSE
        most = f"{max(ceil(round(100 * own, 6)), 1)} % of it{' by its equation' * bends}"
        return f" (no known cause explains more than {most})"
    sessions = getattr(finding.version, "sessions", ())
    if sessions and closest == AlongTravel.name:
        return f" (one profile for all sessions, {closest}, {describe_share(finding, closest)})"
    return f" (the closest known cause, {closest}, {describe_share(finding, closest)})"


def share_by_equation(finding: Finding, cause: str) -> float:
    """The share that a known cause explains of structure without a name, unbent where that can be told."""
    return finding.explains_by_equation.get(cause, finding.explains.get(cause, finding.share))


def describe_share(finding: Finding, cause: str) -> str:
    """The same as a clause; what a bent form explains is no evidence for the cause."""
    share, own = finding.explains.get(cause, finding.share), share_by_equation(finding, cause)
    bent = f", {100 * share:.0f} % if its form may bend as the data ask" if share - own >= MIN_BENT else ""
    return f"explains {100 * (own if bent else share):.0f} % of it{bent}"


def describe_test(finding: Finding, diagnosis: Diagnosis) -> str:
    """The traverses that would test a proposal, as a sentence: where in this log it is at its extremes."""
    carriers: tuple[str, ...] = getattr(finding.version, "carriers", ())
    if diagnosis.table is not None or not carriers:
        return ""
    if not {*DEPARTURES}.isdisjoint(carriers):
        return (
            "To test it, drive one configuration again and again: each traverse should follow what the one "
            "before departed by. Where that has no count, as in a plan, the law expects no departure."
        )
    if getattr(finding.version, "common", 0.0):
        gain = diagnosis.gain_new_session
        if gain is not None and gain.high < 0.0:  # which the answer begins with
            return "It predicts within its session only."
        if gain is not None and gain.extended >= gain.baseline:
            before, after = format_percent(gain.baseline), format_percent(gain.extended)
            worse = "no better" if before == after else f"worse, with errors of {after} in place of {before}"
            if before != after and gain.high > 0:
                worse += ", though not for certain"
            return f"It predicts within its session only: a new session is predicted {worse}."
        does = "may predict" if gain is None or gain.doubt else "predicts"
        return (
            f"What the sessions have in common {does} another session, too; the rest predicts its own only."
        )
    if getattr(finding.version, "sessions", ()):
        own = "Each session has its own" if _differs_by_session(finding) else "It is that of this session"
        return f"{own}; the law has none for a session to come."
    most, least = find_extremes(finding, diagnosis)
    where = f"{_format_extreme(finding, diagnosis, *most)} and {_format_extreme(finding, diagnosis, *least)}"
    return f"To test it, repeat traverses where it is at its extremes, all else alike: {where}."


def find_extremes(finding: Finding, diagnosis: Diagnosis) -> list[tuple[pd.Series[Any], float]]:
    """The traverses on which a function makes steps largest and smallest, each with the relative change.

    Of one that adds steps to counts with their number. Within one joint and direction, so that nothing else
    has to differ between the two.
    """
    selection = diagnosis.selection
    version, rows = selection.behind(finding).version, selection.problem.rows
    change = term_change(selection, version)
    if _adds_steps(finding):
        change = change * rows["steps"].to_numpy(float)
    else:  # the change of the count is minus the sum of each parameter times its function
        change = version.of_sum(-change)[0] - 1.0
    groups = rows.groupby(["joint", "direction"], observed=True).indices.values()
    # A traverse without one before it has no value to repeat.
    carriers: tuple[str, ...] = getattr(finding.version, "carriers", ())
    columns = [rows[name] for name in carriers if name in rows and not is_coordinate(name)]
    known = np.all([np.ones(len(rows), dtype=bool), *(one.notna() & (one != "") for one in columns)], axis=0)
    groups = [places[known[places]] for places in groups if known[places].any()]
    inside = max(groups, key=lambda places: float(np.ptp(change[places])))
    places = [int(inside[extreme(change[inside])]) for extreme in (np.argmax, np.argmin)]
    return [(rows.iloc[place], float(change[place])) for place in places]


def _format_extreme(finding: Finding, diagnosis: Diagnosis, row: pd.Series[Any], size: float) -> str:
    """A traverse, by its carriers, and how large the function is there."""
    carriers: tuple[str, ...] = getattr(finding.version, "carriers", ())
    way = "" if _is_same_both_ways(finding) else f" {format_direction(str(row['direction']))}"
    where = format_carriers([name for name in carriers if name != BEFORE_JOINT], row, diagnosis)
    where = f" at {where}" if where else ""
    after = f" after joint {row[BEFORE_JOINT]:.0f}" if BEFORE_JOINT in carriers else ""
    if _adds_steps(finding):
        more = f"{abs(size):,.0f} steps {'more' if size > 0 else 'fewer'}"
    else:
        more = f"steps {format_percent(size, signed=True)}"
    return f"joint {row['joint']}{way}{where}{after} ({more})"


def format_carriers(carriers: Sequence[str], row: pd.Series[Any], diagnosis: Diagnosis) -> str:
    """Names of carriers and their values on one traverse."""
    machine = load_machine() if diagnosis.log is None else diagnosis.log.machine
    return join_words([_format_carrier(name, row, machine) for name in carriers])


def _is_same_both_ways(finding: Finding) -> bool:
    """Whether a proposal does the same in both directions of a joint."""
    version, ways = finding.version, [way for _, way in getattr(finding.version, "on", ())]
    each, mode = getattr(version, "each", False), getattr(version, "mode", "same")
    return not each and mode == "same" and ways.count("+") == ways.count("-")


def _format_carrier(name: str, row: pd.Series[Any], machine: Machine) -> str:
    """A carrier's name and its value on one traverse."""
    label = name_carrier(name)
    if is_coordinate(name):
        return format_coordinate(name, float(row[name]), machine)
    if name == ZETA:
        joint = int(row["joint"])
        q2 = (row["start"] + row["stop"]) / 2 if joint == 2 else row["q2"]
        return f"zeta = {from_si(float(row['psi'] - q2), 'deg'):.0f}°"
    if name == POSITION:
        joint = int(row["joint"])
        return f"q{joint} about {format_position(float(row['start'] + row['stop']) / 2, joint, machine)}"
    if name == LENGTH:
        return (
            f"{label} {format_position(abs(float(row['stop'] - row['start'])), int(row['joint']), machine)}"
        )
    if name in LOADS:
        start, stop = float(row["start"]), float(row["stop"])
        values = {column: np.array([row[column]]) for column in ("start", "stop", *ANGLES)}
        along = state_at(int(row["joint"]), values, (start + stop) / 2 + (stop - start) / 2 * NODES[None])
        return f"{label} {_format_load(float(traverse_average(carrier_values(along, name))[0]))}"
    if name == "before_direction":
        return f"{label} {format_direction(str(row[name])) or 'unknown'}"
    value, unit = float(row[name]), ""
    if name in RECENT_USE:
        whose = " of its own" if name in JOINT_USE else " of the other joints" if name in OTHER_USE else ""
        minutes = from_si(RECENT_USE[name], "min")
        return f"{value:.2f} full travels{whose} in the last {minutes:.0f} min or so"
    if name in NET_USE | JOINT_NET_USE:
        whose = " of its own" if name in JOINT_NET_USE else ""
        minutes = from_si((NET_USE | JOINT_NET_USE)[name], "min")
        return f"net {value:.2f} full travels{whose} in the last {minutes:.0f} min or so"
    if name == TIME_OF_DAY:
        return f"{label} {int(value // 3600):02d}:{int(value % 3600 // 60):02d}"
    if name == "session_seconds":
        value, unit = from_si(value, "h"), " h"
    elif name in PAUSES:
        return f"{format_significant(from_si(value, 'min'), 3)} min {SINCE[name]}"
    elif name in CHANGES | MOVES:
        of, seconds = (CHANGES | MOVES)[name]
        unit = unit_of(name)
        more = f"{format_significant(from_si(value, unit), 3)}{'°' if unit == 'deg' else f' {unit}'}"
        what = f"a {CONDITIONS[of].label}" if of in CONDITIONS else of
        return f"{what} changed by {more} in the last {seconds / 60.0:.0f} min or so"
    elif shown := unit_of(name):
        value, unit = from_si(value, shown), f" {shown}"
    return f"{label} {format_significant(float(value), 3)}{unit}"


def _format_load(load: float) -> str:
    """A load, which is at most 1; 0 where only rounding makes it none.

    Examples
    --------
    >>> _format_load(6e-17), _format_load(-0.8412)
    ('0.0', '−0.84')
    """
    return format_significant(round(load, 3) + 0.0, 2)


def explains_tables(diagnosis: Diagnosis) -> list[Table]:
    """The causes that come closest to structure without a name, or no table."""
    unit, number = diagnosis.info.unit, diagnosis.info.format_number
    tables = []
    for finding in diagnosis.findings:
        own = {**finding.explains, **finding.explains_by_equation}
        ranked = sorted(finding.explains.items(), key=lambda item: (-own[item[0]], -item[1]))
        shares = [item for item in ranked if item[1] >= MIN_EXPLAINED][:MAX_EXPLAINING]
        size = finding.effect.estimate
        rows = tuple(
            (
                cause,
                f"{100 * finding.explains_by_equation[cause]:.0f}"
                if cause in finding.explains_by_equation
                else MISSING,
                f"{100 * share:.0f}",
                number(size * sqrt(max(1 - share, 0.0))),
            )
            for cause, share in shares
        )
        columns = (
            Column("cause", text=True),
            *numbers("by its equation", "bent to fit", unit="%"),
            Column("leaves", f"{unit} rms".strip()),
        )
        note = (
            f"Each cause by itself: the share that it explains of the square of the "
            f"{diagnosis.info.format_size(size)} rms without a name, by its equation, where that has one "
            "shape, and with a form that bends as the data ask, where it may; and the rms that the bent form "
            "would leave. What only a bent form explains is no evidence for the cause."
        )
        tables += [Table("The closest causes", columns, rows, note=note)] if rows else []
    return tables
