"""A plan and laws that are known make a log."""

from stickslip_fit.simulate.chance import draw_noise
from stickslip_fit.simulate.counts import expected_counts, simulate_counts
from stickslip_fit.simulate.law_values import LawValues, key_of, read_law_values
from stickslip_fit.simulate.simulate import simulate
from stickslip_fit.simulate.stepping import step_through

__all__ = [
    "LawValues",
    "draw_noise",
    "expected_counts",
    "key_of",
    "read_law_values",
    "simulate",
    "simulate_counts",
    "step_through",
]
