"""A cause that other forms of the selected ones cover.

What selected causes leave is tested without what their other forms describe, since the form that was fitted
may not be the true one (`extension.alternative_forms`). A second effect that resembles these would never
show: of a body that falls in air, the camera's distortion bends the curve much as another kind of drag does.
So where such forms take up more of the residuals than of noise, each cause is weighed against them. The
other way round, a function without a name may be all but covered by the causes: it would only undo what they
say. A cause that is found beside such a function, but whose size the two together leave open, is not named.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri, fdtrc

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.cause_set import CAUSE_SET_LOG_BAYES_FACTOR, form_cause_set
from stickslip_fit.diagnosis.extension import (
    Extension,
    SelectedCause,
    alternative_forms,
    compute_evidence,
    make_selected,
    name_explained,
    try_extension,
    weigh_causes,
)
from stickslip_fit.diagnosis.hypotheses import Hypothesis, compute_finite_effects, make_hypothesis
from stickslip_fit.diagnosis.influence import assess_support
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.misfit import UNKNOWN, drop_single_rows, weigh_evidence
from stickslip_fit.diagnosis.refits import MAX_REFIT_GAIN, advantage, refit_likeliest
from stickslip_fit.units import CREDIBLE

MIN_COVERED = 0.5  # of a cause's effect; of any other the test without the forms has told
# Share of a function's square that it adds to a law whose causes take back the rest. One with less has a
# variance inflation factor of 10, which counts as collinear (D. W. Marquardt, Technometrics 12:591, 1970).
MIN_ADDED = 0.1


def find_covered(extension: Extension, level: float) -> tuple[SelectedCause, Extension] | None:
    """A cause that explains what other forms of the selected ones take up, and the law with it.

    The forms have to take up more than of noise at `level` (an F test). The cause has to be likelier than
    any other structure without a name, nearly as likely as they are or more, and the law with it likelier by
    the logarithm of the number of causes over `level`.
    """
    problem, plain, without_forms = extension.problem, extension.plain, extension.linearized
    selected = extension.causes
    if any(one.cause == UNKNOWN for one in selected):
        return None
    p_value = _test_forms(plain, without_forms)
    if not p_value < level:
        return None
    forms = [
        make_hypothesis(UNKNOWN, None, None, plain.project(alternative_forms(plain, one))) for one in selected
    ]
    of_forms = weigh_evidence(plain, drop_single_rows([one for one in forms if one is not None])).log_evidence
    least = float(of_forms.max(initial=-np.inf)) - CAUSE_SET_LOG_BAYES_FACTOR
    names = name_explained(selected)
    effects = compute_finite_effects(plain, [one for one in problem.causes if one.name not in names])
    # In a sampled signal a refit changes the noise, and with it the evidence by any amount.
    if problem.autocorrelation is None:
        of_causes = weigh_causes(plain, effects).values()
        if max(of_causes, default=-np.inf) < least - MAX_REFIT_GAIN:
            return None
    test = compute_evidence(plain, problem, names, effects)
    if not test.hypotheses:
        return None
    refits = refit_likeliest(problem, selected, test)
    following = make_selected(refits.misfit, form_cause_set(refits.misfit), refits.starts)
    if following.cause == UNKNOWN:
        return None
    if following.test.log_evidence_by_cause[following.cause] < least:
        return None
    shape = following.test.best_hypothesis(following.cause)
    if not isinstance(shape, Hypothesis) or _share_covered(shape, plain, without_forms) < MIN_COVERED:
        return None
    if assess_support(plain, following.test, following.cause).too_narrow:
        return None
    both = [*selected, following]
    extended = refits.extension_with(both) or try_extension(problem, both)
    if extended is None:
        return None
    # Of a likelihood ratio K of one among so many causes the chance is at most their number over K.
    chance = len(test.log_evidence_by_cause) * float(np.exp(-max(advantage(extended, extension), 0.0)))
    if chance >= level:
        return None
    return replace(following, p_value=max(p_value, chance)), extended


def is_collinear(before: Extension, after: Extension) -> bool:
    """Whether the last cause in a law, a function without a name, is nearly taken back by the other causes.

    `before` is the extension without it, `after` that with it. Sizes of such causes would be anything, and
    nothing would tell how much of the function is real.
    """
    if len(after.causes) < 2:
        return False
    fit, number = after.fit, len(after.causes[-1].start)
    linearized, slopes = after.problem.linearize_causes(fit)
    function = slopes[:, len(fit.values) - number :] @ fit.values[len(fit.values) - number :]
    added = linearized.whiten(before.fit.residual - fit.residual)
    return float(added @ added) < MIN_ADDED * float(function @ function)


def is_open(after: Extension) -> bool:
    """Whether the last cause in a law may be of either sign or absent, beside a function without a name.

    The function, which bends as the data ask, then does as well what the cause would.
    """
    last = after.causes[-1]
    if last.cause == UNKNOWN or all(one.cause != UNKNOWN for one in after.causes):
        return False
    number, version = len(last.start), last.version
    sizes = slice(number) if version.combine_trials else slice(1)
    values = (after.fit.values[-number:] - np.array(version.null_values))[sizes]
    covariance = after.fit.covariance[-number:, -number:][sizes, sizes]
    wald = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)
    return wald < float(chdtri(len(values), 1.0 - CREDIBLE))


def _test_forms(plain: LinearizedFit, without_forms: LinearizedFit) -> float:
    """p-value of the F test that forms which are projected out take up no more than noise."""
    number = without_forms.basis.shape[1] - plain.basis.shape[1]
    left = float(np.sum(without_forms.residual**2))
    taken = float(np.sum(plain.residual**2)) - left
    if not number or without_forms.df < 1 or left <= 0:
        return 1.0
    ratio = max(taken, 0.0) / number / (left / without_forms.df)
    return float(fdtrc(number, without_forms.df, ratio))


def _share_covered(shape: Hypothesis, plain: LinearizedFit, without_forms: LinearizedFit) -> float:
    """The share of an effect's square that forms take up which are projected out."""
    effects: Array = shape.directions * np.sqrt(shape.prior_share)
    left = np.sum(without_forms.project(effects) ** 2) / np.sum(plain.project(effects) ** 2)
    return 1.0 - float(left)
