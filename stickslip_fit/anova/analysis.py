"""analyze_variance: F tests of day, direction, normal force (thesis Ch. 4 and 5) and position in a log.

Start reading here. Order of reading: `overall`, `term_test`, `designs`, `factor_test`, `contrasts`,
`position`, `variance_components`.
P-values are adjusted over all tests by Holm's method. Each test, or the reason why it cannot be made,
is one flat record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import expm1
from pathlib import Path

import pandas as pd

from stickslip_fit._json import write_json
from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._summary import Summarized
from stickslip_fit._threads import one_blas_thread
from stickslip_fit.anova.contrasts import adjust_holm, holm_levels
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
from stickslip_fit.anova.overall import OVERALL, OverallAnalysis, analyze_overall
from stickslip_fit.anova.position import PositionAnalysis, analyze_positions
from stickslip_fit.anova.term_test import TermTest
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
    write_json(path, list(records))


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


def term_record(test: TermTest, analysis: OverallAnalysis | PositionAnalysis) -> dict[str, object]:
    """As `to_record`, of a term of a model of all traverses; difference, low and high in per cent."""
    record: dict[str, object] = dict.fromkeys(RECORD_COLUMNS)
    name = f"{OVERALL}: {test.term}" if isinstance(analysis, OverallAnalysis) else test.term
    record |= {"analysis": name, "joint": analysis.joint, "F": test.statistic, "df": list(test.df)}
    record |= {"error_term": test.error_term, "p_value": test.p_value, "p_holm": test.p_holm}
    record |= {"omega_squared": test.omega_squared, "unit": "%"}
    if test.effect is not None:
        sizes = {name: getattr(test.effect, name) for name in ("difference", "low", "high")}
        record |= {name: 100.0 * expm1(value) for name, value in sizes.items()}
        record["levels"] = list(test.extreme_levels)
    return record


@dataclass(frozen=True, repr=False)
class Anova(Summarized):
    """F tests of day, direction, normal force and position, and variance components.

    Attributes
    ----------
    factor_tests : tuple of FactorTest
    not_testable : tuple of NotTestable
        Tests that the log does not allow, with the reason.
    observations : tuple of DataFrame
        Of each joint; see `step_size_observations`.
    overall : tuple of OverallAnalysis
        Of each joint whose traverses suffice, all of them together.
    positions : tuple of PositionAnalysis
        Of each joint that was driven over several stretches.
    machine : Machine
    """

    factor_tests: tuple[FactorTest, ...]
    not_testable: tuple[NotTestable, ...]
    observations: tuple[pd.DataFrame, ...] = ()
    overall: tuple[OverallAnalysis, ...] = ()
    positions: tuple[PositionAnalysis, ...] = ()
    machine: Machine = field(default_factory=load_machine)

    @property
    def models(self) -> tuple[OverallAnalysis | PositionAnalysis, ...]:
        """The analyses of more than one configuration."""
        return (*self.overall, *self.positions)

    def shown_terms(self, joint: int) -> set[str]:
        """The terms that all traverses of a joint together show."""
        models = [each for each in self.overall if each.joint == joint]
        return {test.term for each in models for test in each.tests if test.is_significant}

    @cached_property
    def components(self) -> tuple[VarianceComponents, ...]:
        """Variance components of each joint that has them."""
        found = [estimate_components(rows, self.machine) for rows in self.observations]
        return tuple(one for one in found if isinstance(one, VarianceComponents))

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
        terms = [term_record(test, each) for each in self.models for test in each.tests]
        return [*map(to_record, self.factor_tests), *terms, *map(to_record, self.not_testable)]


POSITION_SHARE = 0.5  # of the time


@one_blas_thread
def analyze_variance(
    log: Log,
    *,
    joint: int | None = None,
    session: str | None = None,
    choose: ConfigurationChooser = choose_most_informative,
    progress: ProgressCallback = ignore_progress,
) -> Anova:
    """Test day, direction, configuration, normal force and position for each joint.

    Day, direction and configuration by all traverses together; day, direction and normal force also at one
    configuration, as in the thesis's Sections 4.2, 4.4 and 5.2; position over all stretches of the travel.

    Parameters
    ----------
    log : Log
    joint : int, optional
        This joint only.
    session : str, optional
        This session only.
    choose : callable, optional
        Picks the configurations: `choose_most_informative`, one for each joint, or `choose_all`.
    progress : callable, optional
        Called with each step that begins and the share of the work that is done.

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
    overall: list[OverallAnalysis] = []
    positions: list[PositionAnalysis] = []
    refused: list[NotTestable] = []
    for done, (number, subset) in enumerate(by_joint):
        progress(f"all traverses, joint {number}", POSITION_SHARE * done / len(by_joint))
        whole, reasons = analyze_overall(subset, log.machine)
        along, more = analyze_positions(subset, log.machine)
        overall += [] if whole is None else [whole]
        positions += [] if along is None else [along]
        refused += [*reasons, *more]
    progress("factors", POSITION_SHARE)
    anova = run_factor_tests([*designs, *refused], overall, positions)
    return replace(anova, observations=tuple(subset for _, subset in by_joint), machine=log.machine)


def run_factor_tests(
    designs: Sequence[FactorTestDesign | NotTestable],
    overall: Sequence[OverallAnalysis] = (),
    positions: Sequence[PositionAnalysis] = (),
) -> Anova:
    """Make the tests, with p-values adjusted over all of them and those of `overall` and `positions`."""
    results = [
        run_factor_test(design) if isinstance(design, FactorTestDesign) else design for design in designs
    ]
    factor_tests = [result for result in results if isinstance(result, FactorTest)]
    p_values = [test.p_value for test in factor_tests]
    for tests in (*(each.tests for each in overall), *(each.tests for each in positions)):
        p_values += [test.p_value for test in tests]
    decisions = zip(map(float, adjust_holm(p_values)), map(float, holm_levels(p_values)), strict=True)

    def decide[Test: (FactorTest, TermTest)](tests: Sequence[Test]) -> tuple[Test, ...]:
        return tuple(
            replace(test, p_holm=p_holm, level=level)
            for test, (p_holm, level) in zip(tests, decisions, strict=False)
        )

    # In the order of the p-values.
    return Anova(
        decide(factor_tests),
        tuple(result for result in results if isinstance(result, NotTestable)),
        overall=tuple(replace(each, tests=decide(each.tests)) for each in overall),
        positions=tuple(replace(each, tests=decide(each.tests)) for each in positions),
    )
