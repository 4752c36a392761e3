"""What a person may say of the room, and what is made of it."""

import pytest

from stickslip_fit.capture.operator import format_conditions, parse_conditions
from stickslip_fit.errors import InputError


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("", {}),
        ("temperature_K=300", {"temperature": 300.0}),
        (
            "temperature_C = 0;humidity_pct=50 , supply_V=80.5",
            {"temperature": 273.15, "humidity": 0.5, "supply": 80.5},
        ),
        ("pressure_hPa=1e3", {"covariate:pressure_hPa": 1000.0}),
    ],
)
def test_conditions_are_read_in_the_units_of_a_log(typed, meant):
    assert parse_conditions(typed) == pytest.approx(meant)


def test_conditions_are_written_as_they_would_be_typed():
    typed = "temperature_C=22.5 humidity_pct=41 supply_V=80 payload_g=0.5 pressure_hPa=1013"
    assert format_conditions(parse_conditions(typed)) == typed


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("warm", "give a name and a number"),
        ("=3", "give a name and a number"),
        ("supply_V=nan", "give a name and a number"),
        ("temperature=20", "has no unit; write temperature_C or temperature_K"),
        ("temperature_F=70", "is no unit of temperature"),
        ("step_period_ms=10", "is what the plan says"),
        ("theta_deg=10", "is what the plan says"),
        ("steps=10", "is what the plan says"),
    ],
)
def test_what_is_no_condition_is_refused(typed, said):
    with pytest.raises(InputError, match=said):
        parse_conditions(f"supply_V=80 {typed}")
