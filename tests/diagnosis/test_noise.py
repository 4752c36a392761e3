"""What counts as noise: uneven, heavy in the tails, with wild counts or memory; and what hides in it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from stickslip_fit.diagnosis.evidence import batch_hypotheses
from stickslip_fit.diagnosis.hypotheses import (
    build_session_hypotheses,
    compute_changes,
    make_hypothesis,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import LawBlock, linearize_fit
from stickslip_fit.diagnosis.memory import AR1, Sequences
from stickslip_fit.diagnosis.misfit import (
    StructureRemoved,
    compute_p_value,
    remove_structure,
    weigh_evidence,
)
from stickslip_fit.diagnosis.noise import estimate_noise, find_outliers, shrink_variances
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.diagnosis.separability import compute_cosines
from stickslip_fit.diagnosis.session_stacks import build_per_session_hypotheses
from stickslip_fit.diagnosis.unknown_size import estimate_ar1_effect
from stickslip_fit.laws import Prismatic

NOISE, WIDE = 0.003, 2.0


def drive_of(rows):
    return (rows["direction"] == "-").to_numpy().astype(np.intp)


def kind_of(rows):
    return np.unique(rows["q2"].round(3).to_numpy(), return_inverse=True)[1]


def test_shapes_that_each_session_has_by_itself_are_those_of_all_rows(rows, linearize):
    """Against the same columns written out for all rows, zero outside their session."""
    rng = np.random.default_rng(1)
    linearized = linearize(NOISE * rng.standard_normal(len(rows)))
    columns, every = rng.standard_normal((len(rows), 1, 2)), list(split_sessions(linearized).values())
    (small,) = build_per_session_hypotheses(["unknown:waves"], len(rows), every, columns)
    own = np.concatenate([columns[:, 0] * (rows["session"] == name).to_numpy()[:, None] for name in "ab"], 1)
    large = make_hypothesis("unknown:waves", None, None, linearized.project(own))
    first = every[0]
    (one,) = build_session_hypotheses(
        "jump", None, np.ones((1, 1)), len(rows), first, first.project(columns[first.rows, 0, :1])
    )
    whole = make_hypothesis("jump", None, None, linearized.project(own[:, :1]))
    found = batch_hypotheses([small, large, one, whole], linearized.df).log_evidence(
        linearized.residual[:, None]
    )[:, 0]
    assert found[0] == pytest.approx(found[1], abs=1e-9)
    assert found[2] == pytest.approx(found[3], abs=1e-9)


def test_an_effect_does_not_hide_behind_its_own_signs(rows, linearize):
    """It is in 8 of 200 traverses; with its signs flipped it would look as large in 1 log of 128."""
    rng = np.random.default_rng(2)
    shape = np.zeros((len(rows), 1))
    shape[rng.choice(len(rows), 8, replace=False)] = 1.0
    linearized = linearize(NOISE * (rng.standard_normal(len(rows)) + 3.0 * shape[:, 0]))
    misfit = weigh_evidence(linearized, [make_hypothesis("some", None, None, linearized.project(shape))])
    found = compute_p_value(misfit, linearized, 1999, rng)
    assert found.p_value == 1 / 2000


@pytest.mark.slow
def test_what_two_traverses_show_has_to_exceed_the_heaviest_tails(rows, linearize):
    """100 logs of such tails, and any two neighbours for a shape; then two of them are far off."""
    rng, n = np.random.default_rng(3), len(rows)
    pairs = np.repeat(np.eye(n // 2), 2, axis=0)

    def p_value(departure):
        linearized = linearize(departure)
        shapes = linearized.project(pairs).T
        tried = [make_hypothesis("pair", None, None, shape[:, None]) for shape in shapes]
        return compute_p_value(weigh_evidence(linearized, tried), linearized, 99, rng).p_value

    noise = [NOISE * rng.standard_t(5, n) for _ in range(100)]
    alarms = np.mean([p_value(each) <= 0.02 for each in noise])
    assert alarms < 0.02 + 3 * np.sqrt(0.02 * 0.98 / len(noise))
    assert p_value(noise[0] + 20 * NOISE * pairs[:, 20]) == 1 / 100


def test_configurations_that_repeat_worse_are_found_and_effects_are_not_taken_for_them(rows, linearize):
    rng = np.random.default_rng(4)
    drive, kind = drive_of(rows), kind_of(rows)
    noisy = (rows["q2"] < -2.0).to_numpy()
    where = np.where(noisy, WIDE, 1.0)

    def judged(departure):
        linearized = linearize(departure)
        left = StructureRemoved(linearized.residual, np.zeros(len(rows)))
        return estimate_noise(linearized, left, np.zeros(len(rows)), drive, kind)

    found = judged(NOISE * where * rng.standard_normal(len(rows)))
    assert found.heteroscedasticity.ratio[noisy].mean() == pytest.approx(WIDE, rel=0.2)
    assert found.heteroscedasticity.ratio[~noisy].mean() == pytest.approx(1.0, abs=0.15)
    assert found.sd == pytest.approx([NOISE, NOISE], rel=0.2)
    shifted = judged(NOISE * (rng.standard_normal(len(rows)) + 3.0 * noisy * np.where(drive, -1.0, 1.0)))
    assert np.all(shifted.heteroscedasticity.ratio == 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("tails", "seen"), [(np.inf, True), (5.0, False)])
def test_a_wild_count_is_one_where_the_others_are_tame(rows, parts, tails, seen):
    """The same count, 7 standard deviations off, among 799 with thin and with heavy tails."""
    rng, times = np.random.default_rng(6), 4
    many = pd.concat([rows.assign(session=rows["session"] + str(k)) for k in range(times)], ignore_index=True)
    block = np.concatenate([parts[0].block + 4 * k for k in range(times)])
    values = np.tile(parts[0].values, (times, 1))
    noise = rng.standard_normal(len(many)) if np.isinf(tails) else rng.standard_t(tails, len(many)) / 1.29
    noise[77] = 7.0
    responses = Prismatic().predict(many, values) + NOISE * noise
    part = LawBlock(Prismatic(), np.arange(len(many)), block, values)
    linearized = linearize_fit(RowTable(many), [part], responses, np.full(len(many), NOISE))
    found = find_outliers(linearized, linearized.residual, drive_of(many), 999, rng)
    assert (found.p_value < 0.01) == seen
    assert not seen or found.rows.tolist() == [77]


@pytest.mark.slow
@pytest.mark.parametrize("one_way", [False, True])
@pytest.mark.parametrize("logs", [40, pytest.param(100, marks=pytest.mark.nightly)])
def test_memory_is_as_large_as_calibration_leaves_it(rows, parts, one_way, logs):
    """Logs of 48 traverses in which each departure keeps half of the one before, or every second does."""
    rng, share, n = np.random.default_rng(7), 0.5, 48
    short = pd.concat([rows[:24], rows[100:124]], ignore_index=True)
    subset = np.r_[0:24, 100:124]
    part = LawBlock(Prismatic(), np.arange(n), parts[0].block[subset], parts[0].values[subset])
    before, onto = np.where(np.arange(n) % 24 == 0, -1, np.arange(n) - 1), np.arange(n) % 2 == 1
    inside, ratio = [], []
    for _ in range(logs):
        noise, carried = rng.standard_normal(n), np.zeros(n)
        for row in np.flatnonzero((before >= 0) & (onto | (not one_way))):
            carried[row] = share * noise[row - 1]
            noise[row] += carried[row]
        responses = Prismatic().predict(short, part.values) + NOISE * noise
        linearized = linearize_fit(RowTable(short), [part], responses, np.full(n, 3.0 * NOISE))
        sequences = Sequences.of(before, linearized.basis, onto if one_way else None)
        effect = estimate_ar1_effect(linearized, AR1("unknown:memory", sequences, 0.5), linearized)
        basis = linearized.basis.toarray()
        left = carried - basis @ np.linalg.lstsq(basis, carried, rcond=None)[0]
        truth = NOISE * float(np.sqrt(np.mean(left**2)))
        inside.append(effect.low <= truth <= effect.high)
        ratio.append(effect.estimate / truth)
    assert np.mean(inside) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / logs)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.12)


class Stalling:
    """A cause in proportion to its size, but beyond a limit the law has no answer."""

    name, joints, session, combine_trials, null_values = "stalling", (3,), "", False, (0.0,)

    def changes(self, law, table, values, trials):
        sizes = trials[:, 0] * np.sign(np.sqrt(0.1 - np.abs(trials[:, 0])))
        return np.arange(len(values))[:, None] * sizes


def test_a_trial_that_stalls_a_joint_stands_for_a_smaller_one_without_a_warning(rows, linearize):
    linearized = linearize(np.zeros(len(rows)))
    found = compute_changes(linearized, Stalling(), np.array([[0.5], [0.05], [90.0]]))
    assert found[:, 0] == pytest.approx(10 * found[:, 1])
    assert np.all(found[:, 2] == 0.0)


def test_a_log_too_short_for_periods_has_no_hypothesis_of_one(rows, linearize):
    linearized = linearize(NOISE * np.random.default_rng(4).standard_normal(len(rows)))
    none = np.zeros((len(rows), 0, 2))
    sessions = list(split_sessions(linearized).values())
    coupled = [replace(one, shared=np.eye(len(rows))[:, :1]) for one in sessions]
    for every in (sessions, coupled):
        assert build_per_session_hypotheses([], len(rows), every, none) == []


def test_cosines_are_those_of_the_angles_between_spans(rows, linearize):
    """By the singular values of the directions written out for all rows."""
    rng, n = np.random.default_rng(5), len(rows)
    linearized = linearize(NOISE * rng.standard_normal(n))
    sessions = list(split_sessions(linearized).values())
    own = build_per_session_hypotheses(["unknown:waves"], n, sessions, rng.standard_normal((n, 1, 2)))
    single = [
        build_session_hypotheses(
            "jump", None, np.ones((1, 1)), n, one, one.project(rng.standard_normal((len(one), 1)))
        )[0]
        for one in sessions
    ]
    wide = [
        make_hypothesis("any", None, None, linearized.project(rng.standard_normal((n, m)))) for m in (1, 3)
    ]
    # In some rows only: of these, others have some, all or none.
    for some in (slice(0, n // 3), slice(n // 5, n // 2), slice(n // 2, n)):
        column = np.zeros((n, 1))
        column[some] = rng.standard_normal((len(column[some]), 1))
        wide.append(make_hypothesis("some", None, None, column))
    every = [*own, *single, *wide]
    expected = [
        [np.linalg.svd(one.directions.T @ other.directions, compute_uv=False)[0] for other in every]
        for one in every
    ]
    memory = AR1("unknown:memory", Sequences.of(np.arange(n) - 1, linearized.basis), 0.5)
    cosines = compute_cosines([*every, memory], every)
    np.testing.assert_allclose(cosines[:-1], np.minimum(expected, 1.0), atol=1e-12)
    assert not cosines[-1].any()


@pytest.mark.parametrize("spread", [0.0, 0.2, 1.0])
def test_a_weighted_mean_is_as_uncertain_as_its_expected_variances_say(spread):
    """2,000 means of six drives whose variances are estimated with 12 degrees of freedom each."""
    rng, df, n = np.random.default_rng(8), np.full(6, 12.0), 2000
    variance = np.exp(spread * rng.standard_normal((n, 6)))
    estimate = variance * rng.chisquare(12, (n, 6)) / 12
    expected = np.array([shrink_variances(one, df) for one in estimate])
    means = rng.standard_normal((n, 6)) * np.sqrt(variance)

    def standardize(used):
        return np.sum(means / used, axis=1) / np.sqrt(np.sum(1 / used, axis=1))

    assert np.mean(np.abs(standardize(estimate)) < 1.96) < 0.93
    assert np.mean(np.abs(standardize(expected)) < 1.96) == pytest.approx(0.95, abs=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("df", [1, pytest.param(5, marks=pytest.mark.nightly), 20])
def test_noise_is_told_by_as_many_rows_as_the_law_leaves(rows, parts, df):
    """Over 60 logs of laws that follow some rows much closer than others."""
    rng, n, predicted = np.random.default_rng(df), len(rows), Prismatic().predict(rows, parts[0].values)
    scale, whole, drive = np.full(n, NOISE), np.zeros(n), drive_of(rows)
    calibration = linearize_fit(RowTable(rows), parts, predicted, scale).basis.shape[1]
    variance, uneven = [], 0
    for _ in range(60):
        further = np.exp(rng.standard_normal((n, 1))) * rng.standard_normal((n, n - calibration - df))
        responses = predicted + NOISE * rng.standard_normal(n)
        linearized = linearize_fit(RowTable(rows), parts, responses, scale).absorb(further)
        noise = estimate_noise(
            linearized, StructureRemoved(linearized.residual, whole), whole, drive, kind_of(rows)
        )
        assert noise.df.sum() == pytest.approx(df, abs=1e-3)
        variance.append(np.mean((noise.sd[drive] * noise.ratio / NOISE) ** 2))
        uneven += len(noise.unevenness.carriers) > 0
    assert np.mean(variance) == pytest.approx(1.0, abs=4 * np.sqrt(2 / df / 60))
    assert np.quantile(variance, 0.9) < 1.3 * chi2.ppf(0.9, df) / df
    assert uneven <= 3


@pytest.mark.parametrize("factor", [0.05, 20.0])
def test_structure_is_removed_alike_whatever_noise_it_was_thought_to_be_in(rows, linearize, factor):
    """Noise that is first thought 20 times too large would else keep most of the structure, and stay so."""
    rng = np.random.default_rng(9)
    share = (rows["session_seconds"] / rows["session_seconds"].max()).to_numpy()
    waves = np.cos(np.pi * share[:, None] * np.arange(1, 7))
    linearized = linearize(NOISE * (rng.standard_normal(len(rows)) + 20 * waves @ rng.standard_normal(6)))
    shape = make_hypothesis("unknown:waves", None, None, linearized.project(waves))
    evidence = batch_hypotheses([shape], linearized.df).log_evidence(linearized.residual[:, None])[:, 0]
    left = [
        remove_structure(one * linearized.residual, [shape], evidence, linearized.df).residual / one
        for one in (1.0, factor)
    ]
    np.testing.assert_allclose(left[1], left[0], rtol=1e-9)
    assert np.std(left[0]) == pytest.approx(1.0, abs=0.15)
