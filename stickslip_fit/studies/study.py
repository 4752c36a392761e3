"""run_study: from a StudyPlan to a SimulationStudy, its summaries over campaigns and its tables.

Read first; then `plan`, `simulation`, `calibration`, `execution`. Intervals are over campaigns.
`save_study` writes all tables as CSV and Parquet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._progress import progress_bar
from stickslip_fit._summary import Summarized
from stickslip_fit.errors import InputError, check_count
from stickslip_fit.estimation.result import AxesArray
from stickslip_fit.strategies.compare import convert_units, save_tables
from stickslip_fit.strategies.statistics import t_half_width
from stickslip_fit.strategies.tip_error import SHARE_COLUMNS
from stickslip_fit.studies.calibration import StudyDesign, design_study
from stickslip_fit.studies.execution import (
    TIP_JOINT,
    Backend,
    Chunk,
    Cores,
    ResultStore,
    current_code_version,
)
from stickslip_fit.studies.plan import StudyPlan
from stickslip_fit.studies.simulation import CAMPAIGN_SPACING
from stickslip_fit.units import from_si

CHUNK_CAMPAIGNS = 100  # campaigns; seconds of work
MAX_ROWS = 200_000  # of all campaigns of a chunk; hundreds of megabytes
MAX_CLOCK_TIME = timedelta(days=365 * 250)  # the campaigns of a chunk follow each other on one clock
CAMPAIGN_QUANTILES = (0.05, 0.95)


def run_study(
    plan: StudyPlan,
    folder: str | Path | None = None,
    backend: Backend = Cores(),  # noqa: B008 - frozen, and without state
    *,
    progress: bool = False,
    command: str = "",
) -> SimulationStudy:
    """Simulate every campaign, calibrate it by every strategy, and compute the prediction errors.

    A campaign depends on the study's seed, its scenario's name and its number alone: the results are the
    same on any backend, and whatever was finished before.

    Parameters
    ----------
    folder : path, optional
        Stores finished chunks of up to a hundred campaigns; a later run in the same folder, even with more
        campaigns or scenarios, computes only what is missing.
    progress : bool, optional
        Show a progress bar where there is a terminal.
    command : str, optional
        Kept in the study's provenance.

    Raises
    ------
    InputError
        If two strategies or scenarios have one name, no strategy suits the plan, a joint stalls, the folder
        cannot be written to, the backend fails, or the number of campaigns or the seed is out of its range.
    """
    for kind, named in (("strategies", plan.strategies), ("scenarios", plan.scenarios)):
        names = [item.name for item in named]
        if not names or len(set(names)) < len(names):
            raise InputError(f"{kind} need names that differ, and there must be one; these are {names}")
    check_count("campaigns", plan.campaigns)
    check_count("seed", plan.seed, least=0)
    design = design_study(plan)
    chunks = make_chunks(plan, design)
    if folder is None:
        tables = dict(_run_chunks(chunks, backend, progress, 0))
    else:
        tables = _load_or_run(chunks, ResultStore(Path(folder), current_code_version()), backend, progress)
    campaigns = pd.concat([tables[k] for k in range(len(chunks))], ignore_index=True)
    return SimulationStudy(plan, design, campaigns, command)


def make_chunks(plan: StudyPlan, design: StudyDesign) -> list[Chunk]:
    """The pieces of a study, scenario by scenario."""
    sessions = plan.plan.sessions
    duration = sessions[-1].begins - sessions[0].begins + CAMPAIGN_SPACING
    rows = len(sessions) * plan.plan.traverses_per_session
    size = max(1, min(CHUNK_CAMPAIGNS, MAX_ROWS // rows, MAX_CLOCK_TIME // duration))
    return [
        Chunk(plan, design, scenario, first, min(first + size, plan.campaigns))
        for scenario in plan.scenarios
        for first in range(0, plan.campaigns, size)
    ]


def _load_or_run(
    chunks: Sequence[Chunk], store: ResultStore, backend: Backend, progress: bool
) -> dict[int, pd.DataFrame]:
    """Each chunk's index and table; missing ones are computed and stored first."""
    missing = [k for k, chunk in enumerate(chunks) if not store.has(chunk)]
    finished = sum(map(len, chunks)) - sum(len(chunks[k]) for k in missing)
    for k, table in _run_chunks([chunks[k] for k in missing], backend, progress, finished):
        store.write(chunks[missing[k]], table)
    return {k: store.read(chunk) for k, chunk in enumerate(chunks)}


