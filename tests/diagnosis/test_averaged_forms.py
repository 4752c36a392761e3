"""The average over the forms of a smooth function, against dense covariances and drawn functions."""

from itertools import product

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.causes.smooth import prior_sds
from stickslip_fit.diagnosis.averaged_forms import LEARNING_RATE, LENGTHS, SHARES, _Forms, average_forms
from stickslip_fit.diagnosis.evidence import WIDE_STRENGTHS, find_strength
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.logs import read_log
from stickslip_fit.machine import load_machine
from tests.diagnosis.test_beside_unknown import MACHINE

SESSIONS, NOISE, REACH = ("a", "b", "c"), 0.01, 360.0


def draw(rng: np.random.Generator, length: float, size: float) -> np.ndarray:
    """A function of every degree with a squared-exponential covariance, over 360 of them."""
    x = np.arange(361) / REACH
    covariance = np.exp(-((x[:, None] - x) ** 2) / (2 * length**2)) + 1e-8 * np.eye(361)
    return size * np.linalg.cholesky(covariance) @ rng.standard_normal(361)


def make_problem(folder, rng, functions, traverses=40):
    """Short traverses with log step sizes by session and direction."""
    rows = []
    for session, direction in product(SESSIONS, "+-"):
        low = rng.uniform(0, REACH - 20, traverses)
        middle = (low + 10).astype(int)
        count = 400 * np.exp(NOISE * rng.standard_normal(traverses) - functions[session, direction][middle])
        for first, number in zip(low, count, strict=True):
            ends = (first, first + 20) if direction == "+" else (first + 20, first)
            rows.append((session, 1, direction, round(number), 1, *ends))
    names = ["session", "joint", "direction", "steps", "check_every", "from_deg", "to_deg"]
    pd.DataFrame(rows, columns=names).round(3).to_csv(folder / "log.csv", index=False)
    (folder / "stage.toml").write_text(MACHINE, encoding="utf-8")
    log = read_log(folder / "log.csv", machine=load_machine(folder / "stage.toml"))
    return problem_from_log(log)[0]


def linearize(folder, rng, functions, traverses=40):
    """The linearized law of `make_problem`."""
    return make_problem(folder, rng, functions, traverses).linearize()


def term_of(linearized: LinearizedFit) -> SmoothTerm:
    """A function of the position, each session's own, as the search finds it."""
    reach, number = np.deg2rad(REACH), len(prior_sds(0.25))
    return SmoothTerm(
        ("position",),
        ((-0.15 * reach, 1.15 * reach),),
        tuple((k,) for k in range(1, number + 1)),
        (0.01,) * number,
        ((1, "+"), (1, "-")),
        sessions=SESSIONS,
    )


def variances(term):
    """By whether it is each session's own and whether opposite in directions."""
    return {(own, mode): np.square(sds) for own, mode, sds in term.parts}


@pytest.mark.parametrize(
    ("own", "mode"), [(False, "same"), (False, "opposite"), (True, "same"), (True, "opposite")]
)
def test_most_is_in_the_part_that_the_functions_have(tmp_path, own, mode):
    rng = np.random.default_rng(3)
    common, ways = draw(rng, 0.15, 0.3), {"+": 1.0, "-": 1.0 if mode == "same" else -1.0}
    days = {session: draw(rng, 0.15, 0.3) if own else common for session in SESSIONS}
    functions = {(session, way): ways[way] * days[session] for session, way in product(SESSIONS, "+-")}
    linearized = linearize(tmp_path, rng, functions)
    found = variances(average_forms(term_of(linearized), linearized, linearized.residual))
    # What three sessions do not share may in part be shared: their mean.
    assert found[own, mode].sum() > 0.6 * sum(map(np.sum, found.values()))


