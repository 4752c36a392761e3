"""Hierarchical Bayes: each session's parameters drawn from a campaign's."""

from stickslip_fit.bayes.checks import leave_one_out, predictive_p_values
from stickslip_fit.bayes.estimator import fit_bayes
from stickslip_fit.bayes.posterior import Posterior, load_posterior
from stickslip_fit.bayes.priors import Prior, Priors, weak_prior, weak_priors

__all__ = [
    "Posterior",
    "Prior",
    "Priors",
    "fit_bayes",
    "leave_one_out",
    "load_posterior",
    "predictive_p_values",
    "weak_prior",
    "weak_priors",
]
