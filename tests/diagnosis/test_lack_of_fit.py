"""What a law lacks: told from noise by replicates alone."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import csr_array

from stickslip_fit.diagnosis.effect_interval import LawEffect
from stickslip_fit.diagnosis.lack_of_fit import SHARES, UNNAMED_SHARES, LackOfFit
from stickslip_fit.diagnosis.linearized import LawBlock, LinearizedFit
from stickslip_fit.diagnosis.row_table import RowTable

CELLS, REPLICATES, STRENGTH = 120, 4, 25.0
N = CELLS * REPLICATES


@dataclass(frozen=True)
class JointLaw:
    """All that is asked of a log's law."""

    joint: int = 3


@pytest.fixture
def linearized():
    """Residuals of a law without parameters, so that nothing but cells and noise are in them."""
    cell = np.repeat(np.arange(CELLS), REPLICATES)
    rows = pd.DataFrame(
        {
            "session": "2012-03-05",
            "joint": 3,
            "direction": np.where(cell % 2, "+", "-"),
            "q1": 0.0,
            "q2": 0.01 * (cell // 2),
            "q3": np.nan,
            "theta": 0.0,
            "psi": 0.0,
            "start": 0.0,
            "stop": 0.012,
        }
    )
    part = LawBlock(JointLaw(), np.arange(N), np.zeros(N, np.intp), np.zeros((N, 0)))

    def make(residual, law=part):
        return LinearizedFit(RowTable(rows), (law,), np.full(N, 0.003), residual, csr_array((N, 0)), ())

    return make


def effect(changes):
    """Of a law, as long as `STRENGTH` says."""
    return LawEffect(STRENGTH * changes / np.linalg.norm(changes), changes, np.zeros((N, 0)), shrunk=False)


OF_CONFIGURATIONS = effect(np.repeat(np.cos(np.arange(CELLS)), REPLICATES))


def residuals(share, rng, tails=None):
    """Noise of variance 1, and differences between cells whose norm is a share of the effect's."""
    noise = (
        rng.standard_normal(N) if tails is None else rng.standard_t(tails, N) * np.sqrt((tails - 2) / tails)
    )
    differences = np.repeat(rng.standard_normal(CELLS), REPLICATES)
    return noise + share * STRENGTH * differences / np.linalg.norm(differences)


@pytest.mark.parametrize("tails", [None, 5.0])
@pytest.mark.parametrize(("share", "least", "most"), [(0.0, 0.0, 4.5), (0.25, 2.0, 8.5), (0.5, 10.0, 14.5)])
def test_the_norm_of_what_a_law_lacks_is_found(linearized, share, least, most, tails):
    """On average over logs, root mean square; true: 0, 6.2 and 12.5 standard deviations of the noise."""
    squares = []
    for seed in range(20):
        residual = residuals(share, np.random.default_rng(seed), tails)
        lack = LackOfFit.of(linearized(residual), OF_CONFIGURATIONS)
        squares.append(np.mean(lack.draw_squares(500, np.random.default_rng(0))))
    assert least < np.sqrt(np.mean(squares)) < most


def test_sums_of_squares_are_those_of_an_analysis_of_variance(linearized):
    residual = residuals(0.25, np.random.default_rng(1))
    lack, cells = LackOfFit.of(linearized(residual), OF_CONFIGURATIONS), residual.reshape(CELLS, REPLICATES)
    assert lack.within == pytest.approx(np.sum((cells - cells.mean(axis=1, keepdims=True)) ** 2))
    assert lack.between == pytest.approx(REPLICATES * np.sum(cells.mean(axis=1) ** 2))
    assert (lack.df_between, lack.df_within) == (CELLS, N - CELLS)


@pytest.mark.parametrize("shares", [SHARES, UNNAMED_SHARES])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_what_an_effect_of_the_order_of_replicates_lacks_stays_open(linearized, share, shares):
    """As much as was found, where nothing has a name, so that the size is open by 1.4 times."""
    of_order = effect(np.tile(np.linspace(-1.0, 1.0, REPLICATES), CELLS))
    lack = LackOfFit.of(linearized(residuals(share, np.random.default_rng(2))), of_order, shares)
    squares = lack.draw_squares(4000, np.random.default_rng(0))
    assert np.mean(squares == 0) == pytest.approx(0.5, abs=0.03)
    assert np.mean(squares) == pytest.approx(STRENGTH**2 * np.mean(np.square(shares)) / 2, rel=0.1)
    largest = np.quantile(np.sqrt(STRENGTH**2 + squares), 0.975) / STRENGTH
    assert largest == pytest.approx(np.hypot(1.0, shares[-1]), rel=0.02)


def test_a_table_without_configurations_is_not_asked(linearized):
    part = LawBlock(object(), np.arange(N), np.zeros(N, np.intp), np.zeros((N, 0)))
    assert LackOfFit.of(linearized(np.ones(N), part), OF_CONFIGURATIONS) is None
