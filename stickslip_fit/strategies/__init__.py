"""Calibration strategies compared: how much accuracy a traverse buys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stickslip_fit.strategies import _summary as _summary  # registers how results are summarized
from stickslip_fit.strategies.base import (
    CalibrationTask,
    NotApplicable,
    Predictor,
    Strategy,
    earlier_sessions,
    other_sessions,
)
from stickslip_fit.strategies.compare import Comparison, compare_strategies, save_comparison
from stickslip_fit.strategies.designs import (
    AtRandom,
    ClosedForm,
    ConstantStepStrategy,
    DOptimal,
    IOptimal,
    Thesis,
)
from stickslip_fit.strategies.library import (
    Hierarchical,
    LeastSquares,
    WithCauses,
    causes_from_other_sessions,
    causes_from_result,
    default_strategies,
    default_strategies_with_causes,
)

if TYPE_CHECKING:
    from stickslip_fit.strategies.tip_error import TipErrors, compute_tip_errors

__all__ = [
    "AtRandom",
    "CalibrationTask",
    "ClosedForm",
    "Comparison",
    "ConstantStepStrategy",
    "DOptimal",
    "Hierarchical",
    "IOptimal",
    "LeastSquares",
    "NotApplicable",
    "Predictor",
    "Strategy",
    "Thesis",
    "TipErrors",
    "WithCauses",
    "causes_from_other_sessions",
    "causes_from_result",
    "compare_strategies",
    "compute_tip_errors",
    "default_strategies",
    "default_strategies_with_causes",
    "earlier_sessions",
    "other_sessions",
    "save_comparison",
]


def __getattr__(name: str) -> Any:
    """What `tip_error` has: it loads the planning of moves, which a comparison does without."""
    if name in __all__:
        from stickslip_fit.strategies import tip_error

        return getattr(tip_error, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
