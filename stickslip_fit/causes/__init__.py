"""Why the step size is not what the law says: one file a cause."""

from stickslip_fit.causes.cause import Cause, CauseParameter, CountCause, FactorCause, StateCause, TermCause
from stickslip_fit.causes.extended import ExtendedLaw, extend
from stickslip_fit.causes.library import covariates, library

__all__ = [
    "Cause",
    "CauseParameter",
    "CountCause",
    "ExtendedLaw",
    "FactorCause",
    "StateCause",
    "TermCause",
    "covariates",
    "extend",
    "library",
]
