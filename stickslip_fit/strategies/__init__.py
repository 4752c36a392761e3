"""Calibration strategies compared: how much accuracy a traverse buys."""

from stickslip_fit.strategies.at_hand import earlier_sessions, other_sessions
from stickslip_fit.strategies.closed_form import ClosedForm, ConstantStep
from stickslip_fit.strategies.compare import compare
from stickslip_fit.strategies.comparison import Comparison
from stickslip_fit.strategies.designs import AtRandom, DOptimal, IOptimal, Thesis
from stickslip_fit.strategies.hierarchical import Hierarchical
from stickslip_fit.strategies.least_squares import LeastSquares
from stickslip_fit.strategies.numbers import save_numbers
from stickslip_fit.strategies.task import Predictor, Strategy, Task, Unsuited
from stickslip_fit.strategies.tip import TipErrors, steps_by, tip_errors
from stickslip_fit.strategies.usual import causes_strategies, usual_strategies
from stickslip_fit.strategies.with_causes import WithCauses, from_other_sessions, from_result

__all__ = [
    "AtRandom",
    "ClosedForm",
    "Comparison",
    "ConstantStep",
    "DOptimal",
    "Hierarchical",
    "IOptimal",
    "LeastSquares",
    "Predictor",
    "Strategy",
    "Task",
    "Thesis",
    "TipErrors",
    "Unsuited",
    "WithCauses",
    "causes_strategies",
    "compare",
    "earlier_sessions",
    "from_other_sessions",
    "from_result",
    "other_sessions",
    "save_numbers",
    "steps_by",
    "tip_errors",
    "usual_strategies",
]
