"""Columns of many labels, and of integers that may be labels: beside statsmodels' mixed models."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles, generic_causes, prepare_rows
from stickslip_fit.causes.generic import ColumnDependence
from stickslip_fit.causes.levels import PooledLevels, find_levels
from stickslip_fit.diagnosis.table_gain import hold_out_kinds, number_time_blocks

LINE = "y ~ a + b*x"


def lots(seed, number, rows, spread, name=str):
    """A line in x, the rows of each lot one after the other, each lot with an offset of its own."""
    rng = np.random.default_rng(seed)
    lot, x = np.repeat(np.arange(1, number + 1), rows), rng.uniform(0.0, 10.0, number * rows)
    y = 2.0 + 0.5 * x + spread * rng.standard_normal(number)[lot - 1] + 0.3 * rng.standard_normal(len(lot))
    return pd.DataFrame({"x": x, "lot": list(map(name, lot)), "y": y})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "rows", "name", "seed"),
    [
        pytest.param(8, 9, int, 2, marks=pytest.mark.nightly),
        pytest.param(21, 3, "S{}".format, 1, marks=pytest.mark.nightly),
        (30, 2, "S{}".format, 5),
    ],
)
def test_pooled_offsets_are_those_of_a_mixed_model(number, rows, name, seed):
    frame = lots(seed, number, rows, 0.5, name)
    diagnosis = ssf.diagnose_table(frame, LINE)
    (finding,) = diagnosis.findings
    assert finding.cause == "covariate:lot"
    model = smf.mixedlm("y ~ x", frame, groups="lot").fit()
    expected = {f"d[{level}]": float(effect.iloc[0]) for level, effect in model.random_effects.items()}
    found = {one.name: one.size.estimate for one in finding.parameters}
    assert found == pytest.approx(expected, abs=0.03)
    left = model.scale / rows
    sd = np.sqrt(model.cov_re.iloc[0, 0] * left / (model.cov_re.iloc[0, 0] + left) * (1.0 - 1.0 / number))
    lengths = [one.size.high - one.size.low for one in finding.parameters]
    assert np.mean(lengths) == pytest.approx(2 * 1.96 * sd, rel=0.1)
    # As a mixed model predicts one more row of a known lot: its noise, and the error of the lot's offset.
    ideal = np.sqrt(model.scale * (1.0 + 1.0 / (rows - 1.0)))
    assert diagnosis.gain.extended == pytest.approx(ideal, rel=0.2)


def versions_found(make, seeds):
    found = [ssf.diagnose_table(make(seed), LINE, gain=False).findings for seed in seeds]
    return [type(own[0].version) if own else None for own in found]


@pytest.mark.slow
@pytest.mark.parametrize(("logs", "least"), [(2, 2), pytest.param(4, 3, marks=pytest.mark.nightly)])
def test_integers_are_labels_or_a_quantity_as_is_likelier(logs, least):
    def quantity(seed):
        frame = lots(seed, 8, 9, 0.0, int)
        return frame.assign(y=frame["y"] + 0.04 * (frame["lot"] - 4) ** 2)

    labels = versions_found(partial(lots, number=8, rows=9, spread=0.5, name=int), range(logs))
    assert sum(issubclass(one, PooledLevels) for one in labels) >= least
    assert versions_found(quantity, range(logs)).count(ColumnDependence) >= least


@pytest.mark.slow
@pytest.mark.parametrize(("logs", "least"), [(4, 4), pytest.param(8, 7, marks=pytest.mark.nightly)])
@pytest.mark.parametrize(("number", "name"), [(6, int), (20, str)])
def test_labels_that_do_nothing_are_not_named(number, name, logs, least):
    frames = (lots(seed, number, 60 // number, 0.0, name) for seed in range(logs))
    found = [ssf.diagnose_table(frame, LINE, gain=False) for frame in frames]
    assert [one.verdict for one in found].count("nothing wrong") >= least


def candidate(frame, law=LINE):
    rows = prepare_rows(frame, TableRoles(), ["x"])
    bound = ssf.Law(law).bind_table(rows)
    (cause,) = (one for one in generic_causes(rows, bound, TableRoles()) if one.name == "covariate:lot")
    return rows, cause


def log_evidence(frame, kind):
    misfit = ssf.diagnose_table(frame, LINE, gain=False).selection.first_misfit
    own = [one.cause == "covariate:lot" and type(one.version).__name__ == kind for one in misfit.hypotheses]
    (evidence,) = misfit.log_evidence[own]
    return float(evidence)


@pytest.mark.parametrize("kind", ["LevelDependence", "PooledParameters"])
def test_which_label_comes_first_does_not_matter(kind):
    frame = lots(3, 4, 12, 0.2, "S{}".format)
    assert log_evidence(frame[::-1], kind) == pytest.approx(log_evidence(frame, kind), abs=0.01)


@pytest.mark.parametrize("number", [3, 8])
def test_a_label_without_rows_is_expected_to_be_the_mean_of_all(number):
    frame = lots(1, number, 10, 0.5)
    rows, cause = candidate(frame)
    kept = frame["lot"] != "2"
    version, _ = cause.trials(rows[kept])[0]
    assert set(version.levels) == set(frame["lot"][kept])
    offsets = {level: float(k) for k, level in enumerate(version.levels)}
    of_all = np.arange(len(version.levels)) - (len(version.levels) - 1) / 2
    values = np.array([of_all[version.levels.index(level)] for level in version.named])
    values -= 0.0 if isinstance(version, PooledLevels) else of_all[0]
    term, _ = version.term(rows)(np.tile(values, (len(rows), 1)))
    left_out, known = term[~kept], term[kept]
    assert len(offsets) == number - 1
    assert left_out == pytest.approx(np.full(10, known.mean()))


def test_a_law_that_is_the_same_in_all_rows_has_no_other_parameters_than_offsets():
    rows, cause = candidate(lots(1, 6, 10, 0.5), "y ~ mean")
    assert [type(one).__name__ for one, _ in cause.trials(rows)] == ["PooledOffsets"]


@pytest.mark.parametrize(("number", "rows", "correlation_rows"), [(8, 12, 5.0), (30, 2, 1.0)])
def test_every_label_stays_in_training(number, rows, correlation_rows):
    frame = lots(2, number, rows, 0.5)
    selection = ssf.diagnose_table(frame, LINE, gain=False).selection
    labels = [frame["lot"].astype(int).to_numpy() - 1]
    kinds, _ = number_time_blocks(selection.problem.rows, correlation_rows, labels)
    folds = hold_out_kinds(selection, selection.problem.linearize(), kinds, labels)
    assert sum(len(fold.held_out) for fold in folds) > 0.8 * len(frame)
    for fold in folds:
        assert frame["lot"].iloc[fold.train].nunique() == number


# In each run test_gain.py holds out whole groups.
@pytest.mark.nightly
def test_labels_of_whole_groups_are_held_out_where_that_is_asked_for():
    rng = np.random.default_rng(1)
    day = np.repeat(np.arange(24), 5)
    operator = np.array([f"op {number}" for number in rng.permutation(np.arange(24) % 12)])[day]
    offset = dict(zip(np.unique(operator), rng.standard_normal(12), strict=True))
    y = np.array([offset[one] for one in operator]) + 0.2 * rng.standard_normal(120)
    frame = pd.DataFrame({"day": day, "operator": operator, "y": y})
    diagnosis = ssf.diagnose_table(frame, "y ~ mean", group="day")
    assert diagnosis.gain.held_out == "whole groups (day)"
    assert [one.cause for one in diagnosis.findings] == ["covariate:operator"]
    assert diagnosis.gain.extended < 0.6 * diagnosis.gain.baseline


def test_a_law_of_integer_labels_is_saved(tmp_path):
    frame = lots(2, 8, 9, 0.5, int)
    diagnosis = ssf.diagnose_table(frame, LINE, gain=False)
    offsets = {one.name: one.size.estimate for one in diagnosis.findings[0].parameters}
    lowest, highest = (pick(offsets, key=offsets.__getitem__)[2:-1] for pick in (min, max))
    assert f"from {lowest}, where it is lowest, to {highest}." in diagnosis.summary().headline[0]
    diagnosis.extended_law().save(tmp_path / "law.json")
    again = ssf.load_table_fit(tmp_path / "law.json")
    pd.testing.assert_frame_equal(
        diagnosis.extended_law().predict(frame), again.predict(frame.astype({"lot": float}))
    )
    with pytest.raises(ssf.InputError, match="column lot, value '9': row 1: the law was fitted to 1, 2, 3"):
        again.predict(frame.iloc[:1].assign(lot=9))


def test_labels_are_the_same_however_their_column_is_stored():
    for kind in (int, float, "Int64", str):
        assert find_levels(pd.Series([3, 1, 3]).astype(kind)) == ("3", "1")
