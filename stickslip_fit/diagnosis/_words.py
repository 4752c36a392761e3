"""What is said of findings, in a log or a table: `Words` has what both have in common.

`LogWords` (`_log_words`) and `TableWords` (`_table_words`) say the rest: a log is of traverses and its sizes
are per cent of a step, a table is of rows and its sizes are in the unit of the response.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stickslip_fit._format import format_p_value, join_words
from stickslip_fit._typing import Array
from stickslip_fit.diagnosis._unknown_summary import (
    describe_lag,
    describe_share,
    name_in_sentence,
    share_by_equation,
)
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.finding import TO_SOME_EXTENT, DataInfo, Finding, Gain
from stickslip_fit.diagnosis.linearized import rms
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.residuals import compute_shape, fitted_effect
from stickslip_fit.diagnosis.selection import MAX_LEFT_OF_BOTH, allocate_alpha
from stickslip_fit.diagnosis.withdrawal import explain_unsupported
from stickslip_fit.laws.published import name_of_laws

if TYPE_CHECKING:
    from stickslip_fit.diagnosis.result import Diagnosis

MAX_UNTESTABLE_NAMED = 4
MIN_CORRELATION = 0.5  # of an effect with a column, to be told as rising or falling
MIN_LEFT = 1e-3  # of a column's spread, of which less is rounding
MIN_BULGE = 0.25  # of its range, by which it is larger or smaller at middle values
# Least probability and largest p-value of structure without a name beside what is named, to be told.
MIN_REST, MAX_REST_P_VALUE = 0.3, 0.1
MIN_SHARE, NEARLY_ALL = 0.05, 0.9  # of a structure that its closest cause explains, to be told


def largest_departures(outliers: pd.DataFrame, most: int) -> pd.DataFrame:
    """The rows of a finding of outliers that are farthest off, at `most` so many, the farthest first."""
    return outliers.loc[outliers["departure"].abs().sort_values(ascending=False).index].head(most)


@dataclass(frozen=True)
class Words(ABC):
    """What is said of a diagnosis."""

    diagnosis: Diagnosis

    @property
    def info(self) -> DataInfo:
        """What the data are called, and how sizes are shown."""
        return self.diagnosis.info

    @abstractmethod
    def tell_no_finding(self) -> list[str]:
        """That nothing is wrong, and what comes closest."""

    @abstractmethod
    def tell_findings(self) -> list[str]:
        """What is wrong, what to do about it, and what else is wrong."""

    @abstractmethod
    def describe_effect(self, finding: Finding) -> str:
        """What a named cause does, without a full stop."""

    @abstractmethod
    def describe_carrier(self, carrier: str) -> str:
        """What unknown structure does, as the end of a sentence."""

    @abstractmethod
    def describe_proposal(self, finding: Finding) -> str:
        """What is put into the law for structure without a name, without a full stop."""

    @abstractmethod
    def outlier_cells(self, row: pd.Series) -> dict[str, str]:
        """What identifies a row with an outlying value: cells by the heads of their columns."""

    def tell_rest(self) -> list[str]:
        """What is left after all findings, or may be where that is not unlikely, as a sentence."""
        diagnosis, selection = self.diagnosis, self.diagnosis.selection
        last, most = selection.last_misfit, selection.problem.max_causes
        searched = [one for one in selection.selected if one.cause != selection.problem.outlier_cause]
        if len(searched) == most and last.p_value < allocate_alpha(diagnosis.alpha):
            cause = form_cause_set(last).cause
            follows = "structure without a name" if cause == UNKNOWN else self.name_cause(cause)
            return [
                f"There is more (p {format_p_value(last.p_value, relation=True)}), but the search ends after "
                f"{most} findings; {follows} would be next. Put what was found into the law, and "
                "diagnose again."
            ]
        probability = diagnosis.inclusion.get(UNKNOWN) or 0.0
        is_likely = probability >= MIN_REST and last.p_value <= MAX_REST_P_VALUE
        if not is_likely or any(one.cause == UNKNOWN for one in diagnosis.findings):
            return []
        found = ""
        if last.p_value >= allocate_alpha(diagnosis.alpha):
            found = ", though the test of that raises no alarm"
        return [
            "In what that leaves there may be structure without a name, with a probability of "
            f"{100 * probability:.0f} %{found} (p {format_p_value(last.p_value, relation=True)})."
        ]

    def tell_cancelling(self) -> list[str]:
        """Which effects in the law undo each other nearly, as sentences."""
        selection = self.diagnosis.selection
        in_law = {id(one.version) for one in selection.law_causes}
        found = [one for one in self.diagnosis.findings if id(one.version) in in_law]
        if len(found) < 2:
            return []
        names = name_in_sentence(found)
        effects, told = [fitted_effect(selection, one.version) for one in found], []
        for (one, own), (other, opposite) in combinations(zip(names, effects, strict=True), 2):
            together, smaller = rms(own + opposite), min(rms(own), rms(opposite))
            if together < MAX_LEFT_OF_BOTH * smaller:
                share = 100 * together / smaller
                told.append(
                    f"The effects of {one} and {other} nearly cancel: together they are "
                    f"{share:.2g} % of the smaller one. What they do together is known far better than how "
                    "large each is."
                )
        return told

    def flags(self) -> list[str]:
        """What is doubtful of the law itself."""
        return []

    def notes(self) -> tuple[str, ...]:
        """How the data were read, and what the search left out."""
        return self.diagnosis.notes

    def name_cause(self, cause: str) -> str:
        """A cause in words, with its name."""
        phrases = {one.name: getattr(one, "phrase", "") for one in self.diagnosis.selection.problem.causes}
        return f"{phrases[cause]} ({cause})" if phrases.get(cause) else cause

    def describe_finding(self, finding: Finding) -> str:
        """A finding or the causes that it may be, without a full stop."""
        if finding.cause == UNKNOWN:
            return self.describe_shape(finding)
        effect = (
            f"{self.describe_effect(finding)}{self.describe_way(finding)}{describe_company(finding)}"
            f"{self.describe_support(finding)}"
        )
        if not finding.equivalent:
            return effect
        either = join_words(list(map(self.name_cause, finding.cause_set)), "or")
        return (
            f"This {self.info.data} cannot tell what is wrong: {either}. If it is the first: "
            f"{lower_first(effect)}"
        )

    def describe_side_effect(self, finding: Finding) -> str:
        """A finding beside the first one, as a sentence."""
        if finding.cause == UNKNOWN:
            shape = f"Besides that: {lower_first(self.describe_shape(finding))}."
            return f"{shape} {describe_lag(finding)}".rstrip()
        rivals = f", or {join_words(finding.equivalent, 'or')}" if finding.equivalent else ""
        effect = lower_first(self.describe_effect(finding))
        told = f"{self.describe_way(finding)}{describe_company(finding)}{self.describe_support(finding)}"
        return f"Besides that: {effect} ({finding.cause}{rivals}){told}."

    def describe_shape(self, finding: Finding) -> str:
        """What structure without a name does, without a full stop."""
        if finding.version is not None:
            return self.describe_proposal(finding)
        if finding.withdrawn:
            first, *others = map(self._describe_withdrawn, finding.withdrawn)
            return ". Besides that: ".join([first, *map(lower_first, others)])
        text = (
            f"What the law leaves of {self.info.response}, {self.format_rms(finding)}, "
            f"{self.describe_carrier(finding.carrier)}"
        )
        if finding.carrier.endswith(TO_SOME_EXTENT):
            return f"{text}, but by the evidence of one or two {self.info.row}s, so that no cause is named"
        way, share = self.describe_way(finding), share_by_equation(finding, finding.closest)
        explains = describe_share(finding, finding.closest)
        if finding.closest and share > NEARLY_ALL:
            return f"{text}{way}; {finding.closest} {explains}, but is less likely"
        text += f", and has the shape of no cause that was searched{way}"
        if not finding.closest or share < MIN_SHARE:
            return text
        return f"{text}; the closest, {finding.closest}, {explains}"

    def describe_way(self, finding: Finding) -> str:
        """Which way the response goes with the column that a finding follows, as the end of a sentence.

        Empty where it follows several columns or none, or its parameters say so.
        """
        selection, info = self.diagnosis.selection, self.info
        selected, rows = selection.behind(finding), selection.problem.rows
        version = selected.version
        carrier = finding.carrier.removesuffix(TO_SOME_EXTENT)
        columns: Sequence[str] = getattr(version, "carriers", ()) or getattr(version, "columns", (carrier,))
        names = [name for name in columns if name != "session"]
        is_quantity = not hasattr(version, "levels") and not hasattr(version, "period")
        if (finding.parameters and not finding.term) or len(names) != 1 or not is_quantity:
            return ""
        name = names[0]
        if name not in rows or not pd.api.types.is_numeric_dtype(rows[name]) or selected.misfit is None:
            return ""
        linearized, values = selection.problem.linearize(), rows[name].to_numpy(float)
        if version is None:
            change = linearized.unwhiten(compute_shape(selected, linearized))
        else:
            change = fitted_effect(selection, version)
        known = np.where(np.isfinite(values), values, np.nanmean(values))[:, None]
        # As of the change, what the law's own parameters leave of the values.
        left = linearized.unwhiten(linearized.project(linearized.whiten(known))[:, 0])
        way = find_way(values, left, info.sign * change)
        label = "time" if name == "session_seconds" else self.describe_carrier(name).removeprefix("follows ")
        if way in ("rises", "falls"):
            return f"; beyond the law {info.response} {way} with {label}"
        return f"; beyond the law {info.response} is {way} at middle values of {label}" if way else ""

    def _describe_withdrawn(self, finding: Finding) -> str:
        """What fits best but is not named, with the reason, without a full stop."""
        assert finding.gain is not None
        return (
            f"{self.describe_effect(finding)}: of all that was searched this fits best "
            f"(p {format_p_value(finding.p_value, relation=True)}), but "
            f"{explain_unsupported(finding.gain, self.info)}, so that {finding.cause} is not named"
        )

    def format_rms(self, finding: Finding) -> str:
        """The size of an effect in a sentence; where its estimate is 0, the most that it may be."""
        if finding.effect.estimate > 0:
            return f"{self.info.format_size(finding.effect.estimate)} rms"
        return f"at most {self.info.format_size(finding.effect.high)} rms"

    def describe_support(self, finding: Finding) -> str:
        """That held-out rows do not show one of several causes, as the end of a sentence; else empty."""
        gain, named = finding.gain, [one for one in self.diagnosis.findings if one.version is not None]
        if gain is None or len(named) < 2 or not gain.doubt:
            return ""
        if self._is_no_lower(gain):
            return f"; it does not show in held-out {self.info.row}s"
        return f"; held-out {self.info.row}s do not show it for certain"

    def _is_no_lower(self, gain: Gain) -> bool:
        """Whether the error with the extended law is as large, in the digits that are told."""
        before, after = map(self.info.format_size, (gain.baseline, gain.extended))
        return gain.extended >= gain.baseline or (before == after and bool(gain.doubt))

    def describe_cut(self, gain: Gain) -> str:
        """Both errors on held-out rows, as the end of a sentence on the extended law."""
        before, after = map(self.info.format_size, (gain.baseline, gain.extended))
        if self._is_no_lower(gain):
            return f"predicts held-out {self.info.row}s no better, to {after} rms"
        cuts = f"cuts the prediction error on held-out {self.info.row}s"
        if before == after:
            return f"{cuts}, {before}, by {self.info.format_size(gain.cut.estimate)}"
        return f"{cuts} from {before} to {after}{gain.doubt}"

    def warn_of_new_session(self) -> str:
        """That the extended law predicts a new session worse, as a sentence and a space; else empty."""
        gain, size = self.diagnosis.gain_new_session, self.info.format_size
        if gain is None or gain.high >= 0.0 or size(gain.baseline) == size(gain.extended):
            return ""
        return (
            f"The extended law predicts a new session worse than the {baseline_name(self.diagnosis)} does, "
            f"with errors of {size(gain.extended)} in place of {size(gain.baseline)}: it is for the sessions "
            f"of this {self.info.data} only. "
        )

    @property
    def advice_on_unknown(self) -> str:
        """What to do about structure without a name, and what to reckon with meanwhile."""
        left = self.info.format_size(self.diagnosis.misfit)
        return (
            "The figures show it: compare them with whatever changed meanwhile, and add that as a column or "
            f"a cause; until it has a name, count on errors of {left}"
        )

    def describe_untestable(self) -> str:
        """Which causes the data could not have shown, as a sentence."""
        if not np.isfinite(self.diagnosis.repeatability):
            return "Until then no cause is confirmed, and none ruled out."
        names = list(self.diagnosis.untestable)
        if not names:
            return "It could have shown every cause that was searched, at its largest plausible size."
        if len(names) > MAX_UNTESTABLE_NAMED:
            first = names[: MAX_UNTESTABLE_NAMED - 1]
            names = [*first, f"{len(names) - len(first)} others"]
        return f"It could not have shown {join_words(names)}."


def find_way(values: Array, left: Array, change: Array) -> str:
    """Which way a change goes with values, each shape (n,); empty where it goes no way.

    It ``rises`` or ``falls`` with what a law leaves of the values, or is ``largest`` or ``smallest``
    at those in the middle.

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.0, 30)
    >>> find_way(x, x, x**3), find_way(x, x, -x), find_way(x, x, x**2), find_way(x, 0 * x, np.sin(20 * x))
    ('rises', 'falls', 'smallest', '')
    """
    known = np.isfinite(values)
    x, y = pd.Series(values[known]), pd.Series(change[known])
    spread = float(np.ptp(y)) if len(y) else 0.0
    if x.nunique() < 2 or spread == 0.0:
        return ""
    if np.std(left) > MIN_LEFT * x.std(ddof=0):
        correlation = float(np.corrcoef(left, change)[0, 1])
        if abs(correlation) >= MIN_CORRELATION:
            return "rises" if correlation > 0 else "falls"
    middle = x.between(*x.quantile([1 / 3, 2 / 3]))
    bulge = float(y[middle].mean() - y[~middle].mean()) / spread
    if not abs(bulge) >= MIN_BULGE:
        return ""
    return "largest" if bulge > 0 else "smallest"


def baseline_name(diagnosis: Diagnosis) -> str:
    """What the laws are called that are put to the test."""
    return name_of_laws(part.law for part in diagnosis.selection.problem.parts)


def lower_first(text: str) -> str:
    """The text with a small first letter, for the middle of a sentence."""
    return text[:1].lower() + text[1:]


def describe_company(finding: Finding) -> str:
    """With which other causes a finding was found, as the end of a sentence; empty where it needs none.

    Each may show alone, where another cause, or structure without a name, describes the data better.

    Examples
    --------
    >>> from stickslip_fit.units import Interval
    >>> size = Interval(0.01, 0.0, 0.02)
    >>> describe_company(Finding("drift", None, (), 0.001, (3,), size, (), together_with=("wear",)))
    '; found together with wear: neither is the likeliest alone'
    """
    others = [name for name in finding.together_with if name != UNKNOWN]
    if not others:
        return "; it shows beside structure without a name" if finding.together_with else ""
    alone = "neither" if len(others) == 1 else "none of them"
    return f"; found together with {join_words(others)}: {alone} is the likeliest alone"


def describe_proposals(findings: Sequence[Finding], data: str) -> list[str]:
    """What structure without a name is to the extended law, as sentences; `data` is "log" or "table"."""
    unnamed = [one for one in findings if one.cause == UNKNOWN]
    if not unnamed:
        return []
    if all(one.version is None for one in unnamed):
        return ["Structure without a name is not put into the law, so that it gains nothing."]
    return [
        f"What is proposed for structure without a name describes this {data}; it is no cause, and what acts "
        "may differ from it elsewhere."
    ]
