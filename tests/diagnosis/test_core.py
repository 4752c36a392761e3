"""The arithmetic of the diagnosis, against written-out formulas and other libraries."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import csr_array
from scipy.stats import kstest, multivariate_normal, ncx2, norm

from stickslip_fit.causes import Drift, ThermalWarmUp
from stickslip_fit.diagnosis.effect_interval import noncentral_tail, strength_interval
from stickslip_fit.diagnosis.evidence import STRENGTHS, batch_hypotheses
from stickslip_fit.diagnosis.hypotheses import make_hypothesis
from stickslip_fit.diagnosis.linearized import fit_extended, linearize_fit
from stickslip_fit.diagnosis.memory import AR1, Sequences, log_memory_evidence
from stickslip_fit.diagnosis.misfit import compute_p_value, weigh_evidence
from stickslip_fit.diagnosis.noise import find_outliers
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.laws import Prismatic

NOISE = 0.003


def test_recalibration_is_what_least_squares_would_absorb(rows, parts, linearize):
    """Each block's slopes regressed out by numpy."""
    departure = 0.01 * np.random.default_rng(1).standard_normal(len(rows))
    linearized = linearize(departure)
    slopes = Prismatic().jacobian(rows, parts[0].values)
    left = departure.copy()
    for block in range(4):
        subset = parts[0].block == block
        found = np.linalg.lstsq(slopes[subset], departure[subset], rcond=None)[0]
        left[subset] -= slopes[subset] @ found
    assert linearized.residual == pytest.approx(left / NOISE, abs=1e-8)
    assert linearized.df == len(rows) - 12


def test_evidence_is_the_ratio_of_marginal_likelihoods(rows, linearize):
    """With the noise's size integrated out by brute force over a prior that favours none (1 / sigma)."""
    rng = np.random.default_rng(2)
    linearized = linearize(NOISE * rng.standard_normal(len(rows)))
    effect = linearized.project(rng.standard_normal((len(rows), 3)))
    shape = make_hypothesis("some", None, None, effect)
    found = float(batch_hypotheses([shape], linearized.df).log_evidence(linearized.residual[:, None])[0, 0])
    basis = np.linalg.svd(linearized.project(np.eye(len(rows))))[0][:, : linearized.df]
    along, directions = basis.T @ linearized.residual, basis.T @ shape.directions
    log_sigma = np.linspace(-0.5, 0.5, 401)
    each = []
    for strength in (0.0, *STRENGTHS):
        covariance = np.eye(linearized.df) + strength**2 * (directions * shape.prior_share) @ directions.T
        log = [multivariate_normal.logpdf(along, None, np.exp(2 * s) * covariance) for s in log_sigma[::40]]
        curve = np.polynomial.Polynomial.fit(log_sigma[::40], log, 6)(log_sigma)
        each.append(np.log(np.trapezoid(np.exp(curve - curve.max()), log_sigma)) + curve.max())
    expected = np.log(np.mean(np.exp(np.array(each[1:]) - each[0])))
    assert found == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("way", ["both", "one"])
