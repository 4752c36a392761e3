"""Which factors matter: day, direction, configuration, normal force, position; and any others, by formula."""

from stickslip_fit.anova import _summary as _summary  # registers how results are summarized
from stickslip_fit.anova.analysis import Anova, analyze_variance, save_records
from stickslip_fit.anova.designs import (
    FactorTestDesign,
    NotTestable,
    choose_all,
    choose_most_informative,
    step_size_observations,
)
from stickslip_fit.anova.factor_test import FactorTest
from stickslip_fit.anova.formula import FormulaTable, analyze_formula
from stickslip_fit.anova.overall import OverallAnalysis
from stickslip_fit.anova.position import PositionAnalysis
from stickslip_fit.anova.term_test import TermTest
from stickslip_fit.anova.variance_components import VarianceComponent, VarianceComponents

__all__ = [
    "Anova",
    "FactorTest",
    "FactorTestDesign",
    "FormulaTable",
    "NotTestable",
    "OverallAnalysis",
    "PositionAnalysis",
    "TermTest",
    "VarianceComponent",
    "VarianceComponents",
    "analyze_formula",
    "analyze_variance",
    "choose_all",
    "choose_most_informative",
    "save_records",
    "step_size_observations",
]
