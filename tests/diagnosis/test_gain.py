"""What an extension gains: on rows that took no part, with intervals for a fresh replicate."""

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from stickslip_fit.causes import Wear, library
from stickslip_fit.diagnosis import combinations, diagnose, gain
from stickslip_fit.diagnosis.alternatives import build_unstructured_alternatives
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.cross_validation import (
    deal_kinds,
    hold_out_sessions,
    make_folds,
    match_findings,
    predict_held_out,
    select_from_training,
)
from stickslip_fit.diagnosis.effect_size import size_findings
from stickslip_fit.diagnosis.extension import SelectedCause, assess_residuals, extend_problem
from stickslip_fit.diagnosis.gain import (
    FoldSearches,
    estimate_gains,
    hold_out_configurations,
    number_session_configurations,
    select_in_fold,
)
from stickslip_fit.diagnosis.hypotheses import compute_changes
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.selection import Selection, select_causes
from stickslip_fit.machine import load_machine
from tests.diagnosis.conftest import waves
from tests.hidden import outside
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

ALPHA, N_BOOTSTRAP = 0.01, 1000
FEW = ("drift", "theta-offset", "q2-offset", "cable-torque", "recoil-axis", "end-stop-latency")
SELECT = partial(select_in_fold, alpha=ALPHA)


@pytest.fixture(scope="session")
def problem():
    """A hidden log as a problem with a few causes and one unstructured alternative, to be quick."""

    def made(hidden, names=FEW):
        causes = [cause for cause in library() if cause.name in names]
        own_problem, _ = problem_from_log(read_hidden(hidden), causes)
        return replace(own_problem, alternatives=waves)

    return made


@pytest.fixture(scope="module")
def two_causes(problem):
    """The selection of two hidden causes, and its findings."""
    own_problem = problem(hide("session", ("drift", "end-stop-latency"), 20, seed=4))
    selection = select_causes(own_problem, ALPHA, N_BOOTSTRAP, _rng())
    return selection, size_findings(selection, own_problem, ALPHA)


def splits_of(selection):
    return hold_out_configurations(selection)


def measured(problem, workers=1, selector=SELECT, alpha=ALPHA):
    selection = select_causes(problem, alpha, N_BOOTSTRAP, np.random.default_rng(0))
    found = size_findings(selection, problem, alpha) if selection.p_value < alpha else ()
    searches = FoldSearches(selection, alpha, select=selector)
    [(whole, _)] = estimate_gains(selection, found, [splits_of(selection)], searches, workers=workers)
    return whole, selection


def gained(whole):
    return whole.baseline - whole.extended


@pytest.mark.slow
@pytest.mark.parametrize("design", ["session", "thesis", "many"])
def test_folds_hold_out_each_configuration_whole_and_once_and_every_parameter_stays_known(problem, design):
    own_problem = problem(hide(design, seed=3))
    kinds, splits = (
        number_session_configurations(own_problem.rows),
        make_folds(own_problem.linearize(), number_session_configurations(own_problem.rows), _rng()),
    )
    held = np.concatenate([split.held_out for split in splits])
    assert len(np.unique(held)) == len(held) > 0.85 * len(own_problem)
    assert len(splits) == 10
    for split in splits:
        assert not set(kinds[split.held_out]) & set(kinds[split.train])
        np.testing.assert_array_equal(
            np.sort(np.r_[split.held_out, split.train]), np.arange(len(own_problem))
        )
    for part in own_problem.parts:
        slopes = part.law.jacobian(own_problem.rows.iloc[part.rows], part.values)
        slopes = slopes / np.linalg.norm(slopes, axis=0)
        for block in np.unique(part.block):
            subset = part.block == block
            known = np.linalg.matrix_rank(slopes[subset], 1e-6)
            for split in splits:
                left = subset & np.isin(part.rows, split.train)
                assert np.linalg.matrix_rank(slopes[left], 1e-6) == known


def test_a_kind_that_no_fold_takes_leaves_the_folds_of_the_others_as_they_are():
    """So that a replicate, in which a little else is found, has the same folds."""
    kinds = np.repeat(np.arange(60), np.tile([1, 2, 3], 20))
    whole, without = (
        deal_kinds(kinds, 10, lambda fold, rows, refused=refused: kinds[rows[0]] not in refused, _rng())
        for refused in ([], [7, 30])
    )
    left_out = np.flatnonzero(np.isin(kinds, [7, 30]))
    for one, other in zip(whole, without, strict=True):
        np.testing.assert_array_equal(np.setdiff1d(one.held_out, left_out), other.held_out)
    assert np.ptp([len(split.held_out) for split in whole]) <= 3


