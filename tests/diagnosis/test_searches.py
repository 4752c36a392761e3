"""The searches of a diagnosis: what is told of outliers is that of the search that was made last."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from stickslip_fit.causes import library
from stickslip_fit.diagnosis import diagnose, pipeline
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.combinations import find_needless, revise_causes
from stickslip_fit.diagnosis.extension import compute_evidence, extend_problem, fit_causes, make_selected
from stickslip_fit.diagnosis.noise import Outliers
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.selection import select_causes, widen_selection
from tests.diagnosis.conftest import waves
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

MISFIRE = "end-stop-misfire"


@pytest.fixture
def searches(monkeypatch):
    """The number of rows of every search; each finds that its first row alone made its finding."""
    sizes = []

    def select(problem, *, alpha, **_):
        sizes.append(len(problem))
        found = pipeline.empty_selection(problem)
        return replace(found, influential=np.array([0]), p_value=alpha / 2)

    nothing = Outliers(np.zeros(0, dtype=np.intp), 1.0)
    monkeypatch.setattr(pipeline, "find_gross_errors", lambda *_: nothing)
    monkeypatch.setattr(pipeline, "select_causes", select)
    return sizes


@pytest.mark.slow
def test_outliers_are_the_rows_that_the_last_search_was_made_without(searches, campaign, read_table):
    """Every search asks for another, so that the number of searches ends them."""
    log = read_table(campaign(("2012-03-05",), replicates=1))
    (finding,) = diagnose(log, gain=False).findings
    assert len(searches) == pipeline.MAX_SEARCHES
    assert finding.cause == MISFIRE
    assert len(finding.traverses) == len(log) - searches[-1]
    assert list(finding.traverses.index) == list(range(pipeline.MAX_SEARCHES - 1))


@cache
def drift_and_side_load():
    """A problem in which only drift is hidden, of two causes, and its evidence."""
    causes = [cause for cause in library() if cause.name in ("drift", "side-load")]
    problem, _ = problem_from_log(read_hidden(hide("thesis", ("drift",), 14, seed=3)), causes)
    return problem, compute_evidence(problem.linearize(), problem)


@pytest.mark.slow
def test_a_cause_without_which_the_law_is_as_likely_is_needless():
    """Side-load is fitted to noise."""
    problem, misfit = drift_and_side_load()
    selected = [make_selected(misfit, form_cause_set(misfit, name)) for name in ("drift", "side-load")]
    whole = extend_problem(problem, selected)
    ((others, without),) = find_needless(whole, selected, most=5.0)
    assert [one.cause for one in others] == ["drift"]
    assert len(without.fit.values) == 1
    assert len(find_needless(whole, selected, most=1e6)) == len(selected)


def test_laws_that_were_tried_are_not_fitted_again():
    problem, misfit = drift_and_side_load()
    selected = [make_selected(misfit, form_cause_set(misfit, "drift"))]
    tried = fit_causes(problem, selected)
    known, anew = extend_problem(problem, selected, tried), extend_problem(problem, selected)
    assert known.fit is tried
    np.testing.assert_allclose(known.problem.scale, anew.problem.scale, rtol=1e-9)


@pytest.mark.parametrize("took_its_place", [False, True])
def test_of_two_causes_that_took_each_other_s_place_neither_is_told_from_the_other(took_its_place):
    """A side load that took the place of a drift, which is likelier when both are compared again."""
    problem, misfit = drift_and_side_load()
    one = make_selected(misfit, form_cause_set(misfit, "side-load"))
    if took_its_place:
        one = replace(one, cause_set=one.cause_set.with_rivals(["drift"]))
    (revised,), _ = revise_causes(extend_problem(problem, [one]), [one], 0.0075, np.random.default_rng(0))
    assert revised.cause == "drift"
    assert revised.cause_set.rivals == (("side-load",) if took_its_place else ())


@pytest.mark.slow
def test_start_values_are_those_of_a_refit_of_the_same_form():
    """Another test may have chosen a profile with other coefficients."""
    causes = [cause for cause in library() if cause.name in ("drift", "along-travel")]
    problem, _ = problem_from_log(read_hidden(hide("many", ("drift",), 14, seed=3)), causes)
    misfit = compute_evidence(problem.linearize(), problem)
    cause_set = form_cause_set(misfit, "along-travel")
    estimated = make_selected(misfit, cause_set).start
    known, of_another_form = np.full(len(estimated), 0.01), np.full(len(estimated) + 1, 0.01)
    for values, expected in ((known, known), (of_another_form, estimated)):
        selected = make_selected(misfit, cause_set, {"along-travel": values})
        np.testing.assert_array_equal(selected.start, expected)


@pytest.mark.slow
def test_a_search_is_repeated_for_causes_that_it_could_find_and_no_others():
    """Wear does much of what a hidden drift does; of a side load the last test has what a search says."""
    log = read_hidden(hide("session", ("drift",), 30.0, seed=301))
    names = ("drift", "q2-offset", "side-load", "wear")
    candidates = [cause for cause in library() if cause.name in names]
    problem = replace(problem_from_log(log, candidates)[0], alternatives=waves)
    causes = {cause.name: cause for cause in problem.causes}

    def search(*chosen):
        some = replace(problem, causes=tuple(causes[name] for name in chosen))
        return select_causes(some, 0.01, 1000, np.random.default_rng(0))

    few, all_but_one = search("drift", "q2-offset"), search("drift", "q2-offset", "side-load")
    assert [one.cause for one in few.law_causes] == ["drift"]
    assert widen_selection(few, problem.causes, 0.01) is None
    wider = widen_selection(few, all_but_one.problem.causes, 0.01)
    assert wider.problem.causes == all_but_one.problem.causes
    expected = all_but_one.last_misfit.log_evidence_by_cause
    assert wider.last_misfit.log_evidence_by_cause == pytest.approx(expected, rel=1e-6)
    assert wider.p_value == few.p_value
