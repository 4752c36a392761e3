"""Searching within the bounds of parameters, whatever sizes are tried, and whatever one trial does."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes import CauseParameter, FactorCause
from stickslip_fit.diagnosis import extension, hypotheses, refits
from stickslip_fit.diagnosis._json import diagnosis_to_json
from stickslip_fit.diagnosis.hypotheses import make_hypothesis
from tests.hidden.generate import hide
from tests.hidden.outside import OutsideCase, baseline, rms, true_form
from tests.hidden.reading import read_hidden

N, SD = 240, 0.05


def stribeck(size, seed=0):
    """Friction against velocity, with a bump of some size near zero velocity."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(0.01, 3.0, N)
    force = 1.0 + 0.4 * v + size * np.exp(-((v / 0.5) ** 2)) + SD * rng.standard_normal(N)
    return pd.DataFrame({"v": v, "F": force, "x": rng.standard_normal(N)})


def diagnose(frame, *causes, **options):
    return ssf.diagnose_table(frame, "F ~ F0 + Fv*v", causes=causes, gain=False, generic_causes=(), **options)


@pytest.mark.slow
def test_a_cause_that_cannot_be_as_large_as_what_it_would_explain_is_not_named():
    """Over whole turns a runout has next to no effect, whose slope is that of anything else."""
    case = OutsideCase(
        "unknown:state of set 2", "load over lorentzian of reach, joint 1", "session", "t5", 25.0, 950005
    )
    hidden, fresh = case.make(), case.make(replicate=1)
    found = ssf.diagnose(read_hidden(hidden), gain=False)
    assert [finding.cause for finding in found.findings] == ["unknown"]
    predicted = found.extended_law().predict(read_hidden(fresh).rows)["steps"]
    error = rms(fresh, np.log(predicted.to_numpy()))
    assert error < 1.1 * rms(fresh, true_form(hidden, fresh)) < 0.7 * rms(fresh, baseline(fresh))


def bump(**options):
    return ssf.Cause("stribeck", "+ Fs*exp(-(v/vs)**2)", "Fs, vs", **options)


BOUNDED = {"Fs": (0.0, 5.0), "vs": (0.1, 1.0)}


@pytest.mark.slow
def test_a_cause_whose_best_fit_is_outside_its_bounds_is_not_named():
    found = diagnose(stribeck(-0.3), bump(bounds=BOUNDED))
    assert "stribeck" not in [finding.cause for finding in found.findings]
    free = diagnose(stribeck(-0.3), bump(bounds={"vs": (0.1, 1.0)}))
    assert free.findings[0].cause == "stribeck"


def test_bounds_do_not_hide_what_lies_within_them():
    (finding,) = diagnose(stribeck(0.3), bump(bounds=BOUNDED)).findings
    size = finding.parameters[0].size
    assert finding.cause == "stribeck"
    assert size.low < 0.3 < size.high


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_the_size_that_is_tried_does_not_matter(factor):
    frame = stribeck(0.3)
    frame["F"] = frame["F"] - 0.3 * np.exp(-((frame["v"] / 0.5) ** 2)) + 0.4 * 0.3 * np.tanh(2 * frame["x"])
    causes = [
        ssf.Cause("linear", "+ k*x", "k", size=0.1 * factor),
        ssf.Cause("bent", "+ k*tanh(2*x)", "k", size=0.1 * factor),
    ]
    (finding,) = diagnose(frame, *causes).findings
    assert finding.cause == "bent"


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_shift_of_a_column_is_found_whatever_size_is_tried(factor):
    rng = np.random.default_rng(1)
    v = rng.uniform(0.01, 3.0, N)
    frame = pd.DataFrame({"v": v, "F": 1.0 + 3.0 * np.tanh(v + 0.4) + SD * rng.standard_normal(N)})
    shift = ssf.Cause("shift", "v = v + d", "d", size=0.4 * factor)
    found = ssf.diagnose_table(frame, "F ~ F0 + A*tanh(v)", causes=[shift], gain=False, generic_causes=())
    assert [finding.cause for finding in found.findings] == ["shift"]
    assert found.findings[0].parameters[0].size.low < 0.4 < found.findings[0].parameters[0].size.high


RIPPLE = "+ A*sin(2*pi*f*x)"


def rippled(f, n=300):
    """A straight line with a ripple of frequency f."""
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 10, n)
    y = 1 + 0.3 * x + 0.1 * np.sin(2 * np.pi * f * x) + 0.05 * rng.standard_normal(n)
    return pd.DataFrame({"x": x, "y": y})