@pytest.mark.slow
def test_folds_are_the_same_whichever_configurations_seem_noisier(problem):
    selection = select_causes(problem(hide("many", seed=3)), ALPHA, N_BOOTSTRAP, _rng())
    own, ratio = selection.problem, _rng().choice([1.0, 1.4], selection.problem.configuration.max() + 1)
    other = replace(selection, problem=replace(own, noise_ratio=ratio[own.configuration]))
    for one, again in zip(splits_of(selection), splits_of(other), strict=True):
        np.testing.assert_array_equal(one.held_out, again.held_out)


@pytest.mark.slow
def test_a_cause_that_is_selected_again_in_another_version_is_fitted_in_that(problem, monkeypatch):
    """It kept the fit of the version before, with as many parameters as that has."""
    own_problem = problem(hide("session", ("drift", "end-stop-latency"), 20, seed=4))
    other, _ = next(iter(Wear().trials(own_problem.rows)))

    def select_again(problem, causes, place, level, rng):
        """The first one with two parameters where it had one."""
        if place:
            return None
        return replace(causes[0], version=other, start=np.array(other.start_values))

    monkeypatch.setattr(combinations, "_select_again", select_again)
    monkeypatch.setattr(combinations, "advantage", lambda *_: 0.0)
    found = select_causes(own_problem, ALPHA, N_BOOTSTRAP, _rng())
    numbers = [len(one.version.parameters) for one in found.law_causes]
    assert len(numbers) >= 2
    assert sum(numbers) == len(found.fit.values) == len(found.fit.prior_sd)
    assert found.law_causes[0].version == other


def test_causes_stay_known_in_what_is_left(problem):
    own_problem = problem(hide("session", seed=3))
    study, rng = own_problem.linearize(), _rng()
    effects = study.project(
        rng.standard_normal((len(own_problem), 2)) * (np.arange(len(own_problem)) < 12)[:, None]
    )
    effects *= 7 / np.linalg.norm(effects, axis=0)
    whole = study.basis.toarray()

    def least_left(splits):
        strengths = []
        for split in splits:
            basis, left = whole[split.train], effects[split.train]
            left = left - basis @ np.linalg.lstsq(basis, left)[0]
            strengths.append(np.linalg.norm(left, axis=0))
        return np.min(strengths)

    kinds = number_session_configurations(own_problem.rows)
    assert least_left(make_folds(study, kinds, _rng(), effects)) >= 5.0


@pytest.mark.slow
def test_the_traverses_beside_a_lasting_change_stay_in_training(problem):
    """Which of the two it lies between is a guess without either."""
    hidden = hide("session", ("session-jump",), 25, seed=3, forms={"session-jump": "table"})
    own_problem = problem(hidden, ("session-jump", "drift"))
    selection = select_causes(own_problem, ALPHA, N_BOOTSTRAP, np.random.default_rng(0))
    rows, (moment,) = selection.problem.rows, [one.start[1] for one in selection.law_causes]
    seconds = rows["session_seconds"].to_numpy(float)
    last, first = seconds[seconds < moment].max(), seconds[seconds >= moment].min()
    held_out = np.concatenate([split.held_out for split in splits_of(selection)])
    assert len(held_out) > 0.8 * len(rows)
    assert not {last, first} & set(seconds[held_out])


@pytest.mark.nightly
def test_structure_without_a_name_stays_known_in_each_joint():
    """Without what a joint shows of it, whether it acts on that joint, too, would be a guess."""
    case = next(one for one in outside.cases((25.0,), 461_000) if one.form == "square of psi")
    selection = diagnose(read_hidden(case.make(0), (2, 3)), gain=False).selection
    (found,), study = selection.law_causes, selection.problem.linearize()
    change = compute_changes(study, found.version, selection.fit.values[None])[:, 0] / study.scale
    whole = study.basis.toarray()

    def squares(kept):
        """Of each joint, what calibration by some rows leaves of the effect."""
        left = change[kept] - whole[kept] @ np.linalg.lstsq(whole[kept], change[kept])[0]
        return np.bincount(study.rows["joint"].to_numpy()[kept], left**2)

    least = np.minimum(5.0**2, squares(np.arange(len(change))) / 2)
    shown = least > 1.0
    assert shown.sum() == 2
    for split in splits_of(selection):
        assert (squares(split.train)[shown] > 0.9 * least[shown]).all()  # rows count alike in the folds


