"""Tip errors: how far open-loop moves with a strategy's calibration end from their targets.

Errors are split along and across the move, and by joint: e' J dq / |e|, with J the Jacobian halfway
between the planned and the true position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._format import format_number
from stickslip_fit._summary import Column, Section, Summarized, Summary, Table, numbers
from stickslip_fit._typing import Array
from stickslip_fit.logs.plan import NoiseKind
from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves import StepModel, TipPaths, TrueLaws, plan_steps, simulate_open_loop
from stickslip_fit.moves.path import decompose
from stickslip_fit.simulation import draw_noise
from stickslip_fit.simulation.truth import Group
from stickslip_fit.units import JOINTS

TIP_QUANTILE = 0.95
JOINT_COLUMNS = [f"joint_{joint}" for joint in JOINTS]
SHARE_COLUMNS = [f"share_{joint}" for joint in JOINTS]


@dataclass(frozen=True, eq=False, repr=False)
class TipErrors(Summarized):
    """Where the tip ended after each move, less the target.

    Attributes
    ----------
    table : DataFrame
        A row for each strategy, session and move, in this order: strategy (categorical), number (index of the
        session), move (index of the path); in m: along the move (above 0: too far), across it (length),
        size; and joint_1, joint_2, joint_3, each joint's contribution to the size, which add up to it to
        first order. NaN where a calibration gives no steps.
    """

    table: pd.DataFrame

    def summary(self) -> Summary:
        """The distribution of each strategy's errors."""
        columns = (
            Column("strategy", text=True),
            *numbers("moves", "unknown"),
            *(Column(head, "µm") for head in ("rms", "median", "95 % within", "worst", "along")),
            *(Column(f"joint {joint}", "%", "share of the mean square") for joint in JOINTS),
        )
        rows = tuple(
            (
                str(row["strategy"]),
                f"{row['moves']:,}",
                f"{row['unknown']:,}",
                *(format_number(row[name], "µm") for name in ("rms", "median", "often", "worst", "bias")),
                *(format_number(row[f"share_{joint}"], "%", 0) for joint in JOINTS),
            )
            for _, row in self.distribution().iterrows()
        )
        table = Table("Distance from where each move was to end", columns, rows)
        return Summary("Tip errors", sections=(Section(tables=(table,)),))

    def distribution(self, *by: str) -> pd.DataFrame:
        """The distribution of each strategy's errors.

        Parameters
        ----------
        by : str
            Columns to group by besides, such as ``number`` for each session by itself.

        Returns
        -------
        DataFrame
            strategy and the columns `by`; moves; unknown, how many of them a calibration has no steps for;
            of the others, in m: rms, median, often (95 % of the errors are smaller), worst, and bias, the
            mean along the move; share_1, share_2, share_3 of each joint in the mean square.
        """
        squares = self.table[["size", *JOINT_COLUMNS]].mul(self.table["size"], axis=0).add_prefix("square_")
        groups = self.table.join(squares).groupby(["strategy", *by], observed=True, sort=False)
        size, square = groups["size"], groups["square_size"].mean()
        columns = {
            "moves": groups.size(),
            "unknown": groups.size() - size.count(),
            "rms": np.sqrt(square),
            "median": size.median(),
            "often": size.quantile(TIP_QUANTILE),
            "worst": size.max(),
            "bias": groups["along"].mean(),
        }
        for share, name in zip(SHARE_COLUMNS, JOINT_COLUMNS, strict=True):
            columns[share] = groups[f"square_{name}"].mean() / square
        return pd.DataFrame(columns).reset_index()


