"""The gain of a table's diagnosis, against cross-validation written by hand with plain numpy."""

import pickle

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes.generic import ColumnDependence
from stickslip_fit.diagnosis import gain, table_gain
from stickslip_fit.diagnosis.cross_validation import select_from_training
from stickslip_fit.diagnosis.table_gain import hold_out_kinds, number_rows, number_time_blocks
from tests.table.bench import BY_DIRECTION, CUBIC, LAW, bench, design
from tests.table.test_columns import sum_of_columns, table


def held_out_rms(frame, splits, *, extended):
    x, y, errors = design(frame, extended=extended), frame["F"].to_numpy(), []
    for train, held in splits:
        values = np.linalg.lstsq(x[train], y[train], rcond=None)[0]
        errors.append(y[held] - x[held] @ values)
    return np.sqrt(np.mean(np.concatenate(errors) ** 2))


def splits_of(diagnosis, kinds):
    selection = diagnosis.selection
    folds = hold_out_kinds(selection, selection.problem.linearize(), kinds)
    return [(split.train, split.held_out) for split in folds]


def test_rows_are_held_out_and_predicted_as_by_hand(independent):
    kinds, words = number_rows(len(independent.selection.problem))
    assert words == independent.gain.held_out == "single rows"
    splits, frame = splits_of(independent, kinds), bench(1)
    for train, held in splits:
        assert not {*train} & {*held}
        assert {*kinds[train]}.isdisjoint(kinds[held])
    assert sorted(np.concatenate([held for _, held in splits])) == list(range(len(frame)))
    gain = independent.gain
    assert gain.baseline == pytest.approx(held_out_rms(frame, splits, extended=False), rel=1e-6)
    assert gain.extended == pytest.approx(held_out_rms(frame, splits, extended=True), rel=1e-4)
    assert 0 < gain.low < gain.baseline - gain.extended < gain.high
    assert gain.noise_floor == pytest.approx(0.2, rel=0.15)
    (finding,) = independent.findings
    assert (finding.gain.baseline, finding.gain.extended) == (gain.baseline, gain.extended)


def test_blocks_are_long_against_the_autocorrelation(named):
    info = named.table
    (phi,) = named.extended_law().autocorrelation
    assert info.correlation_rows == pytest.approx((1 + phi) / (1 - phi))
    assert info.independent == pytest.approx(len(named.selection.problem) / info.correlation_rows)
    kinds, words = number_time_blocks(named.selection.problem.rows, info.correlation_rows)
    sizes = np.bincount(kinds)
    assert np.all(np.diff(kinds) >= 0)
    assert sizes.min() >= min(10 * info.correlation_rows, len(kinds) // 10)
    assert words == named.gain.held_out


def test_with_nothing_wrong_nothing_is_gained(nothing):
    gain = nothing.gain
    assert (gain.low, gain.high) == (0, 0)
    assert gain.baseline == gain.extended == pytest.approx(0.2, rel=0.15)


def pump():
    """Its flow saturates: a cause without a name, in each fold as in all rows."""
    rng = np.random.default_rng(4)
    dp = rng.uniform(0.5, 9.0, 120)
    flow = 3.2 * np.sqrt(np.minimum(dp, 6.5)) + 0.05 * rng.standard_normal(120)
    return pd.DataFrame({"dp": dp, "Q": flow})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frame", "law", "time"),
    [
        (pump(), "Q ~ k*sqrt(dp)", None),
        (pump(), "Q ~ k*sqrt(dp)", "order"),
        (table(1, sum_of_columns(4)), "y ~ a + b*x", None),
    ],
    ids=["any order", "in order", "columns"],
)
def test_a_clear_answer_is_not_searched_for_again_in_each_fold(monkeypatch, frame, law, time):
    searched = []
    diagnosis = ssf.diagnose_table(frame, law, time=time, gain=False)

    def search(problem, split, selector, seed):
        searched.append(split)
        return select_from_training(problem, split, selector, seed)

    monkeypatch.setattr(gain, "select_from_training", search)
    confirmed = diagnosis.measure_gain(workers=1).gain
    in_short = len(searched)
    monkeypatch.setattr(table_gain, "prepare_looks", lambda *_: None)
    repeated = diagnosis.measure_gain(workers=1).gain
    assert in_short <= 0.3 * (len(searched) - in_short)
    assert confirmed.baseline == pytest.approx(repeated.baseline, rel=1e-9)
    assert confirmed.extended == pytest.approx(repeated.extended, rel=0.05)
    assert confirmed.extended < 0.3 * confirmed.baseline


