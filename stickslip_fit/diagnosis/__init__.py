"""What the laws get wrong in a log or a table: show it, name the cause, extend the law, measure the gain."""

from stickslip_fit.diagnosis import _summary as _summary  # registers how results are summarized
from stickslip_fit.diagnosis._json import save_diagnosis
from stickslip_fit.diagnosis.experiments import next_experiment
from stickslip_fit.diagnosis.finding import Finding, Gain, NextTraverse, TableInfo
from stickslip_fit.diagnosis.pipeline import diagnose
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.table import diagnose_table, fit_table

__all__ = [
    "Diagnosis",
    "Finding",
    "Gain",
    "NextTraverse",
    "TableInfo",
    "diagnose",
    "diagnose_table",
    "fit_table",
    "next_experiment",
    "save_diagnosis",
]
