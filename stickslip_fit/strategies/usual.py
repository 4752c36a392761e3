"""The strategies that a lab will want to see beside each other."""

from __future__ import annotations

from collections.abc import Mapping

from stickslip_fit.fit.known_causes import KnownCauses
from stickslip_fit.strategies.closed_form import ClosedForm, ConstantStep
from stickslip_fit.strategies.designs import AtRandom, DOptimal, IOptimal, Thesis
from stickslip_fit.strategies.hierarchical import Hierarchical
from stickslip_fit.strategies.least_squares import LeastSquares
from stickslip_fit.strategies.task import Strategy
from stickslip_fit.strategies.with_causes import WithCauses

MORE = 4


def causes_strategies(known: Mapping[str, KnownCauses | str], more: int = MORE) -> tuple[Strategy, ...]:
    """Two of the usual ones with causes of known size in the law; see `WithCauses`."""
    return (WithCauses(ClosedForm(), known), WithCauses(LeastSquares(IOptimal(), more), known))


def usual_strategies(more: int = MORE, seed: int = 0) -> tuple[Strategy, ...]:
    """The thesis's two, then least squares and Bayes on traverses chosen in several ways.

    Parameters
    ----------
    more : int, optional
        Traverses beyond the number of parameters, where least squares takes more.
    seed : int, optional
        Of those chosen at random.

    Examples
    --------
    >>> [strategy.name for strategy in usual_strategies()][:3]
    ['constant step', 'closed form', 'least squares, thesis +4']
    """
    return (
        ConstantStep(),
        ClosedForm(),
        LeastSquares(Thesis(), more),
        LeastSquares(AtRandom(seed), more),
        LeastSquares(DOptimal()),
        LeastSquares(DOptimal(), more),
        LeastSquares(IOptimal()),
        LeastSquares(IOptimal(), more),
        Hierarchical(1),
        Hierarchical(2),
    )
