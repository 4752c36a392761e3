"""A campaign log on the bench."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stickslip_fit.causes import Cause, covariates, library
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.study import Part
from stickslip_fit.diagnose.shapes.structures import configuration, structures
from stickslip_fit.fit.groups import usable_rows
from stickslip_fit.fit.least_squares import least_squares
from stickslip_fit.logs import Log


def bench_of(log: Log, causes: Iterable[Cause] | None = None) -> tuple[Bench, dict[str, str]]:
    """A log under the published laws, fitted to each session and direction.

    Parameters
    ----------
    log : Log
    causes : iterable of Cause, optional
        The library and the lab's own columns without it.

    Returns
    -------
    bench : Bench
    missing : dict of str to str
        Causes that the log has nothing to show of, and why.
    """
    rows = usable_rows(log)
    fitted = least_squares(log)
    known = (*library(), *covariates(rows)) if causes is None else tuple(causes)
    missing = {cause.name: why for cause in known if (why := cause.missing(rows)) is not None}
    parts, repeatability = [], []
    responses, rounding = np.zeros(len(rows)), np.zeros(len(rows))
    drive = np.zeros(len(rows), dtype=np.intp)
    backwards = (rows["direction"] == "-").to_numpy()
    for number, (joint, fit) in enumerate(fitted.joints.items()):
        mine = np.flatnonzero((rows["joint"] == joint).to_numpy())
        block = fit.group_of(rows.iloc[mine])
        responses[mine], rounding[mine] = fit.law.response(rows.iloc[mine])
        drive[mine] = 2 * number + backwards[mine]
        parts.append(Part(fit.law, mine, block, fit.values[block]))
        values = [fit.repeatability[way].value for way in "+-"]
        repeatability += [value if np.isfinite(value) else np.nan for value in values]
    noise = np.array(repeatability)
    noise = np.where(np.isfinite(noise), noise, np.nanmean(noise) if np.isfinite(noise).any() else 3e-3)
    present = tuple(cause.bound(rows, log.machine) for cause in known if cause.name not in missing)
    bench = Bench(
        rows, tuple(parts), responses, rounding, drive, noise, present, structures, configuration(rows),
        np.ones(len(rows)),
    )  # fmt: skip
    return bench, missing
