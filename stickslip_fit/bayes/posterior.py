"""Posterior: the draws as an ArviZ DataTree, the Result made from them, and both on disk.

Estimates are posterior means, intervals are quantiles; flags say what has not converged or is not
identified. Files: netCDF for the draws, JSON for the Result.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import pandas as pd
from scipy.special import ndtri

from stickslip_fit._input import read_file
from stickslip_fit._io import write_atomically
from stickslip_fit._summary import Section, Summarized, Summary
from stickslip_fit._typing import Array
from stickslip_fit.bayes.priors import Priors, predict_log_steps
from stickslip_fit.bayes.result import INTERVAL_QUANTILES, group_name
from stickslip_fit.errors import InputError, InputIssue, check_count
from stickslip_fit.estimation import Flag, JointFit, Result
from stickslip_fit.estimation.result import (
    PREDICTION_COLUMNS,
    AxesArray,
    Provenance,
    convert_predictions,
    result_to_json,
    write_result_json,
)
from stickslip_fit.estimation.saved_result import read_result_json, result_from_json
from stickslip_fit.laws import Laws, traverse_length
from stickslip_fit.machine import Machine

if TYPE_CHECKING:
    from xarray import Dataset, DataTree


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Summarized):
    """A log fitted by Bayes.

    Attributes
    ----------
    result : Result
        Posterior means and covariances of each session's parameters, with intervals between quantiles.
    tree : DataTree
        For each joint and direction a branch, ``tree["joint_3_plus"]``, that ArviZ takes as it is.
    priors : Priors
    diagnostics : DataFrame
        joint, direction, parameter, session (empty for the campaign), r_hat, ess_bulk, ess_tail, k_hat.
    """

    result: Result
    tree: DataTree
    priors: Priors
    diagnostics: pd.DataFrame

    def summary(self) -> Summary:
        """The result's, with the convergence of the draws and the priors."""
        summary = self.result.summary()
        headline = (f"{self.quality}.", *summary.headline)
        sections = (*summary.sections, Section(tables=self.priors.tables()))
        return replace(summary, headline=headline, sections=sections)

    @property
    def method(self) -> str:
        """See `Result`."""
        return self.result.method

    @property
    def machine(self) -> Machine:
        """See `Result`."""
        return self.result.machine

    @property
    def joints(self) -> dict[int, JointFit]:
        """See `Result`."""
        return self.result.joints

    @property
    def residuals(self) -> pd.DataFrame:
        """See `Result`; by the posterior means."""
        return self.result.residuals

    @property
    def flags(self) -> tuple[Flag, ...]:
        """See `Result`; what has not converged is among them."""
        return self.result.flags

    @property
    def provenance(self) -> Provenance:
        """See `Result`."""
        return self.result.provenance

    @property
    def parameters(self) -> pd.DataFrame:
        """See `Result.parameters`; means of the draws, and intervals between their quantiles."""
        return self.result.parameters

    @property
    def si(self) -> PosteriorInSI:
        """The tables of parameters and predictions in SI."""
        return PosteriorInSI(self)

    def save(self, path: str | Path) -> None:
        """Write ``path``, NetCDF that ArviZ and xarray read, and the result beside it, ending in ``.json``.

        Raises
        ------
        InputError
            If they cannot be written.
        """
        tree = self.tree.copy()
        diagnostics = self.diagnostics.astype({"session": str})
        tree.attrs = {
            "schema": SCHEMA,
            "priors": json.dumps(self.priors.to_json()),
            "diagnostics": json.dumps(diagnostics.to_dict(orient="list")),
        }
        sources, result = self.provenance.log_files, result_to_json(self.result)
        draws = bytes(tree.to_netcdf(engine="h5netcdf"))
        write_atomically(path, draws, sources)
        content = result | {DRAWS_KEY: hashlib.sha256(draws).hexdigest()}
        write_result_json(content, Path(path).with_suffix(".json"), sources)

    def plot_corner(self, joint: int, direction: str, session: str | None = None) -> AxesArray:
        """Draws of a session's parameters, by default the latest session's, in pairs; the prior behind.

        Raises
        ------
        InputError
            If there is no such session, joint or direction, or its draws have not converged.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.parameters import plot_draws_corner

        return collect_axes(plot_draws_corner(self, joint, direction, session))

    def plot_forest(self, joint: int) -> AxesArray:
        """Every session's parameters of a joint beside the campaign's mean.

        Raises
        ------
        InputError
            If the joint was not fitted.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.parameters import plot_forest

        return collect_axes(plot_forest(self.result, joint, self.campaign_means()))

    def plot_control(self) -> AxesArray:
        """See `Result.plot_control`."""
        return self.result.plot_control()

    @property
    def quality(self) -> str:
        """Convergence diagnostics in a line."""
        worst = self.diagnostics
        return (
            f"R-hat up to {worst['r_hat'].max():.4f}, at least {worst['ess_bulk'].min():.0f} "
            f"effective draws, k-hat up to {worst['k_hat'].max():.2f}"
        )

    def predict(self, rows: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
        """Steps and step size for traverses of fitted sessions and of new ones.

        A session that was not fitted, such as today's, is predicted from what the campaign's sessions have
        in common and how far they spread.

        Parameters
        ----------
        rows : DataFrame
            A log's columns; steps are not needed.
        seed : int, optional

        Returns
        -------
        DataFrame, indexed as `rows`
            See `Result.predict`. NaN where the fit has not converged or a parameter is not identified.

        Raises
        ------
        InputError
            For a joint or direction that was not fitted, a negative seed, or where the joint may well stall.
        """
        return convert_predictions(self.si.predict(rows, seed=seed), rows, self.machine)

    def _predict(self, rows: pd.DataFrame, seed: int) -> pd.DataFrame:
        check_count("seed", seed, least=0)
        rng = np.random.default_rng(seed)
        predictions = []
        for (joint, direction), subset in rows.groupby(["joint", "direction"], observed=True, sort=False):
            group = (int(joint), str(direction))
            if group not in self.groups:
                fitted = ", ".join(f"{joint} {direction}" for joint, direction in self.groups)
                raise InputError(f"joint {joint}, direction {direction} was not fitted; fitted were {fitted}")
            predictions.append(_predict_group(self, group, subset, rng))
        if not predictions:
            return pd.DataFrame(columns=list(PREDICTION_COLUMNS), dtype=float)
        return pd.concat(predictions).loc[rows.index]

    def campaign_means(self) -> pd.DataFrame:
        """Campaign means of the known parameters: name, joint, direction, estimate, low, high (95 %), SI."""
        tables = []
        for joint, direction in self.groups:
            fit, names = self.result.joints[joint], list(self.priors.prior(joint, direction).names)
            mean = self.draws(joint, direction, "mean")[:, : len(names)]
            low, high = np.quantile(mean, INTERVAL_QUANTILES, axis=0)
            columns = {"estimate": mean.mean(axis=0), "low": low, "high": high}
            table = pd.DataFrame({"name": names, "joint": joint, "direction": direction} | columns)
            known = fit.known[(fit.groups["direction"] == direction).to_numpy(), : len(names)]
            tables.append(table[known.any(axis=0)])
        return pd.concat(tables, ignore_index=True)

    def group_tree(self, joint: int, direction: str) -> DataTree:
        """The tree's branch for a joint and direction."""
        return cast("DataTree", self.tree[group_name(joint, direction)])

    @property
    def groups(self) -> list[tuple[int, str]]:
        """Joints and directions fitted."""
        return list(self.priors.of)

    def draws(self, joint: int, direction: str, name: str) -> Array:
        """Draws of mean, spread, repeatability or parameters, chains end to end; shape (d, ...), SI."""
        return self._drawn(joint, direction, "posterior", name)

    def prior_draws(self, joint: int, direction: str, name: str) -> Array:
        """As `draws`, before the counts were seen; fewer of them."""
        return self._drawn(joint, direction, "prior", name)

    def _drawn(self, joint: int, direction: str, group: str, name: str) -> Array:
        dataset: Dataset = self.group_tree(joint, direction)[group].to_dataset()
        values = dataset[name].to_numpy()
        return values.reshape(-1, *values.shape[2:])

    def sessions(self, joint: int, direction: str) -> list[str]:
        """Sessions that have traverses of a joint in a direction."""
        return [str(each) for each in self.group_tree(joint, direction)["posterior"]["session"].to_numpy()]


@dataclass(frozen=True)
class PosteriorInSI:
    """The tables of a posterior in SI: m and rad, ratios as fractions."""

    posterior: Posterior

    @property
    def parameters(self) -> pd.DataFrame:
        """As `Posterior.parameters`; unit remains the one people read the numbers in."""
        return self.posterior.result.si.parameters

    def predict(self, rows: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
        """As `Posterior.predict`, in rad or m; relative_error and extrapolated as fractions."""
        share = self.posterior.result.extrapolated_share(rows)
        return self.posterior._predict(rows, seed).assign(extrapolated=share)


FORMAT, VERSION = "stickslip-fit/posterior", 1
SCHEMA = f"{FORMAT}/{VERSION}"
DRAWN = ("mean", "spread", "repeatability", "parameters")
MAX_BYTES = 2**33  # of the draws
DRAWS_KEY = "draws_sha256"  # of the result beside the draws: HDF5 itself would not notice a flipped bit


def load_posterior(path: str | Path, *, laws: Laws | None = None) -> Posterior:
    """Read what `Posterior.save` wrote; `laws` as of `load_result`.

    Raises
    ------
    InputError
        If one of the two files cannot be read, is damaged or something else, or was made by a newer version;
        or if the two do not belong together.
    """
    raw = read_file(path, "posterior", MAX_BYTES)
    path = Path(path)
    beside = path.with_suffix(".json")
    content = read_result_json(beside)
    if content.get(DRAWS_KEY) != hashlib.sha256(raw).hexdigest():
        message = f"is no saved posterior, or damaged, or not the one saved with {beside}; fit the log again"
        raise InputError(InputIssue(message, str(path)))
    result = result_from_json(content, beside, laws=laws)
    tree = _read_tree(path)
    version = str(tree.attrs.pop("schema", "")).removeprefix(f"{FORMAT}/")
    if version.isdecimal() and int(version) > VERSION:
        raise InputError(
            InputIssue("was made by a newer version of stickslip-fit; update stickslip-fit", str(path))
        )
    try:
        priors = Priors.from_json(json.loads(tree.attrs.pop("priors")))
        diagnostics = pd.DataFrame(json.loads(tree.attrs.pop("diagnostics")))
        posterior = Posterior(result, tree, priors, diagnostics)
        _check_draws(posterior)
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        message = f"is no saved posterior that can be read ({error!r}); fit the log again"
        raise InputError(InputIssue(message, str(path))) from None
    return posterior


def _read_tree(path: Path) -> DataTree:
    from xarray import open_datatree

    try:
        with open_datatree(path, engine="h5netcdf") as stored:
            return stored.load()
    except Exception as error:  # readers of HDF5 fail in any way on what is none
        message = f"is no netCDF file that can be read ({type(error).__name__}); fit the log again"
        raise InputError(InputIssue(message, str(path))) from None


def _check_draws(posterior: Posterior) -> None:
    """Raise ValueError unless there are finite draws of every parameter of every joint and direction."""
    for joint, direction in posterior.groups:
        fit = posterior.joints[joint]
        p, sessions = len(fit.law.parameters), len(posterior.sessions(joint, direction))
        arrays = [posterior.draws(joint, direction, name) for name in DRAWN]
        count = len(arrays[0])
        shapes = [(count, p), (count, p), (count,), (count, sessions, p)]
        if [array.shape for array in arrays] != shapes or not all(np.isfinite(a).all() for a in arrays):
            raise ValueError(f"the draws of joint {joint}, direction {direction}")


def _predict_group(
    posterior: Posterior, group: tuple[int, str], rows: pd.DataFrame, rng: np.random.Generator
) -> pd.DataFrame:
    values = _draw_parameters(posterior, group, rows, rng)
    repeatability = posterior.draws(*group, "repeatability")
    response = predict_log_steps(posterior.joints[group[0]].law, rows, values)
    if np.any(np.mean(np.isnan(response), axis=0) > INTERVAL_QUANTILES[0]):
        raise InputError(
            f"joint {group[0]}, direction {group[1]} may stall in a traverse that is to be predicted; "
            "log more traverses, or leave this one out"
        )
    response = np.where(np.isnan(response), np.inf, response)  # a joint that stalls takes infinitely many
    total = response + repeatability[:, None] * _stratified_noise(response.shape, rng)
    steps = np.exp(np.median(response, axis=0))
    low, high = np.exp(np.quantile(total, INTERVAL_QUANTILES, axis=0))
    spread = np.nanstd(np.where(np.isinf(response), np.nan, response), axis=0)
    columns = (steps, traverse_length(rows) / steps, spread, low, high)
    predicted = pd.DataFrame(dict(zip(PREDICTION_COLUMNS, columns, strict=True)), index=rows.index)
    fit = posterior.joints[group[0]]
    known = fit.known[(fit.groups["direction"] == group[1]).to_numpy()].all()
    return predicted if known else predicted * np.nan


def _stratified_noise(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Standard normal noise, (d, n), stratified over the d draws for good quantiles."""
    levels = ndtri((np.arange(shape[0]) + 0.5) / shape[0])
    return rng.permuted(np.broadcast_to(levels[:, None], shape), axis=0)


def _draw_parameters(
    posterior: Posterior, group: tuple[int, str], rows: pd.DataFrame, rng: np.random.Generator
) -> Array:
    """Draws of each row's parameters, shape (d, n, p)."""
    fitted, mean, spread = (posterior.draws(*group, name) for name in ("parameters", "mean", "spread"))
    sessions = posterior.sessions(*group)
    new = [session for session in rows["session"].astype(str).unique() if session not in sessions]
    noise = rng.standard_normal((len(mean), len(new), mean.shape[1]))
    of_new = mean[:, None] + spread[:, None] * noise
    index = pd.Index([*sessions, *new]).get_indexer(rows["session"].astype(str))
    return np.concatenate([fitted, of_new], axis=1)[:, index]
