"""Hypotheses as subspaces, beside a cause in the laws."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import library
from stickslip_fit.diagnosis.alternatives import build_unstructured_alternatives
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.evidence import STRENGTHS, batch_hypotheses
from stickslip_fit.diagnosis.extension import (
    alternative_forms,
    compute_evidence,
    extend_problem,
    make_selected,
)
from stickslip_fit.diagnosis.hypotheses import Hypothesis
from stickslip_fit.diagnosis.misfit import (
    UNKNOWN,
    UNKNOWN_WEIGHT,
    Misfit,
    average_by_cause,
    classify_cause,
    weigh_hypotheses,
)
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.session_stacks import StackedBlocks
from tests.hidden.generate import hide
from tests.hidden.reading import drop_lab_columns, read_hidden


def extend(hidden, name, joints=(1, 2, 3)):
    """The problem with one of its causes in the laws, and what that leaves."""
    problem, _ = problem_from_log(read_hidden(hidden, joints), None, None)
    misfit = compute_evidence(problem.linearize(), problem)
    extension = extend_problem(problem, [make_selected(misfit, form_cause_set(misfit, name))])
    extended, linearized = extension.problem, extension.linearized
    return extended, linearized


@pytest.mark.slow
def test_functions_of_each_session_explain_no_more_than_there_is():
    """Also beside a cause that the sessions share, and its other forms."""
    extended, linearized = extend(hide("thesis", ("inertia-quadratic",), 12.0, seed=1), "inertia-quadratic")
    functions = [one for one in extended.alternatives(linearized) if getattr(one.version, "sessions", ())]
    assert {"unknown:time", "unknown:q2, joint 3, in each session"} <= {one.cause for one in functions}
    for one in functions:
        residual = linearized.project(one.directions)
        explained = np.array([np.sum(one.coefficients(column) ** 2) for column in residual.T])
        assert np.all(explained <= np.sum(residual**2, axis=0) * (1 + 1e-9))


@pytest.mark.slow
def test_a_wave_is_described_by_its_slower_period_where_traverses_go_to_and_fro():
    """Of the thesis' plan; where directions come in no order, all periods down to two traverses differ."""
    for design, fastest in (("thesis", 4.0), ("session", 2.0)):
        linearized = problem_from_log(read_hidden(hide(design, seed=4)))[0].linearize()
        waves = {
            one.cause: one
            for one in build_unstructured_alternatives(linearized)
            if re.match(r"unknown:period of .* traverses", one.cause)
        }
        assert min(one.version.period for one in waves.values()) == pytest.approx(fastest, rel=0.02)
        if design == "thesis":
            phase = 2 * np.pi * linearized.rows["session_order"].to_numpy(float) * 0.46
            wave = linearized.project((np.cos(phase) / linearized.scale)[:, None])[:, 0]
            explained = {name: np.sum(one.coefficients(wave) ** 2) for name, one in waves.items()}
            likeliest = waves[max(explained, key=explained.__getitem__)].version
            assert likeliest.mode == "opposite"
            assert likeliest.period == pytest.approx(1 / 0.04, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    "design", ["session", *(pytest.param(one, marks=pytest.mark.nightly) for one in ("thesis", "many"))]
)
def test_directions_have_length_1_and_none_is_of_the_calibration(design):
    """Of jumps and functions of sessions, too, beside a cause in the laws, which acts in all sessions."""
    extended, linearized = extend(hide(design, ("side-load",), 12.0, seed=2), "side-load")
    candidates = compute_evidence(linearized, extended, ["side-load"]).hypotheses
    shapes = [one for one in candidates if isinstance(one, Hypothesis)]
    assert any(one.shared is not None for one in shapes)
    for one in shapes[::7]:
        products = one.directions.T @ one.directions
        assert np.diag(products) == pytest.approx(1.0, abs=1e-6), one.cause
        assert np.abs(linearized.basis.T @ one.directions).max() < 1e-6, one.cause
        if len(one.blocks) == 1:
            assert np.abs(products - np.eye(len(products))).max() < 1e-6, one.cause


@pytest.mark.slow
@pytest.mark.parametrize("part", [1, 7])
@pytest.mark.parametrize("shared", ["nothing", "a slope", "a slope forwards"])
def test_the_evidence_of_many_waves_at_once_is_that_of_each(part, shared):
    """Alike and opposite by direction, of each session; all of them, and a few of each stack.

    Also of sessions that share a parameter, to which all directions have to be orthogonal; one of a single
    direction leaves those of opposite sign as large as they are.
    """
    rng = np.random.default_rng(0)
    problem = problem_from_log(read_hidden(hide("many" if shared == "nothing" else "thesis", seed=3)))[0]
    linearized = problem.linearize()
    if shared != "nothing":
        slope = rng.standard_normal((len(linearized), 1))
        slope[linearized.direction_sign < 0] *= shared == "a slope"
        linearized = linearized.absorb(slope)
    every = [one for one in problem.alternatives(linearized) if isinstance(one, Hypothesis)]
    waves = [one for one in every if isinstance(one.blocks, StackedBlocks)][::part]
    assert {one.sign is None for one in waves} == ({True} if shared == "a slope" else {True, False})
    if shared == "nothing":
        assert max(len(one.blocks) for one in waves) > 2
    else:
        assert all(one.blocks.stack.coupling is not None for one in waves)
        for one in waves[::20]:
            assert np.abs(linearized.shared.T @ one.directions).max() < 1e-9
            assert one.directions.T @ one.directions == pytest.approx(np.eye(len(one.prior_share)), abs=1e-6)
    residuals = linearized.project(rng.standard_normal((len(linearized), 3)))
    batch, weight = batch_hypotheses(waves, linearized.df), rng.standard_normal(len(waves))
    evidence = batch.log_evidence(residuals)
    alone = [
        find_evidence(one.apply_sign().directions, one.prior_share, residuals, linearized.df) for one in waves
    ]
    np.testing.assert_allclose(evidence, alone, rtol=1e-9, atol=1e-9)
    together = np.logaddexp.reduce(np.array(alone) + weight[:, None])
    np.testing.assert_allclose(batch.log_mean_evidence(residuals, weight), together, atol=1e-3)


