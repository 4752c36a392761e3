"""The traverses that are proposed do decide, and none is proposed where none would."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import binom

from stickslip_fit.causes import Drift, library
from stickslip_fit.diagnosis import diagnose, next_experiment
from stickslip_fit.diagnosis.candidate_traverses import forecast_candidates
from stickslip_fit.diagnosis.experiments import find_inseparable_pairs, suggest_traverses
from stickslip_fit.laws import expected_steps, observed_count
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

SESSIONS = 200
DAY_TO_DAY = 0.02
ALPHA = 0.05  # few null simulations do


@dataclass(frozen=True)
class Twin(Drift):
    """Drift under another name: no traverse tells the two apart."""

    name = "twin"


@cache
def log_of(design: str, effect: str, strength: float):
    return read_hidden(hide(design, (effect,), strength=strength, seed=4))


@cache
def diagnosis_of(design: str, effect: str, strength: float):
    """What is said of a log that hides an effect, when all but a few causes are out of the question."""
    known = [cause for cause in library() if cause.name in (effect, *RIVALS[effect])]
    return diagnose(
        log_of(design, effect, strength),
        causes=[*known, Twin()] if effect == "drift" else known,
        alpha=ALPHA,
        gain=False,
    )


RIVALS = {
    "drift": ("thermal-warm-up", "wear"),
    "side-load": ("load-nonlinearity",),
    "psi-offset": ("q2-offset",),
    "reversal-loss": ("end-stop-latency",),
}


def left_with(diagnosis, cause, rivals):
    """The diagnosis of a cause alone, with rivals that the log is said not to exclude."""
    (finding,) = (each for each in diagnosis.findings if each.cause == cause)
    return replace(diagnosis, findings=(replace(finding, equivalent=tuple(rivals)),))


def fit_with(diagnosis, cause, rival):
    """The law with a rival in place of the selected cause, by the problem's own refit."""
    (found,) = (each for each in diagnosis.selection.selected if each.cause == cause)
    shape = found.misfit.best_hypothesis(rival)
    start = np.array(shape.version.null_values) if shape.values is None else shape.values
    return diagnosis.selection.problem.fit_extended([shape.version], start)


def rows_of(choices, traverse):
    """The forecast that a proposed traverse stands in, and its row."""
    for each in choices:
        rows = each.traverses
        at = rows["note"].map(traverse.note.startswith) & (rows["joint"] == traverse.joint)
        at &= rows["direction"] == traverse.direction
        for name in ("q1", "q2", "q3", "theta", "psi", "start", "stop"):
            value = getattr(traverse, name)
            whole = np.isnan(value)
            span = (rows["stop"] - rows["start"]).abs()
            at &= (
                (span > span.max() * 0.999)
                if whole and name in ("start", "stop")
                else (rows[name].isna() if whole else np.isclose(rows[name], value))
            )
        if at.any():
            return each, rows[at].iloc[:1]
    raise AssertionError(traverse)


class Rival:
    """A session to come under one rival: k calibrating readings and one of the proposed traverse."""

    def __init__(self, fit, forecast, row) -> None:
        (self.law,) = (part.law for part in fit.parts if part.law.joint == forecast.law.joint)
        self.rows, self.own = (forecast.calibration, row), forecast.values
        self.sizes, self.covariance = fit.values, fit.covariance
        acting = self.law.parameters[len(self.own) :]
        self.bounds = [each.lower for each in acting], [each.upper for each in acting]
        self.middle = self.log_steps(self.own, self.sizes)
        by_own = self.slopes(self.own, lambda values: self.log_steps(values, self.sizes))
        by_sizes = self.slopes(self.sizes, lambda sizes: self.log_steps(self.own, sizes))
        left, singular, _ = np.linalg.svd(by_own)
        self.free = left[:, np.sum(singular > 1e-9 * singular[0]) :]
        self.doubt = self.free.T @ by_sizes @ self.covariance @ by_sizes.T @ self.free

    def log_steps(self, own, sizes):
        both = np.concatenate([own, sizes])
        return np.concatenate([self.law.predict(rows, both) for rows in self.rows])

    @staticmethod
    def slopes(values, f):
        steps = 1e-6 * np.maximum(np.abs(values), 1e-9)
        return np.stack(
            [(f(values + e) - f(values - e)) / (2 * s) for e, s in zip(np.diag(steps), steps, strict=True)],
            axis=1,
        )

    def misfit(self, readings, variance):
        """Chi-square of mean readings (k + 1,), the session's own parameters free, the cause's as known."""
        off = self.free.T @ (readings - self.middle)
        spread = self.free.T @ np.diag(variance) @ self.free + self.doubt
        return off @ np.linalg.solve(spread, off)

    def readings(self, repeats, repeatability, rng):
        """Mean readings of a session with step sizes of its own, its counts seen at the next look."""
        own = self.own * (1 + DAY_TO_DAY * rng.standard_normal())
        root = np.linalg.cholesky(self.covariance + 1e-30 * np.eye(len(self.sizes)))
        sizes = np.clip(self.sizes + root @ rng.standard_normal(len(self.sizes)), *self.bounds)
        expected = self.log_steps(own, sizes)
        counts = np.exp(expected + repeatability * rng.standard_normal((repeats, len(expected))))
        return np.mean(np.log(expected_steps(observed_count(counts, 5), 5)), axis=0)


