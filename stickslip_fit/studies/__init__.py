"""Simulated studies: thousands of campaigns with known truth, and which calibration survives what."""

from stickslip_fit.studies import _summary as _summary  # registers how results are summarized
from stickslip_fit.studies.execution import Backend, Cluster, Cores
from stickslip_fit.studies.plan import Scenario, StudyPlan, default_study_strategies, read_study
from stickslip_fit.studies.study import SimulationStudy, run_study, save_study

__all__ = [
    "Backend",
    "Cluster",
    "Cores",
    "Scenario",
    "SimulationStudy",
    "StudyPlan",
    "default_study_strategies",
    "read_study",
    "run_study",
    "save_study",
]
