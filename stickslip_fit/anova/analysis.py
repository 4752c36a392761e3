"""analyze_variance: F tests of day, direction and normal force in a log (thesis Ch. 4 and 5).

Start reading here. Order of reading: `designs`, `factor_test`, `contrasts`, `variance_components`.
P-values are adjusted over all tests by Holm's method. Each test, or the reason why it cannot be made,
is one flat record.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from stickslip_fit._format import step_unit
from stickslip_fit._io import write_atomically
from stickslip_fit._summary import Summarized
from stickslip_fit.anova.contrasts import adjust_holm
from stickslip_fit.anova.designs import (
    ConfigurationChooser,
    FactorTestDesign,
    NotTestable,
    choose_most_informative,
    design_day_tests,
    design_direction_tests,
    design_normal_force_tests,
    select_observations,
    step_size_observations,
)
from stickslip_fit.anova.factor_test import FactorTest, run_factor_test
from stickslip_fit.anova.variance_components import VarianceComponents, estimate_components
from stickslip_fit.estimation.result import AxesArray
from stickslip_fit.logs import Log
from stickslip_fit.units import from_si

RECORD_COLUMNS = (
    "analysis", "joint", "direction", "session", "configuration", "F", "df", "error_term", "p_value",
    "p_holm", "p_permutation", "p_permutation_floor", "omega_squared", "difference", "levels", "unit",
    "low", "high",
)  # fmt: skip


def save_records(records: Sequence[Mapping[str, object]], path: str | Path) -> None:
    """Write records as a JSON list.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    text = json.dumps(list(records), indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(path, text + "\n")


def to_record(item: FactorTest | NotTestable) -> dict[str, object]:
    """The fields of `COLUMNS`, None where one does not apply; difference, low and high in `unit`."""
    design = item.design if isinstance(item, FactorTest) else item
    record: dict[str, object] = dict.fromkeys(RECORD_COLUMNS)
    record |= {name: getattr(design, name) for name in RECORD_COLUMNS[:5]}
    if isinstance(item, NotTestable):
        return record
    unit = step_unit(item.design.joint)
    effect, permutation = item.effect, item.permutation
    return record | {
        "F": item.statistic,
        "df": [int(df) for df in item.squares.df[1:]],
        "error_term": item.design.error_term,
        "p_value": item.p_value,
        "p_holm": item.p_holm,
        "p_permutation": permutation.p_value,
        "p_permutation_floor": permutation.floor,
        "omega_squared": float(item.squares.omega_squared),
        "levels": list(item.extreme_levels),
        "unit": unit,
        "difference": from_si(effect.difference, unit),
        "low": from_si(effect.low, unit),
        "high": from_si(effect.high, unit),
    }


@dataclass(frozen=True, repr=False)
class Anova(Summarized):
    """What a log says of day, direction and normal force.

    Attributes
    ----------
    answers : tuple of Answer
    refusals : tuple of Refusal
        What was asked and cannot be answered, with the reason.
    components : tuple of Components
        Variance components of each joint that has them.
    """

    answers: tuple[FactorTest, ...]
    not_testable: tuple[NotTestable, ...]
    components: tuple[VarianceComponents, ...] = ()

    def plot_factor(self, joint: int, factor: str) -> AxesArray:
        """One joint's readings by ``day``, ``direction`` or ``normal-force``.

        Raises
        ------
        InputError
            If that was not answered.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.anova import plot_factor

        return collect_axes(plot_factor(joint, factor, self.answers))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each question, the refused ones last; see `record.record`."""
        return pd.DataFrame(self.to_json(), columns=list(RECORD_COLUMNS))

    def to_json(self) -> list[dict[str, object]]:
        """One object for each question, in people's units, null where a field does not apply."""
        return [*map(to_record, self.answers), *map(to_record, self.not_testable)]


def analyze_variance(
    log: Log,
    *,
    joint: int | None = None,
    session: str | None = None,
    choose: ConfigurationChooser = choose_most_informative,
) -> Anova:
    """Ask the thesis's three questions of each joint.

    Parameters
    ----------
    log : Log
    joint : {1, 2, 3}, optional
        Ask of this joint only.
    session : str, optional
        Ask within this session only.
    choose : callable, optional
        Picks the configurations at which they are asked: `question.most_read`, one for each joint, or
        `question.every`.

    Raises
    ------
    InputError
        If the log has no usable traverse of that joint in that session.
    """
    rows = select_observations(step_size_observations(log), joint, session)
    designs = [
        each
        for number, subset in rows.groupby("joint")
        for ask in (design_day_tests, design_direction_tests, design_normal_force_tests)
        for each in ask(subset, log.machine.span(int(number)), choose)
    ]
    found = [estimate_components(subset) for _, subset in rows.groupby("joint")]
    return replace(
        run_factor_tests(designs),
        components=tuple(each for each in found if isinstance(each, VarianceComponents)),
    )


def run_factor_tests(designs: Sequence[FactorTestDesign | NotTestable]) -> Anova:
    """Answer questions, with p-values adjusted for all of them."""
    results = [run_factor_test(each) if isinstance(each, FactorTestDesign) else each for each in designs]
    factor_tests = [each for each in results if isinstance(each, FactorTest)]
    adjusted = adjust_holm([each.p_value for each in factor_tests])
    return Anova(
        tuple(replace(each, p_holm=float(p)) for each, p in zip(factor_tests, adjusted, strict=True)),
        tuple(each for each in results if isinstance(each, NotTestable)),
    )