@pytest.mark.slow
def test_what_is_held_out_has_no_part_in_its_own_prediction(problem):
    hidden = hide("session", ("drift",), 14, seed=3)
    selection = select_causes(problem(hidden), ALPHA, N_BOOTSTRAP, np.random.default_rng(0))
    found = size_findings(selection, selection.problem, ALPHA)
    split = splits_of(selection)[0]
    wrong = 0.3 * np.isin(np.arange(len(selection.problem)), split.held_out)
    disturbed = replace(selection.problem, responses=selection.problem.responses + wrong)
    before, after = (
        predict_held_out(each, split, found, select_from_training(each, split, SELECT, (0, 0)))
        for each in (selection.problem, disturbed)
    )
    assert np.sqrt(np.mean(before[1] ** 2)) < np.sqrt(np.mean(before[0] ** 2))
    np.testing.assert_allclose(after, before + 0.3, atol=1e-9)


def test_a_new_session_is_predicted_by_its_calibration_and_causes_from_the_other_sessions(problem):
    hidden = hide("thesis", seed=3)
    own_problem = problem(hidden)
    splits = hold_out_sessions(own_problem, load_machine())
    session = own_problem.rows["session"].to_numpy(object)
    assert len(splits) == 3
    for split in splits:
        assert len(set(session[split.held_out]) | set(session[split.calibration])) == 1
        assert not set(session[split.train]) & set(session[split.held_out])
        assert not set(split.calibration) & set(split.held_out)
        parameters = 2 * sum(len(part.law.parameters) for part in own_problem.parts)
        assert len(split.calibration) == parameters
        assert len(split.held_out) + parameters == np.sum(session == session[split.held_out[0]])


def test_a_log_of_two_sessions_has_no_new_one(problem):
    own_problem = problem(hide("thesis", seed=3))
    first = np.flatnonzero(own_problem.rows["session"] == own_problem.rows["session"][0])
    assert hold_out_sessions(own_problem.without_rows(first), load_machine()) == []


def test_where_nothing_is_wrong_nothing_is_gained_and_no_fold_is_searched(problem):
    def never(own_problem, rng):
        raise AssertionError

    whole, selection = measured(problem(hide("session", seed=8)), selector=never)
    assert selection.p_value > ALPHA
    assert whole.extended == whole.baseline
    assert (whole.low, whole.high) == (0.0, 0.0)
    assert whole.noise_floor < whole.baseline < 2 * whole.noise_floor


@pytest.mark.nightly
@pytest.mark.parametrize("limit", ["MAX_SERIAL_ROWS", "MIN_SAVED_SECONDS"])
def test_the_number_of_processes_makes_no_difference(problem, monkeypatch, limit):
    monkeypatch.setattr(gain, limit, 0)  # or this small log would never have two
    own_problem = replace(
        problem(hide("session", ("drift",), 12, seed=3)), alternatives=build_unstructured_alternatives
    )
    selection = select_causes(own_problem, ALPHA, N_BOOTSTRAP, _rng())
    found, splits = size_findings(selection, own_problem, ALPHA), splits_of(selection)[:4]
    one, two = (
        estimate_gains(selection, found, [splits], FoldSearches(selection, ALPHA), workers=workers)[0][0]
        for workers in (1, 2)
    )
    assert (one.baseline, one.extended, one.low, one.high) == (two.baseline, two.extended, two.low, two.high)


@pytest.mark.slow
def test_each_finding_gains_its_step_and_steps_add_up(two_causes):
    selection, found = two_causes
    splits = splits_of(selection)[:1]
    [(whole, own)] = estimate_gains(selection, found, [splits], FoldSearches(selection, ALPHA), workers=1)
    assert {each.cause for each in own} >= {"drift", "end-stop-latency"}
    assert own[0].gain.baseline == whole.baseline
    assert own[-1].gain.extended == whole.extended
    for one, following in pairwise(own):
        assert following.gain.baseline == one.gain.extended
        assert one.gain.low < gained(one.gain) < one.gain.high
    assert whole.by_session["traverses"].sum() == sum(len(split.held_out) for split in splits)