@pytest.mark.parametrize("shared", [False, True])
def test_memory_is_judged_by_the_likelihood_of_what_calibration_leaves(rows, linearize, way, shared):
    """A multivariate normal in coordinates orthogonal to the calibration, its size at its best."""
    rng, n, carried = np.random.default_rng(3), len(rows), 0.5
    linearized = linearize(NOISE * rng.standard_normal(n))
    basis = linearized.basis
    if shared:
        column = linearized.project(np.linspace(-1.0, 1.0, n))
        basis = csr_array(np.column_stack([basis.toarray(), column / np.linalg.norm(column)]))
    residual = linearized.residual - basis @ (basis.T @ linearized.residual)
    forward = np.arange(n) % 2 == 0
    before = np.where(np.arange(n) % 100 == 0, -1, np.arange(n) - 1)
    step = np.zeros((n, n))
    step[before >= 0, before[before >= 0]] = carried
    start = np.where((before < 0) & (way == "both"), np.sqrt(1.0 - carried**2), 1.0)
    if way == "one":
        step[~forward] = 0.0
    root = np.linalg.inv(np.diag(start) - step)
    left = np.linalg.svd(basis.toarray())[0][:, basis.shape[1] :]

    def best(covariance):
        inside, along = left.T @ covariance @ left, left.T @ residual
        scale2 = along @ np.linalg.solve(inside, along) / len(along)
        return multivariate_normal.logpdf(along, None, scale2 * inside)

    memory = AR1("unknown:memory", Sequences.of(before, basis, forward if way == "one" else None), carried)
    found = float(log_memory_evidence([memory], residual[:, None], n - basis.shape[1])[0][0])
    assert found == pytest.approx(best(root @ root.T) - best(np.eye(n)), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("uneven", [pytest.param(False, marks=pytest.mark.nightly), True])
def test_the_p_value_is_even_where_nothing_is_wrong(rows, linearize, uneven):
    """150 logs under heavy tails, twice the noise in two configurations of five."""
    rng = np.random.default_rng(4)
    wide = np.where(uneven & (rows["q2"] < -1.0), 2.0, 1.0)
    shapes = np.stack([rows["session_seconds"] / 36_000, np.cos(3 * rows["q2"])], axis=-1)
    p_values = []
    for _ in range(150):
        linearized = linearize(NOISE * wide * rng.standard_t(5, len(rows)))
        tried = [make_hypothesis(f"{k}", None, None, linearized.project(shapes[:, [k]])) for k in range(2)]
        p_values.append(compute_p_value(weigh_evidence(linearized, tried), linearized, 199, rng).p_value)
    assert kstest(p_values, "uniform").pvalue > 0.01


def test_causes_are_refitted_with_the_law(rows, parts):
    """Twelve parameters of the law and two of a warm-up, against scipy on all of them at once."""
    rng = np.random.default_rng(5)
    seconds, block = rows["session_seconds"].to_numpy(), parts[0].block
    recoil, load = Prismatic().features(rows).T
    warm = -np.log(1 + 0.03 * -np.expm1(-seconds / 5000.0))
    responses = Prismatic().predict(rows, parts[0].values) + warm + NOISE * rng.standard_normal(len(rows))
    scale = np.full(len(rows), NOISE)
    found = fit_extended(RowTable(rows), parts, responses, scale, [ThermalWarmUp()], np.array([0.01, 1000.0]))

    def misfits(x):
        a, b, c = x[:4][block] * 1e-6, x[4:8][block], x[8:12][block] * 1e-6
        steps = np.log(0.012 / ((1 - b * recoil) * (a - c * load)))
        return (responses - steps + np.log(1 + x[12] * -np.expm1(-seconds / (1000 * x[13])))) / NOISE

    start = [0.95] * 4 + [0.3] * 4 + [0.4, -0.4] * 2 + [0.01, 1.0]
    other = least_squares(misfits, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    error = np.sqrt(np.diag(np.linalg.inv(other.jac.T @ other.jac)))[12:] * [1, 1000]
    assert found.converged
    assert found.values == pytest.approx(other.x[12:] * [1, 1000], rel=1e-3)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(error, rel=1e-2)


def test_what_is_left_under_a_refitted_cause_does_not_show_it_again(rows, parts, linearize):
    drift = -np.log(1 + 0.02 * rows["session_seconds"].to_numpy() / 36_000)
    responses = Prismatic().predict(rows, parts[0].values) + drift
    scale = np.full(len(rows), NOISE)
    before = linearize(drift)
    found = fit_extended(RowTable(rows), parts, responses, scale, [Drift()], np.array([1e-7]))
    after = linearize_fit(RowTable(rows), found.parts, responses, scale, shared=1)
    assert np.linalg.norm(before.residual) > 20
    assert np.linalg.norm(after.residual) < 1e-2


@pytest.mark.slow
def test_intervals_of_a_strength_cover_given_the_alarm():
    """10,000 effects of three sizes, seen only where they exceed a threshold."""
    rng, threshold = np.random.default_rng(6), 4.0
    for strength in (3.0, 5.0, 9.0):
        seen = np.abs(strength + rng.standard_normal(4000))
        seen = np.ceil(20 * seen[seen > threshold]) / 20
        lengths, counts = np.unique(seen, return_counts=True)
        intervals = [strength_interval(length, 1, threshold) for length in lengths]
        inside = np.array([each.low <= strength <= each.high for each in intervals])
        share = float(np.average(inside, weights=counts))
        assert share == pytest.approx(0.95, abs=0.005 + 3 * np.sqrt(0.05 * 0.95 / len(seen)))


@pytest.mark.parametrize("df", [1, 2, 20])
def test_the_tail_of_a_noncentral_chi_square_keeps_its_digits(df):
    for x, strength in ((0.1, 1e-6), (16.0, 0.1), (144.0, 1.0), (16.0, 8.0), (144.0, 22.0)):
        assert noncentral_tail(x, df, strength**2) == pytest.approx(ncx2.sf(x, df, strength**2), rel=1e-12)


@pytest.mark.slow
def test_misfires_are_found_and_heavy_tails_are_none(rows, linearize):
    rng = np.random.default_rng(7)
    drive = (rows["direction"] == "-").to_numpy().astype(np.intp)
    wild = norm.rvs(size=len(rows), random_state=rng) * NOISE
    wild[[17, 60, 121, 180]] += NOISE * np.array([14.0, -18.0, 16.0, -13.0])
    linearized = linearize(wild)
    found = find_outliers(linearized, linearized.residual, drive, 500, rng)
    assert found.p_value < 0.005
    assert set(found.rows) == {17, 60, 121, 180}
    alarms = 0
    for _ in range(40):
        linearized = linearize(NOISE * rng.standard_t(5, len(rows)))
        alarms += find_outliers(linearized, linearized.residual, drive, 200, rng).p_value < 0.01
    assert alarms <= 3


def test_a_fit_begins_at_the_size_and_sign_that_an_effect_seems_to_have(named):
    """A drift of -0.3 % an hour; what is looked for has the other sign."""
    (found,) = named.selection.selected
    assert found.start == pytest.approx(named.selection.fit.values, rel=0.1)
    assert found.start[0] < 0
