"""SimulationStudy: the result of `run_study`, its summaries over campaigns, its tables and its text.

Intervals are over campaigns. A strategy is accurate enough in a scenario if the upper limit of its rms
error is below the limit of the plan. `save_study` writes all tables as CSV and Parquet.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._format import format_value
from stickslip_fit._io import write_atomically
from stickslip_fit._summary import Summarized
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.estimation.result import AxesArray
from stickslip_fit.strategies.compare import convert_units
from stickslip_fit.strategies.statistics import t_half_width
from stickslip_fit.studies.calibration import StudyDesign
from stickslip_fit.studies.execution import TIP_JOINT
from stickslip_fit.studies.plan import StudyPlan
from stickslip_fit.units import JOINTS, from_si

CAMPAIGN_QUANTILES = (0.05, 0.95)


def summarize_step_errors(steps: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Errors of the mean step size, every campaign counting alike.

    Parameters
    ----------
    steps : DataFrame
        Rows of joints and directions, see `step_size_errors` and `spent`.
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
    work = steps.assign(
        **{f"square{end}": steps[f"rms{end}"] ** 2 * steps["predictions"] for end in ("", "_relative")},
        **{f"sum{end}": steps[f"bias{end}"] * steps["predictions"] for end in ("", "_relative")},
        held=steps["covered"] * steps["predictions"],
    )
    names = ["predictions", "seconds", "sessions", "failed", "held"]
    names += [f"{kind}{end}" for kind in ("square", "sum") for end in ("", "_relative")]
    each = work.groupby([*by, "campaign"], sort=False)[names].sum(min_count=1)
    for name in ("held", "square", "sum", "square_relative", "sum_relative"):
        each[name] /= each["predictions"].where(each["predictions"] > 0)
    groups = each.groupby(list(by), sort=False)
    size, mean = groups["square"].count(), groups.mean()
    half = groups.std(ddof=1).mul(t_half_width(size) / np.sqrt(size), axis=0)
    found = pd.DataFrame({"campaigns": groups.size()})
    found["traverses"] = steps.groupby(list(by), sort=False)["traverses"].mean()
    found["seconds"], found["failed"] = mean["seconds"], mean["failed"] / mean["sessions"]
    for end in ("", "_relative"):
        square, spread = mean[f"square{end}"], half[f"square{end}"]
        factor = np.exp(spread / square / 2)
        root = np.sqrt(square)
        found[f"rms{end}"] = root
        found[f"rms{end}_low"], found[f"rms{end}_high"] = root / factor, root * factor
        bias, spread = mean[f"sum{end}"], half[f"sum{end}"]
        found[f"bias{end}"] = bias
        found[f"bias{end}_low"], found[f"bias{end}_high"] = bias - spread, bias + spread
        worst = steps.groupby(list(by), sort=False)[f"worst{end}"]
        found[f"worst{end}"] = worst.max().where(worst.max() >= -worst.min(), worst.min())
    found["covered"] = mean["held"]
    found["covered_low"] = np.maximum(mean["held"] - half["held"], 0.0)
    found["covered_high"] = np.minimum(mean["held"] + half["held"], 1.0)
    return found.reset_index()


def summarize_tip_errors(tips: pd.DataFrame) -> pd.DataFrame:
    """The tip's error after moves.

    Parameters
    ----------
    tips : DataFrame
        See `tip_distributions`.

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
    for joint in JOINTS:
        weighted[f"share_{joint}"] = tips[f"share_{joint}"] * square
    sums = weighted.groupby(["scenario", "strategy"], sort=False).sum()
    found = pd.DataFrame({"campaigns": groups.size()})
    found["unknown"] = groups["unknown"].sum() / groups["moves"].sum()
    found["rms"] = np.sqrt(sums["square"] / sums["known"].where(sums["known"] > 0))
    found["median"], found["often"] = groups["median"].median(), groups["often"].median()
    found["often_low"], found["often_high"] = (groups["often"].quantile(end) for end in CAMPAIGN_QUANTILES)
    found["worst"] = groups["worst"].max()
    for joint in JOINTS:
        found[f"share_{joint}"] = sums[f"share_{joint}"] / sums["square"]
    return found.reset_index()


@dataclass(frozen=True, eq=False, repr=False)
class SimulationStudy(Summarized):
    """What `run_study` returns; SI.

    Attributes
    ----------
    plan : StudyPlan
    design : Design
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
        there = set(self.campaigns.loc[self.campaigns["joint"] == joint, "strategy"])
        return tuple(each.name for each in self.plan.strategies if each.name in there)

    def accuracy(self, *by: str) -> pd.DataFrame:
        """Errors of the mean step size by scenario, joint and strategy, and by further columns.

        Parameters
        ----------
        *by : str
            None, or ``"direction"``.

        Returns
        -------
        DataFrame
            See `summary.summarise`.
        """
        steps = self.campaigns[self.campaigns["joint"] != TIP_JOINT]
        return summarize_step_errors(steps, ["scenario", "joint", "strategy", *by])

    def tips(self) -> pd.DataFrame:
        """The tip's errors by scenario and strategy, see `summary.summarise_tips`; empty without moves."""
        tips = self.campaigns[self.campaigns["joint"] == TIP_JOINT]
        return summarize_tip_errors(tips) if len(tips) else tips