CASES = [
    ("session", "drift", 12.0, "wear"),
    pytest.param("session", "side-load", 10.0, "load-nonlinearity", marks=pytest.mark.nightly),
    pytest.param("thesis", "psi-offset", 10.0, "q2-offset", marks=pytest.mark.nightly),
    pytest.param("many", "reversal-loss", 8.0, "end-stop-latency", marks=pytest.mark.nightly),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("design", "effect", "strength", "rival"), CASES)
def test_what_is_proposed_decides_between_the_two_in_nineteen_of_twenty_sessions(
    design, effect, strength, rival
):
    diagnosis = diagnosis_of(design, effect, strength)
    problem = diagnosis.selection.problem
    choices = forecast_candidates(problem, log_of(design, effect, strength).machine)
    (traverse,) = next_experiment(left_with(diagnosis, effect, [rival]))
    assert set(traverse.tells_apart) == {effect, rival}
    forecast, row = rows_of(choices, traverse)
    rivals = [Rival(fit_with(diagnosis, effect, each), forecast, row) for each in (effect, rival)]
    drive = problem.noise_group[
        (problem.rows["joint"] == traverse.joint) & (problem.rows["direction"] == traverse.direction)
    ]
    repeatability = problem.repeatability[drive[0]]
    rng = np.random.default_rng(7)
    variance = np.full(len(rivals[0].middle), repeatability**2 / traverse.repeats)
    wrong = 0
    for truth, other in (rivals, rivals[::-1]):
        for _ in range(SESSIONS):
            readings = truth.readings(traverse.repeats, repeatability, rng)
            wrong += other.misfit(readings, variance) < truth.misfit(readings, variance)
    assert wrong <= binom.ppf(0.999, 2 * SESSIONS, 0.05)


@pytest.mark.nightly
def test_no_more_readings_are_asked_for_than_it_takes():
    diagnosis = diagnosis_of("session", "side-load", 10.0)
    choices = forecast_candidates(diagnosis.selection.problem, log_of("session", "side-load", 10.0).machine)
    (traverse,) = next_experiment(left_with(diagnosis, "side-load", ["load-nonlinearity"]))
    forecast, row = rows_of(choices, traverse)
    one, other = (
        Rival(fit_with(diagnosis, "side-load", each), forecast, row)
        for each in ("side-load", "load-nonlinearity")
    )
    # The distance of the two, along all that the session's own parameters leave, in standard deviations.
    apart = one.free.T @ (one.middle - other.middle)
    problem = diagnosis.selection.problem
    drive = problem.noise_group[
        (problem.rows["joint"] == traverse.joint) & (problem.rows["direction"] == traverse.direction)
    ]
    noise = problem.repeatability[drive[0]] ** 2

    def confused(readings: int) -> float:
        spreads = [np.sqrt((noise / readings + each.doubt).squeeze()) for each in (one, other)]
        return float(np.abs(apart.squeeze()) / sum(spreads))

    assert traverse.repeats > 1
    assert confused(traverse.repeats) >= 1.64
    assert confused(traverse.repeats - 1) < 1.66


