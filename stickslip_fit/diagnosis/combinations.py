"""Combinations: causes that show only together, and causes revised with the others in the law.

Forward selection fails in four ways. A cause may act on one joint or direction alone, or on each joint by
another size, which its equation for all does not describe: it is tried so (`find_in_part`). Two effects may
act so that neither alone explains more than unstructured alternatives do: pairs are tried before `unknown`
is said (`first_of_pair`). Unstructured alternatives may take up a cause beside them: before the search ends
with `unknown`, a cause with such structure beside it is compared with that alone (`find_beside_unknown`).
Or a wrong cause may explain more alone than either of two right ones: each selected cause is compared with
its close rivals, another cause added to these (`find_exchange`). At the end, causes that the others make
needless are dropped (`find_needless`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import batched, compress

import numpy as np
from scipy.special import logsumexp

from stickslip_fit._typing import Array
from stickslip_fit.causes.generic import ColumnDependence
from stickslip_fit.diagnosis.cause_set import CAUSE_SET_LOG_BAYES_FACTOR, form_cause_set
from stickslip_fit.diagnosis.column_pairs import find_column_pair
from stickslip_fit.diagnosis.covered_causes import find_covered
from stickslip_fit.diagnosis.evidence import batch_hypotheses, column_evidence, strength_evidence
from stickslip_fit.diagnosis.extension import (
    Extension,
    SelectedCause,
    absorb_unknown,
    add_candidates,
    compute_evidence,
    make_selected,
    name_explained,
    try_extension,
    weigh_causes,
)
from stickslip_fit.diagnosis.hypotheses import Hypothesis, compute_finite_effects, make_hypothesis
from stickslip_fit.diagnosis.influence import assess_support
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import (
    FINE_STRENGTHS,
    UNKNOWN,
    Misfit,
    average_by_cause,
    classify_cause,
    weigh_hypotheses,
)
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.proposed_term import propose_term
from stickslip_fit.diagnosis.refits import (
    MIN_REFIT_LOG_BAYES_FACTOR,
    MIN_REFIT_SHARE,
    Refits,
    advantage,
    refit_likeliest,
)

# Nats: evidence of a cause to be tried as the first of a pair, and by how much a pair must be likelier than
# unknown structure; the number of causes that are tried.
PAIR_MIN_LOG_BAYES_FACTOR, PAIR_LOG_PENALTY, MAX_PAIR_TRIALS = 3.0, 3.0, 3
MAX_BY_NOISE = 10.0  # nats that a pair gains where the autocorrelation of the noise depends on it
MAX_LIKELY_SHAPES = 6  # of unknown structure, beside which causes are looked for
AT_ONCE = 50  # more structures beside one of these


@dataclass(frozen=True, eq=False)
class Combination:
    """The first of some causes to be selected, and those with which it was found."""

    first: SelectedCause
    others: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Search[T]:
    """What was looked for in place of unknown structure.

    Attributes
    ----------
    behind : float
        Nats that the nearest one lacks where none was found; infinite where none was possible.
    """

    found: T | None
    behind: float = np.inf


def first_of_pair(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], misfit: Misfit
) -> Search[Combination]:
    """Two or three causes that together are likelier than unknown structure, if there are any.

    The sum of two effects is in the span of neither, so that alone each loses to unknown structure; with the
    other one in the law it does not.
    """
    evidence = misfit.log_evidence_by_cause
    highest = evidence[UNKNOWN] + PAIR_LOG_PENALTY
    found: list[tuple[float, list[SelectedCause]]] = []
    pairs: list[tuple[float, list[SelectedCause]]] = []
    causes = misfit.rank_causes(PAIR_MIN_LOG_BAYES_FACTOR)[:MAX_PAIR_TRIALS]
    lacking, df = [np.inf], problem.linearize().df
    if (of_columns := find_column_pair(misfit, df)) is not None:
        first = make_selected(misfit, form_cause_set(misfit, of_columns.causes[0]))
        if of_columns.behind < 0:
            return Search(Combination(first, of_columns.causes[1:]), of_columns.behind)
        lacking.append(of_columns.behind)
    if causes:
        # Linearized: the third of three causes adds no more than the second.
        added = _evidence_added(misfit, causes, df)
        slack = 0.0 if problem.autocorrelation is None else MAX_BY_NOISE
        most = {cause: evidence[cause] + 2.0 * added[cause] + slack for cause in causes}
        causes = [cause for cause in causes if most[cause] > highest]
        lacking += [highest - most[cause] for cause in most if cause not in causes]
    for cause in causes:
        first = make_selected(misfit, form_cause_set(misfit, cause))
        extension = try_extension(problem, [*selected, first])
        if extension is None:
            continue
        left, second, unknown = _next_cause(extension, [*selected, first])
        pair = evidence[cause] + left.log_evidence_by_cause.get(second, -np.inf)
        if second == UNKNOWN:
            continue
        both, ahead = [first, make_selected(left, form_cause_set(left, second))], pair - highest
        beside_first = left.log_evidence_by_cause[second] - unknown
        if min(ahead, beside_first) > 0:
            found.append((pair, both))
            continue
        lacking.append(-min(ahead, beside_first))
        if beside_first <= 0 and left.log_evidence_by_cause[second] > PAIR_MIN_LOG_BAYES_FACTOR:
            pairs.append((pair, both))
    for _, both in sorted(found, key=lambda scored: -scored[0]):
        # What the second one's forms have in common with the first one's effect is not in the test beside it;
        # absorbed together with the second one's own effect, they would take that of the first one as well.
        alone = replace(both[1], misfit=misfit)
        lacking.append(_lacks_beside(problem, selected, both[0], alone))
        if lacking[-1] < 0:
            return Search(Combination(both[0], (both[1].cause,)), min(lacking))
    if not pairs:
        return Search(None, min(lacking))
    pair, both = max(pairs, key=lambda scored: scored[0])
    extension = try_extension(problem, [*selected, *both])
    if extension is None:
        return Search(None, min(lacking))
    left, third, unknown = _next_cause(extension, [*selected, *both])
    share = left.log_evidence_by_cause.get(third, -np.inf)
    if third == UNKNOWN:
        return Search(None, min(lacking))
    lacking.append(max(highest + PAIR_LOG_PENALTY - pair - share, unknown - share))
    if lacking[-1] < 0:
        return Search(Combination(both[0], (both[1].cause, third)))
    return Search(None, min(lacking))


def _lacks_beside(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], cause: SelectedCause, other: SelectedCause
) -> float:
    """Nats by which unknown structure is likelier than a cause with the other one in the law.

    Negative if it is not, by as much as makes up a cause set. Where two effects have nothing in common, the
    other one adds as much to unknown structure.
    """
    extension = try_extension(problem, [*selected, other])
    if extension is None:
        return -np.inf
    left, _, unknown = _next_cause(extension, [*selected, other])
    own = left.log_evidence_by_cause.get(cause.cause, -np.inf)
    return unknown - own - CAUSE_SET_LOG_BAYES_FACTOR


def find_in_part(
    problem: DiagnosisProblem, searched: LinearizedFit, misfit: Misfit, likeliest: str
) -> Search[Misfit]:
    """A test in which a cause in one of its restricted forms is likelier than the `likeliest` one, if any.

    Causes have one size for all joints, which may differ: a knock against one of them, or its own warm-up.
    Beside unknown structure all are tried, beside a cause that one. See `Cause.restricted`.
    """
    allowed = set(misfit.log_evidence_by_cause) if likeliest == UNKNOWN else {likeliest}
    tried = [one for one in problem.causes if one.name in allowed]
    versions = [part for one in tried for part in one.restricted(searched.rows)]
    if problem.autocorrelation is not None or not versions:
        return Search(None)
    test = add_candidates(misfit, searched, compute_finite_effects(searched, versions))
    reach = dict[str, float]()
    for shape, own in zip(test.hypotheses, test.log_evidence.tolist(), strict=True):
        if getattr(shape.version, "is_restricted", False):
            reach[shape.cause] = max(own, reach.get(shape.cause, -np.inf))
    # The others keep what their refits said of their bounds, which a linear test does not know.
    evidence = {
        cause: test.log_evidence_by_cause[cause]
        for cause in reach
        if getattr(test.best_hypothesis(cause).version, "is_restricted", False)
    }
    highest = misfit.log_evidence_by_cause.get(likeliest, -np.inf) + PAIR_LOG_PENALTY
    if max(evidence.values(), default=-np.inf) < highest:
        nearest = max((reach | evidence).values(), default=-np.inf)
        return Search(None, max(highest - nearest, 0.0))
    evidence = misfit.log_evidence_by_cause | evidence
    found = replace(
        misfit, hypotheses=test.hypotheses, log_evidence=test.log_evidence, log_evidence_by_cause=evidence
    )
    return Search(found)


def find_beside_unknown(
    problem: DiagnosisProblem, searched: LinearizedFit, unknown: SelectedCause, level: float
) -> Search[Combination]:
    """A cause that with `unknown` structure beside it is likelier than such structure alone, if any.

    Structure without a name takes up a cause that acts like it in part, and both would have one size; and
    where it is much larger than the noise, nothing shows beside it until it is in the law. The margin is as
    of `find_exchange`. The cause has to be likelier there than more structure without a name.
    """
    misfit, df = unknown.test, searched.df
    shapes = [
        one for one in misfit.hypotheses if isinstance(one, Hypothesis) and classify_cause(one) != UNKNOWN
    ]
    known = [one for one in shapes if one.cause in misfit.log_evidence_by_cause]
    tests = _weigh_beside_unknown(misfit, known, df) if problem.autocorrelation is None and known else []
    if not tests:
        return Search(None)
    causes = [cause for cause in misfit.log_evidence_by_cause if cause != UNKNOWN]
    each = {cause: [evidence.get(cause, -np.inf) for evidence, _ in tests] for cause in causes}
    together = {cause: float(logsumexp(values)) for cause, values in each.items()}
    together[UNKNOWN] = max(
        misfit.log_evidence_by_cause[UNKNOWN],
        float(logsumexp([evidence[UNKNOWN] for evidence, _ in tests])),
    )
    best = max(causes, key=together.__getitem__)
    to_beat = together[UNKNOWN] + float(np.log(len(together) / level))
    behind = to_beat - together[best]
    if behind <= 0:
        behind = max(behind, _more_unknown(misfit, df, tests[int(np.argmax(each[best]))]) - max(each[best]))
    if behind <= 0:
        left, test = _test_beside_unknown(misfit, known, df, *tests[int(np.argmax(each[best]))])
        if not assess_support(searched, left, best).too_narrow:
            one = make_selected(left, form_cause_set(replace(left, log_evidence_by_cause=together), best))
            return Search(Combination(replace(one, misfit=test), (UNKNOWN,)), behind)
    # Beside such structure every effect has some evidence, which other rows hardly turn into enough.
    least = together[UNKNOWN] + PAIR_MIN_LOG_BAYES_FACTOR
    near = [together[cause] for cause in causes if together[cause] > least]
    return Search(None, max(to_beat - max(near, default=-np.inf), 0.0))


Whitening = Callable[[Array], Array]
"""Columns, (n,) or (n, m), without the covariance of some structure."""


def _weigh_beside_unknown(
    misfit: Misfit, known: Sequence[Hypothesis], df: int
) -> list[tuple[dict[str, float], Whitening]]:
    """Evidence of known causes' shapes by cause under the covariance of each likely structure.

    It is that of the structure and the cause together, and for ``unknown`` that of the structure alone, as
    parts of an average over all structures. Under the covariance that a structure gives the residuals,
    effects lose what it may have taken up (C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for
    Machine Learning, 2006, sect. 2.7).
    """
    single = [one for one in known if len(one.prior_share) == 1]
    wide, tests = [one for one in known if len(one.prior_share) > 1], []
    columns = np.concatenate(
        [np.zeros((len(misfit.residual), 0)), *(one.directions for one in single)], axis=1
    )
    one_sided = np.array([one.one_sided for one in single], dtype=bool)
    for alone, whiten in _likely_structures(misfit, df):
        residual = whiten(misfit.residual)
        own = column_evidence(whiten(columns), residual, df, one_sided)
        others = [one for one in _whiten_shapes(wide, whiten) if one is not None]
        shown = [*compress(single, np.isfinite(own)), *others]
        names = [one.cause for one in shown]
        own = own[np.isfinite(own)]
        evidence = np.concatenate([own, batch_hypotheses(others, df).log_evidence(residual[:, None])[:, 0]])
        together = average_by_cause(names, alone + weigh_hypotheses(shown, names), evidence)
        tests.append(({**together, UNKNOWN: alone}, whiten))
    return tests


def _more_unknown(misfit: Misfit, df: int, beside: tuple[dict[str, float], Whitening]) -> float:
    """Evidence of a structure, as `_weigh_beside_unknown` has it, and of another one beside it, together."""
    evidence, whiten = beside
    others = [
        one for one in misfit.hypotheses if isinstance(one, Hypothesis) and classify_cause(one) == UNKNOWN
    ]
    residual, total = whiten(misfit.residual)[:, None], [-np.inf]
    weight = weigh_hypotheses(others, [UNKNOWN] * len(others)).tolist()
    for part in batched(zip(others, weight, strict=True), AT_ONCE):  # whitened, directions take much memory
        made = zip(_whiten_shapes([one for one, _ in part], whiten), part, strict=True)
        seen = [(one, own_weight) for one, (_, own_weight) in made if one is not None]
        if seen:
            own = batch_hypotheses([one for one, _ in seen], df).log_evidence(residual)[:, 0]
            total.append(float(logsumexp(own + [own_weight for _, own_weight in seen])))
    return evidence[UNKNOWN] + float(logsumexp(total))


def _whiten_shapes(shapes: Sequence[Hypothesis], whiten: Whitening) -> list[Hypothesis | None]:
    """Each shape under the covariance of a structure; None where that leaves next to nothing."""
    effects = [whiten(one.directions * np.sqrt(one.prior_share)) for one in shapes]
    return [
        make_hypothesis(one.cause, one.version, one.values, own)
        for one, own in zip(shapes, effects, strict=True)
    ]


def _test_beside_unknown(
    misfit: Misfit, known: Sequence[Hypothesis], df: int, by_cause: dict[str, float], whiten: Whitening
) -> tuple[Misfit, Misfit]:
    """The test under a structure's covariance, evidence by cause given, and with the shapes as they are.

    With those under the covariance beside its own effect, a cause could describe the structure as well.
    """
    made = _whiten_shapes(known, whiten)
    seen = tuple(own for own, one in zip(known, made, strict=True) if one is not None)
    shown, residual = [one for one in made if one is not None], whiten(misfit.residual)
    evidence = batch_hypotheses(shown, df).log_evidence(residual[:, None])[:, 0]
    test = replace(misfit, log_evidence=evidence, log_evidence_by_cause=by_cause, hypotheses=seen)
    return replace(test, residual=residual, hypotheses=tuple(shown)), test


def _likely_structures(misfit: Misfit, df: int) -> Iterator[tuple[float, Whitening]]:
    """The share of unknown structures in an average of their evidence, and columns without their covariance.

    Each likely shape at several strengths: with a cause in the law the noise is smaller, so that it may be
    stronger than is likeliest without.
    """
    causes = [classify_cause(one) for one in misfit.hypotheses]
    weight = weigh_hypotheses(misfit.hypotheses, causes)
    places = [k for k, cause in enumerate(causes) if cause == UNKNOWN]
    places.sort(key=lambda k: -(misfit.log_evidence[k] + weight[k]))
    for k in places[:MAX_LIKELY_SHAPES]:
        shape = misfit.hypotheses[k]
        if isinstance(shape, AR1):
            assert misfit.basis is not None
            yield float(misfit.log_evidence[k] + weight[k]), shape.whitener(misfit.basis)
            continue
        directions, signal = shape.directions, FINE_STRENGTHS[:, None] ** 2 * shape.prior_share
        alone = strength_evidence(signal, directions.T @ misfit.residual, misfit.residual, df)
        alone += weight[k] - np.log(len(signal))
        for strength in range(int(np.argmax(alone)), len(signal)):
            lost = 1.0 - 1.0 / np.sqrt(1.0 + signal[strength])
            yield float(alone[strength]), partial(_subtract_along, directions, lost)


def _subtract_along(directions: Array, lost: Array, columns: Array) -> Array:
    """Columns, (n,) or (n, m), less shares of what they have along directions, (n, k)."""
    return np.asarray(columns - directions @ (lost * (columns.T @ directions)).T)


def _next_cause(
    extension: Extension, selected: Sequence[SelectedCause], without: Sequence[str] = ()
) -> tuple[Misfit, str, float]:
    """The test with causes in the law, the likeliest cause then, and the evidence of unknown structure."""
    linearized = absorb_unknown(extension, selected)
    left = compute_evidence(linearized, extension.problem, [*name_explained(selected), *without])
    evidence = left.log_evidence_by_cause
    following = max((name for name in evidence if name != UNKNOWN), key=evidence.__getitem__, default=UNKNOWN)
    return left, following, evidence.get(UNKNOWN, -np.inf)


def _evidence_of_causes(
    extension: Extension, selected: Sequence[SelectedCause], without: Sequence[str]
) -> float:
    """The evidence of the likeliest cause there, by its trials; functions of columns change it little."""
    linearized, names = absorb_unknown(extension, selected), {*name_explained(selected), *without}
    causes = [one for one in extension.problem.causes if one.name not in names]
    evidence = weigh_causes(linearized, compute_finite_effects(linearized, causes))
    return max(evidence.values(), default=-np.inf)


@dataclass(frozen=True, eq=False)
class Exchange:
    """Rivals of a selected cause that with another cause are as likely as it, or likelier.

    Attributes
    ----------
    found : Combination or None
        A rival and another cause that are to take the place of the selected one.
    rivals : tuple of str
        Those that are as likely as the selected one, where nothing else is to be added to it.
    """

    found: Combination | None = None
    rivals: tuple[str, ...] = ()


def find_exchange(
    problem: DiagnosisProblem,
    selected: Sequence[SelectedCause],
    extension: Extension,
    last: Misfit,
    refits: Refits,
    level: float,
) -> Exchange:
    """Compare the last selected cause with each rival that has another cause beside it.

    `extension` is the `problem` with all `selected` in its laws, `last` the test of what they leave;
    `refits` are those before it was selected. To take its place, the law with a rival B and another cause C
    has to be likelier than the one with A, and with what would be added to A, by the logarithm of the number
    of pairs over `level`: a likelihood ratio of K or more has a probability of at most 1 / K if A is the
    truth (J. Ville, Etude critique de la notion de collectif, 1939). As likely is a law within the margin of
    a cause set, each of the causes that might be C being equally likely beforehand.
    """
    *others, current = selected
    left_over = max(0.0, max(last.log_evidence_by_cause.values(), default=0.0))
    n_causes = max(len(last.log_evidence_by_cause), 1)
    margin = float(np.log(problem.n_refits * n_causes / level))
    rivals = _close_rivals(current, left_over + margin, problem)
    if not rivals:
        return Exchange()
    to_beat, as_likely = left_over + margin, float(np.log(n_causes)) - CAUSE_SET_LOG_BAYES_FACTOR
    best, likelihoods = None, dict[str, float]()
    for rival in rivals:
        one = make_selected(current.test, form_cause_set(current.test, rival), refits.starts)
        trial = [*others, one]
        of_rival = refits.extension_with(trial) or try_extension(problem, trial)
        if of_rival is None:
            continue
        alone = advantage(of_rival, extension)
        least = -np.inf
        if problem.autocorrelation is None:  # where the noise stays, a fit adds little to linearized effects
            least = to_beat - PAIR_LOG_PENALTY - alone
            if _evidence_of_causes(of_rival, trial, [current.cause]) < least - CAUSE_SET_LOG_BAYES_FACTOR:
                continue
        left, _, unknown = _next_cause(of_rival, trial, [current.cause])
        for second in _likely_seconds(left, unknown, problem):
            if left.log_evidence_by_cause[second] < least:
                continue
            two = make_selected(left, form_cause_set(left, second))
            if (getattr(two.version, "amplitude", None) or 0.0) > two.version.max_trial_factor:
                continue  # a function of implausible size that only makes up for the rival
            of_both = try_extension(problem, [*trial, two])
            if of_both is None:
                continue
            likelihood = advantage(of_both, extension)
            likelihoods[rival] = max(likelihood, likelihoods.get(rival, -np.inf))
            if likelihood > to_beat:
                best, to_beat = Combination(one, (second,)), likelihood
    following = last.rank_causes(PAIR_MIN_LOG_BAYES_FACTOR)
    if best is not None and following:  # a fit may say more of what would be added than its linear part
        two = make_selected(last, form_cause_set(last, following[0]))
        of_both = try_extension(problem, [*selected, two])
        if of_both is not None and advantage(of_both, extension) > to_beat:
            best = None
    if last.p_value < level:
        return Exchange(best)
    return Exchange(best, tuple(rival for rival in likelihoods if likelihoods[rival] > as_likely))


def _likely_seconds(misfit: Misfit, unknown: float, problem: DiagnosisProblem) -> list[str]:
    """Causes to be fitted beside a rival: the likeliest, or a few where the noise depends on them."""
    number = 1 if problem.autocorrelation is None else problem.n_refits
    return misfit.rank_causes(max(unknown, PAIR_MIN_LOG_BAYES_FACTOR))[:number]


def _close_rivals(current: SelectedCause, ahead: float, problem: DiagnosisProblem) -> list[str]:
    """Causes that might be likelier than a selected one by `ahead` nats, if another cause were added to them.

    Where the noise does not depend on the causes, the linearized effects already say whether they might be.
    """
    misfit = current.test
    evidence = misfit.log_evidence_by_cause
    least = max(MIN_REFIT_SHARE * evidence[current.cause], MIN_REFIT_LOG_BAYES_FACTOR)
    close = misfit.rank_causes(least, [current.cause])[: problem.n_refits]
    if problem.autocorrelation is not None or not close:
        return close
    added = _evidence_added(misfit, close, problem.linearize().df, [current.cause])
    return [cause for cause in close if evidence[cause] + added[cause] > evidence[current.cause] + ahead]


def _evidence_added(
    misfit: Misfit, causes: Sequence[str], df: int, without: Sequence[str] = ()
) -> dict[str, float]:
    """Of each cause the largest evidence that another one has beside it, in nats; linearized."""
    left = np.stack([_without(misfit, cause) for cause in causes], axis=1)
    shapes = [one for one in misfit.hypotheses if classify_cause(one) not in (UNKNOWN, *without)]
    added = batch_hypotheses(shapes, df).log_evidence(left)
    own = np.array([[one.cause == cause for cause in causes] for one in shapes])
    return dict(zip(causes, np.where(own, -np.inf, added).max(axis=0).tolist(), strict=True))


def _without(misfit: Misfit, cause: str) -> Array:
    """The residuals without all that a cause's likeliest shape explains, shape (n,)."""
    shape = misfit.best_subspace(cause)
    return np.asarray(misfit.residual - shape.explain(misfit.residual))


