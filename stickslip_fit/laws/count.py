"""From the steps a joint needs to the count a lab writes down, and back.

The end stop is looked for after every `check_every` steps, so a count is seen rounded up to the next
multiple. With `check_every` 1 the count is exact.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def seen_count(steps: npt.ArrayLike, check_every: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """The count at which the end stop is noticed.

    Examples
    --------
    >>> seen_count([12300.2, 12300.2], [5, 1])
    array([12305, 12300])
    """
    steps, check_every = np.asarray(steps, float), np.asarray(check_every)
    checks = np.where(check_every > 1, np.ceil(steps / check_every), np.round(steps))
    return np.maximum(checks, 1).astype(np.int64) * check_every


def expected_steps(count: npt.ArrayLike, check_every: npt.ArrayLike) -> Array:
    """The steps that a seen count stands for on average: half a check earlier.

    Examples
    --------
    >>> expected_steps([12305, 12300], [5, 1])
    array([12302.5, 12300. ])
    """
    count, check_every = np.asarray(count, float), np.asarray(check_every)
    return count - np.where(check_every > 1, check_every / 2, 0.0)


def rounding_variance(count: npt.ArrayLike, check_every: npt.ArrayLike) -> Array:
    """Variance of log(steps) that the rounding adds: a uniform spread of one check."""
    spread = np.asarray(check_every, float) / np.sqrt(12.0)
    return (spread / expected_steps(count, check_every)) ** 2
