"""A cause that is withdrawn for its gain: what it costs, and what is told of it."""

from collections import Counter
from dataclasses import replace

import pytest

from stickslip_fit.causes import library
from stickslip_fit.diagnosis import gain, withdrawal
from stickslip_fit.diagnosis._json import diagnosis_to_json
from stickslip_fit.diagnosis._summary import ranking_tables
from stickslip_fit.diagnosis.gain import hold_out_configurations
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.pipeline import diagnose_problem
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.plotting.diagnosis import plot_ranking
from stickslip_fit.reporting.diagnosis import diagnosis_section
from tests.diagnosis.conftest import waves
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

FEW = ("drift", "theta-offset", "q2-offset", "cable-torque", "end-stop-latency")


@pytest.fixture(scope="module")
def two():
    """A diagnosis of two causes, its gain not measured."""
    log = read_hidden(hide("session", ("drift", "end-stop-latency"), 20, seed=4))
    problem, missing = problem_from_log(log, [one for one in library() if one.name in FEW])
    found = diagnose_problem(replace(problem, alternatives=waves), missing, alpha=0.01)
    assert {one.cause for one in found.findings} == {"drift", "end-stop-latency"}
    return replace(found, log=log)


@pytest.fixture(scope="module")
def without_first(two):
    """The same with the gain, as if held-out traverses did not support the first cause; and all searches.

    Beside the two, structure without a name is as good as certain.
    """
    searched, first = Counter(), two.findings[0].cause
    supported, search, confirm = withdrawal.is_supported, gain.select_from_training, gain.confirm_selection

    def counted(function, place):
        def call(*arguments):
            found = function(*arguments)
            searched[arguments[place].train.tobytes()] += found is not None
            return found

        return call

    verdicts = iter([False])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gain, "select_from_training", counted(search, 1))
        patch.setattr(gain, "confirm_selection", counted(confirm, 1))
        patch.setattr(withdrawal, "is_supported", lambda one: next(verdicts, True) and supported(one))
        measured = replace(two, inclusion=two.inclusion | {UNKNOWN: 0.99}).measure_gain()
    assert [one.cause for one in measured.findings[-1].withdrawn] == [first]
    return measured, searched


@pytest.mark.slow
def test_no_search_is_repeated_for_a_cause_that_is_withdrawn(two, without_first):
    """Folds that hold out more, since fewer causes have to stay determined, are searched."""
    measured, searched = without_first
    splits = [*hold_out_configurations(two.selection), *hold_out_configurations(measured.selection)]
    assert set(searched.values()) == {1}
    assert set(searched) == {split.train.tobytes() for split in splits}
    assert len(searched) < len(splits)
    assert measured.gain.extended < measured.gain.baseline


@pytest.mark.nightly
def test_what_is_withdrawn_is_in_the_law_of_no_fold(two, without_first):
    """Here it does predict better, so that without it more is left."""
    both, (measured, _) = two.measure_gain().gain, without_first
    assert measured.gain.extended > 1.2 * both.extended
    assert measured.gain.extended < 0.9 * measured.gain.baseline


@pytest.mark.slow
def test_a_cause_that_is_withdrawn_is_told_as_such_wherever_causes_are_listed(two, without_first):
    cause, (measured, _) = two.findings[0].cause, without_first
    assert two.inclusion[cause] > 0.95
    assert measured.inclusion[cause] < 0.05
    assert measured.inclusion[UNKNOWN] > 0.95
    why = measured.withdrawn[cause]
    assert why.startswith("held-out traverses are predicted")
    (table,) = ranking_tables(measured)
    assert {row[0]: row[1] for row in table.rows}[cause] == "withdrawn"
    assert f"Withdrawn: {cause}, since {why}." in table.note
    assert diagnosis_to_json(measured)["withdrawn"] == [{"cause": cause, "reason": why}]
    assert measured.ranking.set_index("cause").loc[cause, "withdrawn"] == why
    assert any(line.get_marker() == "X" for axis in plot_ranking(measured).axes for line in axis.lines)
    assert "withdrawn" not in str(two)
    assert diagnosis_to_json(two)["withdrawn"] == []


@pytest.mark.slow
def test_structure_without_a_name_that_may_be_left_is_told_in_text_and_page(two):

    def may_be_left(probability, p_value):
        last = replace(two.selection.last_misfit, p_value=p_value)
        selection = replace(two.selection, last_misfit=last)
        return replace(two, selection=selection, inclusion=two.inclusion | {UNKNOWN: probability})

    half, unlikely, as_noise = may_be_left(0.5, 0.05), may_be_left(0.1, 0.05), may_be_left(0.5, 0.4)
    said = "there may be structure without a name, with a probability of"
    for answer in (" ".join(str(half).split()), " ".join(diagnosis_section(half).paragraphs)):
        assert said in answer
    assert diagnosis_to_json(half)["inclusion"][UNKNOWN] == 0.5
    for answer in (unlikely, as_noise):
        assert "there may be structure" not in " ".join(str(answer).split())
