"""What `bayes` returns: the result that every estimator gives, and the draws behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._summary import Section, Summarized, Summary
from stickslip_fit.fit.bayes.means import BOUNDS
from stickslip_fit.fit.bayes.priors import Priors
from stickslip_fit.fit.bayes.tree import branch_name
from stickslip_fit.fit.result import AxesOf, Result

if TYPE_CHECKING:
    from xarray import Dataset, DataTree

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Summarized):
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

    def summary(self) -> Summary:
        """As a result's, with how good the draws are, and the priors."""
        of_result = self.result.summary()
        return replace(
            of_result,
            headline=(f"{self.quality}.", *of_result.headline),
            sections=(*of_result.sections, Section(tables=self.priors.tables())),
        )

    @property
    def parameters(self) -> pd.DataFrame:
        """See `Result.parameters`; means of the draws, and intervals between their quantiles."""
        return self.result.parameters

    def plot_corner(self, joint: int, direction: str, session: str | None = None) -> AxesOf:
        """Draws of a session's parameters, the latest session's unless named, two by two; the prior behind.

        Raises
        ------
        InputError
            If there is no such session, joint or direction, or its draws have not converged.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.corner import plot_draws

        return panels(plot_draws(self, joint, direction, session))

    def plot_forest(self, joint: int) -> AxesOf:
        """Every session's parameters of a joint beside the campaign's mean.

        Raises
        ------
        InputError
            If the joint was not fitted.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.forest import plot_forest

        return panels(plot_forest(self.result, joint, self.campaign_means()))

    def plot_control(self) -> AxesOf:
        """See `Result.plot_control`."""
        return self.result.plot_control()

    @property
    def quality(self) -> str:
        """How good the draws are, in a line."""
        worst = self.diagnostics
        return (
            f"R-hat up to {worst['r_hat'].max():.4f}, at least {worst['ess_bulk'].min():.0f} "
            f"effective draws, k-hat up to {worst['k_hat'].max():.2f}"
        )

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Steps and step size for traverses of fitted sessions and new ones; see `bayes.predict.predict`."""
        from stickslip_fit.fit.bayes.predict import predict

        return predict(self, rows)

    def campaign_means(self) -> pd.DataFrame:
        """Means that the sessions' parameters scatter about; what is not known is not listed.

        Returns
        -------
        DataFrame
            name, joint, direction, estimate, low, high (95 %), SI.
        """
        tables = []
        for joint, direction in self.groups:
            fit, names = self.result.joints[joint], list(self.priors.prior(joint, direction).names)
            mean = self.draws(joint, direction, "mean")[:, : len(names)]
            low, high = np.quantile(mean, BOUNDS, axis=0)
            columns = {"estimate": mean.mean(axis=0), "low": low, "high": high}
            table = pd.DataFrame({"name": names, "joint": joint, "direction": direction} | columns)
            known = fit.known[(fit.groups["direction"] == direction).to_numpy(), : len(names)]
            tables.append(table[known.any(axis=0)])
        return pd.concat(tables, ignore_index=True)

    def branch(self, joint: int, direction: str) -> DataTree:
        """The tree's branch for a joint and direction."""
        return cast("DataTree", self.tree[branch_name(joint, direction)])

    @property
    def groups(self) -> list[tuple[int, str]]:
        """Joints and directions fitted."""
        return list(self.priors.of)

    def draws(self, joint: int, direction: str, name: str) -> Array:
        """Draws of mean, spread, repeatability or parameters, chains end to end; shape (d, ...), SI."""
        return self._drawn(joint, direction, "posterior", name)

    def prior_draws(self, joint: int, direction: str, name: str) -> Array:
        """As `draws`, before the counts were seen; fewer of them."""
        return self._drawn(joint, direction, "prior", name)

    def _drawn(self, joint: int, direction: str, group: str, name: str) -> Array:
        dataset: Dataset = self.branch(joint, direction)[group].to_dataset()
        values = dataset[name].to_numpy()
        return values.reshape(-1, *values.shape[2:])

    def sessions(self, joint: int, direction: str) -> list[str]:
        """Sessions that have traverses of a joint in a direction."""
        return [str(each) for each in self.branch(joint, direction)["posterior"]["session"].to_numpy()]
