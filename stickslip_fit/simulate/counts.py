"""Counts of one joint's traverses under one law."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError
from stickslip_fit.laws import Rows, StepLaw, seen_count
from stickslip_fit.logs.plan import NoiseKind
from stickslip_fit.simulate.chance import draw_noise

Array = npt.NDArray[np.float64]


def expected_counts(law: StepLaw, rows: Rows, values: Array) -> Array:
    """Steps that each traverse takes by the law, shape (n,).

    Raises
    ------
    InputError
        If the joint would come to a halt within one.
    """
    counts, _ = law.counts(rows, values)
    if not np.all(np.isfinite(counts)):
        first = int(np.argmin(np.isfinite(counts)))
        row = {name: np.asarray(rows[name]) for name in law.columns if name in rows}
        place = ", ".join(f"{name} = {of[first]:.4g}" for name, of in row.items() if of.dtype.kind in "fiu")
        raise InputError(
            f"joint {law.joint} comes to a halt (step size 0 or less) with {place} (rad, m); "
            "change the law's parameters or leave that traverse out of the plan"
        )
    return counts


def simulate_counts(
    law: StepLaw,
    rows: Rows,
    values: Array,
    repeatability: npt.ArrayLike,
    rng: np.random.Generator,
    kind: NoiseKind = "gaussian",
) -> npt.NDArray[np.int64]:
    """Counts that a lab would write down.

    Parameters
    ----------
    law : StepLaw
    rows : mapping of str to array, shape (n,)
        check_every besides what the law needs.
    values : array, shape (p,) or (n, p)
    repeatability : float or array, shape (n,)
        Standard deviation of log(steps).
    rng : Generator
    kind : {'gaussian', 't5'}

    Returns
    -------
    array of int, shape (n,)

    Raises
    ------
    InputError
        If the joint would come to a halt within a traverse.

    Examples
    --------
    >>> from stickslip_fit.laws import Prismatic
    >>> row = {"q2": [-np.pi / 2], "theta": [0.0], "psi": [0.0], "start": [0.0], "stop": [0.012]}
    >>> values = np.array([976e-9, 0.3, 438e-9])
    >>> simulate_counts(Prismatic(), row | {"check_every": [5]}, values, 0.0, np.random.default_rng(1))
    array([12300])
    """
    counts = expected_counts(law, rows, values)
    departure = np.asarray(repeatability, float) * draw_noise(kind, len(counts), rng)
    return seen_count(counts * np.exp(departure), rows["check_every"])
