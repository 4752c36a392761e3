"""Noise that is not as assumed is called what it is, and no physical cause is blamed for it."""

import pytest

from benchmarks.noise_types import GROSS, NO_CAUSE, TYPES, coverage, findings, make
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis.gross_errors import find_gross_errors
from stickslip_fit.diagnosis.problem import problem_from_log
from tests.hidden.noise import KINDS
from tests.hidden.reading import read_hidden

LEVEL = 2.5e-4
EXPECTED = {  # findings and noise properties
    "memory": (("unknown",), ("memory",)),
    "skewed": ((), ("skewed",)),
    "rounded": ((), ("rounded",)),
    "sessions": ((), ("uneven",)),
    "configurations": ((), ("uneven",)),
    "places": ((), ("uneven",)),
    GROSS: (("end-stop-misfire",), ("gross errors",)),
}


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("skewed", 3),
        ("rounded", 0),
        pytest.param("configurations", 5072, marks=pytest.mark.nightly),
        pytest.param("places", 5105, marks=pytest.mark.nightly),
        pytest.param(GROSS, 0, marks=pytest.mark.nightly),
    ],
)
def test_noise_is_called_what_it_is(kind, seed):
    """In the third, noisy configurations look like a structure of the configurations at first."""
    assert findings(kind, seed) == EXPECTED[kind]


@pytest.mark.slow
def test_memory_that_a_function_of_time_describes_as_well_is_told_as_either():
    found = diagnose(read_hidden(make("memory", 7700007)), seed=7700007, gain=False)
    (finding,) = found.findings
    assert (finding.cause, finding.carrier, found.noise_properties) == ("unknown", "time", ("memory",))
    assert "Noise with memory from traverse to traverse would look much the same" in " ".join(
        str(found).split()
    )


@pytest.mark.nightly
def test_noise_of_one_session_is_called_so_and_the_text_names_the_session():
    hidden = make("sessions", 5)
    noisy = (
        hidden.campaign.plan.session == hidden.campaign.plan.session[hidden.campaign.repeatability.argmax()]
    )
    (name,) = hidden.table["session"][noisy].unique()
    found = diagnose(read_hidden(hidden, (2, 3)), seed=5, gain=False)
    causes = tuple(finding.cause for finding in found.findings)
    assert (causes, found.noise_properties) == EXPECTED["sessions"]
    assert f" times as large in session {name} as in others" in str(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("skewed", 2),
        pytest.param("skewed", 5, marks=pytest.mark.nightly),
        pytest.param("sessions", 3, marks=pytest.mark.nightly),
        ("sessions", 5),
    ],
)
def test_large_noise_in_small_sessions_is_no_gross_error(kind, seed):
    """A robust fit runs through most rows of a session with few, and far from the others."""
    problem, _ = problem_from_log(read_hidden(make(kind, seed)), ())
    assert not len(find_gross_errors(problem, LEVEL).rows)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", TYPES)
def test_noise_is_blamed_on_no_cause(kind):
    answers = [findings(kind, seed) for seed in range(1000, 1200)]
    physical = sum(bool(set(causes) - NO_CAUSE) for causes, _ in answers)
    right = sum(causes == EXPECTED.get(kind, ((), ()))[0] for causes, _ in answers)
    assert physical <= 0.02 * len(answers), answers
    assert right >= 0.9 * len(answers), answers


@pytest.mark.nightly
@pytest.mark.parametrize("kind", KINDS)
def test_noise_as_assumed_has_no_property(kind):
    answers = [findings(kind, seed) for seed in range(2000, 2200)]
    assert sum(bool(properties) for _, properties in answers) <= 0.02 * len(answers), answers


@pytest.mark.nightly
@pytest.mark.parametrize("kind", TYPES)
def test_the_size_of_an_effect_is_known_whatever_the_noise(kind):
    scores = [coverage(kind, seed, "thermal-warm-up", 12.0) for seed in range(3000, 3100)]
    inside = [one for _, one in scores if one is not None]
    assert sum(inside) >= 0.88 * len(inside)