def _run_chunks(
    chunks: Sequence[Chunk], backend: Backend, progress: bool, finished: int
) -> Iterator[tuple[int, pd.DataFrame]]:
    total = finished + sum(map(len, chunks))
    bar = progress_bar(
        progress, "{n_fmt} of {total_fmt}{unit}", total=total, initial=finished, unit=" campaigns"
    )
    with bar, closing(backend.run(chunks)) as results:
        for k, table in results:
            bar.update(len(chunks[k]))
            yield k, table


def summarize_step_errors(steps: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Errors of the mean step size, every campaign with the same weight.

    Parameters
    ----------
    steps : DataFrame
        Rows of joints and directions, see `compute_step_size_errors` and `compute_cost`.
    by : sequence of str
        Columns to group by.

    Returns
    -------
    DataFrame
        The columns `by`; campaigns; traverses (each way) and seconds of a session's calibration; failed, the
        share of calibrations that found no parameters; for absolute errors, and relative ones under
        ``_relative``: rms and bias with ``_low`` and ``_high``, 95 % by Student's t over the campaigns, and
        worst, of any campaign; covered, the share of 95 % intervals that hold the truth, with its interval.
        NaN where campaigns are too few.
    """
    means = {"held": steps["covered"]}
    for suffix in ("", "_relative"):
        means |= {f"square{suffix}": steps[f"rms{suffix}"] ** 2, f"sum{suffix}": steps[f"bias{suffix}"]}
    weighted = steps.assign(**{name: value * steps["predictions"] for name, value in means.items()})
    names = ["predictions", "seconds", "sessions", "failed", *means]
    by_campaign = weighted.groupby([*by, "campaign"], sort=False)[names].sum(min_count=1)
    for name in means:
        by_campaign[name] /= by_campaign["predictions"].where(by_campaign["predictions"] > 0)
    groups = by_campaign.groupby(list(by), sort=False)
    size, mean = groups["square"].count(), groups.mean()
    half = groups.std(ddof=1).mul(t_half_width(size) / np.sqrt(size), axis=0)
    summary = pd.DataFrame({"campaigns": groups.size()})
    summary["traverses"] = steps.groupby(list(by), sort=False)["traverses"].mean()
    summary["seconds"], summary["failed"] = mean["seconds"], mean["failed"] / mean["sessions"]
    for suffix in ("", "_relative"):
        square, spread = mean[f"square{suffix}"], half[f"square{suffix}"]
        factor = np.exp(spread / square / 2)
        rms = np.sqrt(square)
        summary[f"rms{suffix}"] = rms
        summary[f"rms{suffix}_low"], summary[f"rms{suffix}_high"] = rms / factor, rms * factor
        bias, spread = mean[f"sum{suffix}"], half[f"sum{suffix}"]
        summary[f"bias{suffix}"] = bias
        summary[f"bias{suffix}_low"], summary[f"bias{suffix}_high"] = bias - spread, bias + spread
        worst = steps.groupby(list(by), sort=False)[f"worst{suffix}"]
        summary[f"worst{suffix}"] = worst.max().where(worst.max() >= -worst.min(), worst.min())
    summary["covered"] = mean["held"]
    summary["covered_low"] = np.maximum(mean["held"] - half["held"], 0.0)
    summary["covered_high"] = np.minimum(mean["held"] + half["held"], 1.0)
    return summary.reset_index()


def summarize_tip_errors(tips: pd.DataFrame) -> pd.DataFrame:
    """The tip's error after moves.

    Parameters
    ----------
    tips : DataFrame
        See `compute_tip_distributions`.

    Returns
    -------
    DataFrame
        scenario, strategy; campaigns; unknown, the share of moves for which a calibration has no steps; in m:
        rms over all moves; median and often (within which half and 95 % of a campaign's moves end) of the
        median campaign; often_low and often_high, between which often lies in nine campaigns of ten; worst of
        all moves; share_1, share_2, share_3 of each joint in the mean square.
    """
    groups = tips.groupby(["scenario", "strategy"], sort=False)
    known = tips["moves"] - tips["unknown"]
    square = tips["rms"] ** 2 * known
    weighted = tips[["scenario", "strategy"]].assign(known=known, square=square)
    weighted[SHARE_COLUMNS] = tips[SHARE_COLUMNS].mul(square, axis=0)
    sums = weighted.groupby(["scenario", "strategy"], sort=False).sum()
    summary = pd.DataFrame({"campaigns": groups.size()})
    summary["unknown"] = groups["unknown"].sum() / groups["moves"].sum()
    summary["rms"] = np.sqrt(sums["square"] / sums["known"].where(sums["known"] > 0))
    summary["median"], summary["often"] = groups["median"].median(), groups["often"].median()
    summary["often_low"], summary["often_high"] = (
        groups["often"].quantile(end) for end in CAMPAIGN_QUANTILES
    )
    summary["worst"] = groups["worst"].max()
    summary[SHARE_COLUMNS] = sums[SHARE_COLUMNS].div(sums["square"], axis=0)
    return summary.reset_index()


@dataclass(frozen=True, eq=False, repr=False)
class SimulationStudy(Summarized):
    """What `run_study` returns; SI.

    Attributes
    ----------
    campaigns : DataFrame
        See `Chunk.run`: a row for each campaign, strategy, joint and direction, and for the tip.
    command : str
        As typed; empty where the study was made in a notebook.
    """

    plan: StudyPlan
    design: StudyDesign
    campaigns: pd.DataFrame
    command: str = ""

    def plot_errors(self) -> AxesArray:
        """Calibration time against the error of the mean step size, scenario by scenario."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.strategies import plot_study_errors

        return collect_axes(plot_study_errors(self))

    def plot_tips(self) -> AxesArray:
        """The tip's error after open-loop moves, by scenario and strategy.

        Raises
        ------
        InputError
            If the study made no moves.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.strategies import plot_study_tips

        return collect_axes(plot_study_tips(self))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints that at least one strategy can calibrate."""
        return tuple(int(joint) for joint in sorted(self.campaigns["joint"].unique()) if joint != TIP_JOINT)

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""
        return tuple(scenario.name for scenario in self.plan.scenarios)

    def strategies(self, joint: int) -> tuple[str, ...]:
        """Names of the strategies that suit a joint."""
        present = set(self.campaigns.loc[self.campaigns["joint"] == joint, "strategy"])
        return tuple(strategy.name for strategy in self.plan.strategies if strategy.name in present)

    def accuracy(self, *by: str) -> pd.DataFrame:
        """Errors of the mean step size by scenario, joint and strategy, and by further columns.

        Parameters
        ----------
        *by : str
            None, or ``"direction"``.

        Returns
        -------
        DataFrame
            See `summarize_step_errors`.
        """
        steps = self.campaigns[self.campaigns["joint"] != TIP_JOINT]
        return summarize_step_errors(steps, ["scenario", "joint", "strategy", *by])

    def tips(self) -> pd.DataFrame:
        """The tip's errors by scenario and strategy, see `summarize_tip_errors`; empty without moves."""
        tips = self.campaigns[self.campaigns["joint"] == TIP_JOINT]
        return summarize_tip_errors(tips) if len(tips) else tips


LENGTH_COLUMNS = ("rms", "median", "often", "often_low", "often_high", "worst", "bias")


def make_tables(study: SimulationStudy) -> dict[str, pd.DataFrame]:
    """All tables of a study by name, in people's units.

    Angles and lengths of step sizes are in what the column unit says, those of the tip in µm, relative
    numbers in % under names that end so.
    """
    of_tip = study.campaigns["joint"] == TIP_JOINT
    campaigns = study.campaigns[~of_tip].dropna(axis=1, how="all")
    tips = study.campaigns[of_tip].drop(columns=["joint", "direction"]).dropna(axis=1, how="all")
    tables = {
        "campaigns": convert_units(campaigns.astype({"sessions": int, "failed": int, "predictions": int})),
        "accuracy": convert_units(study.accuracy()),
        "accuracy_by_direction": convert_units(study.accuracy("direction")),
        "left_out": study.design.left_out,
    }
    if len(tips):
        tables |= {"tip_campaigns": _convert_tip_units(tips), "tip": _convert_tip_units(study.tips())}
    return tables


def save_study(study: SimulationStudy, folder: str | Path) -> list[Path]:
    """Write each table as CSV and as Parquet; the folder is made if it does not exist.

    Raises
    ------
    InputError
        If the folder cannot be made or written to.
    """
    return save_tables(make_tables(study), folder)


def _convert_tip_units(table: pd.DataFrame) -> pd.DataFrame:
    columns = {}
    for name in table:
        if name in LENGTH_COLUMNS:
            columns[f"{name}_um"] = from_si(table[name].to_numpy(float), "µm")
        elif name in SHARE_COLUMNS:
            columns[f"{name}_pct"] = 100 * table[name].to_numpy(float)
        else:
            columns[str(name)] = table[name]
    return pd.DataFrame(columns)
