"""A plan and laws that are known make a log."""

from stickslip_fit.simulation.campaign import (
    draw_noise,
    expected_counts,
    simulate,
    simulate_counts,
    step_through,
)
from stickslip_fit.simulation.truth import LawValues, parameter_key, read_law_values

__all__ = [
    "LawValues",
    "draw_noise",
    "expected_counts",
    "parameter_key",
    "read_law_values",
    "simulate",
    "simulate_counts",
    "step_through",
]
