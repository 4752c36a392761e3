"""What a law lacks is told from noise that persists, under laws that lack nearly all of the response."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.signal import fftconvolve, lfilter
from scipy.stats import binom
from statsmodels.tsa.arima.model import ARIMA

import stickslip_fit as ssf
from stickslip_fit.diagnosis.autocorrelation import estimate_noise
from stickslip_fit.diagnosis.restricted_likelihood import RestrictedLikelihood
from stickslip_fit.diagnosis.table import problem_from_table
from stickslip_fit.diagnosis.time_or_columns import prefer_columns


def diagnose(y, t, law="y ~ c", **options):
    return ssf.diagnose_table(pd.DataFrame({"t": t, "y": y}), law, time="t", gain=False, **options)


def names(found):
    return [one.cause for one in found.findings]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("course", "cause"),
    [(lambda s: 3.0 * s, "drift"), (lambda s: 1.2 * -np.expm1(-5.0 * s), "warm-up")],
    ids=["drift", "warm-up"],
)
def test_a_short_record_shows_a_change_that_is_nearly_all_of_it(course, cause):
    """31 rows under a constant: the response's scatter is that of the effect."""
    t = np.linspace(0.0, 30.0, 31)
    y = course(t / 30.0) + 0.02 * np.random.default_rng(3).standard_normal(31)
    assert names(diagnose(y, t)) == [cause]


@pytest.mark.slow
def test_a_curve_beyond_a_line_is_no_noise_that_persists():
    """As regression says, a parabola of 15 times the noise; an autoregression of 50 rows follows it too."""
    t = np.linspace(0.0, 1.0, 50)
    y = 0.3 * (t - 0.5) ** 2 + 0.002 * np.random.default_rng(4).standard_normal(50)
    found = diagnose(y, t, "y ~ a + b*t")
    assert found.verdict != "nothing wrong"
    assert found.table.independent > 40
    assert found.repeatability == pytest.approx(0.002, rel=0.3)


# In each run a fast wave is found in slow noise, and a slow one at uneven times.
@pytest.mark.nightly
@pytest.mark.parametrize("cycles", [3, 5, 20])
def test_a_few_cycles_are_a_period(cycles):
    t = np.arange(200.0)
    y = np.sin(2 * np.pi * t * cycles / 200) + 0.1 * np.random.default_rng(cycles).standard_normal(200)
    found = diagnose(y, t)
    assert names(found) == ["periodic-in-time"]
    (one,) = found.selection.law_causes
    assert one.version.period == pytest.approx(200 / cycles, rel=0.01)


@pytest.mark.slow
def test_a_fast_wave_is_found_in_slow_noise():
    """An hour's wave in noise that wanders 20 times as far over weeks."""
    rng, t = np.random.default_rng(5), np.arange(400.0)
    wander = lfilter([1.0], [1.0, -0.99], 0.2 * rng.standard_normal(800))[400:]
    found = diagnose(wander + 0.3 * np.sin(2 * np.pi * t / 12.0), t)
    assert "periodic-in-time" in names(found)


def test_a_slow_period_is_found_at_uneven_times():
    """150 nights over 20 years, a wave of 3.2 years: between two of as many periods, spread over all."""
    rng = np.random.default_rng(6)
    t = np.sort(rng.uniform(0.0, 7300.0, 150))
    y = 5.0 * np.sin(2 * np.pi * t / 1170.0) + 3.0 * rng.standard_normal(150)
    found = diagnose(y, t)
    assert found.verdict == "unknown cause"
    assert found.findings[0].carrier.startswith("period of 1,")