def find_evidence(directions, share, residuals, df):
    """Zellner's Bayes factor, averaged over strengths."""
    along, squares = directions.T @ residuals, np.sum(residuals**2, axis=0)
    signal = np.square(STRENGTHS)[:, None] * share
    left = 1 - (signal / (1 + signal)) @ along**2 / squares
    log = -0.5 * df * np.log(left) - 0.5 * np.log1p(signal).sum(axis=1)[:, None]
    return np.logaddexp.reduce(log) - np.log(len(STRENGTHS))


@pytest.mark.slow
def test_a_jump_in_one_session_is_no_uneven_noise():
    hidden = hide("many", ("psi-offset", "session-jump"), 14.0, "t5", seed=15)
    bare = replace(hidden, table=drop_lab_columns(hidden.table))
    extended, _ = extend(bare, "psi-offset", (2, 3))
    assert extended.uneven == ()


@pytest.mark.parametrize(("alike", "number"), [(1, 50.0), (25, 2.0), (50, 1.0)])
@pytest.mark.parametrize("name", ["unknown:theta", "drift"])
def test_the_alarm_is_averaged_over_shapes_but_not_over_those_as_likely_as_the_best(name, alike, number):
    shapes = [Hypothesis(name, None, None, 2, (), np.ones(1), 1.0)] * 50
    evidence, causes = np.r_[np.full(alike, 30.0), np.zeros(50 - alike)], [*map(classify_cause, shapes)]
    by_cause = average_by_cause(causes, weigh_hypotheses(shapes, causes), evidence)
    misfit = Misfit(np.zeros(2), tuple(shapes), evidence, by_cause, 0.001, np.zeros(0))
    cause = UNKNOWN if name.startswith(UNKNOWN) else name
    # What has no name counts in the statistic as several causes do.
    expected = max(number / UNKNOWN_WEIGHT, 1.0) if cause == UNKNOWN else number
    assert misfit.n_shapes(cause) == pytest.approx(expected)


def test_each_carrier_counts_alike_and_all_products_together_a_quarter():
    names = [
        *["theta"] * 3,
        *["q2, joint 3"] * 5,
        *["product of q2 and theta"] * 40,
        *["period of 9.0 min"] * 90,
    ]
    names = [f"unknown:{name}" for name in names]
    shapes = [Hypothesis(name, None, None, 2, (), np.ones(1), 1.0) for name in (*names, "drift", "drift")]
    weight = np.exp(weigh_hypotheses(shapes, [classify_cause(one) for one in shapes]))
    shares = pd.Series(weight).groupby([one.cause.split(" ")[0] for one in shapes]).sum()
    expected = {"theta": 0.3125, "q2,": 0.3125, "product": 0.25, "period": 0.125}
    assert shares.to_dict() == pytest.approx(
        {f"unknown:{k}": v for k, v in expected.items()} | {"drift": 1.0}
    )


def test_which_forms_of_a_cause_count_as_known_is_no_matter_of_rounding():
    """Six of a drift's eleven are alike in importance, and only some of them are among the first eight."""
    rng, causes = np.random.default_rng(1), [one for one in library() if one.name == "drift"]
    problem, _ = problem_from_log(read_hidden(hide("session", ("drift",), 20, seed=4)), causes)
    misfit = compute_evidence(problem.linearize(), problem)
    selected = make_selected(misfit, form_cause_set(misfit, "drift"))
    extension = extend_problem(problem, [selected])
    extended, fit = extension.problem, extension.fit
    plain = extended.linearize_extended(fit)

    def shake(shape):
        if shape.cause != "drift":
            return shape
        moved = ((rows, block + 1e-5 * rng.standard_normal(block.shape)) for rows, block in shape.blocks)
        return replace(shape, blocks=tuple(moved))

    shaken = replace(selected, misfit=replace(misfit, hypotheses=tuple(map(shake, misfit.hypotheses))))
    forms, others = alternative_forms(plain, selected), alternative_forms(plain, shaken)
    np.testing.assert_allclose(forms @ forms.T, others @ others.T, atol=0.01)
