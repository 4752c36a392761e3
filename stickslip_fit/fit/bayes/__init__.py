"""Hierarchical Bayes: each session's parameters drawn from a campaign's."""

from stickslip_fit.fit.bayes.checks import leave_one_out, predictive_check, predictive_p_values
from stickslip_fit.fit.bayes.estimate import bayes
from stickslip_fit.fit.bayes.netcdf import load_posterior, save_posterior
from stickslip_fit.fit.bayes.posterior import Posterior
from stickslip_fit.fit.bayes.predict import predict
from stickslip_fit.fit.bayes.priors import Prior, Priors, weak_prior, weak_priors

__all__ = [
    "Posterior",
    "Prior",
    "Priors",
    "bayes",
    "leave_one_out",
    "load_posterior",
    "predict",
    "predictive_check",
    "predictive_p_values",
    "save_posterior",
    "weak_prior",
    "weak_priors",
]
