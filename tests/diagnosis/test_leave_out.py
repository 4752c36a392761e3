"""A test repeated without some rows, by linear algebra: beside the same test of a log that lacks them."""

import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import csr_array

from stickslip_fit.causes import library
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.cross_validation import (
    confirm_selection,
    predict_held_out,
    select_from_training,
)
from stickslip_fit.diagnosis.effect_size import size_findings
from stickslip_fit.diagnosis.extension import compute_evidence, make_selected
from stickslip_fit.diagnosis.fold_selection import OpenSelection, log_likelihood_change, prepare_looks
from stickslip_fit.diagnosis.gain import hold_out_configurations, select_in_fold
from stickslip_fit.diagnosis.hypotheses import make_hypothesis, split_sessions
from stickslip_fit.diagnosis.leave_out import LeftOut, Look
from stickslip_fit.diagnosis.memory import AR1, Sequences
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.selection import select_causes
from stickslip_fit.diagnosis.session_stacks import build_per_session_hypotheses
from stickslip_fit.logs.fading import previous_rows
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

FEW = ("drift", "theta-offset", "cable-torque", "q2-offset", "side-load")
ALPHA = 0.01


@pytest.fixture(scope="module")
def problem():
    log = read_hidden(hide("thesis", ("drift",), 14, seed=3))
    causes = [cause for cause in library() if cause.name in FEW]
    return replace(problem_from_log(log, causes)[0], alternatives=alternatives)


def alternatives(study):
    """Of one direction and of several, in all rows and in sessions, and memory."""
    rows = study.rows
    session = pd.factorize(rows["session"].astype(object))[0].astype(np.int64)
    waves = np.cos(rows["session_seconds"].to_numpy(float)[:, None] / np.array([900.0, 2000.0, 7000.0]))
    waves = waves / study.scale[:, None]
    before, forward = previous_rows(session).astype(np.intp), study.direction_sign > 0
    name, sessions = "unknown:in each session", [*split_sessions(study).values()]
    return [
        make_hypothesis("unknown:wave", None, None, study.project(waves[:, :1])),
        make_hypothesis("unknown:waves", None, None, study.project(waves)),
        *build_per_session_hypotheses([name], len(rows), sessions, waves[:, None]),
        AR1("unknown:memory", Sequences.of(before, study.basis), 0.4),
        AR1("unknown:memory-by-direction", Sequences.of(before, study.basis, forward), -0.4),
    ]


def test_products_are_those_under_the_inverse_of_the_projector():
    rng, n = np.random.default_rng(2), 40
    blocks = np.kron(np.eye(8), np.ones((5, 2))) * rng.standard_normal((n, 16))
    basis = np.linalg.qr(np.concatenate([np.linalg.qr(blocks)[0], rng.standard_normal((n, 3))], axis=1))[0]
    basis[np.abs(basis) < 1e-12] = 0.0
    rows, columns = np.array([0, 1, 7, 12, 13, 30]), rng.standard_normal((n, 4))
    columns -= basis @ (basis.T @ columns)
    left_out = LeftOut.of(csr_array(basis), rows)
    coordinates = left_out.coordinates(columns[rows])
    inverse = np.linalg.inv(np.eye(len(rows)) - basis[rows] @ basis[rows].T)
    np.testing.assert_allclose(
        coordinates.T @ coordinates, columns[rows].T @ inverse @ columns[rows], atol=1e-10
    )
    kept = np.setdiff1d(np.arange(n), rows)
    fitted = basis[kept] @ np.linalg.lstsq(basis[kept], columns[kept])[0]
    left = left_out.remove(columns, csr_array(basis))
    np.testing.assert_allclose(left[kept], columns[kept] - fitted, atol=1e-10)


def test_a_group_of_as_many_rows_as_parameters_says_nothing_of_the_others():
    rng, n = np.random.default_rng(3), 12
    basis = np.zeros((n, 4))
    basis[:2, :2], basis[2:7, 2], basis[7:, 3] = np.eye(2), 5**-0.5, 5**-0.5
    columns = rng.standard_normal((n, 2))
    columns -= basis @ (basis.T @ columns)
    left_out = LeftOut.of(csr_array(basis), np.array([0, 1]))
    assert left_out.own.shape[1] == 0
    np.testing.assert_allclose(left_out.remove(columns, csr_array(basis)), columns, atol=1e-12)


