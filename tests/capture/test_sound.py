"""The emulated microphone hears what its acoustics say, by scipy's spectra."""

import numpy as np
import pytest
from scipy import signal

from stickslip_fit.capture.emulator.acoustics import Acoustics, synthesize_sound
from tests.capture.hearing import steps


def power_in(sound, rate, low, high):
    frequencies, density = signal.welch(sound.astype(float), rate, nperseg=4800)
    inside = (frequencies >= low) & (frequencies <= high)
    return np.trapezoid(density[inside], frequencies[inside])


@pytest.mark.slow
@pytest.mark.parametrize(("snr_db", "peak", "width"), [(0.0, 6000.0, 2000.0), (6.0, 4000.0, 600.0)])
def test_signal_over_noise_is_that_of_2_khz_about_the_peak(snr_db, peak, width):
    acoustics = Acoustics(snr_db, peak, width)
    moving, at_stop = (steps(acoustics, 400, pushing, 3) for pushing in (False, True))
    band = acoustics.rate, peak - 1000, peak + 1000
    noise = power_in(moving, *band)
    stop = power_in(at_stop, *band) - noise
    assert 10 * np.log10(stop / noise) == pytest.approx(snr_db, abs=0.2)
    assert power_in(at_stop, acoustics.rate, peak + 2500, peak + 6000) == pytest.approx(
        power_in(moving, acoustics.rate, peak + 2500, peak + 6000), rel=0.05
    )


def test_steps_click_at_the_step_rate_and_only_when_they_are_made():
    acoustics = Acoustics(clicks=0.1, room=1e-4, hum=0.0)
    rng = np.random.default_rng(1)
    half = np.arange(200) < 100
    sound = synthesize_sound(acoustics, 0.0, half, np.zeros(200), rng)
    loud, quiet = np.split(sound, 2)
    assert quiet.std() < 2e-4 < loud.std() / 100
    lines = np.abs(np.fft.rfft(loud)) ** 2
    harmonics = lines[::100]  # a second of sound: a bin is 1 Hz
    assert harmonics.sum() > 0.95 * lines.sum()


@pytest.mark.slow
def test_bangs_and_speech_are_the_same_however_the_time_is_cut():
    calm = Acoustics(room=1e-9, clicks=1e-9, hum=0.0, bangs=2.0, speech=0.5, seed=4)
    rng = np.random.default_rng(1)
    whole = synthesize_sound(calm, 3.0, np.zeros(400), np.zeros(400), rng)
    cut = [synthesize_sound(calm, 3.0 + 0.05 * k, np.zeros(5), np.zeros(5), rng) for k in range(80)]
    assert np.abs(whole).max() > 0.01
    np.testing.assert_allclose(np.concatenate(cut), whole, atol=1e-7)


def test_the_gain_drifts_by_what_it_says():
    acoustics = Acoustics(drift_db=6.0)
    loud, quiet = (steps(acoustics, 20, False, 1, began=began) for began in (29.5, 89.5))
    assert 20 * np.log10(loud.std() / quiet.std()) == pytest.approx(12.0, abs=0.5)
