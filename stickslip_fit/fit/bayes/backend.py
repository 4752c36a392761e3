"""Where the walks are kept: in memory, or in an HDF5 file from which an interrupted one is taken up."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from pandas.api.types import is_numeric_dtype

from stickslip_fit.causes import describe
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.fit.bayes.priors import Prior
from stickslip_fit.fit.bayes.traverses import Traverses
from stickslip_fit.fit.known_causes import HeldLaw
from stickslip_fit.laws import StepLaw

if TYPE_CHECKING:
    from emcee.backends import Backend, HDFBackend

ENSEMBLES = 4


def in_memory() -> list[Backend]:
    """Backends that are gone with the process, one for each ensemble."""
    from emcee.backends import Backend

    return [Backend() for _ in range(ENSEMBLES)]


def in_file(path: str | Path, name: str, traverses: Traverses, prior: Prior, seed: int) -> list[HDFBackend]:
    """Backends in an HDF5 file, one for each ensemble; the file may hold other joints and directions.

    Parameters
    ----------
    path : path
    name : str
        Of the joint and direction.
    traverses, prior, seed
        What is walked: a file that holds the walks of anything else is refused.

    Raises
    ------
    InputError
        If the file cannot be used, or holds other walks.
    """
    import h5py
    from emcee.backends import HDFBackend

    wanted = _fingerprint(traverses, prior, seed)
    try:
        with h5py.File(path, "a") as file:
            found = file.require_group(name).attrs.setdefault("fingerprint", wanted)
    except OSError as error:
        raise InputError(
            Problem(f"is no HDF5 file that can be written to ({error}); give another path", str(path))
        ) from None
    if found != wanted:
        message = (
            f"holds the walks of another log, law, prior or seed for {name}; give another path, or delete it"
        )
        raise InputError(Problem(message, str(path)))
    return [HDFBackend(str(path), name=f"{name}/ensemble_{number}") for number in range(ENSEMBLES)]


def _fingerprint(traverses: Traverses, prior: Prior, seed: int) -> str:
    """Of all that the walks follow from."""
    law = traverses.law
    said = repr((_described(law), prior.names, list(traverses.groups.table["session"]), seed))
    digest = hashlib.sha256(said.encode())
    columns = [_numbers(traverses.rows[name]) for name in dict.fromkeys((*law.columns, "start", "stop"))]
    levels = np.array([prior.repeatability, prior.spread_factor, prior.repeatability_factor])
    numbers = [*columns, traverses.y, traverses.rounding, prior.centre, prior.width, prior.spread, levels]
    for array in (*numbers, traverses.groups.of_row):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _described(law: StepLaw) -> dict[str, Any]:
    if isinstance(law, HeldLaw):
        return {"held": law.sizes.tolist(), **describe(law.extended)}
    return describe(law)


def _numbers(column: pd.Series[Any]) -> npt.NDArray[Any]:
    """A column as numbers, whatever it holds."""
    if is_numeric_dtype(column):
        return column.to_numpy(float)
    return np.asarray(pd.util.hash_array(column.astype(str).to_numpy(dtype=object)))
