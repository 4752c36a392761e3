"""Estimators: closed form and least squares, one result."""

from stickslip_fit.fit.accuracy import constant_step, errors, summarise
from stickslip_fit.fit.closed_form import calibrate, closed_form
from stickslip_fit.fit.least_squares import least_squares
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.repeatability import Repeatability
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.fit.save import load_result, save_result
from stickslip_fit.fit.solve_d import d_from_quadratic, iterate_d, solve_d

__all__ = [
    "JointFit",
    "Remark",
    "Repeatability",
    "Result",
    "calibrate",
    "closed_form",
    "constant_step",
    "d_from_quadratic",
    "errors",
    "iterate_d",
    "least_squares",
    "load_result",
    "save_result",
    "solve_d",
    "summarise",
]
