"""What `bayes` returns: the result that every estimator gives, and the draws behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.bayes.priors import Priors
from stickslip_fit.fit.bayes.tree import branch_name
from stickslip_fit.fit.result import Result
from stickslip_fit.fit.summary import summary

if TYPE_CHECKING:
    from xarray import Dataset, DataTree

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posterior:
    """A log fitted by Bayes.

    Attributes
    ----------
    result : Result
        Posterior means and covariances of each session's parameters, with intervals between quantiles.
    tree : DataTree
        For each joint and direction a branch, ``tree["joint_3_plus"]``, that ArviZ takes as it is.
    priors : Priors
    diagnostics : DataFrame
        joint, direction, parameter, session (empty for the campaign), r_hat, ess_bulk, ess_tail, k_hat.
    """

    result: Result
    tree: DataTree
    priors: Priors
    diagnostics: pd.DataFrame

    def __str__(self) -> str:
        worst = self.diagnostics
        quality = (
            f"R-hat up to {worst['r_hat'].max():.4f}, at least {worst['ess_bulk'].min():.0f} "
            f"effective draws, k-hat up to {worst['k_hat'].max():.2f}"
        )
        return f"{summary(self.result)}\n\n{quality}\n\nPriors\n{self.priors}"

    def branch(self, joint: int, direction: str) -> DataTree:
        """The tree's branch for a joint and direction."""
        return cast("DataTree", self.tree[branch_name(joint, direction)])

    @property
    def groups(self) -> list[tuple[int, str]]:
        """Joints and directions fitted."""
        return list(self.priors.of)

    def draws(self, joint: int, direction: str, name: str) -> Array:
        """Draws of mean, spread, repeatability or parameters, chains end to end; shape (d, ...), SI."""
        posterior: Dataset = self.branch(joint, direction)["posterior"].to_dataset()
        values = posterior[name].to_numpy()
        return values.reshape(-1, *values.shape[2:])

    def sessions(self, joint: int, direction: str) -> list[str]:
        """Sessions that have traverses of a joint in a direction."""
        return [str(each) for each in self.branch(joint, direction)["posterior"]["session"].to_numpy()]
