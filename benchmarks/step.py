"""Steps a second: closed form, Coulomb friction event by event, LuGre friction by both solvers."""

from collections.abc import Callable
from time import process_time

import numpy as np

from stickslip_fit.step import LuGre, coulomb_step, make_motion, solve_motion, step_size
from stickslip_fit.step._kernels import COMPILED

SETS = 400_000
MASS, FORCE, LOAD = 1e-3, 0.05, 9.81
STIFFNESSES = (1e6, 1e7)  # N/m; the bristles deflect by 50 and 5 nm
PERIODS = 3


def main() -> None:
    rng = np.random.default_rng(0)
    friction, ramp_time = rng.uniform(20, 200, SETS), rng.uniform(5e-5, 4e-4, SETS)
    amplitude = friction * ramp_time**2 * np.exp(rng.uniform(-2.5, 1.5, SETS))
    load = friction * rng.uniform(-0.9, 0.9, SETS)
    closed = rate(lambda: step_size(friction, ramp_time, amplitude, load, 1e-5), SETS)
    motion = make_motion("ramp", amplitude, ramp_time, 1e-5)
    events = rate(lambda: coulomb_step(motion, friction, load), SETS)
    print(f"step: closed form {closed:,.0f} a second, Coulomb friction event by event {events:,.0f}")
    motion = make_motion("ramp", 3e-6, 1e-4, 5e-6, 2.65e-4)
    for stiffness in STIFFNESSES:
        model = LuGre(FORCE, 1.2 * FORCE, 1e-3, stiffness, 0.5)
        tight = solve_motion(motion, MASS, model, LOAD, periods=PERIODS, relative=1e-10).steps
        for solver in ("compiled", "lsoda") if COMPILED else ("lsoda",):
            for relative in (1e-6, 1e-7):

                def solve(solver=solver, relative=relative, model=model):
                    return solve_motion(
                        motion, MASS, model, LOAD, periods=PERIODS, relative=relative, solver=solver
                    )

                error = 1e9 * np.abs(solve().steps - tight).max()
                print(
                    f"step: LuGre, {stiffness / 1e6:g} N/µm, {solver}, tolerance {relative:g}: "
                    f"{rate(solve, PERIODS):,.0f} a second, within {error:.4f} nm"
                )


def rate(call: Callable[[], object], steps: int) -> float:
    """Steps for each second of one core, over half a second and three calls at least."""
    call()
    began, calls = process_time(), 0
    while calls < 3 or process_time() - began < 0.5:
        call()
        calls += 1
    return calls * steps / (process_time() - began)


if __name__ == "__main__":
    main()