@pytest.mark.slow
def test_it_is_the_average_over_all_forms_by_their_dense_covariances(tmp_path):
    """Evidence by determinants of (n, n) matrices, the noise estimated, of every form and strength."""
    rng = np.random.default_rng(5)
    alike = draw(rng, 0.1, 0.1)
    functions = {key: alike + draw(rng, 0.1, 0.05) for key in product(SESSIONS, "+-")}
    linearized = linearize(tmp_path, rng, functions, traverses=8)
    term = term_of(linearized)
    found = variances(average_forms(term, linearized, linearized.residual))

    n, residual, longest = len(linearized), linearized.residual, len(prior_sds(min(LENGTHS)))
    ends = linearized.rows[["start", "stop"]].to_numpy()
    (low, high), (nodes, weights) = term.limits[0], np.polynomial.legendre.leggauss(20)
    along = (ends.mean(axis=1)[:, None] + np.diff(ends) * nodes / 2 - low) / (high - low)
    waves = np.stack([np.cos(k * np.pi * along) @ weights / 2 for k in range(1, longest + 1)], axis=1)
    waves = -waves / linearized.scale[:, None]
    session = linearized.rows["session"].to_numpy(object)
    sign = linearized.direction_sign
    same_day, same_way = session[:, None] == session, np.outer(sign, sign)
    evidence, size = [], []
    for length, opposite, own in product(LENGTHS, SHARES, SHARES):
        sds = np.pad(prior_sds(length), (0, longest - len(prior_sds(length))))
        mask = ((1 - opposite) + opposite * same_way) * ((1 - own) + own * same_day)
        covariance = linearized.project(linearized.project(mask * ((waves * sds**2) @ waves.T)).T)
        total = np.trace(covariance)
        best = (-np.inf,)
        for strength in WIDE_STRENGTHS:
            whole = np.eye(n) + strength**2 / total * covariance
            quadratic = residual @ np.linalg.solve(whole, residual)
            log = -0.5 * np.linalg.slogdet(whole)[1] - 0.5 * linearized.df * np.log(
                quadratic / (residual @ residual)
            )
            best = max(best, (log, strength**2 / total * quadratic / linearized.df))
        evidence.append(best[0])
        parts = {(True, "same"): own * (1 - opposite), (True, "opposite"): own * opposite}
        parts |= {(False, "same"): (1 - own) * (1 - opposite), (False, "opposite"): (1 - own) * opposite}
        size.append({key: share * best[1] * sds**2 for key, share in parts.items()})
    weight = np.exp(LEARNING_RATE * (np.array(evidence) - max(evidence)))
    for key, own in found.items():
        expected = sum(w * one[key] for w, one in zip(weight, size, strict=True)) / weight.sum()
        assert own.sum() == pytest.approx(expected.sum(), rel=0.05)
        np.testing.assert_allclose(own[:5], expected[:5], rtol=0.1)


def test_functions_that_no_row_has_together_are_weighed_as_by_one_covariance():
    """Those of two joints, with a common part and one of each of two sessions; a row is of no function."""
    rng, m = np.random.default_rng(6), 4
    joint, session = np.repeat([0, 1], 20), np.tile([0, 1], 20)
    waves = rng.standard_normal((40, m))
    waves[7] = 0.0
    common = ((joint[:, None] == [0, 1])[:, :, None] * waves[:, None]).reshape(40, -1)
    own = ((2 * joint + session)[:, None] == np.arange(4))[:, :, None] * waves[:, None]
    effects, prior = [common, own.reshape(40, -1)], np.array([1.0, 0.5, 0.3, 0.1])
    residual = common @ rng.standard_normal(2 * m) + rng.standard_normal(40)
    forms = _Forms(effects, [prior], residual, 30)
    for place, share in enumerate(SHARES):
        covariance = sum(
            part * (one * np.tile(prior, one.shape[1] // m) ** 2) @ one.T
            for part, one in zip((1.0 - share, share), effects, strict=True)
        )
        total = np.trace(covariance)
        logs = []
        for strength in WIDE_STRENGTHS:
            whole = np.eye(40) + strength**2 / total * covariance
            left = residual @ np.linalg.solve(whole, residual) / (residual @ residual)
            logs.append(-0.5 * np.linalg.slogdet(whole)[1] - 15.0 * np.log(left))
        assert forms.weigh((0, 0, place)).evidence == pytest.approx(max(logs), abs=1e-6)


def test_what_a_function_leaves_of_residuals_that_it_explains_is_not_lost_to_rounding():
    residual = np.random.default_rng(4).standard_normal(6)
    along, share = residual * (1.0 + 1e-8), np.full(6, 1 / 6)  # directions are orthonormal but for rounding
    found = find_strength(along, share, residual, 8)
    assert found.strength > 1000.0
    assert found.noise == pytest.approx(np.sum(residual**2 / (1.0 + found.strength**2 / 6)) / 8, rel=1e-6)