def compute_tip_errors(
    paths: TipPaths,
    truth: TrueLaws,
    calibrations: Mapping[str, Mapping[Group, StepModel]],
    seeds: Sequence[int | np.random.SeedSequence],
    kind: NoiseKind = "gaussian",
) -> TipErrors:
    """Make every move in every session with each strategy's calibration, and compare the tip with the target.

    A session's noise is the same for all strategies and depends on that session's seed alone, so that
    sessions may be computed together or one by one.

    Parameters
    ----------
    paths : TipPaths
        Such as `moves.draw_random_paths` draws.
    truth : TrueLaws
        Of c sessions, which may be those of many campaigns.
    calibrations : mapping of str to mapping of (int, str) to callable
        By strategy, then by joint and direction: rows to steps, see
        `moves.step_model_from_parameters`.
    seeds : sequence, length c
    kind : {'gaussian', 't5'}, optional
        Distribution of the noise.

    Raises
    ------
    InputError
        If a calibration is missing, or a joint stalls under the true laws.

    Examples
    --------
    Joint 3's step size is taken to be 1 % too large in `+`. Otherwise the calibration is right, and what
    remains is the rounding to whole steps:

    >>> from stickslip_fit.laws import Base, Elbow, Prismatic
    >>> from stickslip_fit.machine import load_machine
    >>> from stickslip_fit.moves import draw_random_paths, step_model_from_parameters
    >>> machine = load_machine()
    >>> laws = {1: Base(machine), 2: Elbow(machine), 3: Prismatic()}
    >>> usual = {1: [96e-6, 0, 0, 0], 2: [95e-6, 90e-6, 0, 0], 3: [976e-9, 0.3, 438e-9]}
    >>> values = {(joint, direction): np.array(usual[joint]) for joint in laws for direction in "+-"}
    >>> right = {group: step_model_from_parameters(laws[group[0]], own) for group, own in values.items()}
    >>> wrong = right | {(3, "+"): step_model_from_parameters(laws[3], values[3, "+"] * [1.01, 1.0, 1.01])}
    >>> paths = draw_random_paths(machine, count=200, seed=1)
    >>> truth = TrueLaws(["Monday"], laws, values)
    >>> errors = compute_tip_errors(paths, truth, {"right": right, "wrong": wrong}, [1])
    >>> errors.distribution("number")[["strategy", "number", "moves"]]
      strategy  number  moves
    0    right       0    200
    1    wrong       0    200
    >>> for _, row in errors.distribution().iterrows():
    ...     print(f"{row.strategy}: rms {row.rms * 1e6:.1f} µm, {row.share_3:.0%} of the square joint 3's")
    right: rms 1.9 µm, 2% of the square joint 3's
    wrong: rms 4.4 µm, 81% of the square joint 3's
    """
    count, size = len(truth.sessions), (len(paths), len(paths.order))
    noise = np.stack(
        [draw_noise(kind, size[0] * size[1], np.random.default_rng(seed)).reshape(size) for seed in seeds]
    )
    tables = []
    for steps_for in calibrations.values():
        steps = plan_steps(paths, steps_for, truth.sessions, truth.conditions)
        errors = _decompose_errors(paths, simulate_open_loop(paths, truth, steps, noise))
        tables.append(pd.DataFrame({column: of.ravel() for column, of in errors.items()}))
    table = pd.concat(tables, ignore_index=True)
    number, move = np.divmod(np.arange(count * len(paths)), len(paths))
    strategy_index = np.arange(len(calibrations)).repeat(len(number))
    table.insert(0, "strategy", pd.Categorical.from_codes(strategy_index, list(calibrations)))
    table.insert(1, "number", np.tile(number, len(calibrations)))
    table.insert(2, "move", np.tile(move, len(calibrations)))
    return TipErrors(table)


def _decompose_errors(paths: TipPaths, q: Array) -> dict[str, Array]:
    """Errors by column from where the joints end, shape (c, m, 3)."""
    target = paths.joint_positions[:, -1]
    error = forward(paths.machine, q) - paths.tips[:, -1]
    along, across = decompose(error, paths.direction)
    size = np.linalg.norm(error, axis=-1)
    jacobians = jacobian(paths.machine, (q + target) / 2)
    unit_error = error / np.where(size > 0, size, 1.0)[..., None]
    by_joint = np.einsum("cmx,cmxj->cmj", unit_error, jacobians) * (q - target)
    contributions = dict(zip(JOINT_COLUMNS, np.moveaxis(by_joint, -1, 0), strict=True))
    return {"along": along, "across": across, "size": size} | contributions
