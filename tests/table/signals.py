"""Sampled motions of a stage under friction, with noise and effects of known strength; scipy alone."""

import numpy as np
import pandas as pd
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter

import stickslip_fit as ssf

LAW = "F ~ M*acc + Fv*vel + Fc*sign(vel) + offset"
ROLES = {"session": "run", "time": "t", "position": "q", "direction": "way"}
SD, INTERVAL = 0.3, 0.01  # N, s
RESONANCE = (2 * 0.95 * np.cos(2 * np.pi / 12), -(0.95**2))  # an autoregression that rings with 12 samples
COEFFICIENTS = {"white": (), "t5": (), "0.5": (0.5,), "0.9": (0.9,), "0.97": (0.97,), "rings": RESONANCE}

EFFECTS = {
    "viscous-by-direction": lambda rows: np.abs(rows["vel"]),
    "stribeck": lambda rows: np.sign(rows["vel"]) * np.exp(-((rows["vel"] / 0.05) ** 2)),
    "spring": lambda rows: rows["q"] ** 2,
    "drift": lambda rows: rows["t"],
    "drift-by-direction": lambda rows: rows["way"] * rows["t"],
    "warm-up": lambda rows: -np.expm1(-rows["t"] / (0.08 * rows["t"].max())),
    "sudden-change": lambda rows: (rows["run"] == "r0") & (rows["t"] > 0.4 * rows["t"].max()),
    "covariate:temp": lambda rows: rows["temp"],
    "position-by-direction": lambda rows: rows["way"] * rows["q"] ** 2,
    "periodic-in-position": lambda rows: np.sin(2 * np.pi * rows["q"] / 0.004),
}


def own_causes() -> list[ssf.Cause]:
    """Three of a user's."""
    return [
        ssf.Cause("viscous-by-direction", "+ dFv*abs(vel)", "dFv in N s/m"),
        ssf.Cause(
            "stribeck", "+ Fs*sign(vel)*exp(-(vel/vs)**2)", "Fs in N, vs in m/s", bounds={"vs": (0.005, 0.2)}
        ),
        ssf.Cause("spring", "+ k*q**2", "k in N/m2"),
    ]


def impulse_response(kind: str, length: int = 4000) -> np.ndarray:
    """Of the noise to one innovation."""
    return lfilter([1.0], [1.0, *(-np.array(COEFFICIENTS[kind]))], np.eye(1, length)[0])


def noise(rng: np.random.Generator, kind: str, n: int) -> np.ndarray:
    """n values of variance 1."""
    response = impulse_response(kind)
    draws = rng.standard_t(5, n + 2000) / np.sqrt(5 / 3) if kind == "t5" else rng.standard_normal(n + 2000)
    return np.convolve(draws, response)[2000 : n + 2000] / np.sqrt(response @ response)


def correlation(kind: str, n: int) -> np.ndarray:
    """Correlation matrix of n neighbours."""
    response = impulse_response(kind, 4000 + n)
    lags = np.array([response[: len(response) - k] @ response[k:] for k in range(n)])
    return toeplitz(lags / lags[0])


def signal(rng: np.random.Generator, kind: str, sessions: int, length: int) -> pd.DataFrame:
    """A stage that swings with two frequencies, in sessions of so many samples; nothing hidden."""
    parts = []
    for number in range(sessions):
        t = INTERVAL * np.arange(length)
        slow, phase = 2 * np.pi * 7.3 / (length * INTERVAL) * rng.uniform(0.9, 1.1), rng.uniform(0, 2 * np.pi)
        q = vel = acc = 0.0
        for size, rate, begin in ((0.02, slow, phase), (0.006, 2.7 * slow, 1.0)):
            q = q + size * np.sin(rate * t + begin)
            vel = vel + size * rate * np.cos(rate * t + begin)
            acc = acc - size * rate**2 * np.sin(rate * t + begin)
        temp = (
            20 + 0.5 * np.sin(2 * np.pi * t / t[-1] * rng.uniform(0.5, 1)) + 0.1 * rng.standard_normal(length)
        )
        force = 1.3 * acc + 4.0 * vel + 0.8 * np.sign(vel) + 0.1 * number + SD * noise(rng, kind, length)
        columns = {"t": t, "q": q, "vel": vel, "acc": acc, "way": np.sign(vel), "temp": temp, "F": force}
        parts.append(pd.DataFrame({"run": f"r{number}", **columns}))
    return pd.concat(parts, ignore_index=True)


def with_effect(rows: pd.DataFrame, kind: str, name: str, strength: float) -> tuple[pd.DataFrame, float]:
    """The table with an effect of this strength, and its z under the known noise."""
    runs = [np.flatnonzero(rows["run"] == run) for run in rows["run"].unique()]
    lower = cholesky(correlation(kind, len(runs[0])), lower=True)

    def whiten(columns: np.ndarray) -> np.ndarray:
        return np.concatenate([solve_triangular(lower, columns[run], lower=True) for run in runs]) / SD

    law = np.column_stack([rows["acc"], rows["vel"], np.sign(rows["vel"]), np.ones(len(rows))])
    own = np.hstack([law * (rows["run"] == run).to_numpy()[:, None] for run in rows["run"].unique()])
    basis = np.linalg.qr(whiten(own))[0]
    shape = np.asarray(EFFECTS[name](rows), float)
    seen = whiten(shape[:, None])
    seen = (seen - basis @ (basis.T @ seen))[:, 0]
    size = strength / np.linalg.norm(seen)
    changed = rows.assign(F=rows["F"] + size * shape)
    measured = whiten(changed["F"].to_numpy()[:, None])[:, 0]
    return changed, float(seen @ measured / np.linalg.norm(seen))


def best_term(rows: pd.DataFrame) -> str:
    """Of a user's three causes, or none, the one that a comparison in numpy chooses.

    Least squares, the residuals' lag-1 correlation removed (D. Cochrane and G. Orcutt, J. Am. Stat. Assoc.
    44:32, 1949), and the Bayesian information criterion, over a grid of velocities for the Stribeck term.
    """
    vel, force = rows["vel"].to_numpy(), rows["F"].to_numpy()
    law = np.column_stack([rows["acc"], vel, np.sign(vel), np.ones(len(rows))])
    terms = {"": [np.zeros((len(rows), 0))], "viscous-by-direction": [np.abs(vel)[:, None]]}
    terms["spring"] = [rows["q"].to_numpy()[:, None] ** 2]
    terms["stribeck"] = [
        (np.sign(vel) * np.exp(-((vel / v) ** 2)))[:, None] for v in 0.005 * 40 ** np.linspace(0, 1, 30)
    ]

    def criterion(columns: np.ndarray, parameters: int) -> float:
        y, x = force, columns
        for _ in range(5):
            values = np.linalg.lstsq(x, y, rcond=None)[0]
            left = force - columns @ values
            phi = left[1:] @ left[:-1] / (left @ left)
            y, x = force[1:] - phi * force[:-1], columns[1:] - phi * columns[:-1]
        squares = np.sum((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2)
        return len(y) * np.log(squares) + parameters * np.log(len(y))

    size = {"": 0, "stribeck": 2}
    return min(
        (criterion(np.hstack([law, term]), size.get(name, 1)), name)
        for name, own in terms.items()
        for term in own
    )[1]
