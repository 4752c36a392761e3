"""Smooth functions in the law: their fit is that of a Gaussian process, and so is their evidence."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from stickslip_fit.causes import CauseParameter
from stickslip_fit.causes.proposed import LOAD, POSITION, TRANSVERSE_LOAD, ZETA, SmoothTerm
from stickslip_fit.causes.smooth import LinearFactor, cosines, prior_sds
from stickslip_fit.diagnosis.hypotheses import compute_changes
from stickslip_fit.diagnosis.linearized import linearize_fit
from stickslip_fit.diagnosis.problem import problem_from_log
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

SD = prior_sds(0.15)


@dataclass(frozen=True)
class WithTheHour(LinearFactor):
    """Steps follow the time in the session smoothly."""

    hours: float = 1.0
    amplitude: float = np.inf
    parameters: tuple[CauseParameter, ...] = field(init=False)

    name = "with-the-hour"
    phrase = "steps follow the hour"
    physics = "Of a test."
    shows_best = "any traverse"
    null_values, scale = (0.0,) * len(SD), (0.01,) * len(SD)
    columns = ("session_seconds",)

    def __post_init__(self):
        parameters = tuple(
            CauseParameter(f"f{k}", "%", "coefficient", prior_sd=self.amplitude * sd)
            for k, sd in enumerate(SD, start=1)
        )
        object.__setattr__(self, "parameters", parameters)

    def functions(self, state):
        return cosines(state.column("session_seconds") / 3600, 0.0, self.hours, len(SD))


@pytest.fixture(scope="module")
def log_problem():
    return problem_from_log(read_hidden(hide("thesis", seed=4)))[0]


def test_a_penalised_fit_is_the_ridge_solution_and_without_a_prior_least_squares(log_problem):
    hours = float(log_problem.rows["session_seconds"].max() / 3600)
    for amplitude in (1e-3, 1e-2, np.inf):
        cause = WithTheHour(hours, amplitude)
        fit = log_problem.fit_extended([cause], np.zeros(len(SD)))
        assert fit.converged
        # Gauss-Newton from the solution does not move: its gradient, penalty included, is zero.
        plain = linearize_fit(log_problem.table, log_problem.parts, log_problem.responses, log_problem.scale)
        slopes = np.zeros((len(log_problem), len(SD)))
        for part in fit.parts:
            jacobian = part.law.jacobian(log_problem.rows.iloc[part.rows], part.values)
            slopes[part.rows] = jacobian[:, -len(SD) :]
        whitened = plain.whiten(slopes)
        gradient = whitened.T @ (fit.residual / log_problem.scale) - fit.values / fit.prior_sd**2
        curvature = np.linalg.inv(fit.covariance)
        step = np.linalg.solve(curvature, gradient)
        np.testing.assert_allclose(step / np.sqrt(np.diag(fit.covariance)), 0.0, atol=0.01)
        projected = plain.project(whitened)
        expected = projected.T @ projected + np.diag(1.0 / fit.prior_sd**2)
        np.testing.assert_allclose(curvature, expected, rtol=0.05, atol=0.02 * np.abs(expected).max())


def test_a_tight_prior_leaves_nothing_to_project_out(log_problem):
    hours = float(log_problem.rows["session_seconds"].max() / 3600)
    width = {}
    for amplitude in (1e-7, 1e-3, 1.0):
        fit = log_problem.fit_extended([WithTheHour(hours, amplitude)], np.zeros(len(SD)))
        width[amplitude] = log_problem.linearize_extended(fit).basis.shape[1]
    plain = log_problem.linearize().basis.shape[1]
    assert plain == width[1e-7] <= width[1e-3] <= width[1.0] == plain + len(SD)


def test_slopes_in_closed_form_are_those_of_differences(log_problem):
    cause, rng = WithTheHour(5.0, 0.01), np.random.default_rng(2)
    (part, *_) = log_problem.parts
    rows, law = log_problem.rows.iloc[part.rows], cause.extend(part.law)
    values = np.concatenate([part.values, np.full((len(rows), len(SD)), 0.01)], axis=1)
    slopes = law.jacobian(rows, values)
    for k in rng.choice(len(SD), 3, replace=False):
        step = 1e-5 * np.eye(values.shape[1])[part.values.shape[1] + k]
        rise = law.predict(rows, values + step) - law.predict(rows, values - step)
        np.testing.assert_allclose(slopes[:, part.values.shape[1] + k], rise / 2e-5, rtol=1e-6, atol=1e-9)
    changes = cause.changes(
        part.law, {name: rows[name].to_numpy() for name in rows}, part.values, np.eye(len(SD))
    )
    small = np.concatenate([part.values, np.full((len(rows), len(SD)), 1e-6)], axis=1)
    np.testing.assert_allclose(
        changes.sum(axis=1),
        (law.predict(rows, small) - part.law.predict(rows, part.values)) / 1e-6,
        rtol=1e-3,
        atol=1e-5,
    )


@pytest.mark.parametrize("carrier", [POSITION, ZETA, LOAD, TRANSVERSE_LOAD])
@pytest.mark.parametrize("joint", [1, 2])
def test_a_function_is_averaged_along_the_traverse(joint, carrier):
    """By hand: the step size hardly changes along a traverse, and an effect counts alike everywhere."""
    problem = problem_from_log(read_hidden(hide("many", seed=4)))[0]
    linearized, size = problem.linearize(), 1e-4
    changes = compute_changes(linearized, SmoothTerm((carrier,), ((-4.0, 4.0),)), np.array([[size]]))[:, 0]
    rows = problem.rows[(problem.rows["joint"] == joint).to_numpy()]
    along = rows["start"].to_numpy()[:, None] + np.ptp(rows[["start", "stop"]].to_numpy(), axis=1)[
        :, None
    ] * np.sign(rows["stop"] - rows["start"]).to_numpy()[:, None] * np.linspace(0.0, 1.0, 201)
    q1, q2 = (along if joint == own else rows[f"q{own}"].to_numpy()[:, None] for own in (1, 2))
    theta, psi = (rows[name].to_numpy()[:, None] for name in ("theta", "psi"))
    zeta = psi - q2
    values = {
        POSITION: along,
        ZETA: zeta + 0.0 * along,
        LOAD: {
            1: np.cos(theta) * np.sin(psi) * np.sin(q1) + np.sin(theta) * np.cos(q1),
            2: np.sin(zeta) * np.cos(theta),
        }[joint],
        TRANSVERSE_LOAD: {
            1: np.cos(theta) * np.sin(psi) * np.cos(q1) - np.sin(theta) * np.sin(q1),
            2: np.cos(zeta) * np.cos(theta),
        }[joint],
    }[carrier]
    by_hand = -np.cos(np.pi * (values + 4.0) / 8.0).mean(axis=1)
    acts = changes[(problem.rows["joint"] == joint).to_numpy()] / size
    known = np.isfinite(by_hand) & (np.ptp(along, axis=1) < np.pi / 2)
    assert known.sum() > 20
    np.testing.assert_allclose(acts[known], by_hand[known], atol=0.05)


def test_functions_are_computed_once_however_often_a_model_is_asked(log_problem, monkeypatch):
    asked, functions = [], WithTheHour.functions
    monkeypatch.setattr(
        WithTheHour, "functions", lambda self, state: asked.append(1) or functions(self, state)
    )
    (part, *_) = log_problem.parts
    model = WithTheHour(5.0, 0.01).extend(part.law).model(log_problem.rows.iloc[part.rows])
    values = np.concatenate([part.values, np.full((len(part.rows), len(SD)), 0.01)], axis=1)
    first, _ = model(values)
    once = len(asked)
    again, _ = model(0.99 * values)
    assert len(asked) == once
    assert np.all(again != first)


@pytest.mark.slow
def test_changes_need_no_derivatives_by_causes_that_are_in_the_law_already(log_problem, monkeypatch):
    """Fine ones, of which some traverses need more panels than others, have hundreds of parameters."""
    rng, cause = np.random.default_rng(1), WithTheHour(5.0, 0.01)
    (part, *_) = (one for one in log_problem.parts if one.law.joint == 3)
    rows = log_problem.rows.iloc[part.rows]
    start = np.where(np.arange(len(rows)) % 2, rows["start"], 0.9 * rows["stop"])  # long ones and short ones
    rows = {**{name: rows[name].to_numpy() for name in rows}, "start": start}
    fine = SmoothTerm(("position",), ((0.0, 0.012),), tuple((k,) for k in range(1, 41)), (0.01,) * 40)
    law = fine.extend(part.law)
    values = np.concatenate([part.values, np.tile(0.01 * rng.standard_normal(40), (len(start), 1))], axis=1)
    whole = np.concatenate([values, np.zeros((len(start), len(SD)))], axis=1)
    expected = cause.extend(law).jacobian(rows, whole)[:, -len(SD) :]

    def refuse(*_):
        raise AssertionError("derivatives by the fine function are asked for")

    monkeypatch.setattr(SmoothTerm, "factor_slopes", refuse)
    np.testing.assert_array_equal(cause.changes(law, rows, values, np.eye(len(SD))), expected)


def test_noise_is_taken_from_the_diagnosis_only_in_a_joint_with_more_coefficients_than_traverses(log_problem):
    problem = replace(log_problem, noise_ratio=np.full(len(log_problem), 2.0))
    fine = SmoothTerm(("q3",), ((0.0, 0.012),), tuple((k,) for k in range(1, 201)), (0.01,) * 200)
    number = {part.law.joint: len(part.rows) for part in problem.parts}
    assert max(number.values()) < 400
    of_one = problem.noise_beside([replace(fine, on=((3, "+"), (3, "-")))])
    assert set(of_one) == {(3, "+"), (3, "-")}
    group = problem.noise_group[(problem.rows["joint"] == 3) & (problem.rows["direction"] == "-")]
    assert of_one[3, "-"] == pytest.approx(2.0 * problem.repeatability[group[0]])
    assert {joint for joint, _ in problem.noise_beside([fine])} == set(number)
    assert problem.noise_beside([replace(fine, orders=((1,),), sds=(0.01,))]) == {}
