"""Measured ball drops: drag and the camera's slant, beside a fit of the same by scipy.

`--set-up` has the same drops with wider bounds of the drag, with each drop's last frame, or without the time.
"""

import argparse
import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from joblib.externals.loky import get_reusable_executor
from scipy.optimize import least_squares

import stickslip_fit as ssf
from stickslip_fit._typing import Array
from tests.balls.fall import LAW, MIDDLE, SLANT, G, drags, linear_drag, quadratic_drag

ROOT = Path(__file__).parents[1]


DRAGS = {"quadratic-drag": quadratic_drag, "linear-drag": linear_drag}


WIDE = {"quadratic-drag": {"k": (0.0, 1.0)}, "linear-drag": {"r": (0.0, 5.0)}}


def read_frames(last: bool = False) -> pd.DataFrame:
    """A row for each frame; the last one of each drop, which may show the impact, only if asked for."""
    frames = pd.read_csv(ROOT / "data" / "ball_drops" / "drops.csv")
    from_end = frames.groupby(["ball", "drop"]).cumcount(ascending=False)
    frames = frames[from_end >= (0 if last else 1)].reset_index(drop=True)
    return pd.DataFrame(
        {
            "ball": frames["ball"],
            "run": frames["ball"] + " " + frames["drop"].astype(str),
            "seconds": frames["time_s"],
            "height": frames["height_m"],
        }
    )


def fit_by_scipy(frames: pd.DataFrame, drag: str, slanted: bool) -> tuple[pd.Series, pd.Series, float]:
    """Plain least squares: coefficients with standard errors, s the last, and the rms residual, m."""
    balls, ball = np.unique(frames["ball"], return_inverse=True)
    runs, run = np.unique(frames["run"], return_inverse=True)
    seconds, seen = frames["seconds"].to_numpy(), frames["height"].to_numpy()

    def residuals(x: Array) -> Array:
        coefficients, rest = x[: len(balls)][ball], x[len(balls) :]
        release, velocity = rest[: len(runs)][run], rest[len(runs) : 2 * len(runs)][run]
        y = release + velocity * seconds - G / 2 * seconds**2 + DRAGS[drag](seconds, velocity, coefficients)
        return np.asarray(y + rest[-1] * slanted * (y - MIDDLE) ** 2 / 2 - seen)

    first = 0.02 if drag == "quadratic-drag" else 0.2
    start = np.concatenate([np.full(len(balls), first), np.full(len(runs), 47.0), np.zeros(len(runs) + 1)])
    scale = np.concatenate([np.full(len(balls), first), np.ones(2 * len(runs)), [0.01]])
    low = np.concatenate([np.full(len(balls), 1e-6), np.full(2 * len(runs) + 1, -np.inf)])
    fit = least_squares(residuals, start, x_scale=scale, bounds=(low, np.inf))
    jacobian = fit.jac if slanted else fit.jac[:, :-1]
    variance = 2.0 * fit.cost / (len(frames) - jacobian.shape[1])
    error = np.sqrt(np.diag(variance * np.linalg.inv(jacobian.T @ jacobian)))
    chosen = [*range(len(balls)), *([len(start) - 1] if slanted else [])]
    names = [*balls, *(["slant"] if slanted else [])]
    rms = float(np.sqrt(np.mean(fit.fun**2)))
    return pd.Series(fit.x[chosen], names), pd.Series(error[chosen], names), rms


def our_sizes(diagnosis: ssf.Diagnosis) -> tuple[pd.Series, pd.Series]:
    """Coefficients that a diagnosis found, with standard errors, by ball, and the slant's s."""
    sizes = {
        one.name.partition("[")[2].rstrip("]") or finding.cause: one.size
        for finding in diagnosis.findings
        for one in finding.parameters
    }
    estimates = pd.Series({name: size.estimate for name, size in sizes.items()})
    return estimates, pd.Series({name: (size.high - size.low) / 3.92 for name, size in sizes.items()})


def main() -> None:
    """Print what is found, the coefficients beside scipy's, and the CPU of the whole diagnosis."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set-up", choices=["plain", "wide", "last-frames", "no-time"], default="plain")
    set_up = parser.parse_args().set_up
    frames, causes = read_frames(set_up == "last-frames"), [*drags("ball"), SLANT]
    if set_up == "wide":
        causes = [replace(one, bounds=WIDE.get(one.name, one.bounds)) for one in causes]
    for drag in DRAGS:
        for slanted in (False, True):
            values, error, rms = fit_by_scipy(frames, drag, slanted)
            s = f"s = {values['slant']:.4f} +- {error['slant']:.4f} 1/m" if slanted else "without slant"
            print(f"scipy   {drag:15s} {s:34s} rms {rms:.3f} m")
    began = _cpu_seconds()
    time = None if set_up == "no-time" else "seconds"
    diagnosis = ssf.diagnose_table(frames, LAW, session="run", time=time, causes=causes)
    seconds = _cpu_seconds() - began
    for finding in diagnosis.findings:
        print(
            f"ours    {finding.cause}; not told apart from: {', '.join(finding.equivalent) or 'none'}; "
            f"found together with: {', '.join(finding.together_with) or 'none'}"
        )
    named = [finding.cause for finding in diagnosis.findings if finding.cause in DRAGS]
    if named:
        ours, our_error = our_sizes(diagnosis)
        values, error, _ = fit_by_scipy(frames, named[0], "slant" in ours)
        both = pd.DataFrame({"ours": ours, "error": our_error, "scipy": values, "scipy's error": error})
        both["apart, ours"] = (both["ours"] - both["scipy"]).abs() / both["error"]
        print(both.round(4).to_string())
    if diagnosis.gain is not None:
        print(
            f"held-out rms {diagnosis.gain.baseline:.3f} m, with the causes {diagnosis.gain.extended:.3f} m"
        )
    print(f"CPU of the whole diagnosis, gain included: {seconds:.1f} s")


def _cpu_seconds() -> float:
    get_reusable_executor().shutdown()  # the time of processes counts once they have ended
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(sum(resource.getrusage(kind)[:2]) for kind in kinds)


if __name__ == "__main__":
    main()