@pytest.mark.nightly
def test_a_large_constant_changes_nothing():
    rng, t = np.random.default_rng(7), np.arange(60.0)
    y = 0.02 * t + 0.1 * rng.standard_normal(60)
    plain, shifted = diagnose(y, t), diagnose(y + 1e8, t)
    assert names(plain) == names(shifted) != []
    assert shifted.repeatability == pytest.approx(plain.repeatability, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("carried", "number"),
    [(0.95, 2), *(pytest.param(one, 8, marks=pytest.mark.nightly) for one in (0.95, 1.0))],
)
def test_noise_that_persists_is_no_structure(carried, number):
    """Walks of 60 to 240 rows: none of a few is an alarm, of which 1 % may be."""
    alarms = 0
    for seed in range(number):
        rng = np.random.default_rng(100 + seed)
        n = int(rng.integers(60, 240))
        y = lfilter([1.0], [1.0, -carried], rng.standard_normal(n + 300))[-n:]
        alarms += bool(names(diagnose(y - y.mean(), np.arange(n), seed=seed)))
    assert alarms == 0


def flicker(rng, n):
    """Noise of spectral density 1 / f, the sum of white noise that fades as a power of time."""
    k = np.arange(1, 4000)
    return fftconvolve(rng.standard_normal(n + 4000), np.cumprod(np.append(1.0, (k - 0.55) / k)))[
        4000 : n + 4000
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "rate"),
    [
        ((309,), 0.0),
        pytest.param((321, 323), 0.0, marks=pytest.mark.nightly),
        pytest.param(range(400, 500), 0.15, marks=pytest.mark.nightly),
    ],
)
def test_noise_that_flickers_is_no_sudden_change(seeds, rate):
    """Low orders of autoregression leave what wanders: with these alone each of the three was an alarm."""
    alarms = sum(
        bool(names(diagnose(flicker(np.random.default_rng(seed), 120), np.arange(120.0)))) for seed in seeds
    )
    assert alarms <= binom.ppf(0.99, len(seeds), rate)


def test_noise_that_wanders_beneath_white_noise_is_estimated_as_by_arma():
    """Beside the exact likelihood of statsmodels, whose autoregression goes on for ever."""
    t = np.arange(1500.0)
    wander = lfilter([1.0, -0.7], [1.0, -0.97], np.random.default_rng(8).standard_normal(3000))[1500:]
    problem, _ = problem_from_table(pd.DataFrame({"t": t, "y": wander}), ssf.Law("y ~ a"))
    found = estimate_noise(problem.linearize(), np.zeros((1500, 0)), np.arange(1500))
    phi, theta, _ = ARIMA(wander - wander.mean(), order=(1, 0, 1), trend="n").fit().params
    lags = np.arange(6)
    assert found.n_free == 2
    np.testing.assert_allclose(found.coefficients[:6], (phi + theta) * (-theta) ** lags, atol=0.02)


def falls(rng, curvatures, noise):
    """Records of 45 samples, each with a parabola of its own."""
    t = np.linspace(0.0, 3.0, 45)
    records = [
        pd.DataFrame({"run": f"run {number}", "t": t, "y": 5.0 - t + size * (t - 1.5) ** 2 + noise(rng, 45)})
        for number, size in enumerate(curvatures)
    ]
    return pd.concat(records, ignore_index=True)


@pytest.mark.nightly
def test_what_a_law_lacks_in_each_session_in_its_own_way_is_no_noise_that_persists(tmp_path):
    """Quarters of a session are held out, so that the first and the last one are extrapolated."""
    rng = np.random.default_rng(12)
    frame = falls(rng, (0.3, 0.02, -0.2, 0.15), lambda rng, n: 0.05 * rng.standard_normal(n))
    found = ssf.diagnose_table(frame, "y ~ a + b*t", session="run", time="t")
    (course,) = found.findings
    assert (course.cause, course.carrier) == ("unknown", "time")
    assert found.gain.extended < 1.6 * 0.05 < 0.4 * found.gain.baseline
    fit = found.extended_law()
    assert fit.rms < 1.2 * 0.05
    assert not fit.parameters.duplicated(["name", "session"]).any()
    assert fit.parameters["standard_error"].max() < 0.05  # no polynomial is what the law has already
    fit.save(tmp_path / "law.json")
    loaded = ssf.load_table_fit(tmp_path / "law.json")
    pd.testing.assert_frame_equal(loaded.predict(frame), fit.predict(frame))
    assert np.std(loaded.predict(frame)["predicted"] - frame["y"]) == pytest.approx(fit.rms, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, pytest.param(3, marks=pytest.mark.nightly)])
