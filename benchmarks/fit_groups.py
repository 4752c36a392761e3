"""Least squares of 2,000 session-direction groups beside loops of MINPACK, scipy and lmfit over them.

Every contender solves the same weighted problem from the same start; the peers' loops are timed on a
share of the groups and scaled up, since a full loop of lmfit takes minutes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import lmfit
import numpy as np
import pandas as pd
from scipy.optimize import least_squares as scipy_least_squares
from scipy.optimize import leastsq

from stickslip_fit.estimation._groups import group_rows
from stickslip_fit.estimation._optimize import minimize
from stickslip_fit.laws import Prismatic

SESSIONS = 1000
PEER_GROUPS = 200
UNIT = np.array([1e-6, 1.0, 1e-6])  # the peers see numbers of order one
REPEATABILITY = 0.0027
START, TOLERANCES = [1.08, 0.2, 0.0], {"xtol": 1e-12, "ftol": 1e-12, "gtol": 1e-12}


def campaign(rng: np.random.Generator) -> pd.DataFrame:
    """Thirty prismatic traverses in each of 2,000 groups."""
    q2 = np.radians(np.repeat(np.arange(0, -181, -30), 4))
    theta = np.radians(np.tile([0, -30, -60, -90], 7))
    q2, theta = np.append(q2, np.radians([-90, -90])), np.append(theta, [0.0, 0.0])
    psi = np.append(np.zeros(28), np.radians([-60, 60]))
    n, groups = len(q2), 2 * SESSIONS
    rows = pd.DataFrame(
        {"q2": np.tile(q2, groups), "theta": np.tile(theta, groups), "psi": np.tile(psi, groups)}
    )
    rows["session"] = np.repeat([f"{index:04d}" for index in range(SESSIONS)], 2 * n)
    rows["direction"] = np.tile(np.repeat(["+", "-"], n), SESSIONS)
    rows["start"], rows["stop"], rows["check_every"] = 0.0, 0.012, 5
    truth = np.array([950e-9, 0.3, 420e-9]) * (1 + 0.02 * rng.standard_normal((groups, 3)))
    steps, _ = Prismatic().counts(rows, np.repeat(truth, n, axis=0))
    rows["steps"] = (
        np.ceil(steps * np.exp(REPEATABILITY * rng.standard_normal(len(rows))) / 5).astype(int) * 5
    )
    return rows


def weights(law: Prismatic, rows: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """The response and its inverse variance."""
    y, rounding = law.response(rows)
    return y, 1.0 / (REPEATABILITY**2 + rounding)


def ours(rows: pd.DataFrame) -> np.ndarray:
    """All groups at once."""
    law, groups = Prismatic(), group_rows(rows)
    y, weight = weights(law, rows)
    mean = np.full(len(groups), 900e-9)
    start, scales = law.start_values(mean), law.scales(mean)
    return minimize(law.model(rows), y, weight, groups, start, scales, damping=0.0).values


def loop(solve: Callable[..., np.ndarray], parts: list[pd.DataFrame]) -> np.ndarray:
    """One group after the other, with the law's analytic derivatives."""
    law, found = Prismatic(), []
    for rows in parts:
        y, weight = weights(law, rows)
        model, root = law.model(rows), np.sqrt(weight)
        best = solve(
            lambda p, model=model, y=y, r=root: r * (y - model(p * UNIT)[0]),
            lambda p, model=model, r=root: -r[:, None] * model(p * UNIT)[1] * UNIT,
        )
        found.append(best * UNIT)
    return np.array(found)


def by_minpack(misfit: Callable[..., np.ndarray], slopes: Callable[..., np.ndarray]) -> np.ndarray:
    """MINPACK's Levenberg-Marquardt."""
    return leastsq(misfit, START, Dfun=slopes, **TOLERANCES)[0]


def by_scipy(misfit: Callable[..., np.ndarray], slopes: Callable[..., np.ndarray]) -> np.ndarray:
    """The trust region that is scipy's default."""
    return scipy_least_squares(misfit, START, jac=slopes, **TOLERANCES).x


def lmfit_loop(parts: list[pd.DataFrame]) -> np.ndarray:
    """One group after the other, as lmfit's users do it."""
    law, found = Prismatic(), []
    for rows in parts:
        y, weight = weights(law, rows)
        model, root = law.model(rows), np.sqrt(weight)

        def misfit(p: lmfit.Parameters, model=model, y=y, r=root) -> np.ndarray:
            values = np.array([p["a"].value * 1e-6, p["b"].value, p["c"].value * 1e-6])
            return r * (y - model(values)[0])

        parameters = lmfit.create_params(a=1.08, b=0.2, c=0.0)
        best = lmfit.minimize(misfit, parameters, xtol=1e-12, ftol=1e-12).params
        found.append([best["a"].value * 1e-6, best["b"].value, best["c"].value * 1e-6])
    return np.array(found)


def main() -> None:
    """Print the ratios and the largest disagreement."""
    rows = campaign(np.random.default_rng(20260101))
    groups = group_rows(rows)
    parts = [rows[groups.of_row == index] for index in range(PEER_GROUPS)]
    timings: dict[str, list[float]] = {"ours": [], "MINPACK's leastsq": [], "scipy": [], "lmfit": []}
    for _ in range(3):
        for name, run in (
            ("ours", partial(ours, rows)),
            ("MINPACK's leastsq", partial(loop, by_minpack, parts)),
            ("scipy", partial(loop, by_scipy, parts)),
            ("lmfit", partial(lmfit_loop, parts)),
        ):
            began = time.process_time()
            answer = run()
            timings[name].append(time.process_time() - began)
            if name == "ours":
                reference = answer[:PEER_GROUPS]
            else:
                off = np.max(np.abs(answer / reference - 1))
                print(f"largest relative disagreement with {name}: {off:.1e}")
    own = np.median(timings["ours"])
    print(f"{len(groups)} groups, {len(rows)} traverses: {own:.2f} s of CPU")
    for name in list(timings)[1:]:
        scaled = np.median(timings[name]) * len(groups) / PEER_GROUPS
        print(f"loop over {name}: {scaled:.1f} s, {scaled / own:.0f} times as long")


if __name__ == "__main__":
    main()
