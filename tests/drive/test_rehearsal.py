"""A drive rehearsed: the table is the loop's and the manipulator's own, and 95 % means 95 %."""

import numpy as np
import pytest
from scipy.stats import chi2

import stickslip_fit as ssf
from stickslip_fit.errors import InputError

START = [0.2, -1.2, 0.004]
LOOP = [(0, 40, 0, 0), (4, 0, 40, 0), (8, 0, 0, 40), (12, 0, 0, 0)]


@pytest.fixture(scope="module")
def fitted():
    return ssf.fit(ssf.read_log("data/reference/campaign.csv"))


@pytest.fixture(scope="module")
def trace(fitted):
    """With advice as soon as the tip may be off by a micrometre."""
    return ssf.rehearse_drive(fitted, START, LOOP, tolerance=1e-6)


@pytest.mark.slow
def test_the_tip_goes_where_the_script_says(trace):
    """Within a step of a rotary joint along each axis."""
    table = trace.table
    moved = table[["x_mm", "y_mm", "z_mm"]].iloc[-1] - table[["x_mm", "y_mm", "z_mm"]].iloc[0]
    assert moved.to_numpy() == pytest.approx([0.16] * 3, abs=0.006)
    assert table["time_s"].iloc[-1] == pytest.approx(12.0, abs=0.2)
    assert (np.diff(table["radius_um"]) > -1e-3).all()
    assert table["error_um"].iloc[-1] < 2 * table["radius_um"].iloc[-1]


@pytest.mark.nightly
def test_errors_of_other_truths_are_as_large_as_their_covariance_says(fitted):
    """Each drive's squared error over its covariance is chi-square with 3 degrees of freedom.

    The sum over the drives lies between the ends of 99.8 % of its distribution.
    """
    drives = 16
    ends = [
        ssf.rehearse_drive(fitted, START, [(0, 30, 30, -30), (0.6, 0, 0, 0)], seed=k) for k in range(drives)
    ]
    errors = np.array([end.true_tips[-1] - end.states[-1].tip for end in ends])
    covariance = np.array([end.states[-1].tip_covariance for end in ends])
    squares = np.einsum("ni,ni->n", errors, np.linalg.solve(covariance, errors[..., None])[..., 0])
    low, high = chi2.ppf([0.001, 0.999], 3 * drives)
    assert low < squares.sum() < high
    assert len(set(squares)) == drives


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ([(0, 1, 2), (1, 0, 0)], "line 1: has 3 cells, not 4"),
        ([(0, 1, 2, 3)], "fewer than two lines"),
        ([(1, 1, 2, 3), (0, 0, 0, 0)], "line 2, column time_s.* increase"),
        ([(0, np.nan, 2, 3), (1, 0, 0, 0)], "column vx_um_s, value 'nan': give a number"),
    ],
)
def test_a_faulty_script_is_refused(fitted, script, said):
    with pytest.raises(InputError, match=said):
        ssf.rehearse_drive(fitted, START, script)


@pytest.mark.slow
def test_the_figure_has_the_moment_of_the_first_advice(trace):
    first = trace.table["time_s"][trace.table["advice"] != ""].iloc[0]
    axis = np.ravel(trace.plot())[0]
    assert any(np.allclose(line.get_xdata(), first) for line in axis.lines)
