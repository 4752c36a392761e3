"""The estimators behind one function each: `fit` by name of the method, `calibrate` as on the day."""

from __future__ import annotations

from typing import Any, Literal, overload

from stickslip_fit.bayes import Posterior, fit_bayes
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import Result, fit_closed_form, fit_least_squares
from stickslip_fit.estimation.noise import StudentT
from stickslip_fit.estimation.profile import flag_unlike_stretches
from stickslip_fit.laws import Laws
from stickslip_fit.logs import Log

METHODS = ("least-squares", "student-t", "closed-form", "bayes")


def calibrate(log: Log, *, laws: Laws | None = None, causes_from: Result | None = None) -> Result:
    """Calibrate every session and direction from the first traverse of each calibration configuration.

    Parameters
    ----------
    log : Log
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    causes_from : Result, optional
        Of another log: its causes are taken as known, with their uncertainty.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If the log has no usable traverse.

    See Also
    --------
    fit : all traverses instead of the first few.
    """
    return fit_closed_form(log, laws=laws, causes_from=causes_from)


@overload
def fit(log: Log, method: Literal["bayes"], *, laws: Laws | None = None, **options: Any) -> Posterior: ...


@overload
def fit(
    log: Log,
    method: Literal["least-squares", "student-t", "closed-form"] = ...,
    *,
    laws: Laws | None = None,
    **options: Any,
) -> Result: ...


def fit(
    log: Log, method: str = "least-squares", *, laws: Laws | None = None, **options: Any
) -> Result | Posterior:
    """Fit the laws of all joints to a log.

    Parameters
    ----------
    log : Log
    method : {"least-squares", "student-t", "closed-form", "bayes"}, optional
        Weighted least squares on log steps; the same with Student-t noise of 5 degrees of freedom, which a
        few outlying counts do not move; the closed form of `calibrate`; or a hierarchical Bayesian fit, in
        which the sessions share a campaign's distribution.
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    **options
        Those of `estimation.fit_least_squares` (causes, causes_from, shared, bounds, repeatability),
        `estimation.fit_closed_form` (causes_from) or `bayes.fit_bayes` (causes, priors, seed, ...).

    Returns
    -------
    Result or Posterior
        A Posterior has what a Result has, and the draws behind it.

    Raises
    ------
    InputError
        For a method that is none of these, or a log without a usable traverse.

    Examples
    --------
    >>> import stickslip_fit as ssf
    >>> ssf.fit("any log", method="least squares")
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: no method 'least squares'; choose one of least-squares, student-t, ...
    """
    if method == "least-squares":
        return flag_unlike_stretches(log, fit_least_squares(log, laws=laws, **options))
    if method == "student-t":
        heavy_tailed = fit_least_squares(log, laws=laws, likelihood=StudentT(), **options)
        return flag_unlike_stretches(log, heavy_tailed)
    if method == "closed-form":
        return fit_closed_form(log, laws=laws, **options)
    if method == "bayes":
        return fit_bayes(log, laws=laws, **options)
    raise InputError(f"no method {method!r}; choose one of {', '.join(METHODS)}")
