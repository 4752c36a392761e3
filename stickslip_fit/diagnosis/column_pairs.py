"""Causes of single columns in the place of unknown structure that follows two of them.

A function of two columns has what each of them does alone in it, and where more columns act, the likeliest
function of the next two hides each of these in turn: chosen one after the other, causes of single columns
would never be likelier. So two such causes are weighed together against the function itself, of which their
sum is a special case; only what they do together beyond their sum speaks for it. Where a cause of one of the
columns is in the law already, its form was chosen before the other column was, and the function mends it: the
cause of the new column comes first, and then forms are chosen anew.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import logsumexp

from stickslip_fit.causes.table_terms import SettingsTerm
from stickslip_fit.diagnosis.cause_set import CAUSE_SET_LOG_BAYES_FACTOR
from stickslip_fit.diagnosis.evidence import batch_hypotheses
from stickslip_fit.diagnosis.extension import SelectedCause
from stickslip_fit.diagnosis.hypotheses import Hypothesis, make_hypothesis
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, classify_cause

MIN_EVIDENCE_SHARE = 0.5  # of unknown structure, for the cause of its new column
MIN_SHARE_OF_SETTINGS = 0.25


@dataclass(frozen=True)
class ColumnPair:
    """Causes of the two columns that the likeliest unknown structure follows.

    Attributes
    ----------
    causes : tuple of str
        The likelier one first.
    behind : float
        Nats by which the two lack being likely enough; negative if they are.
    """

    causes: tuple[str, ...]
    behind: float


def find_column_pair(misfit: Misfit, df: int) -> ColumnPair | None:
    """The pair, None where unknown structure does not follow two columns each of which has a cause."""
    carriers = _columns_of_unknown(misfit)
    causes = [cause for column in carriers if (cause := _cause_of(misfit, column)) is not None]
    if len(carriers) != 2 or len(causes) != 2:
        return None
    of_each = [
        [one for one in misfit.hypotheses if isinstance(one, Hypothesis) and classify_cause(one) == cause]
        for cause in causes
    ]
    effects = [[one.directions * np.sqrt(one.prior_share) for one in shapes] for shapes in of_each]
    pairs = [make_hypothesis("both", None, None, np.hstack(pair)) for pair in product(*effects)]
    tried = [misfit.best_hypothesis(UNKNOWN), *(one for one in pairs if one is not None)]
    own, *together = batch_hypotheses(tried, df).log_evidence(misfit.residual[:, None])[:, 0].tolist()
    pair = float(logsumexp(together)) - np.log(len(pairs)) if together else -np.inf
    causes.sort(key=lambda cause: -misfit.log_evidence_by_cause[cause])
    return ColumnPair(tuple(causes), own - pair - CAUSE_SET_LOG_BAYES_FACTOR)


def find_new_column(misfit: Misfit, selected: Iterable[SelectedCause]) -> str | None:
    """The cause of a column that unknown structure follows beside columns of selected causes.

    Of settings of columns in none of these, the likeliest: in a designed experiment what a factor does alone
    comes before what it does together with others. None where the structure follows other columns, or where
    the cause has less of its evidence than `MIN_EVIDENCE_SHARE`, of settings `MIN_SHARE_OF_SETTINGS`.
    """
    known = {column for one in selected if one.cause != UNKNOWN for column in one.version.columns}
    carriers, evidence = _columns_of_unknown(misfit), misfit.log_evidence_by_cause
    new = [column for column in carriers if column not in known]
    if len(carriers) < 2 or not new:
        return None
    of_settings = isinstance(misfit.best_hypothesis(UNKNOWN).version, SettingsTerm)
    if len(new) > 1 and not of_settings:
        return None
    share = MIN_SHARE_OF_SETTINGS if of_settings else MIN_EVIDENCE_SHARE
    causes = [cause for column in new if (cause := _cause_of(misfit, column)) is not None]
    cause = max(causes, key=evidence.__getitem__, default="")
    return cause if cause and evidence[cause] > share * evidence[UNKNOWN] else None


def _columns_of_unknown(misfit: Misfit) -> tuple[str, ...]:
    """What the likeliest unknown structure follows; nothing where there is none."""
    if UNKNOWN not in misfit.log_evidence_by_cause:
        return ()
    return tuple(getattr(misfit.best_hypothesis(UNKNOWN).version, "carriers", ()))


def _cause_of(misfit: Misfit, column: str) -> str | None:
    """The likeliest cause that follows this column alone."""
    evidence = misfit.log_evidence_by_cause
    causes = [
        name
        for name in evidence
        if name != UNKNOWN
        and tuple(getattr(misfit.best_hypothesis(name).version, "columns", ())) == (column,)
    ]
    return max(causes, key=evidence.__getitem__, default=None)
