import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stickslip_fit._format import format_uncertain, format_value
from stickslip_fit.units import UNITS, from_si, to_si


@pytest.mark.parametrize(
    ("value", "symbol", "si"),
    [
        (180.0, "deg", np.pi),
        (12.0, "mm", 0.012),
        (957.0, "nm", 957e-9),
        (95.0, "µrad", 95e-6),
        (1.0, "µrad/mm", 1e-3),
        (25.0, "°C", 298.15),
        (2.0, "h", 7200.0),
        (0.27, "%", 0.0027),
    ],
)
def test_conversion_to_si(value, symbol, si):
    assert to_si(value, symbol) == pytest.approx(si, rel=1e-15)


@given(st.floats(-1e6, 1e6), st.sampled_from(sorted(UNITS)))
def test_there_and_back(value, symbol):
    assert from_si(to_si(value, symbol), symbol) == pytest.approx(value, rel=1e-12, abs=1e-10)


@pytest.mark.parametrize(
    ("value", "error", "symbol", "shown"),
    [
        (957.34e-9, 1.26e-9, "nm", "957.3 ± 1.3 nm"),
        (957.34e-9, 12.6e-9, "nm", "957 ± 13 nm"),
        (-19.852e-6, 0.0412e-6, "µrad", "−19.85 ± 0.04 µrad"),
        (0.2987, 0.0021, "1", "0.2987 ± 0.0021"),
        (0.0027, 0.00029, "%", "0.270 ± 0.029 %"),
        (957e-9, float("nan"), "nm", "957.0 ± ? nm"),
        (float("nan"), 1e-9, "nm", "not known"),
        (None, None, "nm", "not known"),
    ],
)
def test_an_estimate_shows_the_digits_that_its_error_leaves(value, error, symbol, shown):
    assert format_uncertain(value, error, symbol) == shown


def test_no_negative_zero():
    assert format_value(-1e-12, "µrad", 1) == "0.0 µrad"
