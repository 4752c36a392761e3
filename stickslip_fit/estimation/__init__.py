"""Estimators: closed form and least squares, one result."""

from stickslip_fit.estimation import _summary as _summary  # registers how results are summarized
from stickslip_fit.estimation import _table_summary as _table_summary
from stickslip_fit.estimation.closed_form import fit_closed_form, solve_calibration
from stickslip_fit.estimation.drive_ratio import RatioProfile, physical_law, profile_ratio
from stickslip_fit.estimation.least_squares import fit_least_squares
from stickslip_fit.estimation.load_coefficient import (
    iterate_load_coefficient,
    load_coefficient_from_quadratic,
    solve_load_coefficient,
)
from stickslip_fit.estimation.noise import Flag, NoiseLevel
from stickslip_fit.estimation.prediction import (
    HeldOutErrors,
    fit_constant_step,
    held_out_errors,
    summarize_errors,
)
from stickslip_fit.estimation.result import JointFit, Result
from stickslip_fit.estimation.saved_result import load_result
from stickslip_fit.estimation.saved_table_fit import load_table_fit
from stickslip_fit.estimation.table_fit import TableFit

__all__ = [
    "Flag",
    "HeldOutErrors",
    "JointFit",
    "NoiseLevel",
    "RatioProfile",
    "Result",
    "TableFit",
    "fit_closed_form",
    "fit_constant_step",
    "fit_least_squares",
    "held_out_errors",
    "iterate_load_coefficient",
    "load_coefficient_from_quadratic",
    "load_result",
    "load_table_fit",
    "physical_law",
    "profile_ratio",
    "solve_calibration",
    "solve_load_coefficient",
    "summarize_errors",
]
