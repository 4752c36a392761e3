"""What is proposed after a short listen, kept in a file and drawn."""

import json

import numpy as np
import pytest
from matplotlib.colors import to_hex

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.tuning import choose_tuning, load_tuning, save_tuning
from stickslip_fit.errors import InputError
from tests.capture.hearing import SECONDS, steps, tuned


@pytest.fixture(scope="module")
def tuning():
    return tuned(Acoustics(3.0, 5200.0, 900.0))


def true_rise(acoustics, found):
    """By what factor the stop is louder in the band that was found."""
    low, high = (found.frequency + side * found.width / 2 for side in (-1, 1))
    band = np.linspace(low, high, 500)
    moving = acoustics.room_density(band) + acoustics.click_density(band)
    return 1 + np.mean(acoustics.stop_density(band) / moving)


@pytest.mark.parametrize(("peak", "width"), [(3500.0, 600.0), (6000.0, 2000.0), (9000.0, 1000.0)])
def test_the_band_proposed_is_where_the_day_has_its_peak(peak, width):
    acoustics = Acoustics(3.0, peak, width)
    found = tuned(acoustics)
    assert abs(found.frequency - peak) <= 300
    assert found.rise == pytest.approx(true_rise(acoustics, found), rel=0.06)


def test_degrees_of_freedom_are_twice_band_times_length_less_the_window():
    found = tuned(Acoustics(0.0))
    assert found.width == 2000
    assert found.df == pytest.approx(2 * 2000 * SECONDS * 0.95, rel=0.02)


def test_a_sound_that_scatters_more_than_noise_is_believed():
    rng = np.random.default_rng(2)
    moving, at_stop = (steps(Acoustics(6.0), 100, pushing, 4) for pushing in (False, True))
    uneven = at_stop * np.repeat(np.exp(0.3 * rng.standard_normal(100)), 2400).astype(np.float32)
    assert choose_tuning(moving, uneven, 48000, SECONDS).stop_df < 20


@pytest.mark.parametrize(
    ("snr_db", "said"), [(12.0, "well"), (-1.0, "poorly"), (-9.0, "cannot be distinguished")]
)
def test_how_well_they_separate_is_said_in_words(snr_db, said):
    found = tuned(Acoustics(snr_db))
    assert said in found.conclusion
    assert found.separates == (snr_db > -2)


def test_a_bang_while_listening_changes_nothing_much():
    acoustics = Acoustics(3.0, 5200.0, 900.0)
    moving, at_stop = (steps(acoustics, 100, pushing, (1, pushing)) for pushing in (False, True))
    moving[90000:93000] += np.random.default_rng(1).normal(0, 0.2, 3000).astype(np.float32)
    found = choose_tuning(moving, at_stop, 48000, SECONDS)
    assert abs(found.frequency - 5200) <= 300
    assert found.rise == pytest.approx(true_rise(acoustics, found), rel=0.06)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda sound: sound[:24000], "at the stop: only 10 checks, and at least 20"),
        (lambda sound: 0 * sound, "at the stop: the microphone is dead"),
        (lambda sound: np.clip(200 * sound, -1, 1), "at the stop: the sound clips"),
    ],
)
def test_a_listen_that_is_no_good_is_refused(change, said):
    moving, at_stop = (steps(Acoustics(3.0), 30, pushing, 4) for pushing in (False, True))
    with pytest.raises(InputError, match=said):
        choose_tuning(moving, change(at_stop), 48000, SECONDS)


def test_a_tuning_comes_back_from_its_file(tuning, tmp_path):
    save_tuning(tuning, tmp_path / "ear.json")
    back = load_tuning(tmp_path / "ear.json")
    assert back.conclusion == tuning.conclusion
    sound = steps(Acoustics(3.0), 10, True, 3).reshape(10, -1)
    np.testing.assert_allclose(back.powers(sound), tuning.powers(sound), rtol=1e-4)
    np.testing.assert_array_equal(back.limits.pair_threshold, tuning.limits.pair_threshold)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content | {"rise": None},
        lambda content: content | {"rise": -1.0},
        lambda content: content | {"moving": content["moving"][:-1]},
        lambda content: content | {"at_stop": ["x"]},
        lambda content: {key: value for key, value in content.items() if key != "rate"},
        lambda content: [content],
        lambda content: content | {"colour": "1.0"},
        lambda content: content | {"rate": 10**15},
        lambda content: content | {"rate": 48000.5},
        lambda content: content | {"seconds": 1e300},
        lambda content: content | {"df": 1e-300},
        lambda content: content | {"df": 1e15},
        lambda content: content | {"reference_df": 1e-9},
        lambda content: content | {"rise": 1e300},
        lambda content: content | {"frequency": 1e9},
        lambda content: content | {"width": 1e-9},
    ],
)
def test_a_damaged_tuning_is_refused(tuning, tmp_path, damage):
    path = tmp_path / "ear.json"
    save_tuning(tuning, path)
    path.write_text(json.dumps(damage(json.loads(path.read_text()))))
    with pytest.raises(InputError, match=r"ear\.json: is (no tuning|damaged); tune the detector again"):
        load_tuning(path)


def test_json_nested_too_deeply_is_no_tuning(tmp_path):
    (tmp_path / "ear.json").write_text("[" * 200_000)
    with pytest.raises(InputError, match="is no tuning; tune the detector again"):
        load_tuning(tmp_path / "ear.json")


def test_no_tuning_at_all_is_refused(tmp_path):
    with pytest.raises(InputError, match="is no file"):
        load_tuning(tmp_path)
    with pytest.raises(InputError, match="tune the detector first"):
        load_tuning(tmp_path / "none.json")


def test_the_figure_shows_both_spectra_the_band_and_the_finding(tuning):
    figure = tuning.plot_spectrum().figure
    above, below = figure.axes
    colours = {to_hex(line.get_color()): line.get_ydata() for line in above.lines}
    assert len(colours) == 2
    kilohertz = above.lines[0].get_xdata()
    moving, at_stop = (line.get_ydata() for line in above.lines)
    inside = np.abs(kilohertz - 5.2) < 0.3
    # 3 dB over 2 kHz in a peak of 0.9 kHz: a factor of 5.4 at its top.
    assert np.mean((at_stop - moving)[inside]) == pytest.approx(10 * np.log10(5.4), abs=0.5)
    shaded = [patch.get_bbox() for patch in below.patches]
    assert shaded[0].x0 == pytest.approx((tuning.frequency - tuning.width / 2) / 1000)
    assert shaded[0].x1 == pytest.approx((tuning.frequency + tuning.width / 2) / 1000)
    written = " ".join(text.get_text().replace("\n", " ") for text in figure.texts)
    assert tuning.conclusion in written
