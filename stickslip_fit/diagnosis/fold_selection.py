"""What a selection would be without some rows: its tests repeated by linear algebra (`leave_out`).

Close rivals are judged by the squared residuals of a refit of each, whose linearized law loses the rows as a
test does. A law for unknown structure is proposed anew. Where a test is not clear, the selection has to be
repeated; where only combinations of causes come near to the last structure, as far as that (`OpenSelection`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stickslip_fit._typing import IntArray
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.column_pairs import find_column_pair, find_new_column
from stickslip_fit.diagnosis.combinations import PAIR_LOG_PENALTY
from stickslip_fit.diagnosis.extension import (
    Extension,
    SelectedCause,
    extend_problem,
    fit_causes,
    make_selected,
)
from stickslip_fit.diagnosis.leave_out import LeftOut, Look
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, classify_cause
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.proposed_term import propose_term, rank_forms
from stickslip_fit.diagnosis.selection import Selection, allocate_alpha, select_last

CLEAR_TEST, CLEAR_NAME = 1.0, 3.0  # nats from the critical value, and between the best cause and the next
CLEAR_NAME_SHARE = 0.03  # of the evidence, between the best cause and the next, before these are refitted
# To a combination of causes, which is refitted: a share of the evidence, or standard deviations.
CLEAR_PAIR_SHARE, CLEAR_PAIR_SD = 0.1, 4.0
CLEAR_REFIT = 1.0  # nats between the best cause and the next, both refitted
MAX_GAINED = 8.0  # nats by which a hypothesis may come nearer to a decision by the loss of a few rows
MIN_EVIDENCE_SHARE = 0.5  # of the evidence in all rows; with less, a few rows may bear it


def log_likelihood_change(linearized: LinearizedFit, rows: IntArray) -> float:
    """By how much a fit is likelier without some rows, the size of the noise unknown, but for a constant."""
    residual, left_out = linearized.residual, LeftOut.of(linearized.basis, rows)
    squares, df = float(residual @ residual), linearized.df
    left = squares - float(np.sum(left_out.coordinates(residual[rows, None]) ** 2))
    without = -0.5 * (df - left_out.own.shape[1]) * float(np.log(left))
    return without + 0.5 * df * float(np.log(squares))


@dataclass(frozen=True, eq=False)
class OpenSelection:
    """What is selected without some rows, as far as the tests are clear.

    Structure is left in which no single cause is likelier than `unknown`; a combination of causes may be.
    Nothing is found beside it.

    Attributes
    ----------
    selection : Selection
        Of the causes before it.
    alpha : float
        Of the diagnosis.
    """

    selection: Selection
    alpha: float

    def settle(self, rng: np.random.Generator) -> Selection | None:
        """The selection with a law for what is left; None where that is a combination or has no law."""
        problem, before = self.selection.problem, self.selection.selected
        whole = extend_problem(problem, before) if before else Extension(problem, problem.fit_extended())
        last = select_last(whole, before, self.alpha, rng)
        if last.cause != UNKNOWN or last.version is None:
            return None
        selected = (*before, last)
        return replace(self.selection, selected=selected, fit=fit_causes(problem, selected))


class Looks:
    """The tests that named the causes in a selection's law, and the last one, which named no other."""

    def __init__(self, selection: Selection, alpha: float) -> None:
        self.selection, self.alpha, self.level = selection, alpha, allocate_alpha(alpha)
        looks: dict[int, Look] = {}
        named = {one.cause for one in selection.law_causes if one.cause != UNKNOWN}

        def look(misfit: Misfit) -> Look:
            decisive = np.fmax(MIN_EVIDENCE_SHARE * misfit.statistic, misfit.critical_value(self.level))
            return looks.setdefault(id(misfit), Look(misfit, float(decisive) - MAX_GAINED, named))

        causes = [(one.misfit, one.naming or one.misfit) for one in selection.law_causes]
        self.revised = [look(misfit) for misfit, _ in causes if misfit is not None]
        self.naming = [look(misfit) for _, misfit in causes if misfit is not None]
        # A law for structure without a name may end the search whatever is left.
        ended = selection.selected[-1].version is not None and selection.last_misfit.p_value < self.level
        self.last = None if ended else look(selection.last_misfit)
        self._refits: dict[tuple[str, str | None], LinearizedFit] = {}

    def select_without(self, rows: IntArray) -> list[SelectedCause] | None:
        """The causes in the law as selected without some rows; None if a look is not clear without them.

        Unknown structure has the law of all rows, see `propose_without`. The last may be a combination of
        causes after all, see `is_open`.
        """
        selected: list[SelectedCause] = []
        causes = self.selection.law_causes
        for place, (naming, revised, one) in enumerate(zip(self.naming, self.revised, causes, strict=True)):
            without = naming.without(rows)
            if self._ahead_of_noise(without) < CLEAR_TEST:
                return None
            if one.cause == UNKNOWN:
                if not self._is_unknown(naming, without):
                    return None
                if place + 1 < len(causes) and not self._is_ahead_of_pairs(place, without):
                    return None
                if revised is not naming:
                    without = revised.without(rows)
                    if not self._is_unknown(revised, without):
                        return None
                selected.append(replace(one, misfit=without))
                continue
            if revised is not naming:
                was_unknown = not one.together_with and form_cause_set(naming.misfit).cause == UNKNOWN
                begins = was_unknown and self._is_unknown(naming, without)
                if not begins and not self._is_known(place, without, rows):
                    return None
                without = revised.without(rows)
            if not self._is_clear(revised, without, one.cause, rows, was_revised=revised is not naming):
                return None
            selected.append(revised.select(one.cause, without, rows))
        return selected if self.last is None or self._is_last(self.last.without(rows)) else None

    def is_open(self, rows: IntArray) -> bool:
        """Whether the last structure may be a combination of causes without some rows."""
        last = len(self.naming) - 1
        if self.selection.law_causes[last].cause != UNKNOWN:
            return False
        return not self._is_ahead_of_pairs(last, self.naming[last].without(rows))

    def leave_open(
        self, problem: DiagnosisProblem, selected: Sequence[SelectedCause], rows: IntArray
    ) -> OpenSelection:
        """What is selected in the `problem`, which is without some rows, before the last structure.

        Of the tests what says in which forms each cause may be.
        """
        slim = []
        for look, one in zip(self.revised, selected, strict=False):
            carriers = set(getattr(one.version, "carriers", ()))
            test = look.without(rows)
            best = test.hypotheses.index(test.best_subspace(one.cause))
            alike = [
                place
                for place, shape in enumerate(test.hypotheses)
                if place != best
                and classify_cause(shape) == one.cause
                and (one.cause != UNKNOWN or set(getattr(shape.version, "carriers", ())) == carriers)
            ]
            slim.append(
                replace(one, misfit=look.restrict(test, [best, *alike], rows), naming=None, tested=None)
            )
        return OpenSelection(
            replace(self.selection.without_tests, problem=problem, selected=tuple(slim)), self.alpha
        )

    def propose_without(
        self, place: int, selected: SelectedCause, rows: IntArray, rng: np.random.Generator
    ) -> SelectedCause:
        """Unknown structure, as selected without some rows, with the law that these would propose."""
        test, kept = selected.test, np.setdiff1d(np.arange(len(self.selection.problem)), rows)
        assert selected.tested is not None
        smooth, memory = rank_forms(test, self.selection.problem.rows)
        likeliest = {int(np.argmax(test.log_evidence)), *smooth[:1], *memory[:1]}
        restricted = self.revised[place].restrict(test, sorted(likeliest), rows)
        unknown = replace(selected, version=None, start=np.zeros(0), misfit=restricted)
        linearized, expressions = selected.tested.select_rows(kept), self.selection.problem.expressions
        (proposed,) = propose_term(linearized, [unknown], expressions, rng)
        return replace(proposed, misfit=test)

    def _ahead_of_noise(self, without: Misfit) -> float:
        """Nats of a test's statistic beyond its critical value."""
        return without.statistic - without.critical_value(self.level)

    def _is_known(self, place: int, without: Misfit, rows: IntArray) -> bool:
        """Whether a cause in the law, or a pair of these, is selected first, and not unknown structure."""
        causes, evidence = self.selection.law_causes, without.log_evidence_by_cause
        to_beat = evidence.get(UNKNOWN, -np.inf) + CLEAR_NAME
        if max(evidence.get(one.cause, -np.inf) for one in causes if one.cause != UNKNOWN) > to_beat:
            return True
        if self._is_of_columns(place, without):
            return True
        if place + 1 == len(causes):
            return False
        second = self.naming[place + 1].without(rows).log_evidence_by_cause
        pair = evidence.get(causes[place].cause, -np.inf) + second.get(causes[place + 1].cause, -np.inf)
        return pair > to_beat + PAIR_LOG_PENALTY

    def _is_of_columns(self, place: int, without: Misfit) -> bool:
        """Whether causes in the law are selected since unknown structure follows their columns."""
        causes = self.selection.law_causes
        names = {one.cause for one in causes}
        if (new := find_new_column(without, causes[:place])) is not None:
            return new in names
        df = int(np.count_nonzero(without.residual)) - self.naming[place].basis.shape[1]
        pair = find_column_pair(without, df)
        return pair is not None and pair.behind < -CLEAR_NAME and names.issuperset(pair.causes)

    def _is_clear(
        self, look: Look, without: Misfit, cause: str, rows: IntArray, *, was_revised: bool
    ) -> bool:
        whole, evidence = look.misfit, dict(without.log_evidence_by_cause)
        if was_revised:  # by a known cause or not at all
            evidence.pop(UNKNOWN, None)
        own = evidence[cause]
        least = own - max(CLEAR_NAME, CLEAR_NAME_SHARE * own)
        close = [one for one in evidence if one != cause and evidence[one] >= least]
        versions: list[Any] = [test.best_hypothesis(cause).version for test in (without, whole)]
        version, before = versions
        # Effects that are linear in all parameters need no refit to be compared, unless another form may take
        # over a part of another cause.
        linear = all(getattr(one, "combine_trials", False) for one in versions)
        linear = linear and not (was_revised and len(version.parameters) != len(before.parameters))
        return bool(
            (version is before or linear)
            and own > MIN_EVIDENCE_SHARE * whole.log_evidence_by_cause[cause]
            and (not close or self._is_ahead(look, without, cause, close, rows))
        )

    def _is_ahead(
        self, look: Look, without: Misfit, cause: str, close: Sequence[str], rows: IntArray
    ) -> bool:
        """Whether a cause is likelier than all close rivals, each refitted without the rows."""
        if UNKNOWN in close:  # it has no law to refit
            return False
        try:
            own, *others = (self._evidence(look, without, cause, one, rows) for one in (cause, *close))
        except np.linalg.LinAlgError:
            return False
        return own > max(others) + CLEAR_REFIT

    def _evidence(self, look: Look, without: Misfit, cause: str, rival: str, rows: IntArray) -> float:
        """Log evidence of a rival in the place of a selected cause, refitted without the rows.

        Where a refit to all rows gained nothing, that of its linearized effects without the rows.
        """
        if abs(look.refit_gain.get(rival, 0.0)) < CLEAR_REFIT:
            return without.log_evidence_by_cause[rival]
        before, after = self._refit(look, cause, None), self._refit(look, cause, rival)
        change = log_likelihood_change(after, rows) - log_likelihood_change(before, rows)
        return look.misfit.log_evidence_by_cause[rival] + change

    def _refit(self, look: Look, cause: str, rival: str | None) -> LinearizedFit:
        """The law of all rows with a rival in the place of a selected cause, or with neither."""
        if (cause, rival) not in self._refits:
            causes = [one for one in self.selection.law_causes if one.cause != cause]
            if rival is not None:
                causes.append(make_selected(look.misfit, form_cause_set(look.misfit, rival)))
            problem = self.selection.problem
            self._refits[cause, rival] = problem.linearize_extended(fit_causes(problem, causes))
        return self._refits[cause, rival]

    def _is_unknown(self, look: Look, without: Misfit) -> bool:
        """Whether unknown structure is selected, and no cause."""
        evidence = dict(without.log_evidence_by_cause)
        own = evidence.pop(UNKNOWN)
        margin = max(CLEAR_NAME, CLEAR_NAME_SHARE * own)
        return bool(
            own > MIN_EVIDENCE_SHARE * look.misfit.log_evidence_by_cause[UNKNOWN]
            and own > max(evidence.values(), default=-np.inf) + margin
        )

    def _is_ahead_of_pairs(self, place: int, without: Misfit) -> bool:
        """Whether unknown structure is likelier than any combination of causes, which lose as many rows.

        A log likelihood ratio of D nats has a variance of 2 D (S. Kullback, Information Theory and
        Statistics, 1959, chapter 5, of normal noise), of which each row has its share.
        """
        whole, ahead = self.naming[place].misfit, self.selection.law_causes[place].ahead_of_pairs
        own = without.log_evidence_by_cause[UNKNOWN]
        share = np.count_nonzero(without.residual) / len(whole.residual)
        to_beat = share * (whole.log_evidence_by_cause[UNKNOWN] + PAIR_LOG_PENALTY - ahead)
        least = min(ahead, own + PAIR_LOG_PENALTY - to_beat)
        sd = np.sqrt(2.0 * max(ahead, 0.0) * (1.0 - share)) if np.isfinite(ahead) else 0.0
        return bool(least > max(CLEAR_NAME, min(CLEAR_PAIR_SHARE * own, CLEAR_NAME + CLEAR_PAIR_SD * sd)))

    def _is_last(self, without: Misfit) -> bool:
        """Whether no further known cause would be selected."""
        if self._ahead_of_noise(without) < -CLEAR_TEST:
            return True
        evidence = dict(without.log_evidence_by_cause)
        unknown = evidence.pop(UNKNOWN, -np.inf)
        return bool(unknown > max(evidence.values(), default=-np.inf) + CLEAR_NAME)


def prepare_looks(selection: Selection, alpha: float) -> Looks | None:
    """The looks of a selection, if they can be repeated without some rows by linear algebra."""
    tests = [
        *(test for one in selection.selected for test in (one.misfit, one.naming)),
        selection.last_misfit,
    ]
    known = [one for one in tests if one is not None]
    possible = all(one.basis is not None and len(one.residual) == len(selection.problem) for one in known)
    forced = any(
        one.version is None and one.misfit is not None and form_cause_set(one.misfit).cause != UNKNOWN
        for one in selection.selected
    )
    # A test beside unknown structure is without the shapes of that.
    whole = all({*one.log_evidence_by_cause} <= {*map(classify_cause, one.hypotheses)} for one in known)
    independent = selection.problem.noise_filter is None
    # Of what was found first and is needless at the end, the search may make more without some rows.
    first = next((one.naming or one.misfit for one in selection.law_causes), None)
    dropped = first is not None and first.residual is not selection.first_misfit.residual
    simple = independent and whole and not (forced or dropped)
    return Looks(selection, alpha) if possible and simple else None
