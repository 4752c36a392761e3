"""Solvers of bristle friction: accuracy, limits, dynamics of foot and base; each by both solvers."""

from importlib.util import find_spec
from time import process_time

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.step import (
    Dahl,
    Elastoplastic,
    Foot,
    LuGre,
    RecoilBase,
    StepLimitError,
    coulomb_step,
    make_motion,
    solve_motion,
    spread_maxwell_slip,
)
from stickslip_fit.step._kernels import factorize, linearize, slope, solve
from stickslip_fit.step.ode import _constants

SOLVERS = [
    pytest.param("compiled", marks=pytest.mark.skipif(not find_spec("numba"), reason="needs numba")),
    "lsoda",
]
MOTION = make_motion("ramp", 3e-6, 1e-4, 5e-6, 2.65e-4)
MASS, FORCE, LOAD = 1e-3, 0.05, 9.81
HEAVY = RecoilBase(0.02, 400.0, 0.1)
MODELS = {
    "LuGre": LuGre(FORCE, 1.2 * FORCE, 1e-3, 1e6, 0.5, 0.1),
    "Dahl": Dahl(FORCE, 1e6, 1.5),
    "elastoplastic": Elastoplastic(FORCE, 1.2 * FORCE, 1e-3, 1e6, 0.5, 0.0, 2e-8),
    "Maxwell-slip": spread_maxwell_slip(FORCE, 1e6, 4, 0.5),
}


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_a_step_is_within_a_fiftieth_of_a_nanometre_of_a_much_tighter_solution(model, solver):
    usual = solve_motion(MOTION, MASS, model, LOAD, solver=solver)
    tight = solve_motion(MOTION, MASS, model, LOAD, solver=solver, relative=1e-10)
    # The compiled solver ends its steps where sliding changes sides and where an element slips.
    assert np.max(np.abs(usual.steps - tight.steps)) < (1e-4 if solver == "compiled" else 0.02) * 1e-9
    # A share of the tolerance, so that the reference is one; the step itself is some 270 nm.
    assert usual.steps[-1] > 200e-9


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("w", [2e-4, -0.03])
@pytest.mark.parametrize(
    ("foot", "base"), [(None, None), (Foot(1e-3, 6e4), None), (Foot(1e-3), HEAVY), (Foot(1e-3, 6e4), HEAVY)]
)
def test_the_linear_system_of_a_stage_is_that_of_the_equations_of_motion(model, w, foot, base):
    """The Jacobian by differences, and the derivative by time, against what the kernels solve."""
    has_piezo = foot is not None and foot.is_dynamic
    shape = has_piezo, base is not None, _constants(MASS, LOAD, foot, base)
    friction, command = (model.kind, model.parameters), np.array([1e-7, 0.02, 300.0])
    mechanical = 2 + 2 * has_piezo + 2 * (base is not None)
    y = 1e-3 * np.arange(1.0, mechanical + model.states + 1)
    y[mechanical:] = np.linspace(0.6, 1.3, model.states) * np.sign(w) * model.deflections
    foot_speed = y[3] if has_piezo else command[1] + command[2] * 1e-5
    y[1] = w + foot_speed + (y[mechanical - 1] if base is not None else 0.0)

    def rate(t, state):
        change = np.empty(len(y))
        slope(t, state, change, *shape, *friction, command, 0.0)
        return change

    scales = np.r_[np.tile([1e-7, 1e-3], mechanical // 2), model.deflections]
    by_state = np.column_stack(
        [
            (rate(1e-5, y + d) - rate(1e-5, y - d)) / (2e-5 * s)
            for s, d in zip(scales, np.diag(1e-5 * scales), strict=True)
        ]
    )
    bristles, by_time, factors = np.empty((4, model.states)), np.empty(len(y)), np.empty(9)
    by_speed = linearize(1e-5, y, *shape, *friction, command, np.sign(w), bristles, by_time)
    expected = (rate(1.001e-5, y) - rate(0.999e-5, y)) / 2e-8
    np.testing.assert_allclose(by_time, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    g, r = 3e5, np.r_[np.tile([0.01, 100.0], mechanical // 2), np.full(model.states, 1e-3)]
    factorize(g, *shape, bristles, by_speed, factors)
    solved = np.empty((1, len(y)))
    solve(r, solved, 0, *shape, bristles, factors)
    exact = np.linalg.solve(g * np.eye(len(y)) - by_state, r)
    np.testing.assert_allclose(solved[0], exact, rtol=1e-4)


@pytest.mark.skipif(not find_spec("numba"), reason="needs numba")
def test_stiffer_bristles_take_hardly_more_solver_steps_in_sliding():
    motion = make_motion("ramp", 3e-6, 1e-4, 1e-4)  # it never rests
    steps = [
        solve_motion(motion, MASS, LuGre(FORCE, 1.2 * FORCE, 1e-3, stiffness), periods=1).solver_steps
        for stiffness in (1e7, 1e9)
    ]
    assert steps[1] < 2 * steps[0] < 400


@pytest.mark.skipif(not find_spec("numba"), reason="needs numba")
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_solvers_that_share_no_method_agree(model):
    ours = solve_motion(MOTION, MASS, model, LOAD, solver="compiled", relative=1e-9)
    other = solve_motion(MOTION, MASS, model, LOAD, solver="lsoda", relative=1e-9)
    np.testing.assert_allclose(ours.steps, other.steps, atol=0.005e-9)


@pytest.mark.parametrize("solver", SOLVERS)
def test_lugre_tends_to_coulomb_as_the_bristles_stiffen(solver):
    exact = coulomb_step(MOTION, FORCE / MASS, LOAD)
    errors = []
    for stiffness in (1e6, 1e7, 1e8):
        model = LuGre(FORCE, FORCE, 1e-3, stiffness, 2 * np.sqrt(stiffness * MASS) * 0.05)
        errors.append(abs(solve_motion(MOTION, MASS, model, LOAD, periods=1, solver=solver).steps[0] - exact))
    assert np.all(np.diff(errors) < 0)
    # The deviation is of the bristles' size, F / sigma0 = 0.5 nm.
    assert errors[-1] < 2e-9


def drift(model, amplitude, load=20.0, periods=30):
    """Displacement by triangles of a small amplitude, against a load, over the last half of the periods."""
    motion = make_motion("ramp", amplitude, 1e-4, 1e-4)
    return (
        solve_motion(motion, MASS, model, load, periods=periods, relative=1e-9).steps[periods // 2 :].mean()
    )


@pytest.mark.slow
def test_elastoplastic_stands_below_its_zero_step_amplitude_and_lugre_drifts():
    """Load and oscillation stay below z_ba: elastic, no net motion. LuGre creeps at any amplitude."""
    lugre = LuGre(FORCE, FORCE, 1e-3, 1e6, 20.0)
    elastoplastic = Elastoplastic(FORCE, FORCE, 1e-3, 1e6, 20.0, 0.0, 40e-9)
    small = 5e-9
    assert abs(drift(elastoplastic, small)) < 1e-14
    assert abs(drift(lugre, small)) > 1e-11
    assert abs(drift(elastoplastic, 60e-9)) > 1e-10


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_stiff_foot_follows_its_waveform_and_a_soft_one_overshoots(solver):
    model, motion = MODELS["LuGre"], make_motion("s-curve", 1e-6, 1e-4, 3e-5, 1.7e-4)
    ideal = solve_motion(motion, MASS, model, periods=2, solver=solver)
    stiff = solve_motion(motion, MASS, model, foot=Foot(1e-3, 300e3, 0.7), periods=2, solver=solver)
    assert stiff.steps[-1] == pytest.approx(ideal.steps[-1], rel=0.02)
    soft = solve_motion(
        motion, MASS, model, foot=Foot(1e-3, 15e3, 0.02), periods=1, samples=300, solver=solver
    )
    assert soft.foot.max() > 1.05e-6


@pytest.mark.parametrize("foot", [Foot(0.5e-3), Foot(0.5e-3, 60e3, 0.3)], ids=["ideal", "dynamic"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_free_base_keeps_the_momentum_of_all(foot, solver):
    """Nothing outside acts without load and mount: base, foot and slider have no momentum together."""
    motion, heavy = make_motion("s-curve", 1e-6, 1e-4, 3e-5, 1.7e-4), RecoilBase(5e-3)
    solved = solve_motion(
        motion, MASS, MODELS["LuGre"], foot=foot, base=heavy, periods=1, samples=50, solver=solver
    )
    moved = heavy.mass * solved.base + foot.mass * solved.foot + MASS * solved.slider
    np.testing.assert_allclose(moved, 0, atol=1e-6 * heavy.mass * np.abs(solved.base).max())
    assert np.abs(solved.base).max() > 1e-8


def test_a_recoiling_base_costs_part_of_the_step():
    motion, foot = make_motion("ramp", 1e-6, 1e-4, 5e-6, 2.65e-4), Foot(1e-3)
    model = LuGre(0.3, 0.3, 1e-3, 1e7, 3.0)
    firm = solve_motion(motion, MASS, model).steps[-1]
    steps = [
        solve_motion(motion, MASS, model, foot=foot, base=RecoilBase(mass, 200.0, 0.3)).steps[-1]
        for mass in (1.0, 0.1, 0.02)
    ]
    assert steps[0] == pytest.approx(firm, rel=0.01)
    assert steps[2] < steps[1] < steps[0]


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_call_hangs(solver):
    stiff = LuGre(FORCE, FORCE, 1e-3, 1e14, 0.0)
    started = process_time()
    with pytest.raises(StepLimitError, match="too stiff"):
        solve_motion(MOTION, MASS, stiff, solver=solver, max_steps=100)
    assert process_time() - started < 20


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion": make_motion("ramp", 1e-6, 1e-4)}, "the foot jumps"),
        ({"mass": 0.0}, "mass above 0"),
        ({"load": 50.0}, "runs away"),
        ({"base": RecoilBase(1.0)}, "give the foot"),
        ({"relative": 0.5}, "tolerance"),
        ({"periods": 0}, "periods"),
        ({"motion": make_motion("ramp", [1e-6, 2e-6], 1e-4, 1e-5)}, "one motion"),
    ],
)
def test_what_cannot_be_solved_is_refused(change, message):
    values = {"motion": MOTION, "mass": MASS, "load": 0.0} | change
    with pytest.raises(InputError, match=message):
        solve_motion(values.pop("motion"), values.pop("mass"), MODELS["LuGre"], values.pop("load"), **values)


@pytest.mark.parametrize("make", [lambda: Foot(0.0), lambda: Foot(1e-3, -1.0), lambda: RecoilBase(-1.0)])
def test_foot_and_base_have_mass(make):
    with pytest.raises(InputError, match="mass"):
        make()