def search_ripple(f, highest):
    cause = ssf.Cause("ripple", RIPPLE, "A, f", bounds={"f": (2.0, highest)})
    return ssf.diagnose_table(rippled(f), "y ~ a + b*x", causes=[cause], gain=False, generic_causes=())


@pytest.mark.slow
@pytest.mark.parametrize("f", [2.3, 3.1, 3.9])
def test_a_grid_is_as_fine_as_the_effect_asks_for(f):
    """With the 9 places that a grid begins with, none of these is found."""
    found = search_ripple(f, 4.0)
    assert [finding.cause for finding in found.findings] == ["ripple"]
    assert found.notes == ()


def test_a_cause_that_asks_for_more_trials_than_there_may_be_says_so():
    """What is looked for lies between two of the places, so that it would look absent."""
    found = search_ripple(4.3, 1000.0)
    assert found.findings == ()
    (note,) = found.notes
    assert "ripple has gaps" in note
    assert "narrower bounds" in note
    assert note in " ".join(found.summary().headline)
    assert diagnosis_to_json(found)["notes"] == [note]


class Root(FactorCause):
    """A factor that is no number for rows whose theta is below its second parameter."""

    name = "root"
    phrase = "a root"
    parameters = (CauseParameter("k", "%", "size"), CauseParameter("begin", "deg", "where it begins"))
    null_values = (0.0, 0.0)
    scale = (0.01, 1.0)
    trial_values = ((0.01, -2.0), (0.01, -0.5), (0.01, 0.5))

    def factor(self, state, values):
        with np.errstate(invalid="ignore"):
            return 1.0 + values[0] * np.sqrt(state.theta - values[1])


class NoRoot(Root):
    name = "no-root"
    trial_values = ((0.01, 0.5),)


@pytest.mark.slow
def test_trials_whose_effects_are_no_numbers_are_told(table, read_table):
    found = ssf.diagnose(read_table(table, "root.csv"), causes=[Root(), NoRoot()], gain=False)
    (note,) = found.notes
    assert note.startswith("2 of the 3 trials of root are left out")
    assert note in found.summary().headline
    assert "none of its trials" in found.untestable["no-root"]
    assert found.inclusion["no-root"] is None
    assert "root" not in found.untestable


def failing(*arguments, **options):
    """What numpy does with a matrix now and then, and with one that is no number always."""
    raise np.linalg.LinAlgError("Eigenvalues did not converge")


def test_eigenvalues_that_do_not_converge_drop_a_trial(monkeypatch):
    effects = np.random.default_rng(0).standard_normal((20, 3))
    assert make_hypothesis("cause", None, None, effects) is not None
    monkeypatch.setattr(np.linalg, "eigh", failing)
    assert make_hypothesis("cause", None, None, effects) is None


@pytest.mark.slow
def test_a_cause_whose_eigenvalues_do_not_converge_is_dropped_with_a_note(monkeypatch):
    bases = ssf.Cause("two", "+ a*sin(x) + b*cos(x)", "a, b")
    assert diagnose(stribeck(0.3), bases).untestable == {}
    real = hypotheses.make_hypothesis

    def failing_for_causes(cause, *arguments):
        with monkeypatch.context() as patch:
            if not cause.startswith("unknown"):
                patch.setattr(np.linalg, "eigh", failing)
            return real(cause, *arguments)

    monkeypatch.setattr(hypotheses, "make_hypothesis", failing_for_causes)
    assert "none of its trials" in diagnose(stribeck(0.3), bases).untestable["two"]


def test_a_cause_whose_fit_fails_is_dropped_with_a_note(monkeypatch):
    monkeypatch.setattr(refits, "fit_trial", lambda *_: failing())
    found = diagnose(stribeck(0.3), bump(bounds=BOUNDED))
    assert "stribeck" not in [finding.cause for finding in found.findings]
    assert "could not be fitted" in found.untestable["stribeck"]


@pytest.mark.nightly
def test_laws_without_a_finite_fit_are_no_rivals(monkeypatch):
    """Whatever is tried beside or in place of what was found."""
    tried = []

    def failing_for_trials(problem, selected, _=None):
        tried.append([one.cause for one in selected])
        failing()

    monkeypatch.setattr(extension, "extend_problem", failing_for_trials)
    log = read_hidden(hide("session", ("cable-torque", "drift"), 14, seed=3), (2,))
    found = ssf.diagnose(log, gain=False)
    assert tried
    assert found.findings
