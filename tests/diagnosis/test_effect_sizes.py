"""Sizes of a cause and of structure without a name beside it, each of what it alone changes."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.causes import Drift, library
from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.diagnosis import Finding, diagnose
from stickslip_fit.diagnosis.effect_interval import fit_beside, linearize_unweighted
from stickslip_fit.diagnosis.effect_size import order_findings, size_findings
from stickslip_fit.diagnosis.hypotheses import compute_changes
from stickslip_fit.units import Interval
from tests.hidden.generate import hide
from tests.hidden.reading import drop_lab_columns, read_hidden
from tests.hidden.study import Case, make

WARM_UP, HIDDEN = "thermal-warm-up", "unknown:product"
RIVALS = ("drift", "wear", "session-jump")


def test_the_largest_stands_first_and_last_what_all_others_leave():
    found = (
        ("unknown", None, 0.9),
        ("drift", Drift(), 0.1),
        ("end-stop-misfire", None, 0.2),
        ("unknown", SmoothTerm(("load",)), 0.3),
    )
    findings = [
        Finding(cause, version, (), 0.001, (3,), Interval(size, 0.0, 1.0), ())
        for cause, version, size in found
    ]
    assert [one.effect.estimate for one in order_findings(findings)] == [0.3, 0.2, 0.1, 0.9]


def hide_both(strengths):
    forms = {WARM_UP: "table", HIDDEN: "load and hours"}
    hidden = hide("session", (WARM_UP, HIDDEN), strengths, seed=0, forms=forms)
    return replace(hidden, table=drop_lab_columns(hidden.table))


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((12.0, 25.0), id="structure first"),
        pytest.param((25.0, 12.0), id="cause first", marks=pytest.mark.nightly),
    ],
)
def both(request):
    """What is hidden, and what the diagnosis finds among the cause and those most like it."""
    hidden = hide_both(request.param)
    causes = [one for one in library() if one.name in (WARM_UP, *RIVALS)]
    return hidden, diagnose(read_hidden(hidden), causes=causes, gain=False)


def sizes(findings):
    return {one.cause: one.effect for one in findings}


def truths(hidden):
    effects = hidden.truth["effects"]
    return {one["name"].split(":")[0]: one["effect_rms_pct"] / 100 for one in effects}


@pytest.mark.slow
def test_a_cause_and_structure_beside_it_have_their_own_sizes(both):
    hidden, found = both
    size, truth = sizes(found.findings), truths(hidden)
    assert size.keys() == truth.keys()
    for name, true in truth.items():
        assert size[name].low <= true <= size[name].high
        assert size[name].high - size[name].low < 0.6 * true


@pytest.mark.slow
def test_each_has_the_effect_that_it_has_in_the_law_with_the_other(both):
    _, found = both
    selection, changes = found.selection, {}
    for one, place in zip(selection.law_causes, selection.slices, strict=True):
        beside = linearize_unweighted(selection.problem, fit_beside(selection, one))
        changes[one.cause] = compute_changes(beside, one.version, selection.fit.values[None, place])[:, 0]
        for part, whole in zip(beside.parts, selection.fit.parts, strict=True):
            rows = selection.problem.rows.iloc[part.rows]
            change = whole.law.predict(rows, whole.values) - part.law.predict(rows, part.values)
            # To first order, if a smooth function.
            assert np.linalg.norm(changes[one.cause][part.rows] - change) <= 0.05 * np.linalg.norm(change)
    assert len(changes) == 2


@pytest.mark.slow
def test_what_the_choice_of_a_law_leaves_open_adds_to_errors_alone(both):
    """As a parameter of its own, a choice that nearly does what the structure does would stand for it."""
    hidden, found = both
    selection, truth = found.selection, truths(hidden)["unknown"]
    problem = selection.problem
    # With the residuals in it, data would ask for more of it than any choice has.
    open_changes = hidden.effect(HIDDEN) + 0.3 * selection.linearized.unwhiten(selection.linearized.residual)
    uncertain = tuple((part.rows, open_changes[part.rows, None]) for part in problem.parts)
    other = replace(selection, problem=replace(problem, uncertain=uncertain))
    before = sizes(size_findings(selection, problem, found.alpha))["unknown"]
    after = sizes(size_findings(other, other.problem, found.alpha))["unknown"]
    assert after.estimate == pytest.approx(before.estimate, rel=0.1)
    assert after.low <= truth <= after.high
    assert after.high - after.low > 1.2 * (before.high - before.low)


@pytest.mark.nightly
def test_a_spot_narrower_than_can_be_told_has_the_size_that_it_has():
    """Its width and depth are known as a product alone, and its effect is known all the same."""
    hidden = hide("many", ("worn-spot",), 12.0, seed=0)
    log = read_hidden(hidden, (3,))  # which has the spot
    (finding,) = diagnose(log, gain=False).findings
    (effect,) = hidden.truth["effects"]
    assert finding.cause == effect["cause"] == "worn-spot"
    size = effect["effect_rms_pct"] / 100 * (len(hidden.table) / len(log)) ** 0.5
    assert finding.effect.low < size < finding.effect.high < 1.5 * size
    truths = [
        one["value"] / scale for one, scale in zip(effect["parameters"], (100, 1000, 1000), strict=True)
    ]
    for found, true in zip(finding.parameters, truths, strict=True):  # %, mm and mm
        assert found.size.low < true < found.size.high


@pytest.mark.nightly
def test_counts_without_which_a_session_has_no_law():
    """Of four outlying counts of one direction of a session two have no prediction once all are out."""
    hidden = make(Case("single", "many", "t5", 25.0, 1000041))
    (found,) = diagnose(read_hidden(hidden), gain=False).findings
    (truth,) = hidden.truth["effects"]
    assert found.cause == truth["cause"] == "end-stop-misfire"
    assert found.traverses["departure"].isna().any()
    assert 100 * found.effect.low <= truth["effect_rms_pct"] <= 100 * found.effect.high
