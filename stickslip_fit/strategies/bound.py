"""How well any calibration could do: the Cramer-Rao bound of k traverses, and the repeatability floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.groups import mean_steps
from stickslip_fit.fit.levenberg_marquardt import RANK_TOL
from stickslip_fit.laws import travel
from stickslip_fit.strategies.cost import stepping_seconds
from stickslip_fit.strategies.designs import NOTHING
from stickslip_fit.strategies.exchange import exchange, mean_variance
from stickslip_fit.strategies.solve import solve
from stickslip_fit.strategies.trials import Trial

Array = npt.NDArray[np.float64]


def bounds(trials: Sequence[Trial], held_out: Array, most: int, handling: float) -> pd.DataFrame:
    """What the k traverses of a session that predict the held-out ones best could reach.

    The bound is that of an unbiased estimate which knows only today's traverses, under a law that is right;
    what borrows from other sessions may do better, and what is biased may be lucky.

    Parameters
    ----------
    trials : sequence of Trial
        Of one joint.
    held_out : array of int
        Places of the traverses that are predicted, see `Outcomes.errors`.
    most : int
        Traverses in a direction up to which to go.
    handling : float
        Seconds that a traverse costs beside its steps.

    Returns
    -------
    DataFrame
        traverses (in each direction), seconds (of a session, both directions), and rms, rms_relative, floor,
        floor_relative of a held-out traverse: the bound, and what remains of it when the law is known.
    """
    tables = [each for trial in trials if (each := _of_trial(trial, held_out, most, handling)) is not None]
    if not tables:
        return pd.DataFrame()
    table = pd.concat(tables)
    both = table.groupby(["session", "traverses"], sort=False)
    summed = both["seconds"].sum().groupby("traverses").mean()
    weights = table["rows"]
    columns = ["square", "square_relative", "noise", "noise_relative"]
    pooled = table[columns].mul(weights, axis=0).assign(traverses=table["traverses"], rows=weights)
    sums = pooled.groupby("traverses").sum()
    found = np.sqrt(sums[columns].div(sums["rows"], axis=0))
    found.columns = pd.Index(["rms", "rms_relative", "floor", "floor_relative"])
    return found.assign(seconds=summed).reset_index()


def prediction_variance(jacobian: Array, made: Array, variance: Array) -> Array:
    """Cramer-Rao bound of the variance of responses, shape (n, p) -> (n,).

    Parameters
    ----------
    jacobian : array, shape (n, p)
        Slopes of the responses to predict.
    made : array, shape (k, p)
        Slopes of the traverses made.
    variance : array, shape (k,)
        Of their responses.

    Notes
    -----
    What the traverses made leave open counts as known: a choice that is best for the rows to predict leaves
    open only what these do not depend on.
    """
    estimator = np.linalg.pinv(made / np.sqrt(variance)[:, None], rcond=RANK_TOL)
    return np.sum((jacobian @ estimator) ** 2, axis=1)


def _of_trial(trial: Trial, held_out: Array, most: int, handling: float) -> pd.DataFrame | None:
    task, rows = trial.task, trial.rows
    found = solve(task.law, rows, task.repeatability)
    held = rows[rows.index.isin(held_out)]
    if held.empty or not found.known.all():
        return None
    offered = rows.loc[task.offered.index]
    y, rounding = task.law.response(rows)
    variance = pd.Series(task.repeatability**2 + rounding, rows.index)
    scales = task.law.scales(mean_steps(found.groups, rows, y))[0]
    slopes = task.law.jacobian(rows, np.broadcast_to(found.values[0], (len(rows), len(scales)))) * scales
    of_row = pd.DataFrame(slopes, rows.index)
    region, candidates = (of_row.loc[each.index].to_numpy() for each in (held, offered))
    noise, step = variance[held.index].to_numpy(), (travel(held) / np.exp(y[rows.index.isin(held.index)]))
    seconds = stepping_seconds(offered) + handling
    lines = []
    for count in range(len(scales), min(most, len(offered)) + 1):
        prior = NOTHING * np.eye(len(scales))
        chosen = exchange(candidates, count, mean_variance(region), prior)
        made = variance[offered.index].to_numpy()[chosen]
        square = noise + prediction_variance(region, candidates[chosen], made)
        lines.append(
            {
                "session": task.session, "traverses": count, "seconds": seconds[chosen].sum(),
                "rows": len(held), "square": np.mean(square * step**2), "square_relative": np.mean(square),
                "noise": np.mean(noise * step**2), "noise_relative": np.mean(noise),
            }
        )  # fmt: skip
    return pd.DataFrame(lines) if lines else None
