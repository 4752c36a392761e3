"""Sound in, stops and faults out."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.capture.audio import Recording
from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.end_stop import (
    MAX_MASKED_CHECKS,
    SequentialDetector,
    begin_sequential_test,
    update_sequential_test,
)
from stickslip_fit.capture.protocols import Samples
from stickslip_fit.capture.tuning import compute_limits
from stickslip_fit.errors import InputError
from tests.capture.hearing import AT_ZERO, SECONDS, Played, checks_of, steps, tuned

MOVING = 60  # checks before the stop


@pytest.fixture(scope="module")
def tuning():
    return tuned(AT_ZERO)


def traverse(acoustics, seed, pushing=6):
    """The sound of a joint that meets its stop after `MOVING` checks."""
    freely = steps(acoustics, MOVING, False, (seed, 0))
    return np.concatenate([freely, steps(acoustics, pushing, True, (seed, 1), MOVING * SECONDS)])


def until_it_says_something(detector, seconds=SECONDS, most=400):
    """The check at which there is a stop or a fault, and what was heard."""
    detector.begin()
    for check in range(1, most):
        heard = detector.check(seconds)
        if heard.at_stop or heard.fault:
            return check, heard
    return most, heard


@pytest.mark.slow
def test_a_stop_is_found_at_its_second_check_and_told_from_its_first(tuning):
    for seed in range(20):
        check, heard = until_it_says_something(
            SequentialDetector(Recording(traverse(AT_ZERO, seed), 48000), tuning)
        )
        assert heard.at_stop
        assert not heard.fault
        assert check - heard.late_checks == pytest.approx(MOVING + 1, abs=1)
        assert check in (MOVING + 1, MOVING + 2)
        assert heard.level == pytest.approx(3.0, abs=1.6)


@pytest.mark.parametrize("seconds", [0.047, 0.052, 0.1, 0.2])
def test_a_stop_is_found_however_the_sound_is_cut(tuning, seconds):
    check, heard = until_it_says_something(
        SequentialDetector(Recording(traverse(AT_ZERO, 3), 48000), tuning), seconds
    )
    assert heard.at_stop
    first = (check - heard.late_checks) * seconds
    assert MOVING * SECONDS < first < MOVING * SECONDS + seconds + SECONDS


def test_a_check_shorter_than_those_tuned_with_waits_for_more(tuning):
    detector = SequentialDetector(Recording(traverse(AT_ZERO, 3), 48000), tuning)
    levels = [detector.check(0.01).level for _ in range(8)]
    assert np.isfinite(levels).tolist() == [False, False, False, False, True, False, False, False]


def test_a_traverse_forgets_the_one_before(tuning):
    sound = checks_of(traverse(AT_ZERO, 1))[: MOVING + 2]
    detector = SequentialDetector(Played([*sound, *sound]), tuning)
    first, second = (until_it_says_something(detector) for _ in range(2))
    assert first == second
    assert first[0] == MOVING + 2


@pytest.mark.parametrize("gain", [0.3, 1.0, 3.0])
def test_a_joint_that_begins_at_its_stop_is_noticed_whatever_the_gain(gain):
    acoustics = Acoustics(snr_db=6.0)
    sound = gain * steps(acoustics, 10, True, 5)
    check, heard = until_it_says_something(SequentialDetector(Recording(sound, 48000), tuned(acoustics)))
    assert (check, heard.at_stop, heard.fault) == (2, True, "")


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_a_bang_however_loud_is_no_stop(tuning, share):
    sound = steps(AT_ZERO, MOVING, False, 8)
    at = 30 * 2400 + 2000  # into the next check, too
    bang = np.random.default_rng(1).normal(0, 0.1 * share, 1200)
    sound[at : at + 1200] += bang.astype(np.float32)
    levels = [
        heard.level
        for heard in map(SequentialDetector(Recording(sound, 48000), tuning).check, [SECONDS] * MOVING)
    ]
    assert max(levels) > 6
    check, heard = until_it_says_something(SequentialDetector(Recording(sound, 48000), tuning), most=MOVING)
    assert not heard.at_stop
    assert check == MOVING


def test_a_lone_check_in_the_band_alone_is_no_stop(tuning):
    sound = checks_of(steps(AT_ZERO, MOVING, False, 8))
    sound[30] = checks_of(steps(replace(AT_ZERO, snr_db=20.0), 1, True, 9))[0]
    check, heard = until_it_says_something(SequentialDetector(Played(sound), tuning), most=MOVING)
    assert check == MOVING
    assert not heard.at_stop


def test_a_room_that_stays_loud_ends_the_move(tuning):
    loud = 2 * steps(AT_ZERO, MAX_MASKED_CHECKS + 5, False, 4)
    sound = np.concatenate([steps(AT_ZERO, MOVING, False, 3), loud])
    check, heard = until_it_says_something(SequentialDetector(Recording(sound, 48000), tuning))
    assert check == MOVING + MAX_MASKED_CHECKS
    assert not heard.at_stop
    assert "too loud" in heard.fault


def test_a_stop_reached_while_the_room_was_loud_gives_no_count(tuning):
    loud = 3 * steps(AT_ZERO, 5, True, 4)
    sound = np.concatenate([steps(AT_ZERO, MOVING, False, 3), loud, steps(AT_ZERO, 5, True, 5)])
    check, heard = until_it_says_something(SequentialDetector(Recording(sound, 48000), tuning))
    assert check == MOVING + 7
    assert "5 checks" in heard.fault


def spoilt(kind, check):
    values = check.values.copy()
    if kind == "overflow":
        return Samples(values, overflowed=True)
    if kind == "clips":
        values[::300] = 1.0
    elif kind == "one value":
        values[:] = 0.01
    elif kind == "hardly anything":
        values *= 0.01
    elif kind == "no numbers":
        values[7] = np.nan
    else:
        values = values[:100]
    return Samples(values)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("overflow", "lost"),
        ("clips", "clips"),
        ("one value", "dead"),
        ("hardly anything", "hardly anything"),
        ("no numbers", "no numbers"),
        ("ended", "ended"),
    ],
)
def test_faults_of_the_sound_end_the_move(tuning, kind, said):
    sound = checks_of(steps(AT_ZERO, 20, False, 2))
    sound[12] = spoilt(kind, sound[12])
    check, heard = until_it_says_something(SequentialDetector(Played(sound), tuning), most=20)
    assert check == 13
    assert said in heard.fault
    assert not heard.at_stop


def test_a_few_samples_at_full_scale_are_a_bang_and_no_clipping(tuning):
    sound = checks_of(steps(AT_ZERO, 20, False, 2))
    sound[12].values[100:102] = 1.0
    check, heard = until_it_says_something(SequentialDetector(Played(sound), tuning), most=20)
    assert (check, heard.fault, heard.at_stop) == (20, "", False)


def test_an_ear_tuned_at_another_rate_is_refused(tuning):
    with pytest.raises(InputError, match="48,000 samples per second and the sound has 44,100"):
        SequentialDetector(Recording(np.zeros(10, np.float32), 44100), tuning)


def test_traverses_side_by_side_are_heard_as_each_by_itself():
    limits = compute_limits(190.0, 380.0, 2.0, 1.0)
    rng = np.random.default_rng(1)
    band, reference = rng.gamma(95, 1 / 95, (2, 3, 50))
    band[0, 30:] *= 2
    reference[1, 10:13] *= 3
    together, said = begin_sequential_test(3), []
    for check in range(50):
        together, verdict = update_sequential_test(limits, together, band[:, check], reference[:, check])
        said.append(verdict.at_stop)
    for place in range(3):
        alone = begin_sequential_test(1)
        for check in range(50):
            alone, verdict = update_sequential_test(
                limits, alone, band[place, [check]], reference[place, [check]]
            )
            assert verdict.at_stop[0] == said[check][place]
    assert np.argmax(np.array(said)[:, 0]) in (30, 31)