def test_noise_that_persists_is_no_course_of_each_session(number):
    def wander(rng, n):
        return lfilter([1.0], [1.0, -0.97], 0.05 * rng.standard_normal(n + 300))[300:]

    for seed in range(number):
        frame = falls(np.random.default_rng(seed), (0.0,) * 4, wander)
        assert not ssf.diagnose_table(frame, "y ~ a + b*t", session="run", time="t", gain=False).findings


def test_coefficients_of_which_there_is_no_likelihood_are_no_reason_to_fail(monkeypatch):
    """Near unit roots the matrix of a law's parameters may be singular; the search goes on below them."""
    t = np.arange(300.0)
    y = lfilter([1.0], [1.0, -0.8], np.random.default_rng(9).standard_normal(600))[300:]
    problem, _ = problem_from_table(pd.DataFrame({"t": t, "y": y}), ssf.Law("y ~ a + b*t"))
    computed, refused = RestrictedLikelihood.differentiate, []

    def differentiate(likelihood, partial):
        if partial[0] > 0.85:
            refused.append(partial)
            raise np.linalg.LinAlgError
        return computed(likelihood, partial)

    monkeypatch.setattr(RestrictedLikelihood, "differentiate", differentiate)
    linearized = problem.linearize()
    found = estimate_noise(linearized, np.zeros((300, 0)), np.arange(300)).coefficients
    assert refused
    assert found[0] == pytest.approx(0.8, abs=4 * np.sqrt((1 - 0.8**2) / 300))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, pytest.param(21, marks=pytest.mark.nightly)])
def test_what_noise_that_persists_did_while_samples_are_missing_is_no_sudden_change(seed):
    rng, seconds = np.random.default_rng(seed), np.arange(300.0)
    wander = lfilter([1.0], [1.0, -0.99], 0.2 * rng.standard_normal(500))[-300:]
    frame = pd.DataFrame({"t": seconds, "y": wander})[(seconds < 120) | (seconds > 200)]
    assert not ssf.diagnose_table(frame, "y ~ mean", time="t", gain=False).findings


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, 2])
def test_a_wave_with_harmonics_whose_size_grows_is_one_finding(seed):
    rng, hours = np.random.default_rng(seed), np.arange(480.0)
    day = 2.0 * np.pi * hours / 24.0
    wave = 2.0 * np.cos(day) + np.cos(2.0 * day + 0.5) + 0.3 * np.cos(3.0 * day)
    noise = lfilter([1.0], [1.0, -0.7], 0.15 * rng.standard_normal(480))
    (found,) = diagnose((1.0 + 0.8 * hours / 480.0) * wave + noise, 3600.0 * hours).findings
    assert found.cause == "periodic-in-time"
    assert found.version.period == pytest.approx(24 * 3600.0, rel=1e-3)


