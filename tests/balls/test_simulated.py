"""Drops whose truth is known: what is hidden is named, what cannot be told apart is said to be so."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import binom

import stickslip_fit as ssf
from tests.balls.fall import ANOTHER_G, CAMERA_SCALE, CLOCK_OFFSET, LAW, SLANT, G, drags

FRAME, NUMBER, NOISE = 1 / 15, 46, 0.05  # s, frames of a drop, m
RELEASED = ((47.5, -0.4), (46.8, 0.9))  # m, m/s
ACCELERATIONS = {
    "quadratic-drag": lambda velocity: -G - 0.02 * velocity * abs(velocity),
    "linear-drag": lambda velocity: -G - 0.3 * velocity,
}
SIZES = {"quadratic-drag": 0.02, "linear-drag": 0.3}


def fall(release, velocity, acceleration):
    """Height in each frame, by an adaptive integrator of high order."""
    seconds = FRAME * np.arange(NUMBER)
    path = solve_ivp(
        lambda _, y: [y[1], acceleration(y[1])], (0.0, seconds[-1]), [release, velocity],
        method="DOP853", t_eval=seconds, rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    return path.y[0]


def filmed(acceleration, seed):
    rng, seconds = np.random.default_rng(seed), FRAME * np.arange(NUMBER)
    drops = [
        pd.DataFrame({"drop": number, "seconds": seconds, "height": fall(*released, acceleration)})
        for number, released in enumerate(RELEASED, start=1)
    ]
    frames = pd.concat(drops, ignore_index=True)
    return frames.assign(height=frames["height"] + NOISE * rng.standard_normal(len(frames)))


def rms_left(path, changed):
    """Rms of what a change of the heights seen in all drops leaves once each drop is released anew."""
    left = []
    for released in RELEASED:
        moved = [(path(*(np.array(released) + step)) - path(*released)) / 1e-3 for step in 1e-3 * np.eye(2)]
        change = changed(*released) - path(*released)
        left.append(change - np.stack(moved, axis=1) @ np.linalg.lstsq(np.stack(moved, axis=1), change)[0])
    return np.sqrt(np.mean(np.concatenate(left) ** 2))


def diagnose(frames, causes=(), gain=False, **options):
    return ssf.diagnose_table(
        frames, LAW, session="drop", time="seconds", causes=[*drags(), *causes], alpha=0.01, gain=gain,
        **options,
    )  # fmt: skip


@pytest.mark.parametrize("name", SIZES)
def test_falls_are_those_of_an_integrator(name):
    """To a tenth of a millimetre, thrown up or down."""
    frames = filmed(ACCELERATIONS[name], 0)
    law = LAW.bind_table(frames, session="drop")
    (cause,) = (one.bind_table(law, frames) for one in drags() if one.name == name)
    for release, velocity in RELEASED:
        values = np.array([release, velocity, SIZES[name]])
        heights = cause.extend(law).predict(frames[:NUMBER], values)
        assert heights == pytest.approx(fall(release, velocity, ACCELERATIONS[name]), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "most"), [(2, 0), pytest.param(400, binom.ppf(0.99, 400, 0.01), marks=pytest.mark.nightly)]
)
def test_free_fall_is_nothing_wrong(number, most):
    found = [diagnose(filmed(lambda _: -G, seed)).p_value < 0.01 for seed in range(number)]
    assert sum(found) <= most


@pytest.mark.parametrize(
    ("name", "number"),
    [
        pytest.param("quadratic-drag", 1, marks=pytest.mark.nightly),
        ("linear-drag", 1),
        *(pytest.param(name, 20, marks=pytest.mark.nightly) for name in SIZES),
    ],
)
def test_drag_is_named_with_its_size(name, number):
    covered = 0
    for seed in range(number):
        (finding,) = diagnose(filmed(ACCELERATIONS[name], seed)).findings
        assert (finding.cause, finding.equivalent) == (name, ())
        size = finding.parameters[0].size
        covered += size.low < SIZES[name] < size.high
        assert abs(size.estimate - SIZES[name]) < size.high - size.low  # four standard errors
    assert covered >= binom.ppf(0.001, number, 0.95)


@pytest.mark.slow
def test_another_g_and_the_cameras_scale_cannot_be_told_apart():
    causes = (ANOTHER_G, CAMERA_SCALE)
    diagnosis = diagnose(filmed(lambda _: -1.05 * G, 1), causes, generic_causes=())
    (finding,) = diagnosis.findings
    assert diagnosis.verdict == "cannot tell apart"
    assert {finding.cause, *finding.equivalent} == {"another-g", "camera-scale"}


@pytest.mark.slow
def test_what_release_absorbs_is_untestable():
    diagnosis = diagnose(filmed(ACCELERATIONS["quadratic-drag"], 2), (CLOCK_OFFSET,))
    assert "clock-offset" in diagnosis.untestable
    assert [finding.cause for finding in diagnosis.findings] == ["quadratic-drag"]


def seen(height):
    """Through a slanted camera."""
    return height - 0.01 * (height - 30.0) ** 2 / 2


@pytest.mark.nightly
def test_a_slanted_camera_and_drag_are_both_found():
    """The camera sees where the ball is: the slant acts on the height with the drag in it."""
    frames = filmed(ACCELERATIONS["quadratic-drag"], 4)
    diagnosis = diagnose(frames.assign(height=seen(frames["height"])), (SLANT,))
    sizes = {finding.cause: finding.parameters[0].size for finding in diagnosis.findings}
    assert set(sizes) == {"quadratic-drag", "slant"}
    assert sizes["quadratic-drag"].low < 0.02 < sizes["quadratic-drag"].high
    assert sizes["slant"].low < -0.01 < sizes["slant"].high
    effects = {finding.cause: finding.effect for finding in diagnosis.findings}
    # Each is what it changes beside the other, but for what release and velocity take up.
    without = {
        "slant": lambda *drop: fall(*drop, ACCELERATIONS["quadratic-drag"]),
        "quadratic-drag": lambda *drop: seen(fall(*drop, lambda _: -G)),
    }
    for name, path in without.items():
        true = rms_left(path, lambda *drop: seen(fall(*drop, ACCELERATIONS["quadratic-drag"])))
        assert effects[name].low < true < effects[name].high


@pytest.mark.nightly
def test_frames_held_out_are_predicted_to_within_the_noise():
    gain = diagnose(filmed(ACCELERATIONS["quadratic-drag"], 5), gain=True).gain
    assert gain.baseline > 20 * NOISE
    assert gain.extended < 2 * NOISE


@pytest.mark.nightly
@pytest.mark.parametrize("name", SIZES)
def test_drag_that_is_right_for_every_ball_is_told_from_the_other(name):
    """Of four balls, filmed at a slant."""
    rng, rates, balls = np.random.default_rng(5), {"quadratic-drag": 0.01, "linear-drag": 0.1}, []
    for number in range(1, 5):
        rate = number * rates[name]
        acceleration = {
            "quadratic-drag": lambda v, k=rate: -G - k * v * abs(v),
            "linear-drag": lambda v, r=rate: -G - r * v,
        }[name]
        for drop, released in enumerate(RELEASED):
            height = fall(*released, acceleration)
            seen = height - 0.005 * (height - 30.0) ** 2 / 2 + NOISE * rng.standard_normal(NUMBER)
            one = {"ball": f"ball {number}", "drop": f"{number}, {drop}", "height": seen}
            balls.append(pd.DataFrame({**one, "seconds": FRAME * np.arange(NUMBER)}))
    frames = pd.concat(balls, ignore_index=True)
    diagnosis = ssf.diagnose_table(
        frames, LAW, session="drop", time="seconds", causes=[*drags(by="ball"), SLANT], gain=False
    )
    assert {one.cause: one.equivalent for one in diagnosis.findings} == {name: (), "slant": ()}
