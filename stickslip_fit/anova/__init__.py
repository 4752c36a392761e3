"""Which factors matter: day, direction, normal force; and any others, by formula."""

from stickslip_fit.anova.analyse import Anova, analyse
from stickslip_fit.anova.answer import Answer
from stickslip_fit.anova.components import Component, Components
from stickslip_fit.anova.formula import FormulaTable, formula
from stickslip_fit.anova.question import Question, Refusal, every, most_read
from stickslip_fit.anova.readings import readings
from stickslip_fit.anova.record import save_records

__all__ = [
    "Anova",
    "Answer",
    "Component",
    "Components",
    "FormulaTable",
    "Question",
    "Refusal",
    "analyse",
    "every",
    "formula",
    "most_read",
    "readings",
    "save_records",
]