@pytest.mark.slow
def test_what_stands_for_a_withdrawn_finding_counts_in_no_other(two_causes):
    """Neither a cause of its own name nor what a split has in its place, which may predict badly."""
    selection, found = two_causes
    (kept,) = (one for one in found if one.cause == "drift")
    splits, options = splits_of(selection)[:2], {"workers": 1, "confirm": lambda _: selection}
    predicted = []

    def predict(problem, split, findings, selection):
        predicted.append([one.cause for one in selection.law_causes])
        return predict_held_out(problem, split, findings, selection)

    searches = FoldSearches(selection, ALPHA, findings=found)
    [(alone, _)] = estimate_gains(selection, (kept,), [splits], searches, predict=predict, **options)
    assert predicted == [["drift"]] * len(splits)
    [(together, own)] = estimate_gains(selection, found, [splits], searches, **options)
    assert own[0].cause == "drift"
    assert alone.baseline == together.baseline
    assert alone.extended == pytest.approx(own[0].gain.extended, rel=1e-6)


@dataclass
class Choice:
    """A cause selected in a part of a log, or a finding of the whole log."""

    cause: str
    cause_set: tuple[str, ...] = ()
    version: object = None


@pytest.mark.parametrize(
    ("selected", "expected"),
    [
        (["b", "a"], [1, 0]),
        (["rival of b"], [1]),
        (["other", "b"], [0, 1]),  # in the place of a
        (["other", "another"], [0, 1]),
        (["other", "another", "third"], [0, 1, 1]),
        (["a", "other", "another"], [0, 1, 1]),
        (["a", "b", "other"], [0, 1, None]),  # beside all that the whole law has
        (["a", "rival of b", "b"], [0, 1, 1]),
        ([], []),
    ],
)
def test_what_a_fold_finds_besides_stands_for_nothing(selected, expected):
    findings = [Choice("a", ("a",)), Choice("b", ("b", "rival of b"))]
    assert match_findings([Choice(one) for one in selected], findings) == expected


@pytest.mark.slow
def test_rows_on_which_the_laws_alone_stall_say_nothing_of_a_cause(problem):
    own_problem = problem(hide("session", ("drift",), 20, seed=4))
    selection = select_causes(own_problem, ALPHA, N_BOOTSTRAP, _rng())
    found, splits = size_findings(selection, own_problem, ALPHA), splits_of(selection)[:2]

    def predicted(problem, split, findings, selection):
        errors = np.full((1 + len(findings), len(split.held_out)), 0.02)
        errors[1:] = 0.01
        errors[0, :2], errors[-1, 1:3] = np.nan, np.nan
        return errors

    known = {"predict": predicted, "confirm": lambda _: selection}
    [(whole, own)] = estimate_gains(selection, found, [splits], FoldSearches(selection, ALPHA), **known)
    n = sum(len(split.held_out) - 2 for split in splits)
    assert whole.by_session["traverses"].sum() == n
    assert whole.stalled == 2 * len(splits)
    assert whole.baseline == pytest.approx(0.02)
    assert whole.extended == pytest.approx(np.sqrt((len(splits) * 1.0 + (n - len(splits)) * 1e-4) / n))
    assert all(np.isfinite([each.gain.low, each.gain.high]).all() for each in own)


def oracle(hidden, selection):
    """Held-out rms errors without and with the true effect, its size fitted: plain linear algebra."""
    problem, blocks = selection.problem, []
    for part in problem.parts:
        slopes = part.law.jacobian(problem.rows.iloc[part.rows], part.values)
        for block in np.unique(part.block):
            columns = np.zeros((len(problem), slopes.shape[1]))
            subset = part.block == block
            columns[part.rows[subset]] = slopes[subset] / np.abs(slopes).max(axis=0)
            blocks.append(columns)
    effect = hidden.effect(hidden.acts[0].name)[:, None]
    predicted = np.zeros(len(problem))
    for part in problem.parts:
        predicted[part.rows] = part.law.predict(problem.rows.iloc[part.rows], part.values)
    left, weight, squares = problem.responses - predicted, 1 / problem.scale, []
    for columns in (np.concatenate(blocks, axis=1), np.concatenate([*blocks, effect], axis=1)):
        off = []
        for split in splits_of(selection):
            rest = split.train
            fitted = np.linalg.lstsq(columns[rest] * weight[rest, None], left[rest] * weight[rest])[0]
            off.append(left[split.held_out] - columns[split.held_out] @ fitted)
        squares.append(np.mean(np.concatenate(off) ** 2))
    return np.sqrt(squares)