SLOW = {
    "parabola": lambda u: 3.0 * u**2,
    "turned parabola": lambda u: 12.0 * (u - 0.4) ** 2,
    "cubic": lambda u: 24.0 * (u - 0.5) ** 3,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape",
    [
        "parabola",
        pytest.param("turned parabola", marks=pytest.mark.nightly),
        pytest.param("cubic", marks=pytest.mark.nightly),
    ],
)
def test_a_polynomial_in_time_is_no_warm_up_no_drift_and_no_sudden_change(shape):
    rng, u = np.random.default_rng(0), np.arange(120) / 120
    x = rng.uniform(0.0, 10.0, 120)
    y = 2.0 + 0.3 * x + SLOW[shape](u) + 0.3 * rng.standard_normal(120)
    frame = pd.DataFrame({"t": np.arange(120.0), "x": x, "y": y})
    found = ssf.diagnose_table(frame, "y ~ a + b*x", time="t", gain=False)
    assert [(one.cause, one.carrier) for one in found.findings] == [("unknown", "time")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cycles", "offset", "drift", "expected"),
    [
        pytest.param(1, 0.02, 0.0, "offset-by-direction", id="one sweep"),
        pytest.param(3, 0.02, 0.0, "offset-by-direction", id="three sweeps", marks=pytest.mark.nightly),
        pytest.param(3, 0.0, 0.03, "drift", id="drift beside sweeps", marks=pytest.mark.nightly),
    ],
)
def test_what_follows_a_column_that_is_swept_is_no_function_of_time(cycles, offset, drift, expected):
    """A parabola in the temperature and an effect beside it: together a smooth course, or a wave, in time."""
    share = np.arange(180) / 180
    phase = share * cycles % 1.0
    swept = pd.DataFrame({"t": 20.0 * np.arange(180), "T": 20.0 + 360.0 * np.minimum(phase, 1.0 - phase)})
    swept["branch"] = np.where(phase < 0.5, "heating", "cooling")
    swept["E"] = 0.005 * swept["T"] + 0.0944 * ((swept["T"] - 110.0) / 90.0) ** 2 + drift * share
    swept["E"] += offset * (phase >= 0.5) + 0.006 * np.random.default_rng(0).standard_normal(180)
    found = ssf.diagnose_table(swept, "E ~ a + b*T", time="t", direction="branch", gain=False)
    unknown, named = sorted(found.findings, key=lambda one: one.cause != "unknown")
    assert (unknown.cause, unknown.carrier) == ("unknown", "T")
    assert "^2" in unknown.term
    assert expected in named.cause_set  # in one sweep others do the same


def loading_cycles(seed, *, in_order=True, n_cycles=6):
    """A spring loaded and unloaded: what lies between the two branches is a parabola of the way."""
    rng = np.random.default_rng(seed)
    way = np.concatenate([np.arange(0.0, 61.0, 10.0), np.arange(60.0, -1.0, -10.0)])
    branch, loop = np.repeat(["load", "unload"], 7), np.repeat([1.0, -1.0], 7)
    frame = pd.concat([pd.DataFrame({"x": way, "branch": branch})] * n_cycles, ignore_index=True)
    share = frame["x"] / 60.0
    between = 0.24 * share * (1.0 - share) * np.tile(loop, n_cycles)
    if not in_order:  # and the same wave, which is then none of the settings
        frame = frame.sample(frac=1.0, random_state=seed, ignore_index=True)
    noise = 0.015 * rng.standard_normal(len(frame))
    return frame.assign(F=0.35 + 0.082 * frame["x"] + between + noise)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, pytest.param(4, marks=pytest.mark.nightly)])
def test_settings_that_come_back_are_the_reason_and_not_a_wave_of_their_period(seed):
    found = ssf.diagnose_table(loading_cycles(seed), "F ~ F0 + k*x", time="order")
    assert found.findings
    assert "periodic-in-time" not in names(found)
    assert "branch" in found.findings[0].carrier or found.findings[0].cause == "covariate:branch"
    assert found.gain.extended < 0.022  # noise of 0.015; a loop of 0.043 rms without
    (note,) = [one for one in found.notes if "comes back every" in one]
    assert re.search(r"of x and branch comes back every (13\.9.|14\.00) rows", note)


@pytest.mark.slow
def test_a_wave_is_named_where_settings_come_in_any_order():
    found = ssf.diagnose_table(loading_cycles(0, in_order=False), "F ~ F0 + k*x", time="order", gain=False)
    assert "periodic-in-time" in names(found)
    assert not any("comes back every" in one for one in found.notes)


@pytest.mark.parametrize(
    "columns", [{}, {"c": np.random.default_rng(2).standard_normal(200)}], ids=["time", "c"]
)
def test_only_where_there_are_columns_a_wave_is_compared_with_what_these_do(columns):
    rng, t = np.random.default_rng(1), np.arange(200.0)
    y = 3.0 + 0.3 * np.sin(2 * np.pi * t / 17) + 0.1 * rng.standard_normal(200)
    found = ssf.diagnose_table(pd.DataFrame({"t": t, "y": y, **columns}), "y ~ a", time="t", gain=False)
    assert [one.cause for one in found.findings] == ["periodic-in-time"]
    searched = []

    def search(problem):
        searched.append(problem)
        return found

    prefer_columns(found.selection.problem, found, search)
    assert len(searched) == len(columns)
