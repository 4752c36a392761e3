"""What a comparison could have shown: power of its F test, by the noncentral F distribution."""

from __future__ import annotations

import numpy as np

from stickslip_fit.anova.comparison import Comparison, level_means
from stickslip_fit.anova.effect import difference_factor

LEVEL, POWER = 0.05, 0.80


def power(noncentrality: float, freedom: tuple[int, int], level: float = LEVEL) -> float:
    """Probability that the F test rejects.

    Parameters
    ----------
    noncentrality : float
        Sum of squares of the true level means within blocks over the error's variance.
    freedom : tuple of (int, int)
    level : float, optional

    Examples
    --------
    >>> round(power(0.0, (1, 4)), 6)
    0.05
    """
    from statsmodels.stats.power import ftest_power_f2

    return float(ftest_power_f2(noncentrality / sum(freedom), *freedom, level, ncc=0))


def noncentrality(difference: float, spread: float, comparison: Comparison) -> float:
    """The smallest noncentrality when two levels differ by `difference`.

    It arises for the two levels that are known least, with all others where they help least.
    """
    _, factor = level_means(np.zeros(len(comparison.level)), comparison)
    return (difference / spread) ** 2 / float(difference_factor(factor).max())


def smallest_difference(spread: float, comparison: Comparison) -> float:
    """The smallest difference between two levels that shows at 5 % in 80 of 100 such comparisons.

    Parameters
    ----------
    spread : float
        Standard deviation of the error.
    comparison : Comparison

    Examples
    --------
    >>> from stickslip_fit.anova.comparison import compare
    >>> two_days_of_three = compare(list("aaabbb"))
    >>> round(smallest_difference(1.0, two_days_of_three), 3)
    3.071
    """
    from scipy.optimize import brentq

    # FTestPower.solve_power stops within 1e-5 of the root, and FTestPowerF2's stays at its start for few df.
    most = 10.0
    while power(most, comparison.freedom) < POWER:
        most *= 4.0
    wanted = float(brentq(lambda size: power(size, comparison.freedom) - POWER, 1e-6, most, rtol=1e-10))
    return spread * float(np.sqrt(wanted / noncentrality(1.0, 1.0, comparison)))