def share_of_the_oracle(problem, seeds, strength, design="session"):
    subset, its, apart = [], [], []
    for seed in seeds:
        hidden = hide(design, (FEW[seed % len(FEW)],), strength, seed=seed)
        whole, selection = measured(problem(hidden))
        baseline, extended = oracle(hidden, selection)
        apart.append(abs(whole.baseline / baseline - 1.0))
        subset.append(gained(whole))
        its.append(baseline - extended)
    # Laws are not linear: of a session with few rows one may err by far more than by algebra.
    assert np.median(apart) < 0.01
    assert np.max(apart) < 0.06
    return np.sum(subset) / np.sum(its)


def covered(problem, seeds, strength):
    inside = []
    for seed in seeds:
        both = [
            hide("session", (FEW[seed % len(FEW)],), strength, seed=seed, replicate=replicate)
            for replicate in (0, 1)
        ]
        whole, selection = measured(problem(both[0]))
        if selection.p_value < ALPHA:
            fresh = gained(measured(problem(both[1]))[0])
            inside.append(whole.low <= fresh <= whole.high)
    return np.array(inside)


def forced(own_problem, rng):
    """The best cause in the law, whether or not anything is wrong."""
    study = own_problem.linearize()
    misfit = assess_residuals(study, own_problem, 100, rng)
    cause_set = form_cause_set(misfit)
    if cause_set.cause == UNKNOWN:
        best = max(
            (cause for cause in misfit.log_evidence_by_cause if cause != UNKNOWN),
            key=misfit.log_evidence_by_cause.get,
        )
        cause_set = replace(cause_set, cause=best)
    shape = misfit.best_hypothesis(cause_set.cause)
    start = np.array(shape.version.null_values) if shape.values is None else shape.values
    found = SelectedCause(cause_set.cause, shape.version, start, cause_set, misfit, 1.0)
    extension = extend_problem(own_problem, [found])
    problem, fit, left = extension.problem, extension.fit, extension.linearized
    return Selection(problem, np.zeros(0, np.intp), (found,), misfit, misfit, 1.0, fit, left)


def above_zero(problem, seeds):
    above = []
    for seed in seeds:
        own_problem = problem(hide("session", seed=seed, noise=("gaussian", "t5", "uneven")[seed % 3]))
        selection = forced(own_problem, _rng())
        found = size_findings(selection, own_problem, 2.0)
        searches = FoldSearches(selection, 2.0, select=forced)
        [(whole, _)] = estimate_gains(selection, found, [splits_of(selection)], searches, workers=1)
        above.append(whole.low > 0)
    return np.array(above)


def test_held_out_gain_is_nearly_that_of_knowing_the_effect(problem):
    assert share_of_the_oracle(problem, range(1), 12) > 0.9


def test_a_fit_that_fails_is_begun_again_nearer_to_no_effect(problem):
    """Wear that is looked for with the wrong sign and far too slow."""
    own_problem = problem(hide("session", ("wear",), 25, seed=2))
    right, wrong = (
        own_problem.fit_extended([Wear()], np.array(start)) for start in ((0.005, 1e4), (-0.005, 1e6))
    )
    assert wrong.converged
    assert wrong.values == pytest.approx(right.values, rel=0.01)


@pytest.mark.nightly
def test_the_interval_covers_the_gain_of_a_fresh_replicate(problem):
    assert covered(problem, range(4), 12).sum() >= 3


@pytest.mark.nightly
def test_a_cause_forced_upon_a_log_in_which_nothing_is_wrong_gains_nothing(problem):
    assert above_zero(problem, range(6)).sum() <= 1


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("design", "strength"), [("thesis", 8), ("many", 8), ("session", 12), ("session", 25)]
)
def test_held_out_gain_is_nearly_that_of_knowing_the_effect_in_many_logs(problem, design, strength):
    # In one small session a single configuration may hold most of what shows an effect of strength 8.
    assert share_of_the_oracle(problem, range(40), strength, design) > 0.9


@pytest.mark.nightly
@pytest.mark.parametrize("strength", [6, 8, 12, 25])
def test_the_interval_covers_the_gain_of_a_fresh_replicate_in_many_logs(problem, strength):
    inside = covered(problem, range(60), strength)
    assert inside.mean() > 0.95 - 3 * np.sqrt(0.05 * 0.95 / len(inside))


@pytest.mark.nightly
def test_a_cause_forced_upon_many_logs_in_which_nothing_is_wrong_gains_nothing(problem):
    above = above_zero(problem, range(150))
    assert above.mean() < 0.05 + 2 * np.sqrt(0.05 * 0.95 / len(above))


def _rng():
    return np.random.default_rng(0)
