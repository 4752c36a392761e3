"""The published laws against the physical ones: held-out errors, regimes, and what would tell them apart."""

from stickslip_fit.law_comparison import _summary as _summary  # registers how comparisons are summarized
from stickslip_fit.law_comparison.comparison import JointComparison, LawComparison, Regime, compare_laws
from stickslip_fit.law_comparison.experiments import Experiment
from stickslip_fit.law_comparison.held_out import ErrorEstimate, HeldOutComparison

__all__ = [
    "ErrorEstimate",
    "Experiment",
    "HeldOutComparison",
    "JointComparison",
    "LawComparison",
    "Regime",
    "compare_laws",
]
