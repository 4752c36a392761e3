"""Each session's parameters where sessions inform each other, without sampling.

A session with few traverses borrows from the campaign what its own counts leave open: its parameters are
drawn to the campaign's mean by as much as the spread between sessions allows (partial pooling; B. Efron
and C. Morris, Journal of the American Statistical Association 70:311, 1975).
"""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.bayes.marginal import expected_sessions, linearize_at_mode
from stickslip_fit.bayes.priors import Prior, build_group_data, weak_prior
from stickslip_fit.laws import StepLaw


@dataclass(frozen=True, eq=False)
class Pooling:
    """How much the sessions of a joint and direction say of each other.

    Attributes
    ----------
    prior : Prior
    levels : array, shape (p + 1,)
        Likeliest spread between sessions and repeatability; see `Prior.levels`.
    """

    prior: Prior
    levels: Array

    @classmethod
    def estimate(cls, law: StepLaw, rows: pd.DataFrame) -> Pooling:
        """From the traverses of a joint and direction, with a weak prior.

        Raises
        ------
        InputError
            If the joint would stall with the law's start values.
        """
        prior = weak_prior(law, rows)
        return cls(prior, linearize_at_mode(build_group_data(law, rows), prior)[1])

    def fit(self, law: StepLaw, rows: pd.DataFrame) -> pd.DataFrame:
        """Expected parameters, SI, one row for each session of the traverses.

        Parameters
        ----------
        law : StepLaw
            With the parameters of the one by which this was estimated.
        rows : DataFrame
            Traverses of the joint and direction; the campaign's mean is that of these alone.
        """
        traverses = build_group_data(law, rows)
        values = expected_sessions(traverses, self.prior, self.levels)
        return pd.DataFrame(values, traverses.groups.table["session"], list(self.prior.names))
