"""What the sentences say follows the adjusted p-values, and names what was compared."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.anova import analyze_variance
from stickslip_fit.anova.analysis import run_factor_tests
from tests.thesis.reconstruct import reconstruct

DAYS = {"Mon": 976e-9, "Tue": 951e-9}
WAYS = {"+": 976e-9, "-": 903e-9}


def told(*questions):
    return " ".join(str(run_factor_tests(questions)).split())


def test_an_effect_is_one_only_if_it_is_after_everything_that_was_asked():
    by_day = reconstruct("day", DAYS, 0.03, direction="+")
    others = [reconstruct("direction", WAYS, 0.5) for _ in range(3)]
    assert "changes from session to session, by up to 25.0 nm (2.6 %) in direction +" in told(by_day)
    assert "no change from session to session shows in direction + (25.0 nm" in told(by_day, *others)


def test_what_would_have_shown_goes_with_what_did_not():
    for others in (0, 9):
        questions = [reconstruct("direction", WAYS, 0.4)] * (1 + others)
        found = run_factor_tests(questions).factor_tests[0]
        low, high = found.effect.low * 1e9, found.effect.high * 1e9
        assert (found.p_holm == 1.0) == (others > 0)
        assert (
            f"no difference between the directions shows (73.0 nm, 95 %: −{-low:.1f} to {high:.1f}; adjusted "
            f"p = {'1' if others else '0.40'}; one of {found.detectable * 1e9:.1f} nm would most likely have "
            "shown)"
        ) in told(*questions)


@pytest.mark.parametrize("name", ["day", "direction"])
def test_what_to_do_and_what_it_costs_not_to(log_of_readings, readings_of, name):
    """Days 30 nm apart or alike, directions 40 nm apart or alike."""
    days, apart = ("Mon", "Tue", "Wed", "Thu"), {"day": (30.0, 0.0), "direction": (0.0, 40.0)}[name]
    step, gap = apart
    found = analyze_variance(
        log_of_readings(
            readings_of(
                {(d, s, 0.0): 4 for d in days for s in "+-"},
                lambda d, s, t: step * days.index(d) + gap * (s == "+"),
                noise=1.0,
            )
        )
    )
    text = " ".join(str(found).split())
    (parts,) = found.components
    assert ("Recalibrate each session: the calibration of another session is off by" in text) == (
        name == "day"
    )
    assert ("Keep separate parameters for each direction: one set for both is off by" in text) == (
        name == "direction"
    )
    if name == "day":
        assert (
            "This log gives no reason to keep separate parameters for each direction: one set for both"
            in text
        )
    else:
        assert "This log gives no reason to recalibrate each session" in text
    assert parts.total.deviation * 1e9 == pytest.approx(step * np.std(range(4), ddof=1), abs=1.0)
    assert parts.direction * 1e9 == pytest.approx(gap, abs=1.0)


def test_a_small_log_does_not_say_that_nothing_matters(log_of_readings, readings_of):
    design = {(d, s, 0.0): 2 for d in ("Mon", "Tue") for s in "+-"}
    text = " ".join(str(analyze_variance(log_of_readings(readings_of(design)))).split())
    assert "Whether to recalibrate each session this log is too small to say" in text


def test_a_drift_that_could_pass_for_the_normal_force_is_told_with_it(log_of_readings, readings_of):
    """Orientations one after another while the joint warms up: never without the warning."""
    rng = np.random.default_rng(0)
    readings = [
        (day, sign, theta, 960.0 + 10.0 * k + 0.5 * rng.standard_normal())
        for day in ("Mon", "Tue", "Wed")
        for k, theta in enumerate((0.0, -30.0, -60.0))
        for _ in range(2)
        for sign in "+-"
    ]
    text = " ".join(str(analyze_variance(log_of_readings(readings))).split())
    assert "but repeated traverses drift, or may, within their session, which alone could do that" in text


def test_the_table_of_questions_is_a_data_frame(log_of_readings, readings_of):
    found = analyze_variance(
        log_of_readings(readings_of({(d, s, 0.0): 2 for d in ("Mon", "Tue") for s in "+-"}))
    )
    assert isinstance(found.table, pd.DataFrame)
    assert list(found.table["analysis"].unique()) == [
        "day",
        "direction",
        "normal-force",
        "all traverses",
        "position",
    ]
