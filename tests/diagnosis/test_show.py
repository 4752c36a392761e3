"""Residuals against what varied: unbiased means, an envelope that holds, the right carrier."""

import numpy as np
import pytest

from stickslip_fit.diagnosis.residuals import (
    bin_residuals,
    bin_values,
    compare_residuals,
    compute_shape,
    explained_share,
    find_carrier,
)
from stickslip_fit.machine import load_machine
from stickslip_fit.plotting.residuals import SESSION_HOURS, collect_covariates, concatenate_sessions
from tests.diagnosis.conftest import hours_in


@pytest.fixture(scope="module")
def left(named):
    return compare_residuals(named.selection, named.seed)


def test_values_that_come_again_are_classes_of_their_own():
    values = np.array([0.0, -90.0, 0.0, 45.0, np.nan])
    assert list(bin_values(values)) == [1, 0, 1, 2, -1]


def test_no_class_straddles_a_gap_much_wider_than_itself():
    values = np.r_[np.linspace(0, 1, 31), np.linspace(9, 10, 50)]
    place = bin_values(values)
    assert not set(place[values < 5]) & set(place[values > 5])
    assert np.bincount(place).min() >= 5


def test_means_are_those_of_pandas(left):
    values = left.rows["q2"].to_numpy(float)
    subset = (left.rows["joint"] == 3).to_numpy()
    found = bin_residuals(left.before, left.null_before, values, bin_values(values), subset)
    by_hand = left.rows.assign(residual=left.before)[subset].groupby("q2")["residual"].mean()
    assert found.centre == pytest.approx(by_hand.index.to_numpy())
    assert found.mean == pytest.approx(by_hand.to_numpy())


def test_before_shows_the_drift_and_after_does_not(left, drifting):
    hours = left.rows["session_seconds"].to_numpy(float) / 3600.0
    subset = (left.rows["joint"] == 3).to_numpy()
    before = bin_residuals(left.before, left.null_before, hours, bin_values(hours), subset)
    after = bin_residuals(left.after, left.null_after, hours, bin_values(hours), subset)
    assert np.polyfit(before.centre, before.mean, 1)[0] == pytest.approx(0.003, rel=0.2)
    assert np.any(np.abs(before.mean) > before.envelope)
    assert np.all(np.abs(after.mean) < after.envelope)


def test_the_envelope_holds_all_means_of_95_logs_in_100(left):
    rng = np.random.default_rng(4)
    values = rng.integers(0, 8, len(left.rows)).astype(float)
    place, everything = bin_values(values), np.ones(len(values), dtype=bool)
    logs = left.null_before.shape[1]
    inside = 0
    for k in range(logs):
        found = bin_residuals(left.null_before[:, k], left.null_before, values, place, everything)
        inside += bool(np.all(np.abs(found.mean) <= found.envelope))
    assert inside / logs == pytest.approx(0.95, abs=0.02)


def test_the_error_is_that_of_a_mean_of_noise(nothing):
    """The variance of a sum of independent signs, recalibrated, in closed form."""
    linearized, quiet = nothing.selection.linearized, compare_residuals(nothing.selection, 0)
    values = np.random.default_rng(6).integers(0, 4, len(linearized)).astype(float)
    found = bin_residuals(
        quiet.after, quiet.null_after, values, bin_values(values), np.ones(len(values), dtype=bool)
    )
    mean_of = (values == np.arange(4.0)[:, None]) / np.bincount(values.astype(int))[:, None]
    raw = linearized.residual / np.sqrt(1.0 - linearized.leverage)
    expected = np.sqrt(
        np.sum((linearized.project((mean_of * linearized.scale).T) * raw[:, None]) ** 2, axis=0)
    )
    assert found.error == pytest.approx(expected, rel=0.15)


def test_a_drift_is_carried_by_the_hours_in_the_session(named, left):
    shape = compute_shape(named.selection.selected[0], named.selection.problem.linearize())
    columns = collect_covariates(left.rows, load_machine())
    groups = left.rows["joint"].to_numpy()
    assert find_carrier(shape, columns, groups) == SESSION_HOURS
    assert (
        explained_share(shape, columns[SESSION_HOURS], groups)
        > 0.8
        > 0.5
        > explained_share(shape, columns["theta (°)"], groups)
    )


def test_noise_explains_nothing_however_many_classes():
    rng = np.random.default_rng(1)
    shares = [
        explained_share(rng.normal(size=300), rng.normal(size=300), np.zeros(300, dtype=int))
        for _ in range(50)
    ]
    assert np.mean(shares) < 0.03


def test_sessions_in_a_row_do_not_overlap(table, drifting):
    rows = drifting.usable
    hours = concatenate_sessions(rows)
    first = (rows["session"] == "2012-03-05").to_numpy()
    assert hours[first].max() < hours[~first].min()
    assert np.sort(hours[first]) == pytest.approx(np.sort(hours_in(table)[: first.sum()]))


def test_a_quantity_that_does_not_vary_has_no_axis(left):
    labels = set(collect_covariates(left.rows, load_machine()))
    assert {"load along the axis", "q2 (°)", "q3 (mm)", "theta (°)"} <= labels
    assert not {"psi (°)", "q1 (°)", "temperature (°C)"} & labels
