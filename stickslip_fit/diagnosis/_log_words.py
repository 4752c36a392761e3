"""What the diagnosis of a log says of its findings, and what cures them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    capitalize_first,
    format_direction,
    format_p_value,
    format_percent,
    format_position,
    format_time,
    join_words,
    pluralize,
)
from stickslip_fit.causes import EndStopMisfire
from stickslip_fit.causes.function_of_cause import FunctionOfCause
from stickslip_fit.causes.parameters import plain_description
from stickslip_fit.causes.profile import AlongTravel
from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.diagnosis._noise_words import describe_noise
from stickslip_fit.diagnosis._stage_summary import describe_reading
from stickslip_fit.diagnosis._unknown_summary import (
    describe_carrier,
    describe_proposal,
    describe_scatter,
    describe_unknown_gain,
    find_extremes,
    format_carriers,
    name_carrier,
)
from stickslip_fit.diagnosis._words import Words, baseline_name
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.problem import MISFIRE
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.travel_profile import TravelProfile, format_extremes
from stickslip_fit.estimation._gaps import fill_gaps
from stickslip_fit.units import Z_95

STANDS_OUT = 2.0  # times the profile of any other session
FAR_ABOVE = 3.0  # times the noise: an error that is told
MAX_PROFILES = 4  # told one by one


def describe_effect(finding: Finding) -> str:
    """What a named cause does, without a full stop; without parameters, with the size of its effect.

    A cause without `describe` is described by its phrase. No sentence takes for known what is at the end of
    the range searched.
    """
    cause = _cause(finding)
    ends = [one for one in finding.parameters if one.name in finding.at_bounds]
    known = [one for one in finding.parameters if one not in ends]
    if hasattr(cause, "describe"):
        text = cause.describe(known)
    else:
        text = plain_description(getattr(cause, "phrase", finding.cause), known)
    text += "".join(
        f", {one.name} at the end of the range searched, {f'{one:+}'.removeprefix('+')}" for one in ends
    )
    return text if finding.parameters else f"{text}, by {format_percent(finding.effect.estimate)} rms"


def remedy_for(finding: Finding) -> str:
    """What cures it, as the beginning of a sentence; empty where only the extended law does."""
    return getattr(_cause(finding), "remedy", "")


def _cause(finding: Finding) -> Any:
    return EndStopMisfire() if finding.cause == MISFIRE else finding.version


@dataclass(frozen=True)
class LogWords(Words):
    """What is said of a log."""

    def tell_no_finding(self) -> list[str]:
        diagnosis = self.diagnosis
        is_less = diagnosis.misfit < diagnosis.repeatability
        is_less &= format_percent(diagnosis.misfit) != format_percent(diagnosis.repeatability)
        absorbed = ", a part of which the fit takes up" * is_less
        text = (
            f"Nothing is wrong that this log can show: the {baseline_name(diagnosis)} leaves "
            f"{format_percent(diagnosis.misfit)} rms, and {describe_scatter(diagnosis)}{absorbed} "
            f"(p {format_p_value(diagnosis.p_value, relation=True)})."
        )
        if not np.isfinite(diagnosis.repeatability):
            text = f"Nothing can be said of this log: {diagnosis.untestable[UNKNOWN]}."
        return [text, *describe_noise(diagnosis), *describe_gaps(diagnosis)]

    def tell_findings(self) -> list[str]:
        """See `Words`: outlying counts last, since the gain is that of the law, and takes them out before."""
        first, *others = sorted(self.diagnosis.findings, key=lambda one: one.cause == MISFIRE)
        return [
            f"{self.warn_of_new_session()}{self.describe_finding(first)}.{self._describe_travel(first)}",
            f"{self._describe_gain(first)}{self._describe_excess()}",
            *(f"{self.describe_side_effect(one)}{self._describe_travel(one)}" for one in others),
            *(describe_reading(one, intervals=False) for one in self.diagnosis.stage if one.has_size),
            *describe_noise(self.diagnosis),
            *describe_gaps(self.diagnosis),
        ]

    describe_effect = staticmethod(describe_effect)
    describe_carrier = staticmethod(describe_carrier)
    describe_proposal = staticmethod(describe_proposal)

    def outlier_cells(self, row: pd.Series) -> dict[str, str]:
        """See `Words`: without a time a traverse is known by its ends."""
        joint, machine = int(row["joint"]), self.diagnosis.require_log().machine
        ends = [format_position(float(row[end]), joint, machine) for end in ("start", "stop")]
        when = {"time": format_time(row["time"])} if pd.notna(row["time"]) else {"ends": " to ".join(ends)}
        return {
            "session": str(row["session"]),
            **when,
            "joint": f"{row['joint']} {format_direction(str(row['direction']))}",
            "steps": f"{row['steps']:,}",
        }

    def _describe_travel(self, finding: Finding) -> str:
        """Where along the travel steps are smallest and largest, as a sentence with a space before it.

        Empty where parameters tell it, and where each session has a function and none stands out.
        """
        if isinstance(finding.version, FunctionOfCause):
            return self._describe_curve(finding)
        profiles = sorted(filter(_is_known, finding.travel), key=lambda one: -one.rms)
        if not profiles or not isinstance(finding.version, AlongTravel | SmoothTerm):
            return ""
        begin, session = "", profiles[0].session
        if session:
            rest = max((one.rms for one in profiles if one.session != session), default=0.0)
            if profiles[0].rms < STANDS_OUT * rest:
                return ""
            profiles = [one for one in profiles if one.session == session]
            sizes = f"{format_percent(profiles[0].rms)} rms, others at most {format_percent(rest)}"
            begin = f"Session {session} stands out ({sizes}): "
        told = []
        for one in sorted(profiles[:MAX_PROFILES], key=lambda one: (one.joint, one.direction)):
            least, most = format_extremes(one, self.diagnosis.require_log().machine)
            where = [f"joint {one.joint}"] if len({one.joint for one in profiles}) > 1 else []
            where += [f"direction {format_direction(one.direction)}"] if one.direction else []
            scope = f"in {', '.join(where)} " if where else ""
            told.append(f"{scope}steps are smallest at {least} and largest at {most}")
        text = begin + "; ".join(told)
        return f" {capitalize_first(text)}."

    def _describe_curve(self, finding: Finding) -> str:
        """Where the curve of a cause is at its extremes, as a sentence with a space before it."""
        (most, high), (least, low) = find_extremes(finding, self.diagnosis)
        carriers = finding.version.carriers
        largest, smallest = (format_carriers(carriers, row, self.diagnosis) for row in (most, least))
        return (
            f" Steps are smallest at {smallest} ({format_percent(low, signed=True)}) and largest at "
            f"{largest} ({format_percent(high, signed=True)})."
        )

    def _describe_excess(self) -> str:
        """That held-out errors are far above the noise, as a sentence with a space before it; else empty."""
        gain = self.diagnosis.gain
        if gain is None or not gain.extended > FAR_ABOVE * gain.noise_floor:
            return ""
        return (
            f" On held-out traverses the extended law still errs by {gain.extended / gain.noise_floor:.0f} "
            "times that: its functions are learned from too few traverses, or something else is left."
        )

    def _describe_gain(self, finding: Finding) -> str:
        diagnosis = self.diagnosis
        scatter = describe_scatter(diagnosis)
        if finding.cause == UNKNOWN:
            return describe_unknown_gain(finding, diagnosis) or f"{self.advice_on_unknown}; {scatter}."
        cure = remedy_for(finding) if not finding.equivalent else ""
        law = "" if finding.cause == MISFIRE else "the extended law"
        gain = diagnosis.gain
        if cure and gain is not None and all(one.version is None for one in diagnosis.findings):
            held_out = f"held-out traverses are predicted to {format_percent(gain.extended)} rms"
            return f"Remedy: {cure}; {held_out}; {scatter}."
        if gain is None:
            cut = f"takes away errors of {format_percent(finding.effect.estimate)} rms"
        else:
            cut = self.describe_cut(gain)
        choices = " or ".join(filter(None, [f"{cure}," if cure and law else cure, law]))
        what = f"Remedy: {choices}, which" if cure else capitalize_first(law)
        following = ""
        if finding.equivalent and diagnosis.next_experiment:
            following = " The full answer lists the traverses that would separate them."
        elif finding.equivalent and knows_calibration(diagnosis):
            following = " No candidate traverse would separate them."
        elif finding.equivalent:
            following = (
                " No traverse that would separate them is proposed, as the law does not say how a session is "
                "calibrated."
            )
        return f"{what} {cut}; {scatter}.{following}"


def _is_known(profile: TravelProfile) -> bool:
    """Whether any of its extremes is more than its error."""
    return bool(np.any(np.abs(profile.change) > Z_95 * profile.error))


def knows_calibration(diagnosis: Diagnosis) -> bool:
    """Whether a law says how its next session is calibrated, without which no traverse is proposed."""
    return any(part.law.calibration() for part in diagnosis.selection.problem.parts)


def describe_gaps(diagnosis: Diagnosis) -> list[str]:
    """A sentence on empty cells of smooth columns; none where there is none."""
    if diagnosis.log is None:
        return []
    rows = diagnosis.log.rows
    rows = rows[rows["status"] == "ok"]
    filled = fill_gaps(rows).isna().sum()
    counts = {name: int(rows[name].isna().sum() - filled[name]) for name in rows}
    told = [f"{pluralize(n, 'empty cell')} of {name_carrier(name)}" for name, n in counts.items() if n]
    return [f"Filled in between readings: {join_words(told)}."] if told else []