@pytest.mark.nightly
def test_drift_warm_up_and_wear_are_told_apart_by_a_later_traverse():
    diagnosis = diagnosis_of("session", "drift", 12.0)
    doubtful = left_with(diagnosis, "drift", RIVALS["drift"])
    traverses = next_experiment(doubtful)
    assert traverses
    assert all("h after the calibration" in each.note for each in traverses)
    assert find_inseparable_pairs(doubtful.findings, traverses) == ()


@pytest.mark.slow
def test_nothing_is_proposed_where_nothing_is_left_to_tell_apart():
    diagnosis = diagnosis_of("session", "drift", 12.0)
    sure = left_with(diagnosis, "drift", [])
    assert next_experiment(sure) == ()
    assert find_inseparable_pairs(sure.findings, ()) == ()


@pytest.mark.slow
def test_two_names_for_one_thing_are_out_of_reach_of_every_traverse():
    diagnosis = diagnosis_of("session", "drift", 12.0)
    doubtful = left_with(diagnosis, "drift", ["twin", "wear"])
    traverses = next_experiment(doubtful)
    assert all({"drift", "twin"} - set(each.tells_apart) for each in traverses)
    assert find_inseparable_pairs(doubtful.findings, traverses) == (("drift", "twin"),)


@pytest.mark.slow
def test_the_history_of_what_is_proposed_is_that_of_a_session_with_its_calibration():
    log = log_of("session", "drift", 12.0)
    for each in forecast_candidates(diagnosis_of("session", "drift", 12.0).selection.problem, log.machine):
        begun, rows = each.calibration, each.traverses
        driven = log.rows.loc[log.rows["joint"] == each.law.joint, "steps"].sum()
        assert (begun["steps_before"] >= driven - 1).all()
        assert (begun["session_seconds"].diff().dropna() > begun["seconds"].iloc[0]).all()
        after = rows[rows["session_seconds"] > 0]
        assert after.empty or after["steps_before"].min() >= begun["steps_before"].max()
        first = rows[rows["session_seconds"] == 0]
        assert (first["before_direction"] == "").all()
        assert (first["before_load"] == 0).all()
        rest = after[after["note"].str.contains("at rest")]
        busy = after[after["note"].str.contains("to and fro")]
        assert (rest["steps_before"] < after["steps_before"].max()).all()
        # Driven all the while, a joint makes the steps that traverses, each with its pause, have time for.
        pace = rest["steps"].to_numpy() / rest["seconds"].to_numpy()
        hours = (rest["session_seconds"] - after["session_seconds"].min()).to_numpy()
        more = busy["steps_before"].to_numpy() - rest["steps_before"].to_numpy()
        np.testing.assert_allclose(more, hours * pace, rtol=1e-9)


@pytest.fixture(scope="module")
def whole_guide():
    """A log that never sets q1 and runs the whole guide in every traverse of joint 3."""
    log = log_of("session", "side-load", 10.0)
    diagnosis = diagnose(log.select(log.rows["joint"] == 3), causes=library(), alpha=ALPHA, gain=False)
    return diagnosis, suggest_traverses(diagnosis, library())


@pytest.mark.slow
def test_what_makes_a_cause_testable_has_what_the_log_lacked(whole_guide):
    diagnosis, missed = whole_guide
    by_cause = {each.cause: each for each in missed}
    assert {"q1-gravity", "worn-spot", "guide-gradient", "humidity"} <= set(diagnosis.untestable)
    assert set(by_cause) == set(diagnosis.untestable)
    assert by_cause["q1-gravity"].traverse.q1 == pytest.approx(np.pi / 2)
    assert by_cause["worn-spot"].traverse.joint == 3
    assert np.isfinite(by_cause["worn-spot"].traverse.start)
    assert np.isfinite(by_cause["guide-gradient"].traverse.start)


@pytest.mark.slow
def test_a_column_that_nobody_wrote_down_takes_more_than_a_traverse(whole_guide):
    (humidity,) = (each for each in whole_guide[1] if each.cause == "humidity")
    assert humidity.traverse is None
    assert "humid" in humidity.shows_best


@pytest.mark.slow
def test_what_takes_least_time_comes_first(whole_guide):
    seconds = [each.seconds for each in whole_guide[1]]
    assert seconds == sorted(seconds)