def revise_causes(
    extension: Extension,
    causes: Sequence[SelectedCause],
    level: float,
    rng: np.random.Generator,
    n_last: int = 0,
) -> tuple[list[SelectedCause], Extension]:
    """Each cause, and structure without a name, selected again with all the others in the law.

    `extension` is the law with all; so many of the last causes stay. Other forms of the others may hide a
    cause from the test that is to select it again; then it is looked for as in `find_covered`, at `level`.
    What makes the law less likely does not take its place.
    """
    revised, problem = list(causes), extension.problem
    for place in range(len(causes) - n_last):
        one = _select_again(problem, revised, place, level, rng)
        before = revised[place]
        if one is None:
            continue
        trial = [*revised[:place], one, *revised[place + 1 :]]
        # In another version a cause of the same name has other parameters.
        if (one.cause, one.version) != (before.cause, before.version):
            other = try_extension(problem, trial)
            if other is None or advantage(other, extension) < -CAUSE_SET_LOG_BAYES_FACTOR:
                continue
            extension = other
        revised = trial
    return revised, extension


def _select_again(
    problem: DiagnosisProblem,
    causes: Sequence[SelectedCause],
    place: int,
    level: float,
    rng: np.random.Generator,
) -> SelectedCause | None:
    """What is selected in a place with all other causes in the law; None where nothing can be."""
    before = causes[place]
    # Restricted to a part, it is no version that others are compared with.
    if getattr(before.version, "is_restricted", False):
        return None
    others = [one for k, one in enumerate(causes) if k != place]
    extension = try_extension(problem, others)
    if extension is None:
        return None
    trial, linearized = extension.problem, absorb_unknown(extension, others)
    misfit = compute_evidence(linearized, trial, name_explained(others))
    if not misfit.hypotheses:  # beside a proposal for the same column, of which all forms count
        return None
    if before.cause != UNKNOWN and not misfit.rank_causes(MIN_REFIT_LOG_BAYES_FACTOR):
        covered = find_covered(extension, level)
        return None if covered is None else replace(covered[0], naming=before.naming or before.misfit)
    refits = refit_likeliest(trial, others, misfit)
    one = make_selected(refits.misfit, form_cause_set(refits.misfit), refits.starts)
    if one.cause == UNKNOWN and before.cause != UNKNOWN:
        if not isinstance(before.version, ColumnDependence):
            return None
        # It stays, in the form that is likeliest beside the others; that of one of these may have to change.
        one = make_selected(refits.misfit, form_cause_set(refits.misfit, before.cause), refits.starts)
    elif one.cause == UNKNOWN:
        one = replace(one, ahead_of_pairs=before.ahead_of_pairs)
        one = propose_term(linearized, [*others, one], problem.expressions, rng)[-1]
        if one.version is None:
            return None
    if one.cause in before.cause_set.by_refit:  # of two that took each other's place neither is clear
        one = replace(one, cause_set=one.cause_set.with_rivals([before.cause]))
    return replace(one, p_value=before.p_value, naming=before.naming or before.misfit)


def find_needless(
    whole: Extension, selected: Sequence[SelectedCause], most: float, needed: Sequence[int] = ()
) -> list[tuple[list[SelectedCause], Extension]]:
    """The laws without one of the selected causes that are hardly less likely than the `whole`.

    Those at some places are known to be `needed`.

    What is selected later, unknown structure above all, may do as well what an earlier cause was needed for.

    Returns
    -------
    list of (selected, Extension)
        Those whose penalised likelihood is less by at most `most` nats, the likeliest first.
    """
    found = []
    for place in (place for place in range(len(selected)) if place not in needed):
        others = [one for k, one in enumerate(selected) if k != place]
        extension = try_extension(whole.problem, others)
        if extension is None:
            continue
        likelihood = advantage(extension, whole)
        if likelihood > -most:
            found.append((likelihood, others, extension))
    found.sort(key=lambda one: -one[0])
    return [(others, extension) for _, others, extension in found]