@pytest.mark.parametrize("out", ["a tenth", "a third", "a session"])
def test_the_evidence_is_that_of_a_log_without_the_rows(problem, out):
    session = pd.factorize(problem.rows["session"].astype(object))[0]
    n, rng = len(problem), np.random.default_rng(5)
    rows = {
        "a tenth": np.sort(rng.choice(n, n // 10, replace=False)),
        "a third": np.sort(rng.choice(n, n // 3, replace=False)),
        "a session": np.flatnonzero(session == 1),
    }[out]
    kept = np.setdiff1d(np.arange(n), rows)
    whole = compute_evidence(problem.linearize(), problem)
    smaller = problem.select_rows(kept)
    expected = compute_evidence(smaller.linearize(), smaller)
    without = Look(whole).without(rows)
    np.testing.assert_allclose(without.residual[kept], expected.residual, atol=1e-9)
    assert not without.residual[rows].any()
    assert without.log_evidence == pytest.approx(expected.log_evidence, abs=1e-6)
    assert without.log_evidence_by_cause == pytest.approx(expected.log_evidence_by_cause, abs=1e-6)
    cause = max(FEW, key=lambda name: expected.log_evidence_by_cause.get(name, -np.inf))
    one, other = (
        Look(whole).select(cause, without, rows),
        make_selected(expected, Look(whole).select(cause, without, rows).cause_set),
    )
    assert one.start == pytest.approx(other.start, rel=1e-6)


def test_with_a_cause_in_the_law_the_evidence_is_that_of_a_log_without_the_rows(problem):
    """What all rows share is no part of a session's directions, which are not orthogonal to it."""
    cause = next(one for one in problem.causes if one.name == "drift")
    version = cause.trials(problem.rows)[0][0]
    fit = problem.fit_extended([version], np.array(version.start_values))
    rows = np.arange(2, len(problem), 7)
    kept = np.setdiff1d(np.arange(len(problem)), rows)

    def assess(problem, fit):
        linearized = problem.linearize_extended(fit)
        return compute_evidence(linearized, problem, ["drift"])

    smaller = replace(problem, parts=fit.parts).select_rows(kept)
    expected = assess(smaller, replace(fit, parts=smaller.parts))
    without = Look(assess(problem, fit)).without(rows)
    np.testing.assert_allclose(without.residual[kept], expected.residual, atol=1e-9)
    assert without.log_evidence == pytest.approx(expected.log_evidence, abs=1e-6)


def test_where_nothing_but_memory_is_left_to_test_its_evidence_is_that_without_the_rows(problem):
    only = replace(problem, causes=(), alternatives=lambda study: alternatives(study)[-2:])
    rows = np.arange(2, len(problem), 7)

    def assess(problem):
        return compute_evidence(problem.linearize(), problem)

    expected = assess(only.select_rows(np.setdiff1d(np.arange(len(problem)), rows)))
    assert Look(assess(only)).without(rows).log_evidence == pytest.approx(expected.log_evidence, abs=1e-6)


def test_shapes_of_a_session_that_is_left_out_have_no_part_in_the_test_of_the_others(problem):
    jump = [cause for cause in library() if cause.name == "session-jump"]
    with_jumps = replace(problem, causes=tuple(jump))
    session = with_jumps.rows["session"].to_numpy(object)
    rows = np.flatnonzero(session == session[0])
    look = Look(compute_evidence(with_jumps.linearize(), with_jumps))
    places = [k for k, one in enumerate(look.misfit.hypotheses) if one.cause == "session-jump"]
    test = look.restrict(look.without(rows), places, rows)
    assert 0 < len(test.hypotheses) == len(test.log_evidence) < len(places)
    assert session[0] not in {one.version.session for one in test.hypotheses}


@pytest.mark.slow
def test_hypotheses_that_are_far_behind_need_not_be_tested_anew():
    """In the test that names a cause and in the one that shows nothing more, the answers stay the same."""
    log = read_hidden(hide("session", ("drift",), 14, seed=3))
    problem, _ = problem_from_log(log, library())
    looks = prepare_looks(select_causes(problem, ALPHA, 199, np.random.default_rng(1)), ALPHA)
    rng, n = np.random.default_rng(2), len(problem)
    for look, tolerance in ((looks.naming[0], 1e-3), (looks.last, 0.3)):  # a clear answer is 1 away
        every = Look(look.misfit)
        for _ in range(5):
            rows = np.sort(rng.choice(n, n // 10, replace=False))
            without = look.without(rows)
            assert np.mean(without.log_evidence == look.misfit.log_evidence) > 0.9
            assert without.statistic == pytest.approx(every.without(rows).statistic, abs=tolerance)


def test_a_refit_loses_rows_as_if_it_were_repeated_without_them(problem):
    cause = next(one for one in problem.causes if one.name == "drift")
    version = cause.trials(problem.rows)[0][0]
    rows = np.arange(2, len(problem), 7)
    kept = np.setdiff1d(np.arange(len(problem)), rows)

    def refit(problem, start):
        fit = problem.fit_extended([version], start)
        linearized = problem.linearize_extended(fit)
        squares = linearized.residual @ linearized.residual
        return linearized, fit.values, -0.5 * linearized.df * np.log(squares)

    whole, values, likelihood = refit(problem, np.array(version.start_values))
    _, _, again = refit(problem.select_rows(kept), values)
    without = likelihood + log_likelihood_change(whole, rows)
    assert without == pytest.approx(again, abs=0.1)  # second order
    assert abs(without - likelihood * len(kept) / len(problem)) > 1.0


def repeat_search(selection, split, findings):
    """Held-out errors of the search repeated."""
    search = partial(select_in_fold, alpha=ALPHA)
    selected = select_from_training(selection.problem, split, search, (0, 0))
    return predict_held_out(selection.problem, split, findings, selected)


def confirm_search(looks, split, findings):
    """The same where that need not be repeated, else None."""
    selected = confirm_selection(looks, split)
    return selected and predict_held_out(looks.selection.problem, split, findings, selected)


@pytest.mark.slow
def test_held_out_errors_are_those_of_the_whole_selection_repeated(problem):
    selection = select_causes(problem, ALPHA, 1000, np.random.default_rng(0))
    findings = size_findings(selection, selection.problem, ALPHA)
    assert [one.cause for one in findings] == ["drift"]
    looks = prepare_looks(selection, ALPHA)
    split = hold_out_configurations(selection)[0]
    confirmed = confirm_search(looks, split, findings)
    repeated = repeat_search(selection, split, findings)
    before, after = np.sqrt(np.mean(repeated**2, axis=1))
    np.testing.assert_allclose(confirmed[0], repeated[0], rtol=1e-6)
    assert after < before
    assert np.sqrt(np.mean((confirmed[1] - repeated[1]) ** 2)) < 0.1 * after


@pytest.mark.slow
def test_a_law_for_unknown_structure_is_searched_anew_in_each_fold():
    """Without the search for causes, whose answer is clear; as in the search repeated."""
    log = hide("session", ("unknown:product",), 25, seed=5, forms={"unknown:product": "load and hours"})
    causes = [cause for cause in library() if cause.name in FEW]
    problem, _ = problem_from_log(read_hidden(log, (3,)), causes)
    selection = select_causes(problem, ALPHA, 1000, np.random.default_rng(0))
    findings = size_findings(selection, selection.problem, ALPHA)
    assert [one.cause for one in findings] == [UNKNOWN]
    looks, split = prepare_looks(selection, ALPHA), hold_out_configurations(selection)[0]
    repeated = repeat_search(selection, split, findings)
    before, after = np.sqrt(np.mean(repeated**2, axis=1))
    assert after < 0.5 * before
    confirmed = confirm_search(looks, split, findings)
    np.testing.assert_allclose(confirmed[0], repeated[0], rtol=1e-6)
    assert np.sqrt(np.mean((confirmed[1] - repeated[1]) ** 2)) < 0.02 * after
    (unknown,) = selection.selected
    # Where a pair of causes comes near, pairs are tried anew, and nothing else is.
    near = replace(selection, selected=(replace(unknown, ahead_of_pairs=2.0),))
    begun = confirm_selection(prepare_looks(near, ALPHA), split)
    assert isinstance(begun, OpenSelection)
    settled = begun.settle(np.random.default_rng(0))
    errors = predict_held_out(selection.problem, split, findings, settled)
    assert np.sqrt(np.mean((errors[1] - repeated[1]) ** 2)) < 0.02 * after
    # Where a cause is likelier instead, the search has to be repeated.
    by_causes = replace(begun.selection, problem=replace(begun.selection.problem, alternatives=lambda _: ()))
    assert replace(begun, selection=by_causes).settle(np.random.default_rng(0)) is None
    looks.selection = replace(selection, problem=replace(selection.problem, expressions=lambda _: None))
    smooth = confirm_search(looks, split, findings)
    assert np.sqrt(np.mean((smooth[1] - repeated[1]) ** 2)) > 0.05 * after  # no expression is left to choose


def test_looks_that_are_not_clear_are_left_to_the_whole_selection(problem):
    selection = select_causes(problem, ALPHA, 1000, np.random.default_rng(0))
    looks, few = prepare_looks(selection, ALPHA), np.arange(0, len(selection.problem), 9)
    assert [one.cause for one in looks.select_without(few)] == ["drift"]
    assert looks.select_without(np.arange(0, len(selection.problem) - 60)) is None  # hardly a row is left
    (one,) = selection.selected
    evidence = one.misfit.log_evidence_by_cause
    rival = {**evidence, UNKNOWN: evidence["drift"] - 1.0}
    close = replace(one, misfit=replace(one.misfit, log_evidence_by_cause=rival))
    withdrawn = replace(one, cause=UNKNOWN, version=None)
    assert prepare_looks(replace(selection, selected=(withdrawn,)), ALPHA) is None
    assert prepare_looks(replace(selection, selected=(close,)), ALPHA) is not None
    # A test beside unknown structure, whose shapes are not among its hypotheses.
    shapes = tuple(shape for shape in one.misfit.hypotheses if not shape.cause.startswith(UNKNOWN))
    beside = replace(one, naming=replace(one.misfit, hypotheses=shapes))
    assert prepare_looks(replace(selection, selected=(beside,)), ALPHA) is None


def compare_with_repetition(log, causes=None):
    """A selection, its findings, and errors of a fold: confirmed by linear algebra, and searched again."""
    problem, _ = problem_from_log(log, causes)
    selection = select_causes(problem, ALPHA, 1000, np.random.default_rng(0))
    findings = size_findings(selection, selection.problem, ALPHA)
    looks, split = prepare_looks(selection, ALPHA), hold_out_configurations(selection)[0]
    repeated = repeat_search(selection, split, findings)
    return selection, findings, confirm_search(looks, split, findings), repeated


@pytest.mark.nightly
def test_a_law_for_unknown_structure_is_searched_anew_beside_a_cause():
    """As in the search repeated, within a few hundredths of the noise."""
    hidden = ("session-jump", "unknown:harmonic")
    forms = {"session-jump": "table", "unknown:harmonic": "cos 3 q2"}
    log = read_hidden(hide("session", hidden, (25, 25), seed=3, forms=forms))
    _, findings, confirmed, repeated = compare_with_repetition(log)
    assert {one.cause for one in findings} == {"session-jump", UNKNOWN}
    assert findings[0].effect.estimate > findings[1].effect.estimate
    before, *_, after = np.sqrt(np.mean(repeated**2, axis=1))
    assert after < 0.8 * before
    assert np.sqrt(np.mean((confirmed[-1] - repeated[-1]) ** 2)) < 0.1 * after


@pytest.mark.slow
def test_a_selection_that_is_open_goes_on_after_what_was_selected_before():
    """Also in another process; as in the search repeated."""
    hidden, forms = ("drift", "unknown:harmonic"), {"unknown:harmonic": "cos 3 q2"}
    log = read_hidden(hide("thesis", hidden, (60, 24), seed=6, forms=forms), (3,))
    causes = [cause for cause in library() if cause.name in FEW]
    selection, findings, _, repeated = compare_with_repetition(log, causes)
    first, second = selection.selected
    assert (first.cause, second.cause) == ("drift", UNKNOWN)
    assert form_cause_set(first.naming).cause == UNKNOWN  # found in the place of a function without a name
    near = replace(selection, selected=(first, replace(second, ahead_of_pairs=2.0)))
    split = hold_out_configurations(selection)[0]
    begun = pickle.loads(pickle.dumps(confirm_selection(prepare_looks(near, ALPHA), split)))
    (before,) = begun.selection.selected
    assert before.cause == "drift"
    assert len(before.misfit.hypotheses) < 0.1 * len(first.misfit.hypotheses)
    settled = begun.settle(np.random.default_rng(0))
    errors = predict_held_out(selection.problem, split, findings, settled)
    with_one, with_both = np.sqrt(np.mean(repeated[1:] ** 2, axis=1))
    assert with_both < 0.97 * with_one
    assert np.sqrt(np.mean((errors[-1] - repeated[-1]) ** 2)) < 0.1 * with_both


@pytest.mark.nightly
def test_a_law_for_unknown_structure_before_a_cause_is_searched_anew():
    """As in the search repeated, where the cause was named after it."""
    hidden, forms = ("unknown:harmonic", "drift"), {"unknown:harmonic": "cos 3 q2"}
    log = read_hidden(hide("session", hidden, (60, 24), seed=4, forms=forms), (3,))
    causes = [cause for cause in library() if cause.name in FEW]
    selection, findings, confirmed, repeated = compare_with_repetition(log, causes)
    assert [one.cause for one in selection.selected] == [UNKNOWN, "drift"]
    before, *_, after = np.sqrt(np.mean(repeated**2, axis=1))
    assert after < 0.3 * before
    assert np.sqrt(np.mean((confirmed[-1] - repeated[-1]) ** 2)) < 0.1 * after
    unknown, drift = selection.selected
    rivals = {**unknown.naming.log_evidence_by_cause, "side-load": 1e3}
    hidden = replace(unknown, naming=replace(unknown.naming, log_evidence_by_cause=rivals))
    unclear = replace(selection, selected=(hidden, drift))
    split = hold_out_configurations(selection)[0]
    assert confirm_search(prepare_looks(unclear, ALPHA), split, findings) is None


@pytest.mark.nightly
def test_several_causes_are_those_of_the_whole_selection_repeated():
    """Each is asked for again with the others in the law, and where it was named first."""
    log = read_hidden(hide("thesis", ("cable-torque", "drift"), 14, seed=3), (2,))
    causes = [cause for cause in library() if cause.name in FEW]
    problem = replace(problem_from_log(log, causes)[0], alternatives=alternatives)
    selection = select_causes(problem, ALPHA, 1000, np.random.default_rng(0))
    findings = size_findings(selection, selection.problem, ALPHA)
    assert {one.cause for one in findings} == {"cable-torque", "drift"}
    assert all(one.naming is not None for one in selection.law_causes)
    looks, split = prepare_looks(selection, ALPHA), hold_out_configurations(selection)[0]
    confirmed = confirm_search(looks, split, findings)
    repeated = repeat_search(selection, split, findings)
    after = np.sqrt(np.mean(repeated[-1] ** 2))
    assert np.sqrt(np.mean((confirmed[-1] - repeated[-1]) ** 2)) < 0.1 * after
    first, second = selection.law_causes
    evidence = {**first.naming.log_evidence_by_cause, UNKNOWN: 1e3}  # which would have been selected
    hidden = replace(first, naming=replace(first.naming, log_evidence_by_cause=evidence))
    unclear = replace(selection, selected=(hidden, second))
    assert confirm_search(prepare_looks(unclear, ALPHA), split, findings) is None
    assert prepare_looks(replace(selection, selected=(second,)), ALPHA) is None  # another was first


@pytest.mark.slow
def test_a_moment_of_change_is_chosen_without_the_rows_held_out():
    log = read_hidden(hide("session", ("session-jump",), 25, seed=4))
    causes = [cause for cause in library() if cause.name in (*FEW, "session-jump")]
    problem = replace(problem_from_log(log, causes)[0], alternatives=alternatives)
    selection = select_causes(problem, ALPHA, 1000, np.random.default_rng(0))
    findings = size_findings(selection, selection.problem, ALPHA)
    assert [one.cause for one in findings] == ["session-jump"]
    split = hold_out_configurations(selection)[0]
    size, moment = selection.fit.values
    elsewhere = replace(selection, fit=replace(selection.fit, values=np.array([size, 0.5 * moment])))
    one, other = (
        confirm_search(prepare_looks(each, ALPHA), split, findings) for each in (selection, elsewhere)
    )
    np.testing.assert_allclose(one, other, rtol=1e-6)