@pytest.mark.slow
def test_groups_are_held_out_as_a_whole():
    frame = bench(1, n=180).assign(specimen=np.repeat(list("abcdef"), 30))
    diagnosis = ssf.diagnose_table(
        frame, LAW, group="specimen", causes=[BY_DIRECTION, CUBIC], generic_causes=()
    )
    kinds = pd.factorize(frame["specimen"])[0]
    splits = splits_of(diagnosis, kinds)
    assert len(splits) == 6
    assert diagnosis.gain.held_out == "whole groups (specimen)"
    assert diagnosis.gain.baseline == pytest.approx(held_out_rms(frame, splits, extended=False), rel=1e-6)
    assert diagnosis.gain.extended == pytest.approx(held_out_rms(frame, splits, extended=True), rel=1e-4)


def sessions(shared):
    frame = bench(1).assign(run=np.repeat(["a", "b", "c"], 100))
    return ssf.diagnose_table(
        frame, LAW, session="run", shared=shared, causes=[BY_DIRECTION, CUBIC], generic_causes=()
    )


@pytest.mark.nightly
def test_new_sessions_are_predicted_where_all_parameters_are_shared():
    gain = sessions("all").gain_new_session
    assert gain.held_out == "whole sessions"
    splits = [
        (np.flatnonzero(np.arange(300) // 100 != run), np.flatnonzero(np.arange(300) // 100 == run))
        for run in range(3)
    ]
    assert gain.extended == pytest.approx(held_out_rms(bench(1), splits, extended=True), rel=1e-4)
    assert sessions(()).gain_new_session is None


def test_of_many_rows_sets_at_random_are_held_out():
    kinds, words = number_rows(1234)
    sizes = np.bincount(kinds)
    assert (len(sizes), set(sizes)) == (500, {2, 3})
    assert np.abs(np.corrcoef(kinds, np.arange(1234))[0, 1]) < 0.1
    assert "at random" in words


def test_without_a_time_the_order_of_rows_changes_no_gain():
    """In a table sorted by what the law lacks, blocks of rows would be half of a label, or an end of x."""
    rng = np.random.default_rng(4)
    x, who = np.tile(np.linspace(0.0, 1.0, 10), 12), np.repeat(np.arange(12), 10)
    slope = 1.0 + rng.standard_normal(12)[who]
    runs = pd.DataFrame({"x": x, "who": [f"w{k}" for k in who], "y": slope * x + rng.normal(0.0, 0.1, 120)})
    in_order, at_random = (
        ssf.diagnose_table(frame, "y ~ a + b*x").gain
        for frame in (runs, runs.sample(frac=1.0, random_state=1).reset_index(drop=True))
    )
    assert in_order.extended == pytest.approx(at_random.extended, rel=0.15)
    assert in_order.extended < 0.13


@pytest.mark.slow
def test_a_row_without_which_a_parameter_is_unknown_stays_in_training():
    frame = bench(1)
    frame["lamp"] = (np.arange(len(frame)) == 7).astype(float)
    diagnosis = ssf.diagnose_table(
        frame,
        ssf.Law("F ~ M*acc + Fv*vel + Fc*sign(vel) + offset + light*lamp"),
        causes=[BY_DIRECTION],
        generic_causes=(),
        gain=False,
    )
    kinds, _ = number_rows(len(frame))
    held = np.concatenate([held for _, held in splits_of(diagnosis, kinds)])
    assert 7 not in held
    assert len(held) == len(frame) - np.sum(kinds == kinds[7])


@pytest.mark.nightly
@pytest.mark.parametrize("phi", [0.0, 0.7])
def test_the_interval_covers_the_gain_of_a_replicate(phi):
    """Each interval against the gains of all: not independent, so that the bound is loose."""
    gains = [
        ssf.diagnose_table(
            bench(seed, phi=phi), LAW, time="t", causes=[BY_DIRECTION, CUBIC], generic_causes=()
        ).gain
        for seed in range(20)
    ]
    differences = np.array([one.baseline - one.extended for one in gains])
    inside = [np.mean((one.low < differences) & (differences < one.high)) for one in gains]
    assert np.mean(inside) > 0.85


@pytest.mark.parametrize("correlation_rows", [1.0, 50.0])
def test_every_sequence_has_four_blocks_of_its_own_or_as_many_as_it_has_rows(correlation_rows):
    """Long autocorrelation would make one block of a short session, whose parameters nothing would tell."""
    lengths = {"a": 12, "b": 3, "c": 400, "d": 41}
    rows = pd.DataFrame({"session": np.repeat(list(lengths), list(lengths.values()))})
    kinds, _ = number_time_blocks(rows, correlation_rows)
    blocks = pd.Series(kinds).groupby(rows["session"]).nunique()
    assert pd.Series(kinds).groupby(kinds).ngroups == blocks.sum()
    assert blocks[["a", "b", "d"]].tolist() == [4, 3, 4]
    assert blocks["c"] >= (4 if correlation_rows > 1 else 20)
    for session in lengths:
        sizes = np.bincount(kinds[rows["session"] == session])
        assert np.ptp(sizes[sizes > 0]) <= 1


@pytest.mark.nightly
def test_a_wave_under_a_wander_is_judged_by_each_row_given_those_before_it():
    """A random walk of 1.8 hides a wave of 0.25 rms in the errors themselves."""
    rng, hours = np.random.default_rng(4), np.arange(480.0)
    wander = np.cumsum(0.15 * rng.standard_normal(480))
    y = 20.0 + wander + 0.35 * np.cos(2.0 * np.pi * hours / 24.0 + 1.0) + 0.02 * rng.standard_normal(480)
    diagnosis = ssf.diagnose_table(pd.DataFrame({"t_h": hours, "T": y.round(3)}), "T ~ mean", time="t_h")
    (finding,) = diagnosis.findings
    assert finding.cause == "periodic-in-time"
    assert diagnosis.gain.extended > diagnosis.gain.baseline
    before, after = diagnosis.gain.given_before
    # Of a random walk the steps, and what a wave adds to them: 0.35 (2 pi / 24) / sqrt(2).
    assert 0.14 < after < 0.16
    assert before**2 - after**2 == pytest.approx(0.065**2, rel=0.4)
    text = " ".join(str(diagnosis).split())
    assert "predicts held-out rows no better" in text
    assert f"each given those before it: from {before:.3f} to {after:.3f}" in text


def test_an_extended_law_is_constant_beyond_the_rows_that_it_was_fitted_to():
    """A polynomial that goes on beyond them is off by far more than the effect in the one row out there."""
    z = np.append(np.linspace(0.0, 1.0, 40), -3.0)
    frame = pd.DataFrame({"z": z, "y": np.sin(3.0 * z)})
    law = ssf.Law("y ~ c").bind_table(frame)
    law = ColumnDependence(column="z", low=-3.0, high=1.0, unit="").extend(law)
    values = np.linalg.lstsq(law.jacobian(frame, np.zeros(4))[:40], frame["y"][:40], rcond=None)[0]
    assert abs(law.predict(frame, values)[40]) > 10.0
    within = law.fitted_to(frame[:40]).predict(frame, values)
    np.testing.assert_allclose(within[:40], law.predict(frame, values)[:40])
    assert within[40] == within[0]


@pytest.mark.slow
def test_a_row_far_out_in_a_column_withdraws_nothing():
    """Held out, it is predicted by what the others show, in the interval of the gain, too."""
    rng = np.random.default_rng(4)
    frame = pd.DataFrame({"x": rng.uniform(0.0, 10.0, 150), "z": rng.uniform(0.0, 1.0, 150)})
    frame.loc[20, "z"] = -3.0
    effect = np.tanh(6.0 * (frame["z"] - 0.5))
    frame["y"] = 2.0 + 0.3 * frame["x"] + effect + 0.3 * rng.standard_normal(150)
    diagnosis = ssf.diagnose_table(frame, "y ~ a + b*x")
    assert [one.cause for one in diagnosis.findings] == ["covariate:z"]
    assert diagnosis.gain.low > 0


@pytest.mark.slow
def test_rows_that_few_parameters_explain_end_the_search():
    """Yearly calls in Belgium, 1950 to 1973, some of them counted in minutes (Rousseeuw and Leroy 1987)."""
    calls = [0.44, 0.47, 0.47, 0.59, 0.66, 0.73, 0.81, 0.88, 1.06, 1.2, 1.35, 1.49, 1.61, 2.12, 11.9, 12.4]
    calls += [14.2, 15.9, 18.2, 21.2, 4.3, 2.4, 2.7, 2.9]
    frame = pd.DataFrame({"year": 1950.0 + np.arange(24), "calls": calls})
    law = ssf.Law("calls ~ a + b*year", units={"year": "years"})
    assert ssf.diagnose_table(frame, law, time="year", gain=False).findings


def test_folds_go_to_other_processes_whatever_was_computed_before(named):
    linearized = named.selection.problem.linearize()
    noise = np.random.default_rng(1).standard_normal(len(linearized))
    coloured = linearized.recolour(noise)  # by a factorization, which no process can be sent
    assert pickle.loads(pickle.dumps(linearized)).recolour(noise) == pytest.approx(coloured)
    assert not np.allclose(coloured, noise)