LENGTH_COLUMNS = ("rms", "median", "often", "often_low", "often_high", "worst", "bias")
SHARE_COLUMNS = tuple(f"share_{joint}" for joint in JOINTS)


def make_tables(found: SimulationStudy) -> dict[str, pd.DataFrame]:
    """All tables of a study by name, in people's units.

    Angles and lengths of step sizes are in what the column unit says, those of the tip in µm, relative
    numbers in % under names that end so.
    """
    of_tip = found.campaigns["joint"] == TIP_JOINT
    campaigns = found.campaigns[~of_tip].dropna(axis=1, how="all")
    tips = found.campaigns[of_tip].drop(columns=["joint", "direction"]).dropna(axis=1, how="all")
    shown = {
        "campaigns": convert_units(campaigns.astype({"sessions": int, "failed": int, "predictions": int})),
        "accuracy": convert_units(found.accuracy()),
        "accuracy_by_direction": convert_units(found.accuracy("direction")),
        "left_out": found.design.left_out,
    }
    if len(tips):
        shown |= {"tip_campaigns": _convert_tip_units(tips), "tip": _convert_tip_units(found.tips())}
    return shown


def save_study(found: SimulationStudy, folder: str | Path) -> list[Path]:
    """Write each table as CSV and as Parquet; the folder is made where it is not there.

    Raises
    ------
    InputError
        If the folder cannot be made or written to.
    """
    folder = Path(folder)
    make_folder(folder)
    written = []
    for name, table in make_tables(found).items():
        stream = io.BytesIO()
        table.to_parquet(stream, index=False)
        for suffix, content in ((".csv", table.to_csv(index=False)), (".parquet", stream.getvalue())):
            written.append(folder / f"{name}{suffix}")
            write_atomically(written[-1], content)
    return written


def make_folder(folder: Path) -> None:
    """Make a folder in an existing one, unless it is there.

    Raises
    ------
    InputError
        If it cannot be made.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        message = f"cannot be made ({error.strerror}); name a folder in an existing one"
        raise InputError(InputIssue(message, str(folder))) from None


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


MIN_COVERAGE = 0.9  # share of 95 % intervals that hold the truth, below which nobody should believe them


def write_study_headline(found: SimulationStudy, joint: int) -> str:
    """What a lab can act on, in a few sentences."""
    table, limit = rows_of_joint(found.accuracy(), joint), found.plan.good_enough
    good = {scenario: select_accurate(table, scenario, limit) for scenario in found.scenarios}
    lasting = [name for name in good[found.scenarios[0]] if all(name in own for own in good.values())]
    count = len(found.scenarios)
    never = [name for name in found.strategies(joint) if not any(name in own for own in good.values())]
    whatever = f" in {'all ' * (count > 1)}{count} scenario{'s' * (count > 1)}"
    told = [f"Within {100 * limit:g} % rms{whatever}: {_join_names(lasting) or 'none'}."]
    if lasting:
        told.append(
            f"The cheapest, {lasting[0]}, takes {calibration_minutes(table, lasting[0]):.0f} min a session."
        )
    if never:
        told.append(f"In none: {_join_names(never)}.")
    for scenario, own in good.items():
        lost = [name for name in found.strategies(joint) if name not in own and name not in never]
        if not own:
            told.append(f"With {scenario}, the least wrong is {_describe_best(table, scenario)}.")
        elif lost:
            told.append(f"Lost to {scenario}: {_join_names(lost)}.")
    return " ".join([*told, *_describe_undercoverage(table, found)])


def select_accurate(table: pd.DataFrame, scenario: str, good_enough: float) -> list[str]:
    """Strategies of a joint whose rms error is sure to be good enough, the cheapest first."""
    subset = table[table["scenario"] == scenario].sort_values("seconds", kind="stable")
    # One campaign has no interval.
    high = subset["rms_relative_high"].fillna(subset["rms_relative"])
    return list(subset.loc[high <= good_enough, "strategy"])


def rows_of_joint(table: pd.DataFrame, joint: int) -> pd.DataFrame:
    """The rows of a joint."""
    return table[table["joint"] == joint]


def calibration_minutes(table: pd.DataFrame, strategy: str) -> float:
    """What a strategy's calibration of a session takes, over all scenarios."""
    return float(table.loc[table["strategy"] == strategy, "seconds"].mean()) / 60


def _describe_best(table: pd.DataFrame, scenario: str) -> str:
    subset = table[table["scenario"] == scenario]
    best = subset.loc[subset["rms_relative"].idxmin()]
    return f"{best['strategy']} ({format_value(best['rms_relative'], '%', 2)})"


def _describe_undercoverage(table: pd.DataFrame, found: SimulationStudy) -> list[str]:
    """Where intervals cannot be believed any more that could while nothing was hidden."""
    by = table.pivot(index="strategy", columns="scenario", values="covered")
    plain = [scenario.name for scenario in found.plan.scenarios if not scenario.causes]
    honest = by[(by[plain] >= MIN_COVERAGE).all(axis=1)] if plain else by
    lowest = honest.min()
    broken = [
        f"{scenario} (down to {format_value(lowest[scenario], '%', 0)})"
        for scenario in found.scenarios
        if lowest[scenario] < MIN_COVERAGE
    ]
    if not broken:
        return []
    return [f"Stated 95 % intervals hold the truth too rarely with {_join_names(broken)}."]


def _join_names(names: Sequence[str]) -> str:
    return "; ".join(names)
