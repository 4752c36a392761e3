"""Two causes, one of each of the two columns that unknown structure follows.

A function of two columns has what each of them does alone in it, and where more columns act, the likeliest
function of the next two hides each of these in turn: chosen one after the other, causes of single columns
would never be likelier. So the two are weighed together against the function itself, of which their sum is a
special case; only what they do together beyond their sum speaks for it.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.special import logsumexp

from stickslip_fit.diagnosis.cause_set import CAUSE_SET_LOG_BAYES_FACTOR
from stickslip_fit.diagnosis.evidence import batch_hypotheses
from stickslip_fit.diagnosis.hypotheses import make_hypothesis
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, classify_cause


def find_column_pair(misfit: Misfit, df: int) -> tuple[str, str, float] | None:
    """Causes of the two columns that the likeliest unknown structure follows.

    Returns
    -------
    first, second : str
        The likelier one first.
    behind : float
        Nats by which the two lack being likely enough; negative if they are.
    None
        Where unknown structure does not follow two columns each of which has a cause.
    """
    unknown = misfit.best_hypothesis(UNKNOWN)
    carriers = tuple(getattr(unknown.version, "carriers", ()))
    causes = [cause for column in carriers if (cause := _cause_of(misfit, column)) is not None]
    if len(carriers) != 2 or len(causes) != 2:
        return None
    of_each = [[one for one in misfit.hypotheses if classify_cause(one) == cause] for cause in causes]
    effects = [[one.directions * np.sqrt(one.prior_share) for one in shapes] for shapes in of_each]
    pairs = [make_hypothesis("both", None, None, np.hstack(pair)) for pair in product(*effects)]
    tried = [unknown, *(one for one in pairs if one is not None)]
    own, *together = batch_hypotheses(tried, df).log_evidence(misfit.residual[:, None])[:, 0].tolist()
    pair = float(logsumexp(together)) - np.log(len(pairs)) if together else -np.inf
    first, second = sorted(causes, key=lambda cause: -misfit.log_evidence_by_cause[cause])
    return first, second, own - pair - CAUSE_SET_LOG_BAYES_FACTOR


def _cause_of(misfit: Misfit, column: str) -> str | None:
    """The likeliest cause that follows this column alone."""
    evidence = misfit.log_evidence_by_cause
    causes = [
        name
        for name in evidence
        if name != UNKNOWN and tuple(getattr(misfit.best_hypothesis(name).version, "columns", ())) == (column,)
    ]
    return max(causes, key=evidence.__getitem__, default=None)
