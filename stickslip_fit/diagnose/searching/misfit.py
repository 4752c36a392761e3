"""Is anything wrong at all? One number for everything that was searched.

If nothing is wrong, each residual is as likely to be above as below what the law says, whatever the noise's
tails and wherever it is larger: flipping signs at random makes further logs in which nothing is wrong. (E. S.
Edgington and P. Onghena, Randomization Tests, 4th ed., Chapman & Hall, 2007; J. L. Horowitz, Annu. Rev. Econ.
11:193, 2019, on the wild bootstrap.) Each is recalibrated and searched just as the log itself.

What is plainly wrong would be flipped with the noise and hide behind itself. It is taken out before, and
what is left of each row is divided by the share of its noise that stayed (the jackknife's residuals: J. G.
MacKinnon and H. White, J. Econometrics 29:305, 1985). Of an effect that shows in a few traverses alone that
would leave next to nothing, and the signs of a few say little: such an effect has to exceed what noise with
the heaviest tails that noise may have makes of a log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp

from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.noise.cleared import Cleared, cleared
from stickslip_fit.diagnose.searching.evidence import stack
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.shapes.memory import Memory

Array = npt.NDArray[np.float64]

UNKNOWN = "unknown"
LARGEST_LEVERAGE = 0.8
CONCENTRATED = 0.15  # share of an effect in one traverse, above which it shows in few alone
HEAVIEST = 5.0  # degrees of freedom
AT_A_TIME, NUMBERS = 500, 25_000_000  # flipped logs, and residuals in them


@dataclass(frozen=True, eq=False)
class Misfit:
    """How likely the residuals are by chance, and what each hypothesis makes of them.

    Attributes
    ----------
    residual : array, shape (n,)
    hypotheses : tuple of Hypothesis or Memory
    log_evidence : array, shape (H,)
    by_cause : dict of str to float
        Log evidence of each cause, averaged over its shapes.
    p_value : float
    null : array, shape (flips,)
        Log evidence, over everything, in logs in which nothing is wrong.
    times : float
        By how much `p_value` is larger than their share that looks worse than the log.
    """

    residual: Array
    hypotheses: tuple[Hypothesis | Memory, ...]
    log_evidence: Array
    by_cause: dict[str, float]
    p_value: float
    null: Array
    times: float = 1.0

    def critical(self, level: float) -> float:
        """Log evidence, over everything, that chance exceeds with probability `level`."""
        return float(np.quantile(self.null, 1.0 - level / self.times)) if len(self.null) else np.nan

    def best_of(self, cause: str) -> Hypothesis | Memory:
        """The likeliest shape of a cause."""
        mine = [k for k, each in enumerate(self.hypotheses) if kind_of(each) == cause]
        return self.hypotheses[max(mine, key=lambda k: self.log_evidence[k])]


def kind_of(hypothesis: Hypothesis | Memory) -> str:
    """The cause, or ``unknown`` for any structure."""
    return UNKNOWN if hypothesis.cause.startswith(f"{UNKNOWN}:") else hypothesis.cause


def misfit(
    study: Study,
    hypotheses: Sequence[Hypothesis | Memory],
    flips: int,
    rng: np.random.Generator,
    enough: int | None = None,
    times: float = 1.0,
) -> Misfit:
    """Judge the residuals of a study.

    Parameters
    ----------
    study : Study
    hypotheses : sequence of Hypothesis
    flips : int
        Logs in which nothing is wrong; 0 gives no p-value (NaN).
    rng : Generator
    enough : int, optional
        Of those, that look worse than the log itself, after which no more are made (J. Besag and P.
        Clifford, Biometrika 78:301, 1991).
    times : float, optional
        Makes the p-value that much larger, where the rows' weights were chosen by the same residuals.
    """
    together = stack(hypotheses, study.freedom)
    kinds = [kind_of(each) for each in hypotheses]
    weight = _weights(hypotheses, kinds)
    own = together.log_evidence(study.residual[:, None])[:, 0]
    each = {
        name: float(logsumexp((own + weight)[[kind == name for kind in kinds]]))
        for name in dict.fromkeys(kinds)
    }
    total, by_chance = float(logsumexp(list(each.values()))), np.zeros(0)
    noise = _noise(study, cleared(study.residual, hypotheses, own), rng)
    for first in range(
        0, flips, at_a_time := min(AT_A_TIME, max(NUMBERS // max(len(study), len(together.share)), 1))
    ):
        drawn = noise(min(at_a_time, flips - first))
        null = together.log_mean_evidence(study.project(drawn), weight)
        by_chance = np.concatenate([by_chance, null])
        if enough is not None and np.sum(by_chance >= total) >= enough:
            break
    share = (1 + int(np.sum(by_chance >= total))) / (1 + len(by_chance)) if flips else np.nan
    return Misfit(study.residual, tuple(hypotheses), own, each, min(times * share, 1.0), by_chance, times)


def _noise(study: Study, left: Cleared, rng: np.random.Generator) -> Callable[[int], Array]:
    """A maker of logs in which nothing is wrong, before recalibration: their number k -> (n, k)."""
    n = len(study)
    if left.leverage.max() > CONCENTRATED:
        return lambda number: rng.standard_t(HEAVIEST, (n, number))
    # As they were before recalibration, and what else was taken out, made them smaller.
    kept = (1.0 - left.leverage) * np.sqrt(1.0 - np.minimum(study.leverage, LARGEST_LEVERAGE))
    sizes = (left.residual / kept)[:, None]
    return lambda number: rng.choice([-1.0, 1.0], (n, number)) * sizes


def _weights(hypotheses: Sequence[Hypothesis | Memory], kinds: Sequence[str]) -> Array:
    """Log weight of each hypothesis in its cause: alike for all shapes, structures kind by kind."""
    families = [
        each.cause.split(" ")[0].removesuffix(",") if kind == UNKNOWN else kind
        for each, kind in zip(hypotheses, kinds, strict=True)
    ]
    sizes = {family: families.count(family) for family in families}
    structures = len({family for family in families if family.startswith(f"{UNKNOWN}:")})
    return -np.array(
        [
            np.log(sizes[family]) + (np.log(structures) if kind == UNKNOWN else 0.0)
            for family, kind in zip(families, kinds, strict=True)
        ]
    )
