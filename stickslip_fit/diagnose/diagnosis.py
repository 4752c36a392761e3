"""What a diagnosis says: whether anything is wrong, what, how large, and what would tell more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Any, Literal

import pandas as pd

from stickslip_fit._summary import Summarized
from stickslip_fit.causes.parameters import SizedParameter
from stickslip_fit.diagnose.searching.search import Search
from stickslip_fit.fit.result import AxesOf
from stickslip_fit.units import Interval

Verdict = Literal["nothing wrong", "cause named", "cannot tell apart", "unknown cause"]


@dataclass(frozen=True)
class Gain:
    """Error on traverses that took no part, before and after extending the law; relative, rms.

    Attributes
    ----------
    baseline, extended : float
    noise_floor : float
        What even the true law would leave, rounding included.
    low, high : float
        95 % interval of baseline less extended for a fresh replicate of the campaign.
    by_session : DataFrame
        session, baseline, extended, traverses.
    """

    baseline: float
    extended: float
    noise_floor: float
    low: float
    high: float
    by_session: pd.DataFrame


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes
    ----------
    cause : str
    version : object or None
        The cause as it acts in this log.
    equivalent : tuple of str
        Causes that this log cannot tell from it.
    p_value : float
    joints : tuple of int
    effect : Interval
        Rms over all rows of the relative change in the count, recalibration taken out.
    parameters : tuple of SizedParameter
    gain : Gain or None
        From the findings before it to those with it.
    closest, share : str, float
        For ``unknown``: the cause that comes closest, and the share of the structure that it explains.
    carrier : str
        For ``unknown``: what the structure follows.
    traverses : DataFrame or None
        For misfires: those traverses, with `departure` (relative) from the law.
    """

    cause: str
    version: Any
    equivalent: tuple[str, ...]
    p_value: float
    joints: tuple[int, ...]
    effect: Interval
    parameters: tuple[SizedParameter, ...]
    gain: Gain | None = None
    closest: str = ""
    share: float = 0.0
    carrier: str = ""
    traverses: pd.DataFrame | None = None


@dataclass(frozen=True)
class NextTraverse:
    """A traverse worth making next; SI, NaN where it does not matter.

    Attributes
    ----------
    session : str
        ``new``, or one that is still going on.
    joint : int
    direction : str
    q1, q2, q3, theta, psi, start, stop : float
    repeats : int
    tells_apart : tuple of str
    note : str
        When to make it, where that matters.
    """

    session: str
    joint: int
    direction: str
    q1: float
    q2: float
    q3: float
    theta: float
    psi: float
    start: float
    stop: float
    repeats: int
    tells_apart: tuple[str, ...]
    note: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Summarized):
    """The answer, and what it rests on.

    Attributes
    ----------
    verdict : str
    findings : tuple of Finding
        Strongest first.
    p_value : float
        Of anything at all, corrected for everything that was searched.
    misfit : float
        Rms residual of the baseline.
    repeatability : float
        Root mean square over the rows of each row's own.
    inclusion : dict of str to float or None
        Probability that each cause is at work; None where the log cannot show it.
    untestable : dict of str to str
        Why the log cannot show a cause.
    gain, gain_new_session : Gain or None
    next_experiment : tuple of NextTraverse
    alpha : float
    seed : int
    seconds : float
    log_file, log_sha256 : str
    search : Search
        What all this follows from, for pictures.
    alike : tuple of (str, str)
        Causes of which the second can do in this log all that the first does, whatever the size.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    p_value: float
    misfit: float
    repeatability: float
    inclusion: Mapping[str, float | None]
    untestable: Mapping[str, str]
    gain: Gain | None
    gain_new_session: Gain | None
    next_experiment: tuple[NextTraverse, ...]
    alpha: float
    seed: int
    seconds: float
    log_file: str
    log_sha256: str
    search: Search
    alike: tuple[tuple[str, str], ...] = ()

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter of what was named, one row each.

        cause, name, joint, direction, session (None for one of the whole campaign), unit (the one people read
        it in), estimate, low, high: SI, 95 %.
        """
        columns = ["cause", "name", "joint", "direction", "session", "unit", "estimate", "low", "high"]
        rows = [
            (each.cause, one.name, one.joint, one.direction, one.session, one.unit, *astuple(one.size))
            for each in self.findings
            for one in each.parameters
        ]
        return pd.DataFrame(rows, columns=columns)

    @property
    def residuals(self) -> pd.DataFrame:
        """The log's rows with before and after, counts less the law's, relative.

        Before under the published law, after with all that was named in it; what recalibration absorbs is
        taken out, and counts that misfired are not among them.
        """
        first, last = self.search.bench.study(), self.search.study
        return self.search.bench.rows.assign(
            before=first.residual * first.scale, after=last.residual * last.scale
        )

    @property
    def ranking(self) -> pd.DataFrame:
        """Every cause that was asked about, likeliest first.

        cause, probability (NaN where the log cannot show it), untestable: why it cannot.
        """
        table = pd.DataFrame({"cause": list(self.inclusion), "probability": list(self.inclusion.values())})
        table["probability"] = table["probability"].astype(float)
        table["untestable"] = table["cause"].map(dict(self.untestable)).fillna("")
        return table.sort_values("probability", ascending=False, kind="stable", ignore_index=True)

    def plot_residuals(self, finding: int = 0) -> AxesOf:
        """What a finding explains: counts less the law before and after, over what carries it.

        Raises
        ------
        InputError
            If there is no such finding, or it has no shape.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.gains import plot_residuals

        return panels(plot_residuals(self, finding))

    def plot_ranking(self) -> AxesOf:
        """How likely each cause is, at each look at the residuals."""
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.ranking import plot_ranking

        return panels(plot_ranking(self))

    def plot_gain(self) -> AxesOf:
        """Errors on held-out traverses by session, before and after.

        Raises
        ------
        InputError
            If nothing was named, so that nothing was gained.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.gains import plot_gain

        return panels(plot_gain(self))
