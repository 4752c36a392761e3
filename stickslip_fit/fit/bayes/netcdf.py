"""A posterior on disk: its draws as netCDF, and beside them its result as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import write_atomically
from stickslip_fit.fit.bayes.posterior import Posterior
from stickslip_fit.fit.bayes.priors import Priors
from stickslip_fit.fit.save import load_result, save_result


def save_posterior(posterior: Posterior, path: str | Path) -> None:
    """Write ``path``, netCDF that ArviZ and xarray read, and the result beside it with the ending ``.json``.

    Raises
    ------
    InputError
        If they cannot be written.
    """
    path = Path(path)
    tree = posterior.tree.copy()
    quality = posterior.diagnostics.astype({"session": str})
    tree.attrs = {
        "priors": json.dumps(posterior.priors.to_json()),
        "diagnostics": json.dumps(quality.to_dict(orient="list")),
    }
    write_atomically(path, bytes(tree.to_netcdf(engine="h5netcdf")))
    save_result(posterior.result, path.with_suffix(".json"))


def load_posterior(path: str | Path) -> Posterior:
    """Read what `save_posterior` wrote.

    Raises
    ------
    InputError
        If one of the two files cannot be read, or is something else.
    """
    from xarray import open_datatree

    path = Path(path)
    try:
        with open_datatree(path, engine="h5netcdf") as stored:
            tree = stored.load()
        priors = Priors.from_json(json.loads(tree.attrs.pop("priors")))
        diagnostics = pd.DataFrame(json.loads(tree.attrs.pop("diagnostics")))
    except (OSError, KeyError, ValueError) as error:
        message = f"is no saved posterior that can be read ({error!r}); fit the log again"
        raise InputError(Problem(message, str(path))) from None
    return Posterior(load_result(path.with_suffix(".json")), tree, priors, diagnostics)
