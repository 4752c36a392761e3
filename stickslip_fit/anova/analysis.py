"""analyze_variance: F tests of day, direction and normal force in a log (thesis Ch. 4 and 5).

Start reading here. Order of reading: `designs`, `factor_test`, `contrasts`, `variance_components`.
P-values are adjusted over all tests by Holm's method. Each test, or the reason why it cannot be made,
is one flat record.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import pandas as pd

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
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.units import from_si

RECORD_COLUMNS = (
    *("analysis", "joint", "direction", "session", "configuration", "F", "df", "error_term", "p_value"),
    *("p_holm", "p_permutation", "p_permutation_floor", "omega_squared", "difference", "levels", "unit"),
    *("low", "high"),
)


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
    """The fields of `RECORD_COLUMNS`, None where one does not apply; difference, low and high in `unit`."""
    design = item.design if isinstance(item, FactorTest) else item
    record: dict[str, object] = dict.fromkeys(RECORD_COLUMNS)
    record |= {name: getattr(design, name) for name in RECORD_COLUMNS[:5]}
    if isinstance(item, NotTestable):
        return record
    unit, effect = item.design.unit, item.effect
    return record | {
        "F": item.statistic,
        "df": [int(df) for df in item.sums.df[1:]],
        "error_term": item.design.error_term,
        "p_value": item.p_value,
        "p_holm": item.p_holm,
        "p_permutation": item.permutation.p_value,
        "p_permutation_floor": item.permutation.floor,
        "omega_squared": float(item.sums.omega_squared),
        "levels": list(item.extreme_levels),
        "unit": unit,
        "difference": from_si(effect.difference, unit),
        "low": from_si(effect.low, unit),
        "high": from_si(effect.high, unit),
    }


@dataclass(frozen=True, repr=False)
class Anova(Summarized):
    """F tests of day, direction and normal force, and variance components.

    Attributes
    ----------
    factor_tests : tuple of FactorTest
    not_testable : tuple of NotTestable
        Tests that the log does not allow, with the reason.
    components : tuple of VarianceComponents
        Of each joint that has them.
    machine : Machine
    """

    factor_tests: tuple[FactorTest, ...]
    not_testable: tuple[NotTestable, ...]
    components: tuple[VarianceComponents, ...] = ()
    machine: Machine = field(default_factory=load_machine)

    def plot_factor(self, joint: int, factor: str) -> AxesArray:
        """One joint's observations by ``day``, ``direction`` or ``normal-force``.

        Raises
        ------
        InputError
            If that was not tested.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.anova import plot_factor

        return collect_axes(plot_factor(joint, factor, self.factor_tests))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each test, those that cannot be made last; columns `RECORD_COLUMNS`."""
        return pd.DataFrame(self.to_json(), columns=list(RECORD_COLUMNS))

    def to_json(self) -> list[dict[str, object]]:
        """One object for each test, null where a field does not apply."""
        return [*map(to_record, self.factor_tests), *map(to_record, self.not_testable)]


def analyze_variance(
    log: Log,
    *,
    joint: int | None = None,
    session: str | None = None,
    choose: ConfigurationChooser = choose_most_informative,
) -> Anova:
    """Test day, direction and normal force for each joint, as in the thesis's Sections 4.2, 4.4 and 5.2.

    Parameters
    ----------
    log : Log
    joint : int, optional
        This joint only.
    session : str, optional
        This session only.
    choose : callable, optional
        Picks the configurations: `choose_most_informative`, one for each joint, or `choose_all`.

    Raises
    ------
    InputError
        If the log has no usable traverse of that joint in that session.
    """
    rows = select_observations(step_size_observations(log), joint, session)
    by_joint = list(rows.groupby("joint"))
    designs = [
        design
        for _, subset in by_joint
        for make_designs in (design_day_tests, design_direction_tests, design_normal_force_tests)
        for design in make_designs(subset, log.machine, choose)
    ]
    components = [estimate_components(subset, log.machine) for _, subset in by_joint]
    estimated = tuple(one for one in components if isinstance(one, VarianceComponents))
    return replace(run_factor_tests(designs), components=estimated, machine=log.machine)


def run_factor_tests(designs: Sequence[FactorTestDesign | NotTestable]) -> Anova:
    """Make the tests, with p-values adjusted over all of them."""
    results = [
        run_factor_test(design) if isinstance(design, FactorTestDesign) else design for design in designs
    ]
    factor_tests = [result for result in results if isinstance(result, FactorTest)]
    adjusted = adjust_holm([test.p_value for test in factor_tests])
    return Anova(
        tuple(replace(test, p_holm=float(p)) for test, p in zip(factor_tests, adjusted, strict=True)),
        tuple(result for result in results if isinstance(result, NotTestable)),
    )
