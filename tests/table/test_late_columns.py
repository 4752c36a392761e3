"""A response that follows a column late is described by the column behind a low-pass filter."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter, lsim

import stickslip_fit as ssf

LAW, LAG = "px ~ a + b*line", 2700.0  # s


def spectrometer(seed, *, lag=LAG, phi=0.0, n=360, rise=0.3):
    """Lines of lamps whose place moves with the temperature of a heavy bench; one row a minute."""
    rng, seconds = np.random.default_rng(seed), 60.0 * np.arange(n)
    room = 21.0 + 1.3 * np.sin(seconds / 1700.0) + 0.7 * np.sin(seconds / 610.0 + 1.0)
    bench = lsim(([1.0], [lag, 1.0]), room - room[0], seconds)[1] + room[0] if lag else room
    line = rng.choice([404.7, 546.1, 696.5, 811.5], n)
    noise = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], 0.05 * rng.standard_normal(n))
    humidity = 45.0 + lfilter([1.0], [1.0, -0.95], rng.standard_normal(n))
    px = -800.0 + 3.2 * line + rise * bench + noise
    return pd.DataFrame({"t": seconds, "line": line, "px": px, "room": room, "humidity": humidity.round(1)})


def lag_of(diagnosis):
    (name,) = (one.cause for one in diagnosis.findings if one.cause.endswith("late"))
    column, size, unit = name.removeprefix("covariate:").removesuffix(" late").split()
    assert column == "room"
    return float(size) * {"s": 1.0, "h": 3600.0}[unit]


@pytest.mark.slow
@pytest.mark.parametrize("phi", [0.0, 0.5])
def test_the_column_is_found_with_its_lag(phi):
    found = ssf.diagnose_table(spectrometer(1, phi=phi), LAW, time="t", gain=False)
    assert lag_of(found) == pytest.approx(LAG, rel=0.15)
    assert len(found.findings) == 1
    assert any("low-pass filter" in one and "room" in one for one in found.table.notes)


@pytest.mark.slow
def test_the_saved_law_filters_the_columns_of_another_table(tmp_path):
    found = ssf.diagnose_table(spectrometer(1), LAW, time="t")
    assert found.gain.extended < 1.2 * found.gain.noise_floor
    found.extended_law().save(tmp_path / "law.json")
    again, other = ssf.load_table_fit(tmp_path / "law.json"), spectrometer(2, n=240)
    shuffled = other.sample(frac=1.0, random_state=0)
    predicted = again.predict(shuffled)["predicted"]
    assert np.std(predicted - shuffled["px"]) < 1.3 * 0.05
    with pytest.raises(ssf.InputError, match="column room: is in the law, and the table has no such column"):
        again.predict(other.drop(columns="room"))
    with pytest.raises(ssf.InputError, match="named as the time"):
        again.predict(other.drop(columns="t"))


@pytest.mark.slow
def test_the_figure_shows_the_effect_of_a_cause_that_is_found_with_another():
    """The bench was cold when the log began: neither explains enough alone."""
    frame = spectrometer(1)
    frame["px"] += 0.5 * (1.0 - np.exp(-frame["t"] / 3000.0))
    found = ssf.diagnose_table(frame, LAW, time="t", gain=False)
    assert len(found.findings) == 2
    place = next(k for k, one in enumerate(found.findings) if one.cause.endswith("late"))
    (dashed,) = (one for one in found.plot_residuals(place)[0].lines if one.get_linestyle() == "--")
    rise = np.polyfit(*dashed.get_data(), 1)[0]
    assert rise == pytest.approx(0.3, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("lag", "rise"), [(0.0, 0.3), (LAG, 0.0)], ids=["at once", "not at all"])
def test_no_lag_is_searched_where_the_column_explains_as_much(lag, rise):
    found = ssf.diagnose_table(spectrometer(3, lag=lag, rise=rise), LAW, time="t", gain=False)
    assert [one.cause for one in found.findings] == (["covariate:room"] if rise else [])
    assert not [name for name in found.selection.problem.rows if name.endswith("late")]


@pytest.mark.slow
def test_at_irregular_times_no_lag_is_searched():
    """What persists there is structure, and no noise beside which a lag could be likely."""
    frame = spectrometer(3, rise=0.0)
    frame["t"] += np.random.default_rng(0).uniform(0.0, 55.0, len(frame)).round(1)
    found = ssf.diagnose_table(frame, LAW, time="t", gain=False)
    assert found.verdict == "nothing wrong"
    assert not [name for name in found.selection.problem.rows if name.endswith("late")]


@pytest.mark.nightly
@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_noise_that_persists_is_not_taken_for_a_late_column(phi):
    """In 40 tables with two slow columns none is picked; 1 in 100 would be within alpha."""
    picked = 0
    for seed in range(40):
        found = ssf.diagnose_table(spectrometer(seed, rise=0.0, phi=phi), LAW, time="t", gain=False)
        picked += any(name.endswith("late") for name in found.selection.problem.rows)
    assert picked <= 1
